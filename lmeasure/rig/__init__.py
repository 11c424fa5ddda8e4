"""The instrument as rig.toml describes it: observation points, drums, encoders, CAN tables, parameters and its calibration record."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
