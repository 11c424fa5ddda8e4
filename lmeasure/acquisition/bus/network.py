"""Messages of devices and the bus about themselves while counts come: emergencies, states and restarts (CiA 301, J1939), and error frames.

Whether a word ends the origin of an incremental counter:

- it does: boot-up (700h + node, state 0), NMT reset node or communication (000h, 81h or 82h), an emergency of the device's hardware,
  of its software (a watchdog) or of its sensor, or with the register's bit of the device profile, in which CiA 406 has position errors;
- it may: an emergency of no stated kind, of the supply's voltage, or "no error" without an error before, as some send at power-on; a node
  that is pre-operational again without a command; a J1939 address claim. Then the next counts decide (`counters.CounterState`);
- it does not: temperature, current, communication, and all else.
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lmeasure.acquisition.bus.frames import BUS_OFF, CLASSED, CONTROLLER, ERROR, EXTENDED, PASSIVE, REMOTE, Frames
from lmeasure.acquisition.counters.decoders import CounterField, Readings
from lmeasure.core import BoolArray, IntArray
from lmeasure.rig import Rig
from lmeasure.text import joined, message

EMERGENCY, HEARTBEAT = 0x80, 0x700
OTHERS = 0x780
"""Above every identifier that is looked for."""
BOOT_UP, OPERATIONAL, PRE_OPERATIONAL = 0, 5, 127
STATES = (BOOT_UP, 4, OPERATIONAL, PRE_OPERATIONAL)
RESETS = {0x81: "reset_node", 0x82: "reset_communication"}
ENTER_PRE_OPERATIONAL = 0x80
ERROR_CLASSES = (0x00, 0x10, 0x20, 0x30, 0x40, 0x50, 0x60, 0x70, 0x80, 0x90, 0xF0, 0xFF)
LOST, DOUBTFUL = "lost", "doubtful"
"""Effect of a word on an origin."""
POSITION_CODES = (0x50, 0x60, 0x61, 0x63, 0x73)
DOUBTFUL_CODES = (0x00, 0x10, 0x30, 0x31, 0x32, 0x33, 0x51, 0x52, 0x53, 0x62, 0xFF)
"""High bytes of emergency codes."""
PROFILE_ERROR = 0x20
"""Bit of the error register (1001h): device profile specific."""
ADDRESS_CLAIM, ADDRESS_CLAIM_MASK = 0x00EEFF00, 0x03FFFF00
ADDRESS = 0xFF
ERROR_BITS = (0x01, 0x02, 0x04, 0x08, 0x10, 0x20, 0x40, 0x80, 0x100, 0x200)


@dataclass(frozen=True)
class Word:
    """Report in frame `row` of a batch: kind of event and text, for the fields `of` (all: the bus), and its effect on their origins: LOST,
    DOUBTFUL or none."""

    row: int
    kind: str
    text: str
    of: tuple[int, ...] = ()
    origin: str = ""


class NetworkWatch:
    """Listens to the nodes that send the counters, to their master, and to error frames."""

    def __init__(self, fields: tuple[CounterField, ...], sync_id: int) -> None:
        self._nodes: dict[int, tuple[int, ...]] = {}
        self._addresses: dict[int, tuple[int, ...]] = {}
        for j, f in enumerate(fields):
            if f.node is not None:
                self._nodes[f.node] = (*self._nodes.get(f.node, ()), j)
            elif f.extended and f.mask & ADDRESS == ADDRESS and f.mask != 0x1FFFFFFF:
                address = f.identifier & ADDRESS
                self._addresses[address] = (*self._addresses.get(address, ()), j)
        wanted = {EMERGENCY + n for n in self._nodes} | {HEARTBEAT + n for n in self._nodes} | ({0} if self._nodes else set())
        self._wanted = np.zeros(OTHERS + 1, np.bool_)
        self._wanted[list(wanted - {sync_id} - {f.identifier for f in fields})] = True
        self._state: dict[int, int] = {}
        self._failed: set[int] = set()
        """Nodes that sent an emergency."""

    def words(self, frames: Frames) -> list[Word]:
        """Return the reports in a batch, in its order."""
        looked = self._wanted[np.minimum(frames.identifier, OTHERS)]
        if self._addresses:
            looked |= (frames.identifier & ADDRESS_CLAIM_MASK) == ADDRESS_CLAIM
        looked |= (frames.flags & ERROR) != 0
        out = []
        for row in np.flatnonzero(looked).tolist():
            identifier, data, flags = int(frames.identifier[row]), frames.data[row, : frames.length[row]].tobytes(), int(frames.flags[row])
            if flags & ERROR:
                word: Word | None = _error(row, identifier, data, bool(flags & CLASSED))
            else:
                word = None if flags & REMOTE else self._word(row, identifier, bool(flags & EXTENDED), data)
            if word is not None:
                out.append(word)
        return out

    def _word(self, row: int, identifier: int, extended: bool, data: bytes) -> Word | None:
        if extended:
            address = identifier & ADDRESS
            if identifier & ADDRESS_CLAIM_MASK != ADDRESS_CLAIM or address not in self._addresses:
                return None
            return Word(row, "heartbeat", message("bus.address_claimed", address=address), self._addresses[address], DOUBTFUL)
        if identifier == 0:
            return self._command(row, data)
        node = identifier & 0x7F
        of = self._nodes[node]
        if identifier < HEARTBEAT and len(data) == 8:
            code, register = data[0] | data[1] << 8, data[2]
            group = next((g for g in (code >> 8, code >> 8 & 0xF0) if g in ERROR_CLASSES), None)
            kind = message("bus.emergency_unknown" if group is None else f"bus.emergency_{group:02x}")
            text = message("bus.emergency", node=node, emergency=code, kind=kind, register=register)
            origin = self._after_emergency(node, code, register)
            return Word(row, "emcy", text, of, origin)
        if identifier > HEARTBEAT and len(data) == 1:
            state = data[0] & 0x7F  # the highest bit toggles in node guarding
            before = self._state.get(node)
            self._state[node] = state
            if state == BOOT_UP or before not in {None, state}:
                again = before == OPERATIONAL and state == PRE_OPERATIONAL
                origin = LOST if state == BOOT_UP else DOUBTFUL if again else ""
                named = message(f"bus.state_{state}") if state in STATES else str(state)
                return Word(row, "heartbeat", message("bus.node_state", node=node, state=named), of, origin)
        return None

    def _after_emergency(self, node: int, code: int, register: int) -> str:
        first = node not in self._failed
        if code >> 8 == 0:
            self._failed.discard(node)
        else:
            self._failed.add(node)
        if code >> 8 in POSITION_CODES or (code and register & PROFILE_ERROR):
            return LOST
        return DOUBTFUL if code >> 8 in DOUBTFUL_CODES and (code >> 8 or first) else ""

    def _command(self, row: int, data: bytes) -> Word | None:
        """Network management: a reset of one node, or of all (0)."""
        if len(data) != 2:
            return None
        command, node = data[0], data[1]
        if command == ENTER_PRE_OPERATIONAL:
            for one in self._nodes if node == 0 else (node,):
                self._state[one] = PRE_OPERATIONAL
        of = tuple(j for number, fields in self._nodes.items() for j in fields if node in (0, number))
        if command not in RESETS or not of:
            return None
        return Word(row, "nmt", message(f"bus.{RESETS[command]}" if node else f"bus.{RESETS[command]}_all", node=node), of, LOST)


def _error(row: int, identifier: int, data: bytes, classed: bool) -> Word:
    """Return the event of an error frame: its class and data, as far as the interface or the log has them."""
    shown = data.hex().upper() or "–"
    if not classed or not identifier:
        return Word(row, "bus_error", message("bus.error_frame", identifier=identifier, data=shown))
    passive = identifier & CONTROLLER and len(data) > 1 and data[1] & sum(PASSIVE[1:])
    kind = "bus_off" if identifier & BUS_OFF else "error_passive" if passive else "bus_error"
    names = tuple(message(f"bus.error_{bit:x}") for bit in ERROR_BITS if identifier & bit)
    return Word(row, kind, message("bus.error_frame_of", identifier=identifier, names=names, data=shown))


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
        """Return the watch of a rig's bus, where the counters are in these fields."""
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
        """Return likely reasons for missing counts, in words."""
        rate = message("bus.other_rate") if bit_rate is None else message("bus.other_rate_than", rate=bit_rate)
        if self.errors and not self._seen:
            return message("bus.only_errors", count=self.errors, rate=rate)
        if not self._seen:
            return message("bus.no_frame", rate=rate)
        counting = any(self._is_of(f, identifier, wide) for f in self.fields for identifier, wide in self._seen)
        if self._synced and counting and not self._seen[(self.sync_id, False)]:
            return message("bus.no_sync", sync_id=self.sync_id)
        if counting and (twice := self.twice()):
            return joined(twice)
        foreign = self.foreign()
        if counting and foreign:
            return message("bus.other_frames_too", found=tuple(foreign))
        if foreign:
            wanted = ", ".join(f"{f.identifier:03X}h" for f in self.fields)
            return message("bus.other_frames", found=tuple(foreign), wanted=wanted)
        return message("bus.no_counter_frames") if self._seen else ""

    def foreign(self) -> list[str]:
        """Return identifiers that no device of the rig sends, the most frequent first."""
        nodes = {f.identifier & 0x7F for f in self.fields if not f.extended}
        network = {base + n for n in nodes for base in (EMERGENCY, HEARTBEAT, *SDO)} | {*NETWORK, self.sync_id, *self._others}
        out = [
            message("acquisition.h_frames", identifier=identifier, n=n)
            for (identifier, wide), n in self._seen.most_common()
            if not any(self._is_of(f, identifier, wide) for f in self.fields) and (wide or identifier not in network)
        ]
        return [*out[:REPORTED], *([message("bus.more", count=len(out) - REPORTED)] if len(out) > REPORTED else [])]

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


