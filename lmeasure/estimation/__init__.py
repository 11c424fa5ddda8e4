"""Estimation of parameters from residuals: it knows a `Problem`, not its source.

A `Problem` is parameters with priors, residuals with derivatives and a covariance, and perhaps nuisance parameters; its `Fit` is an optimum
with its uncertainty.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
