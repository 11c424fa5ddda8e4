"""lmeasure: cables, drums and encoders as a 6-DOF metrology instrument.

Counts -> lengths -> poses -> accuracy -> certificate. The stages (`calibrate`, `reconstruct`, `zone`, `evaluate`, `certify` ...) take files
or objects; `plot` draws any of them. Everything public is a name of this package; each is imported when it is first used, so that
`import lmeasure` costs nothing. All errors are `LMeasureError`.
"""

import lazy_loader

__version__ = "1.0.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
