"""FP_max: how far the farthest cycle of a pose is from where the robot was sent. ISO 9283 does not have it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmeasure.iso9283 import Attainment, Clause, Figure, IsoTest, Maker, Quantity, Subject


@dataclass(frozen=True, kw_only=True)
class FarthestTest(IsoTest):
    """The test at one pose: commanded (3,) [mm], and how many cycles the robot did."""

    commanded: NDArray[np.float64]
    cycles: int

    def figures(self) -> list[Figure]:
        """Return the figure: a function of the attained positions (..., n, 3) [mm], with whose errors its uncertainty is drawn."""

        def farthest(states: Mapping[Subject, Any]) -> NDArray[np.float64]:
            away = np.linalg.norm(states[self.subject].position - self.commanded, axis=-1)
            return np.asarray(away.max(axis=-1))

        make = Maker(cycles=self.cycles, needs=(self.subject,), pose=self.subject.name)
        return [make.one("FP_max", "none", "mm", farthest, extension=True)]


def tests(attained: Attainment) -> Iterator[FarthestTest]:
    """Yield a test for each pose that the robot attained."""
    for name, pose in attained.poses.items():
        yield FarthestTest(subject=Subject("pose", name), commanded=pose.commanded[:3], cycles=len(pose.poses))


CLAUSE = Clause(
    tests=tests,
    quantities=(
        Quantity(symbol="FP", label="farthest attained position", labels={"ru": "самое далёкое положение"}, summary={"FP_max": 25}),
    ),
)
