"""Whether the counters come back to what they showed at the first pose."""

from dataclasses import dataclass

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.rig import Rig
from lmeasure.text import message

ALLOWED = 3.0
"""Standard uncertainties of the difference of two means."""
LOST_COUNTS = 3.0
LOST_MM = 0.1
"""Beyond both nothing but lost counts, a cable that slipped, or another pose is meant: the second is what robots drift by."""


@dataclass(frozen=True)
class Return:
    """Channels by what they came back to: counts less those at first, what rounding (and the robot's stated repeatability) allows, and in
    mm; lost: those that neither rounding nor a robot's drift explains."""

    channels: tuple[str, ...]
    counts: FloatArray
    allowed: FloatArray
    mm: FloatArray

    @property
    def beyond(self) -> tuple[str, ...]:
        """Channels that came back to other counts than are allowed."""
        return tuple(c for c, far in zip(self.channels, np.abs(self.counts) > self.allowed, strict=True) if far)

    @property
    def lost(self) -> tuple[str, ...]:
        """Those of them that lost counts."""
        far = (np.abs(self.counts) > np.maximum(self.allowed, LOST_COUNTS)) & ((np.abs(self.mm) > LOST_MM) | (self.mm == 0.0))
        return tuple(c for c, is_far in zip(self.channels, far, strict=True) if is_far)

    def lines(self) -> list[str]:
        """For a person."""
        reported = dict(zip(self.channels, zip(self.counts, self.mm, strict=True), strict=True))
        shown = "  ".join(f"{c} {counts:+.1f}" for c, (counts, _) in reported.items())
        lines: list[str] = [message("capture.back_first_pose_counts", shown=shown)]
        if not self.beyond:
            return [*lines, message("capture.closed_no_more_than", v1=self.allowed.max())]
        for channel in self.lost:
            lines.append(message("capture.came_back_counts_mm", channel=channel, counts=reported[channel][0], mm=reported[channel][1]))
        if not self.lost:
            most = np.abs(self.mm).max()
            lines.append(message("capture.not_closed_rounding_alone", v1=tuple(self.beyond), most=most))
        elif len(self.lost) > len(self.channels) / 2:
            lines.append(message("capture.most_channels_off_this"))
        return lines


def lengths_of_counts(rig: Rig, channels: tuple[str, ...], passage: int) -> FloatArray:
    """(m,) length of a recorded count of each channel [mm], 0 of those that count no length."""
    known = [rig.counters_of(passage)[c] for c in channels]
    return np.array([c.per_count / c.scale if c.is_length else 0.0 for c in known])


def judged_return(
    rig: Rig, channels: tuple[str, ...], passage: int, counts: FloatArray, *, variance: FloatArray, u_repeatability_mm: float
) -> Return:
    """Counts (m,) at the return less those at first, whose difference has the variance (m,) by reading; the robot comes back with the
    standard deviation u_repeatability_mm, twice."""
    mm = lengths_of_counts(rig, channels, passage)
    of_robot = np.where(mm > 0.0, np.sqrt(2.0) * u_repeatability_mm / np.where(mm > 0.0, mm, 1.0), 0.0)
    return Return(channels, counts, ALLOWED * np.sqrt(variance + of_robot**2), counts * mm)