MOST = 240
ANSWERS = 5
"""Answers that show an n above 1; three show that every SYNC is answered."""
RECENT = 16
"""Number of answers from which n is determined again."""
REGULAR = 0.9
"""Part of the distances between answers that are multiples of n at least."""


def every(answered: IntArray) -> int | None:
    """Return n of a channel that answered the SYNCs of these numbers (k,): the median of their distances; None where they are too few.

    1 where the distances are no multiples of the median: then answers are lost.
    """
    distances = np.diff(answered)
    distances = distances[distances > 0]
    if len(distances) >= 2 and (distances[:2] == 1).all() and len(distances) < ANSWERS - 1:
        return 1
    if len(distances) < ANSWERS - 1:
        return None
    n = int(np.median(distances))
    return n if 1 < n <= MOST and np.mean(distances % n == 0) >= REGULAR else 1


def ordinal(n: int) -> str:
    """2nd, 3rd, 11th, ..."""
    return f"{n}{'th' if n % 100 // 10 == 1 else {1: 'st', 2: 'nd', 3: 'rd'}.get(n % 10, 'th')}"


class Transmission:
    """SYNCs that each of m channels is due to answer, from those that it has answered. SYNCs are numbered from the first one on."""

    def __init__(self, channels: int) -> None:
        self.n = np.ones(channels, np.int64)
        """Each channel answers every n-th SYNC."""
        self._recent: list[IntArray] = [np.empty(0, np.int64)] * channels
        self._latest: list[IntArray] = [np.empty(0, np.int64)] * channels

    def known(self, answers: Sequence[IntArray]) -> BoolArray:
        """(m,) whether n of each channel is known, by the numbers of the SYNCs that it answered so far."""
        return np.array([every(one) is not None for one in answers])

    def learn(self, answers: Sequence[IntArray]) -> list[int]:
        """Take the numbers of the SYNCs that each channel answered since the last time; the channels whose n is another now."""
        other = []
        for c, new in enumerate(answers):
            self._recent[c] = np.concatenate([self._recent[c], new])[-RECENT:]
            self._latest[c] = np.concatenate([self._latest[c][-1:], new])
            n = every(self._recent[c])
            if n is not None and n != self.n[c]:
                self.n[c] = n
                other.append(c)
        return other

    def moved(self, channel: int, number: int) -> None:
        """The answer to the SYNC behind this one was late, and belongs to this one."""
        for kept in (self._recent, self._latest):
            kept[channel] = np.where(kept[channel] == number + 1, number, kept[channel])

    def due(self, first: int, end: int) -> BoolArray:
        """(m, end - first) which of the SYNCs from first to end each channel is due to answer, by its last answer before."""
        number = np.arange(first, end)
        out = np.ones((len(self.n), end - first), np.bool_)
        for c in np.flatnonzero(self.n > 1):
            if len(latest := self._latest[c]):
                before = latest[np.maximum(np.searchsorted(latest, number) - 1, 0)]
                out[c] = (number - before) % self.n[c] == 0
        return out

    @property
    def meets(self) -> bool:
        """Return whether all channels answer some of the same SYNCs."""
        slow = [(int(self.n[c]), int(self._recent[c][-1])) for c in np.flatnonzero(self.n > 1) if len(self._recent[c])]
        return all((a - b) % math.gcd(n, k) == 0 for n, a in slow for k, b in slow)


def misfits(fields: tuple[CounterField, ...], readings: Readings) -> list[Word]:
    """Return frames whose data do not fit the field that the rig states."""
    out = []
    for j, (field, short, wider) in enumerate(zip(fields, readings.short, readings.wider, strict=True)):
        out += [Word(row, "short_frame", message("event.short_frame", bytes=field.bytes_needed), (j,)) for row in short.tolist()]
        out += [Word(row, "wider", message("event.wider", bits=field.bits), (j,)) for row in wider.tolist()]
    return out
