"""Who is on the bus: frames that are not of the rig, encoders that are there twice, error frames of a wrong bit rate."""

from collections import Counter
from collections.abc import Mapping

import numpy as np

from lmeasure.acquisition.bus.frames import ERROR, EXTENDED, Frames
from lmeasure.acquisition.bus.network import EMERGENCY, HEARTBEAT
from lmeasure.acquisition.counters.decoders import CounterField
from lmeasure.rig import Rig
from lmeasure.text import message

SEVERAL = 1.5
"""Frames of a counter for each SYNC from which on they are of more than one sender, and SYNCs for each frame likewise."""
NETWORK = (0x000, 0x100)
"""Network management and the time stamp."""
SDO = (0x580, 0x600)
REPORTED = 4


class BusWatch:
    """Counts frames by their identifiers; extended ones and standard ones apart."""

    def __init__(self, fields: tuple[CounterField, ...], sync_id: int, others: tuple[int, ...] = (), *, synced: bool = True) -> None:
        """synced: whether counts are taken at SYNCs."""
        self.fields, self.sync_id, self._others, self._synced = fields, sync_id, others, synced
        self._seen: Counter[tuple[int, bool]] = Counter()
        self.errors = 0

    @classmethod
    def of_rig(cls, rig: Rig, fields: tuple[CounterField, ...]) -> "BusWatch":
        """Of a rig's bus, where the counters are in these fields."""
        table = rig.can_table
        others = () if table.start_input is None else (table.start_input.id,)
        return cls(fields, table.sync_id, others, synced=table.timing == "sync")

    def feed(self, frames: Frames) -> None:
        """Look at a batch."""
        bad = (frames.flags & ERROR) != 0
        self.errors += int(bad.sum())
        extended = (frames.flags & EXTENDED) != 0
        for wide in (False, True):
            identifiers, counts = np.unique(frames.identifier[~bad & (extended == wide)], return_counts=True)
            self._seen.update({(int(i), wide): int(n) for i, n in zip(identifiers, counts, strict=True)})

    def silence(self, bit_rate: int | None) -> str:
        """Why no count may have come, in words."""
        rate = "another bit rate than the bus has" if bit_rate is None else f"another bit rate than the {bit_rate} bit/s of the rig"
        if self.errors and not self._seen:
            return f"{self.errors} error frames and none that can be read: {rate}, or a line without its terminating resistors"
        if not self._seen:
            return f"no frame at all: nothing is connected or switched on, or {rate} is set"
        counting = any(self._is_of(f, identifier, wide) for f in self.fields for identifier, wide in self._seen)
        if self._synced and counting and not self._seen[(self.sync_id, False)]:
            return f"the counters' frames come, but no SYNC {self.sync_id:03X}h: nobody sends it, or sync_id of the rig is another"
        if counting and (twice := self.twice()):
            return "; ".join(twice)
        foreign = self.foreign()
        if counting and foreign:
            return f"its counters' frames do not come; there are frames of {', '.join(foreign)}, which the rig does not name"
        if foreign:
            wanted = ", ".join(f"{f.identifier:03X}h" for f in self.fields)
            return f"frames come, but of {', '.join(foreign)}; the rig's counters are in {wanted}"
        return "its counters' frames do not come" if self._seen else ""

    def foreign(self) -> list[str]:
        """Identifiers that nobody of the rig sends, the most frequent first."""
        nodes = {f.identifier & 0x7F for f in self.fields if not f.extended}
        network = {base + n for n in nodes for base in (EMERGENCY, HEARTBEAT, *SDO)} | {*NETWORK, self.sync_id, *self._others}
        out = [
            message("acquisition.h_frames", identifier=identifier, n=n)
            for (identifier, wide), n in self._seen.most_common()
            if not any(self._is_of(f, identifier, wide) for f in self.fields) and (wide or identifier not in network)
        ]
        return [*out[:REPORTED], *([f"{len(out) - REPORTED} more"] if len(out) > REPORTED else [])]

    def twice(self, every: Mapping[str, int] | None = None) -> list[str]:
        """Signs of two senders where one should be, a line each; every: channels that answer every n-th SYNC only."""
        syncs = self._seen[(self.sync_id, False)]
        if syncs < 10:
            return []
        counts = {f.channel: sum(n for (i, wide), n in self._seen.items() if self._is_of(f, i, wide)) for f in self.fields}
        counts = {channel: n * (every or {}).get(channel, 1) for channel, n in counts.items()}
        out: list[str] = [
            message("acquisition.channel_frames_h_syncs", channel=f.channel, counts=counts[f.channel], identifier=f.identifier, syncs=syncs)
            for f in self.fields
            if counts[f.channel] > SEVERAL * syncs
        ]
        most = max(counts.values(), default=0)
        if 0 < SEVERAL * most < syncs:
            out.append(message("acquisition.syncs_frames_counter_more", syncs=syncs, frames=most))
        return out

    @staticmethod
    def _is_of(field: CounterField, identifier: int, wide: bool) -> bool:
        return field.extended == wide and identifier & field.mask == field.identifier & field.mask
