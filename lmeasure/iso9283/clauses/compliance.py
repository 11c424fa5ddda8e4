"""Static compliance (clause 10): dwells at a pose under forces."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lmeasure.core import FloatArray, IntArray
from lmeasure.iso9283 import formulas as iso
from lmeasure.iso9283.attainment import Attainment
from lmeasure.iso9283.clause import Clause, IsoTest, Quantity, SampleErrors
from lmeasure.iso9283.clauses.pose import PosePart, numbered, of_rests
from lmeasure.iso9283.figure import AXES, Figure, Maker, Subject, component
from lmeasure.iso9283.uncertainty import Part
from lmeasure.trajectory import AttainedPose, attain


@dataclass(frozen=True, kw_only=True)
class ComplianceTest(IsoTest):
    """C along the axes on which forces (n, 3) [N] acted at the dwells of a pose; groups (n,): numbers of dwells under one force."""

    loaded: AttainedPose
    forces: FloatArray
    groups: IntArray

    def samples(self) -> IntArray:
        return self.loaded.samples

    def parts(self, errors: SampleErrors) -> dict[Subject, Part]:
        at_rest = of_rests(errors(self.loaded.samples), self.loaded, self.groups)
        return {self.subject: PosePart(self.loaded, at_rest, None, self.groups)}

    def figures(self) -> list[Figure]:
        key, forces = self.subject, self.forces
        acted = np.abs(forces - forces.mean(axis=0)).max(axis=0) > 0
        make = Maker(cycles=len(forces), needs=(key,), pose=self.loaded.name)
        return [
            make.one(f"C_{AXES[i]}", "10", "mm/N", component(lambda s: iso.static_compliance(s[key].position, forces), i, i))
            for i in np.flatnonzero(acted).tolist()
        ]


def tests(attained: Attainment) -> Iterator[ComplianceTest]:
    """Return the tests of every table of forces."""
    frame, still_mm = attained.frame, attained.settings.still_mm
    for number, requested in enumerate(attained.program.compliance, 1):
        if not requested.windows_s:
            continue
        loaded = attain(
            requested.pose, attained.commanded(requested.pose), requested.windows_s, attained.trajectory, frame=frame, still_mm=still_mm
        )
        yield ComplianceTest(
            subject=Subject("compliance", str(number)),
            windows=requested.windows_s,
            angle_deg=loaded.angle_deg,
            loaded=loaded,
            forces=np.array(requested.force_n),
            groups=numbered(requested.force_n),
        )


CLAUSE = Clause(tests=tests, quantities=(Quantity(symbol="C", label="static compliance", summary={"C_x": 190, "C_y": 200, "C_z": 210}),))
