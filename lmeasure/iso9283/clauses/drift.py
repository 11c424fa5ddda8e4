"""Drift of pose characteristics (clause 7.6): groups of cycles one after the other."""

from collections.abc import Iterator
from dataclasses import dataclass

from lmeasure.core import FloatArray
from lmeasure.iso9283.attainment import Attainment
from lmeasure.iso9283.clause import Clause, IsoTest, Quantity
from lmeasure.iso9283.clauses.pose import split
from lmeasure.iso9283.figure import ANGLES, Figure, Maker, Subject
from lmeasure.iso9283.formulas import pose as iso


@dataclass(frozen=True, kw_only=True)
class DriftTest(IsoTest):
    """dAP and dRP of a pose commanded (3,) [mm], whose whole groups of cycles have times (k,); convention of component-wise angles or
    None."""

    commanded: FloatArray
    times: tuple[str, ...]
    convention: str | None

    def figures(self) -> list[Figure]:
        key, commanded, times = self.subject, self.commanded, self.times

        def grouped(values: FloatArray) -> list[FloatArray]:
            return split(values[..., : len(times), :], times)

        make = Maker(cycles=len(times), needs=(key,), pose=key.name, angles=self.convention)
        out = [make.one("dAP_p", "7.6", "mm", lambda s: iso.drift_of_accuracy(grouped(s[key].position), commanded))]
        if self.convention is not None:
            out += make.components("dAP", "7.6", lambda s: iso.drift_of_orientation(grouped(s[key].angles_deg)), ANGLES)
        out.append(make.one("dRP_l", "7.6", "mm", lambda s: iso.drift_of_repeatability(grouped(s[key].position))))
        return out


def tests(attained: Attainment) -> Iterator[DriftTest]:
    """As the program asks for them, of poses that have windows for two groups at least."""
    for asked in attained.program.drift:
        pose = attained.poses.get(asked.pose)
        n = 0 if pose is None else len(pose.poses) // asked.group
        if pose is None or n < 2:
            continue
        convention, _ = attained.convention_of_pose(pose)
        times = tuple(str(j) for j in range(n) for _ in range(asked.group))
        yield DriftTest(subject=Subject("pose", asked.pose), commanded=pose.commanded[:3], times=times, convention=convention)


CLAUSE = Clause(
    tests=tests,
    quantities=(
        Quantity(symbol="dAP", label="drift of pose accuracy", summary={"dAP_p": 150}),
        Quantity(symbol="dRP", label="drift of pose repeatability", summary={"dRP_l": 160}),
    ),
)
