"""Groups of the cycles of a pose: multi-directional variation (clause 7.2.3), exchangeability (7.7) and drift (7.6).

The groups are the directions from which the pose is reached, robots of one type that are sent to it, or cycles one after the other.
"""

from collections.abc import Iterator
from dataclasses import dataclass

from lmeasure.core import FloatArray
from lmeasure.iso9283 import formulas as iso
from lmeasure.iso9283.attainment import Attainment
from lmeasure.iso9283.clause import Clause, IsoTest, Quantity
from lmeasure.iso9283.clauses.pose import split
from lmeasure.iso9283.figure import ANGLES, Figure, Maker, Subject


@dataclass(frozen=True, kw_only=True)
class GroupTest(IsoTest):
    """A pose whose first cycles are of groups (n,); convention of component-wise angles or None."""

    groups: tuple[str, ...]
    convention: str | None = None

    def grouped(self, values: FloatArray) -> list[FloatArray]:
        """Values (..., cycles, 3) by group."""
        return split(values[..., : len(self.groups), :], self.groups)

    @property
    def make(self) -> Maker:
        """Return the common function of its figures."""
        return Maker(cycles=len(self.groups), needs=(self.subject,), pose=self.subject.name, angles=self.convention)


class ApproachTest(GroupTest):
    """vAP of a pose whose cycles come from several directions."""

    def figures(self) -> list[Figure]:
        key, of = self.subject, self.grouped
        out = [self.make.one("vAP_p", "7.2.3", "mm", lambda s: iso.multidirectional_variation(of(s[key].position)))]
        if self.convention is not None:
            out += self.make.components("vAP", "7.2.3", lambda s: iso.multidirectional_variation_of_angles(of(s[key].angles_deg)), ANGLES)
        return out


class ExchangeabilityTest(GroupTest):
    """E of a pose whose cycles are of several robots."""

    def figures(self) -> list[Figure]:
        key, of = self.subject, self.grouped
        return [self.make.one("E", "7.7", "mm", lambda s: iso.exchangeability(of(s[key].position)))]


@dataclass(frozen=True, kw_only=True)
class DriftTest(GroupTest):
    """dAP and dRP of a pose commanded (3,) [mm] over its whole groups of cycles."""

    commanded: FloatArray

    def figures(self) -> list[Figure]:
        key, of, commanded = self.subject, self.grouped, self.commanded
        out = [self.make.one("dAP_p", "7.6", "mm", lambda s: iso.drift_of_accuracy(of(s[key].position), commanded))]
        if self.convention is not None:
            out += self.make.components("dAP", "7.6", lambda s: iso.drift_of_orientation(of(s[key].angles_deg)), ANGLES)
        return [*out, self.make.one("dRP_l", "7.6", "mm", lambda s: iso.drift_of_repeatability(of(s[key].position)))]


def tests(attained: Attainment) -> Iterator[GroupTest]:
    """Return the tests of every pose with windows, several directions or robots; drift for a program that wants it, of at least two whole
    groups."""
    known = [pose for pose in attained.program.pose if pose.name in attained.poses]
    for pose in known:
        if len(set(pose.approaches)) > 1:
            convention, _ = attained.convention_of_pose(attained.poses[pose.name])
            yield ApproachTest(subject=Subject("pose", pose.name), groups=pose.approaches, convention=convention)
    for pose in known:
        if len(set(pose.units)) > 1:
            yield ExchangeabilityTest(subject=Subject("pose", pose.name), groups=pose.units)
    for requested in attained.program.drift:
        found = attained.poses.get(requested.pose)
        n = 0 if found is None else len(found.poses) // requested.group
        if found is not None and n >= 2:
            convention, _ = attained.convention_of_pose(found)
            times = tuple(str(j) for j in range(n) for _ in range(requested.group))
            yield DriftTest(subject=Subject("pose", requested.pose), groups=times, convention=convention, commanded=found.commanded[:3])


CLAUSE = Clause(
    tests=tests,
    quantities=(
        Quantity(symbol="vAP", label="multi-directional pose accuracy variation", summary={"vAP_p": 30}),
        Quantity(symbol="E", label="exchangeability", summary={"E": 170}),
        Quantity(symbol="dAP", label="drift of pose accuracy", summary={"dAP_p": 150}),
        Quantity(symbol="dRP", label="drift of pose repeatability", summary={"dRP_l": 160}),
    ),
)
