"""Compiled numerics: floats and arrays in, floats and a status out; no exceptions, no objects.

Conventions of every kernel
---------------------------
* Millimetres and radians. A 3-vector is a tuple of three floats; a pose is a row `x, y, z, qx, qy, qz, qw`
  (base_from_tool, unit quaternion).
* What cannot exist is NaN, never an exception: the callers turn it into an error or a status.
* Compiled code is kept between runs, in a folder named by a digest of these sources. Numba's own cache looks only at the file that
  defines a function and would miss a change in an inlined helper of another file. `cache` says what is trusted.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
