"""Simulate the instrument as a forward model only: motions in, recorded counts out."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
