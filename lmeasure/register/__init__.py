"""Register of calibrations, checks and certificates over years: control charts, drift, next calibration, recall."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
