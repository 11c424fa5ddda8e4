"""Estimation of parameters from residuals: it knows a `Problem` and nothing of where that comes from.

A `Problem` is parameters with priors, residuals with derivatives and a covariance, and perhaps nuisance parameters; its `Fit` is an optimum
with what it tells.
"""

from lmeasure.estimation.fit import Fit
from lmeasure.estimation.least_squares import fit
from lmeasure.estimation.problem import Gauge, Nuisance, Parameters, Problem

__all__ = ["Fit", "Gauge", "Nuisance", "Parameters", "Problem", "fit"]
