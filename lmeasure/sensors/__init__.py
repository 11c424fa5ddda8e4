"""What a channel measures, defined once for each kind of sensor, and poses from any number of channels of any kind.

`channel` defines what every kind provides (`Observation`); `cable`, `swivel` and `inclination` are the kinds. `solver` finds
poses from readings and their errors, `continuation` follows a run. Nothing here is compiled: it is the reference, plain to read, that
tests compare every compiled path with.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
