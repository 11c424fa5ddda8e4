"""Settling of a robot: pose stabilisation time and overshoot (clauses 7.4 and 7.5), and minimum posing time (clause 9).

Limits are crossed and extremes taken between samples: `motion_readings` describes the reading of a motion there and its errors. Errors
common to the run cancel in distances from the robot's rest.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from lmeasure.core import CertificationError, FloatArray, IntArray
from lmeasure.iso9283 import formulas as iso
from lmeasure.iso9283.attainment import Attainment, places_in
from lmeasure.iso9283.characteristic import CharacteristicKey
from lmeasure.iso9283.clause import Clause, IsoTest, Quantity, Read
from lmeasure.iso9283.figure import Subject
from lmeasure.iso9283.motion_readings import Motion, Reading, Reported, distance, longest_s
from lmeasure.iso9283.uncertainty import of_duration
from lmeasure.text import Message, message

Known = Mapping[CharacteristicKey, float]


@dataclass(frozen=True, kw_only=True)
class RestTest(IsoTest):
    """Figures of coming to rest at a pose. limit_band_mm: about where the robot ends, None for that pose's repeatability; at (k,): samples
    at whose errors it looks."""

    pose: str
    limit_band_mm: float | None
    at: IntArray

    def samples(self) -> IntArray:
        return self.at

    def band(self, known: Known, needs: str) -> float:
        """Return the limit band [mm]; CertificationError names its need if none is known."""
        band = self.limit_band_mm or known.get(CharacteristicKey("RP_l", self.pose))
        if band is None:
            raise CertificationError(needs)
        return band

    def not_reached(self, reported: Reported, code: str, band_mm: float, **of: str) -> Message | None:
        """Return the messages about the first cycle that does not reach its band."""
        for cycle, ((start, end), reached) in enumerate(zip(self.windows, reported.reached, strict=True), 1):
            if not reached:
                return message(code, **of, cycle=cycle, band_mm=band_mm, start_s=start, end_s=end)
        return None


class SettlingTest(RestTest):
    """t_s and OV of a pose: mean and largest of its cycles."""

    def read(self, motion: Motion, known: Known) -> Read:
        name = self.subject.name
        band = self.band(known, message("iso.settling_needs_band", name=name))

        def both(time_s: FloatArray, from_rest: FloatArray) -> FloatArray:
            times = iso.stabilisation_time(time_s, distance(from_rest), band)
            return np.stack([times, iso.excursion(distance(from_rest), band)], axis=-1)

        def largest(excursions: FloatArray, axis: int = -1) -> FloatArray:
            return iso.overshoot(excursions, band, axis)

        cycles = [motion.stretch(*w, f"pose {name}, settling {i}", begins=False) for i, w in enumerate(self.windows, 1)]
        farthest = max(float(distance(s.poses[:, :3] - s.poses[s.places[-1], :3].mean(axis=0)).max()) for s in cycles)
        reported = motion.read(cycles, Reading(both, distance, band, np.array([longest_s(cycles), farthest]), largest=True))
        if finding := self.not_reached(reported, "settling.not_reached", band, pose=name):
            return Read(findings=(finding,))
        note = message("settling.band" if self.limit_band_mm else "settling.band_repeatability", band_mm=band)
        time = reported.characteristic(0, CharacteristicKey("t_s", name), clause="7.4", unit="s", note=note)
        overshoot = reported.characteristic(1, CharacteristicKey("OV", name), clause="7.5", unit="mm", note=note, over=largest, above=band)
        if overshoot.u95 >= band:
            # only draws that never leave the band can change by all of it: the overshoot may be zero
            overshoot = replace(overshoot, u95=max(overshoot.u95, overshoot.value))
        return Read((of_duration(time, motion.stamps), overshoot))


class PosingTest(RestTest):
    """t_min of moves to a pose from another, from rest to rest, mean of the cycles."""

    def read(self, motion: Motion, known: Known) -> Read:
        name = self.subject.name
        band = self.band(known, message("iso.posing_needs_band", name=name, pose=self.pose))

        def time(time_s: FloatArray, from_start: FloatArray, from_rest: FloatArray) -> FloatArray:
            return iso.posing_time(time_s, distance(from_start), distance(from_rest), band)[..., None]

        cycles = [motion.stretch(*w, f"posing {name}, cycle {i}", begins=True) for i, w in enumerate(self.windows, 1)]
        reported = motion.read(cycles, Reading(time, distance, band, np.array([longest_s(cycles)])))
        if finding := self.not_reached(reported, "posing.not_reached", band, posing=name):
            return Read(findings=(finding,))
        note = message("posing.band", band_mm=band)
        found = reported.characteristic(0, CharacteristicKey("t_min", name), clause="9", unit="s", note=note)
        return Read((of_duration(found, motion.stamps),))


def tests(attained: Attainment) -> Iterator[RestTest]:
    """Return the tests of every pose with settling_s, and of every move that has windows."""
    for pose in attained.program.pose:
        if pose.settling_s:
            yield SettlingTest(
                subject=Subject("settling", pose.name),
                windows=pose.settling_s,
                needs=(Subject("pose", pose.name), Subject("settling", pose.name)),
                angle_deg=attained.worst_angle(pose.settling_s, f"settling {pose.name}"),
                pose=pose.name,
                limit_band_mm=pose.limit_band_mm,
                at=places_in(attained.trajectory, pose.settling_s, f"pose {pose.name}, settling"),
            )
    for move in attained.program.posing:
        if move.windows_s:
            yield PosingTest(
                subject=Subject("posing", move.name),
                windows=move.windows_s,
                needs=(Subject("posing", move.name),),
                angle_deg=attained.worst_angle(move.windows_s, f"posing {move.name}"),
                pose=move.to_pose,
                limit_band_mm=move.limit_band_mm,
                at=places_in(attained.trajectory, move.windows_s, f"posing {move.name}"),
            )


CLAUSE = Clause(
    tests=tests,
    quantities=(
        Quantity(symbol="t_s", label="position stabilisation time", summary={"t_s": 60}),
        Quantity(symbol="OV", label="position overshoot", summary={"OV": 130}),
        Quantity(symbol="t_min", label="minimum posing time", summary={"t_min": 180}, between="move"),
    ),
)
