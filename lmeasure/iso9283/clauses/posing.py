"""Minimum posing time (clause 9): moves between two poses, from rest to rest; see `settling` for how they are read."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

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
class PosingTest(IsoTest):
    """t_min of moves to a pose, mean of the cycles. limit_band_mm: about where the robot ends, None for that pose's repeatability; at (k,):
    samples at whose errors it looks."""

    to_pose: str
    limit_band_mm: float | None
    at: IntArray

    def samples(self) -> IntArray:
        return self.at

    def read(self, motion: Motion, known: Mapping[CharacteristicKey, float]) -> Read:
        """See `IsoTest`; CertificationError when no band is known."""
        name = self.subject.name
        band = self.limit_band_mm or known.get(CharacteristicKey("RP_l", self.to_pose))
        if band is None:
            raise CertificationError(f"posing {name}: needs limit_band_mm, or two cycles of {self.to_pose} for its repeatability")

        def time(time_s: FloatArray, from_start: FloatArray, from_rest: FloatArray) -> FloatArray:
            return iso9283_time.posing_time(time_s, distance(from_start), distance(from_rest), band)[..., None]

        cycles = [motion.stretch(*w, f"posing {name}, cycle {i}", begins=True) for i, w in enumerate(self.windows, 1)]
        reported = motion.read(cycles, Reading(time, distance, band, np.array([longest_s(cycles)])))
        for cycle, ((start, end), reached) in enumerate(zip(self.windows, reported.reached, strict=True), 1):
            if not reached:
                where = {"posing": name, "cycle": cycle, "band_mm": band, "start_s": start, "end_s": end}
                return Read(findings=(message("posing.not_reached", **where),))
        note = message("posing.band", band_mm=band)
        found = reported.characteristic(0, CharacteristicKey("t_min", name), clause="9", unit="s", note=note)
        return Read((of_duration(found, motion.stamps),))


def tests(attained: Attainment) -> Iterator[PosingTest]:
    """Of every move that has windows."""
    for asked in attained.program.posing:
        if asked.windows_s:
            yield PosingTest(
                subject=Subject("posing", asked.name),
                windows=asked.windows_s,
                needs=(Subject("posing", asked.name),),
                angle_deg=attained.worst_angle(asked.windows_s, f"posing {asked.name}"),
                to_pose=asked.to_pose,
                limit_band_mm=asked.limit_band_mm,
                at=places_in(attained.trajectory, asked.windows_s, f"posing {asked.name}"),
            )


CLAUSE = Clause(tests=tests, quantities=(Quantity(symbol="t_min", label="minimum posing time", summary={"t_min": 180}, between="move"),))
