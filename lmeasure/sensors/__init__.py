"""Channels of an instrument: their readings, the effects that act on them, and kinds of sensors that other packages add.

`channels` has the arrays of an instrument, `lengths` the way from counts to readings, `sensor_kind` the laws of other packages.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
