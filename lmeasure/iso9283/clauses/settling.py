"""Pose stabilisation time and overshoot (clauses 7.4 and 7.5): how a robot comes to rest.

Limits are crossed and extremes taken between samples: `readings` says how a motion is read there, and what the counts make it err by.
Errors common to the run cancel in distances from where the robot stands.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from lmeasure.core import CertificationError, FloatArray, IntArray
from lmeasure.iso9283.attainment import Attainment, places_in
from lmeasure.iso9283.characteristic import CharacteristicKey
from lmeasure.iso9283.clause import Clause, IsoTest, Quantity, Read
from lmeasure.iso9283.figure import Subject
from lmeasure.iso9283.formulas import time as iso9283_time
from lmeasure.iso9283.instants import of_duration
from lmeasure.iso9283.motion_readings import Motion, Reading, distance, longest_s
from lmeasure.text import message


@dataclass(frozen=True, kw_only=True)
class SettlingTest(IsoTest):
    """t_s and OV of a pose: mean and largest of its cycles. limit_band_mm: about where the robot ends, None for the pose's repeatability;
    at (k,): samples at whose errors it looks."""

    limit_band_mm: float | None
    at: IntArray

    def samples(self) -> IntArray:
        return self.at

    def read(self, motion: Motion, known: Mapping[CharacteristicKey, float]) -> Read:
        """See `IsoTest`; CertificationError when no band is known."""
        name = self.subject.name
        band = self.limit_band_mm or known.get(CharacteristicKey("RP_l", name))
        if band is None:
            raise CertificationError(f"pose {name}: settling_s needs limit_band_mm, or two cycles for the pose's repeatability")

        def both(time_s: FloatArray, from_rest: FloatArray) -> FloatArray:
            times = iso9283_time.stabilisation_time(time_s, distance(from_rest), band)
            return np.stack([times, iso9283_time.excursion(distance(from_rest), band)], axis=-1)

        def largest(excursions: FloatArray, axis: int = -1) -> FloatArray:
            return iso9283_time.overshoot(excursions, band, axis)

        cycles = [motion.stretch(*w, f"pose {name}, settling {i}", begins=False) for i, w in enumerate(self.windows, 1)]
        farthest = max(float(distance(s.poses[:, :3] - s.poses[s.places[-1], :3].mean(axis=0)).max()) for s in cycles)
        reported = motion.read(cycles, Reading(both, distance, band, np.array([longest_s(cycles), farthest]), largest=True))
        for cycle, ((start, end), reached) in enumerate(zip(self.windows, reported.reached, strict=True), 1):
            if not reached:
                where = {"pose": name, "cycle": cycle, "band_mm": band, "start_s": start, "end_s": end}
                return Read(findings=(message("settling.not_reached", **where),))
        note = message("settling.band" if self.limit_band_mm else "settling.band_repeatability", band_mm=band)
        time = reported.characteristic(0, CharacteristicKey("t_s", name), clause="7.4", unit="s", note=note)
        overshoot = reported.characteristic(1, CharacteristicKey("OV", name), clause="7.5", unit="mm", note=note, over=largest, above=band)
        if overshoot.u95 >= band:
            # no draw errs by a band but those that never leave it again: then all of it may be none
            overshoot = replace(overshoot, u95=max(overshoot.u95, overshoot.value))
        return Read((of_duration(time, motion.stamps), overshoot))


def tests(attained: Attainment) -> Iterator[SettlingTest]:
    """Of every pose with settling_s."""
    for pose in attained.program.pose:
        if pose.settling_s:
            yield SettlingTest(
                subject=Subject("settling", pose.name),
                windows=pose.settling_s,
                needs=(Subject("pose", pose.name), Subject("settling", pose.name)),
                angle_deg=attained.worst_angle(pose.settling_s, f"settling {pose.name}"),
                limit_band_mm=pose.limit_band_mm,
                at=places_in(attained.trajectory, pose.settling_s, f"pose {pose.name}, settling"),
            )


CLAUSE = Clause(
    tests=tests,
    quantities=(
        Quantity(symbol="t_s", label="position stabilisation time", summary={"t_s": 60}),
        Quantity(symbol="OV", label="position overshoot", summary={"OV": 130}),
    ),
)
