"""Whether the counters still count from where they did: after a fault, or in a new session, that is seen at a pose that was read."""

from dataclasses import dataclass, field

import numpy as np

from lmeasure.acquisition import folded, moduli
from lmeasure.core import FloatArray
from lmeasure.procedures.capture.closure import lengths_of_counts
from lmeasure.procedures.capture.folder import Reading
from lmeasure.rig import Rig

KEPT_COUNTS = 3.0
KEPT_MM = 0.1
"""By which counters differ at most at a pose read before, when they have kept their counts; the second is what robots drift by."""
TOLD = 0.5
"""Part of the channels that may be off a pose for the others to tell which it is."""
BACK = "go back to a pose that has been read, to see that the counters kept their counts"


@dataclass
class Trust:
    """In the counters of a session. resumed: whether readings were there when it began, and have not been seen again; doubts: channels
    that something happened to since, and what."""

    rig: Rig
    channels: tuple[str, ...]
    passage: int
    resumed: bool
    doubts: dict[str, str] = field(default_factory=dict)

    @property
    def whole(self) -> bool:
        """Whether nothing is to be said against the counters."""
        return not self.resumed and not self.doubts

    @property
    def why(self) -> str:
        """What is to be said against them."""
        return "; ".join(f"{channel} {what}" for channel, what in self.doubts.items()) or ("this is a new session" if self.resumed else "")

    def restore(self) -> None:
        """From here on they are believed."""
        self.resumed, self.doubts = False, {}

    def held_against(self, mean: FloatArray, readings: list[Reading]) -> tuple[str, str]:
        """Mean counts (m,) of a rest against what was read: the pose at which they are the same, and why not where it is none."""
        mm = lengths_of_counts(self.rig, self.channels, self.passage)
        limit = np.where(mm > 0.0, np.maximum(KEPT_COUNTS, KEPT_MM / np.where(mm > 0.0, mm, 1.0)), KEPT_COUNTS)
        off = folded(np.array([mean - r.mean for r in readings]), moduli(self.rig, self.channels, self.passage))
        # of each reading the half of the channels that agrees best says how near it is
        agree = np.sort(np.abs(off) / limit, axis=1)[:, : max(len(mm) // 2, 1)].max(axis=1)
        nearest = int(np.argmin(agree))
        wrong, pose = ~(np.abs(off[nearest]) <= limit), readings[nearest].pose
        if not wrong.any():
            return pose, ""
        if wrong.mean() < TOLD:
            told = ", ".join(f"{self.channels[j]} by {off[nearest, j]:+.0f} counts" for j in np.flatnonzero(wrong))
            return "", f"the others stand as at pose {pose}, but off are {told}: counts were lost; begin in a new folder, or `trust`"
        return "", f"{self.why}: {BACK}; this is none of them"
