"""Before numpy is loaded, here and in started processes: matrices are small, and threads of BLAS only wait for each other."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
