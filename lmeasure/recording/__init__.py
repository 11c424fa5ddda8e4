"""Recorded data and their start: counts, run folders, start poses, reference poses and robot programs."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
