"""The tests of ISO 9283:1998, a module each: its windows, its figures with their uncertainties, what excludes it and what it notes."""

from collections.abc import Callable, Iterable

from lmeasure.iso9283.attainment import Attainment
from lmeasure.iso9283.clause import IsoTest
from lmeasure.iso9283.clauses import (
    approaches,
    compliance,
    corners,
    distance,
    drift,
    exchangeability,
    path,
    pose,
    posing,
    settling,
    stabilisation,
    velocity,
    weaving,
)

TESTS: tuple[Callable[[Attainment], Iterable[IsoTest]], ...] = (
    pose.tests,
    approaches.tests,
    exchangeability.tests,
    drift.tests,
    distance.tests,
    compliance.tests,
    path.tests,
    velocity.tests,
    corners.tests,
    weaving.tests,
    settling.tests,
    posing.tests,
    stabilisation.tests,
)
"""The table of the tests; certificates list figures in this order, those of one subject together."""


def tests_of(attained: Attainment) -> list[IsoTest]:
    """All tests that a trajectory holds of its program."""
    found = [test for tests in TESTS for test in tests(attained)]
    order = {subject: i for i, subject in enumerate(dict.fromkeys(test.subject for test in found))}
    return sorted(found, key=lambda test: order[test.subject])
