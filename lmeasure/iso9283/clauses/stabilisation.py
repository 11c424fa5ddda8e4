"""Stabilisation path length (clause 8.5): the way behind a corner from which a robot is back on its path.

Read as in `settling`; deviations from a commanded path have the errors common to the run; those from a fitted frame have the base's.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.iso9283 import formulas as iso9283_path
from lmeasure.iso9283.attainment import Attainment
from lmeasure.iso9283.characteristic import CharacteristicKey
from lmeasure.iso9283.clause import Clause, IsoTest, Quantity, Read
from lmeasure.iso9283.clauses.corners import Corner, Passing, passings
from lmeasure.iso9283.figure import Subject
from lmeasure.iso9283.motion_readings import MARGIN, Motion, Reading, Stretch, distance
from lmeasure.iso9283.paths import Cycle
from lmeasure.text import message


@dataclass(frozen=True, kw_only=True)
class StabilisationTest(IsoTest):
    """SPL behind a corner, mean of the cycles that pass it."""

    limit_mm: float
    corner: Corner
    passed: tuple[tuple[Cycle, Passing], ...]

    def read(self, motion: Motion, known: Mapping[CharacteristicKey, float]) -> Read:
        corner, limit = self.corner, self.limit_mm

        def length(_: FloatArray, from_corner: FloatArray) -> FloatArray:
            return iso9283_path.stabilisation_length(from_corner @ corner.outgoing, deviation(from_corner), limit)[..., None]

        def deviation(from_corner: FloatArray) -> FloatArray:
            along = from_corner @ corner.outgoing
            return np.where(along >= 0.0, distance(from_corner - along[..., None] * corner.outgoing), 0.0)

        cycles = []
        for cycle, passing in self.passed:
            part = slice(max(passing.behind.start - MARGIN, 0), passing.behind.stop)
            place = np.array([passing.behind.start - part.start])
            cycles.append(Stretch(cycle.samples[part], cycle.time_s[part], cycle.poses[part], (place,)))
        reported = motion.read(cycles, Reading(length, deviation, limit, np.array([0.5 * corner.after_mm]), origin=corner.place))
        for number, reached in enumerate(reported.reached, 1):
            if not reached:
                where = {"path": self.subject.name, "cycle": number, "corner": corner.number, "limit_mm": limit}
                return Read(findings=(message("stabilisation.not_reached", **where),))
        key = CharacteristicKey("SPL", path=self.subject.name, part=f"corner {corner.number}")
        return Read((reported.characteristic(0, key, clause="8.5", unit="mm", note=message("stabilisation.limit", limit_mm=limit)),))


def tests(attained: Attainment) -> Iterator[StabilisationTest]:
    """Return the tests of every corner of paths with stabilisation_mm."""
    for path in attained.program.path:
        if path.stabilisation_mm is None or path.name not in attained.paths:
            continue
        crossed = attained.paths[path.name]
        for corner, passed in passings(crossed):
            yield StabilisationTest(
                subject=Subject("stabilisation", path.name),
                needs=(Subject("path", path.name),),
                limit_mm=path.stabilisation_mm,
                corner=corner,
                passed=tuple(zip(crossed.cycles, passed, strict=True)),
            )


CLAUSE = Clause(tests=tests, quantities=(Quantity(symbol="SPL", label="stabilisation path length"),))
