"""Multi-directional pose accuracy variation (clause 7.2.3): a pose that is reached from several directions."""

from collections.abc import Iterator
from dataclasses import dataclass

from lmeasure.iso9283.attainment import Attainment
from lmeasure.iso9283.clause import Clause, IsoTest, Quantity
from lmeasure.iso9283.clauses.pose import split
from lmeasure.iso9283.figure import ANGLES, Figure, Maker, Subject
from lmeasure.iso9283.formulas import pose as iso


@dataclass(frozen=True, kw_only=True)
class ApproachTest(IsoTest):
    """vAP of a pose whose cycles come from directions (n,); convention of component-wise angles or None."""

    directions: tuple[str, ...]
    convention: str | None

    def figures(self) -> list[Figure]:
        key, of = self.subject, self.directions
        make = Maker(cycles=len(of), needs=(key,), pose=key.name, angles=self.convention)
        out = [make.one("vAP_p", "7.2.3", "mm", lambda s: iso.multidirectional_variation(split(s[key].position, of)))]
        if self.convention is not None:
            angular = make.components(
                "vAP", "7.2.3", lambda s: iso.multidirectional_variation_of_angles(split(s[key].angles_deg, of)), ANGLES
            )
            out += angular
        return out


def tests(attained: Attainment) -> Iterator[ApproachTest]:
    """Of every pose that has windows and is approached from several directions."""
    for pose in attained.program.pose:
        if pose.name in attained.poses and len(set(pose.approaches)) > 1:
            convention, _ = attained.convention_of_pose(attained.poses[pose.name])
            yield ApproachTest(subject=Subject("pose", pose.name), directions=pose.approaches, convention=convention)


CLAUSE = Clause(tests=tests, quantities=(Quantity(symbol="vAP", label="multi-directional pose accuracy variation", summary={"vAP_p": 30}),))
