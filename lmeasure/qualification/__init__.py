"""Qualification of this program on the user's machine, which ISO/IEC 17025 clause 7.11 requires before use."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
