from .confidence_regions import BENT as BENT, PROBABILITY as PROBABILITY, Regions as Regions, regions as regions
from .deletion import (
    MIN_FREEDOM as MIN_FREEDOM,
    Deletion as Deletion,
    Remainder as Remainder,
    deletion_squares as deletion_squares,
    fall_test as fall_test,
    validation_residuals as validation_residuals,
)
from .elimination import Eliminated as Eliminated, linear_objective as linear_objective
from .exchange import (
    CRITERIA as CRITERIA,
    Criterion as Criterion,
    Design as Design,
    Numbered as Numbered,
    empty as empty,
    grown as grown,
    improved as improved,
    ordered as ordered,
)
from .explanations import (
    CHANCE as CHANCE,
    Explained as Explained,
    Explanation as Explanation,
    Key as Key,
    evidence as evidence,
    explained as explained,
    improbable as improbable,
    settled as settled,
)
from .least_squares import fit as fit, fit_from_starts as fit_from_starts
from .normal_equations import Optimum as Optimum, optimum as optimum
from .observability import (
    blocks as blocks,
    by_few as by_few,
    by_owner as by_owner,
    estimated_covariance as estimated_covariance,
    parameter_information as parameter_information,
)
from .problem import Fit as Fit, Nuisance as Nuisance, Parameters as Parameters, Problem as Problem
from .robust import (
    BIWEIGHT as BIWEIGHT,
    EXCLUDED as EXCLUDED,
    Group as Group,
    Weights as Weights,
    biweights as biweights,
    normal_deviates as normal_deviates,
    robust_fit as robust_fit,
    scatter as scatter,
    trust as trust,
)
from .variance_components import Sizes as Sizes, sizes as sizes
