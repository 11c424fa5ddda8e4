"""Accuracy: pressure angles, uncertainty over the cell, zones, and where to put the observation points."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
