"""Distance accuracy and repeatability (clause 7.3): between two poses with the same number of cycles."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lmeasure.core import CertificationError, FloatArray
from lmeasure.iso9283 import formulas as iso
from lmeasure.iso9283.attainment import Attainment
from lmeasure.iso9283.clause import Clause, IsoTest, Quantity
from lmeasure.iso9283.figure import Figure, Maker, States, Subject
from lmeasure.recording import Distance
from lmeasure.text import message

USUAL = ["P2", "P4"]
"""Poses of the distance in the standard, for a program without one."""


@dataclass(frozen=True, kw_only=True)
class DistanceTest(IsoTest):
    """AD, and RD from two cycles on, between poses that are commanded (3,) [mm] apart."""

    ends: tuple[Subject, Subject]
    commanded: FloatArray
    cycles: int

    def figures(self) -> list[Figure]:
        (one, other), commanded = self.ends, self.commanded
        length = float(np.linalg.norm(commanded))

        def both(s: States) -> tuple[FloatArray, FloatArray]:
            return s[one].position, s[other].position

        make = Maker(cycles=self.cycles, needs=self.ends, pose=self.subject.name)
        out = [make.one("AD_p", "7.3.2", "mm", lambda s: iso.distance_accuracy(*both(s), length))]
        out += make.components("AD", "7.3.2", lambda s: iso.distance_accuracy_components(*both(s), commanded), vector="AD_p")
        if self.cycles > 1:
            out.append(make.one("RD", "7.3.3", "mm", lambda s: iso.distance_repeatability(*both(s))))
            out += make.components("RD", "7.3.3", lambda s: iso.distance_repeatability_components(*both(s)))
        return out


def tests(attained: Attainment) -> Iterator[DistanceTest]:
    """Yield the program's distances, by default `USUAL` or the first two poses. CertificationError names an impossible one."""
    poses = attained.poses
    requested = list(attained.program.distance)
    if not requested:
        pair = USUAL if set(USUAL) <= set(poses) else list(poses)[:2]
        if len(pair) == 2 and len({len(poses[name].poses) for name in pair}) == 1:
            requested = [Distance.model_validate({"from": pair[0], "to": pair[1]})]
    for d in requested:
        names = d.from_pose, d.to_pose
        for name in names:
            if name not in poses:
                raise CertificationError(message("error.distance_pose_has_no", name=d.name, name2=name))
        one, other = (poses[name] for name in names)
        if len(one.poses) != len(other.poses):
            raise CertificationError(
                message(
                    "error.distance_has_cycles_and",
                    name=d.name,
                    names=names[0],
                    n_poses=len(one.poses),
                    names2=names[1],
                    n_poses2=len(other.poses),
                )
            )
        yield DistanceTest(
            subject=Subject("distance", d.name),
            ends=(Subject("pose", names[0]), Subject("pose", names[1])),
            commanded=one.commanded[:3] - other.commanded[:3],
            cycles=len(one.poses),
        )


CLAUSE = Clause(
    tests=tests,
    quantities=(
        Quantity(symbol="AD", label="distance accuracy", summary={"AD_p": 40}, signed=("AD_p",), trend="AD_p", between="distance"),
        Quantity(symbol="RD", label="distance repeatability", summary={"RD": 50}, trend="RD", between="distance"),
    ),
)
