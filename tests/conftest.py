"""Before numpy is loaded, here and in started processes: matrices are small, and threads of BLAS only wait for each other."""

import os

from hypothesis import settings

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# what is printed is compared with English, whatever the language of the machine
os.environ["LANGUAGE"] = "en"
# how long an example takes says more of what else the machine does
settings.register_profile("unhurried", deadline=None)
settings.load_profile("unhurried")
