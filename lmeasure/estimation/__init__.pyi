from .confidence_regions import (
    BENT as BENT,
)
from .confidence_regions import (
    PROBABILITY as PROBABILITY,
)
from .confidence_regions import (
    Regions as Regions,
)
from .confidence_regions import (
    regions as regions,
)
from .deletion import (
    MIN_FREEDOM as MIN_FREEDOM,
)
from .deletion import (
    Deletion as Deletion,
)
from .deletion import (
    Remainder as Remainder,
)
from .deletion import (
    deletion_squares as deletion_squares,
)
from .deletion import (
    fall_test as fall_test,
)
from .deletion import (
    held_out as held_out,
)
from .elimination import (
    Eliminated as Eliminated,
)
from .elimination import (
    linear_objective as linear_objective,
)
from .exchange import (
    CRITERIA as CRITERIA,
)
from .exchange import (
    Criterion as Criterion,
)
from .exchange import (
    Design as Design,
)
from .exchange import (
    Numbered as Numbered,
)
from .exchange import (
    empty as empty,
)
from .exchange import (
    grown as grown,
)
from .exchange import (
    improved as improved,
)
from .exchange import (
    ordered as ordered,
)
from .explanations import (
    CHANCE as CHANCE,
)
from .explanations import (
    Explained as Explained,
)
from .explanations import (
    Explanation as Explanation,
)
from .explanations import (
    Key as Key,
)
from .explanations import (
    evidence as evidence,
)
from .explanations import (
    explained as explained,
)
from .explanations import (
    improbable as improbable,
)
from .explanations import (
    settled as settled,
)
from .fit_result import (
    Fit as Fit,
)
from .information import (
    blocks as blocks,
)
from .information import (
    estimated_covariance as estimated_covariance,
)
from .information import (
    parameter_information as parameter_information,
)
from .least_squares import (
    fit as fit,
)
from .normal_equations import (
    Optimum as Optimum,
)
from .normal_equations import (
    optimum as optimum,
)
from .observability import (
    by_few as by_few,
)
from .observability import (
    by_owner as by_owner,
)
from .problem import (
    Nuisance as Nuisance,
)
from .problem import (
    Parameters as Parameters,
)
from .problem import (
    Problem as Problem,
)
from .robust import (
    BIWEIGHT as BIWEIGHT,
)
from .robust import (
    EXCLUDED as EXCLUDED,
)
from .robust import (
    Group as Group,
)
from .robust import (
    Weights as Weights,
)
from .robust import (
    biweights as biweights,
)
from .robust import (
    normal_deviates as normal_deviates,
)
from .robust import (
    robust_fit as robust_fit,
)
from .robust import (
    scatter as scatter,
)
from .robust import (
    trust as trust,
)
