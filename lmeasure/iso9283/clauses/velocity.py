"""Path velocity characteristics (clause 8.6): between the planes in the middle of a path's lines."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lmeasure.iso9283 import formulas as iso
from lmeasure.iso9283.attainment import Attainment
from lmeasure.iso9283.clause import Clause, IsoTest, Quantity
from lmeasure.iso9283.figure import Figure, Maker, OfInstants, Subject
from lmeasure.iso9283.paths import Crossings
from lmeasure.trajectory import Stamps


@dataclass(frozen=True, kw_only=True)
class VelocityTest(IsoTest):
    """FV of a path; AV, and RV from two cycles on, where a speed [mm/s] is commanded."""

    crossings: Crossings
    commanded_mm_s: float | None
    stamps: Stamps

    def figures(self) -> list[Figure]:
        key, speed, n = self.subject, self.commanded_mm_s, self.crossings.time_s.shape[1]
        make = Maker(cycles=n, needs=(key,), path=key.name)
        out = []
        if speed is not None:
            accuracy = make.one("AV", "8.6.2", "%", lambda s: iso.velocity_accuracy(s[key].speed_mm_s, speed), instants=self._of_instants)
            out.append(accuracy)
            if n > 1:
                out.append(make.one("RV", "8.6.3", "%", lambda s: iso.velocity_repeatability(s[key].speed_mm_s, speed)))
        return [*out, make.one("FV", "8.6.4", "mm/s", lambda s: iso.velocity_fluctuation(s[key].speed_mm_s), extreme=True)]

    def _of_instants(self, value: float) -> OfInstants:
        """The mean of way over time is more than way over the mean of times."""
        apart = np.diff(self.crossings.time_s, axis=0)
        return OfInstants(0.0, (100.0 + value) * float(np.mean(2.0 * self.stamps.u_time_s**2 / apart**2)))


def tests(attained: Attainment) -> Iterator[VelocityTest]:
    """Return the tests of every path that has windows."""
    for path in attained.program.path:
        if path.name in attained.paths:
            crossed = attained.paths[path.name]
            yield VelocityTest(
                subject=Subject("path", path.name), crossings=crossed, commanded_mm_s=path.speed_mm_s, stamps=attained.stamps
            )


CLAUSE = Clause(
    tests=tests,
    quantities=(
        Quantity(symbol="AV", label="path velocity accuracy", summary={"AV": 100}, signed=("AV",)),
        Quantity(symbol="RV", label="path velocity repeatability", summary={"RV": 120}),
        Quantity(symbol="FV", label="path velocity fluctuation", summary={"FV": 110}),
    ),
)
