"""What CANopen encoders say about themselves while they count: emergencies and states (CiA 301)."""

import numpy as np

from lmeasure.acquisition.decoders import CounterField
from lmeasure.acquisition.events import Event, EventLog
from lmeasure.acquisition.frames import ERROR, EXTENDED, REMOTE, Frames

FIRST_PDO_ID, LAST_PDO_ID = 0x181, 0x57F
EMERGENCY, HEARTBEAT = 0x80, 0x700
OTHERS = 0x780
"""Above every identifier that is looked for."""
STATES = {0: "boot-up", 4: "stopped", 5: "operational", 127: "pre-operational"}
ERROR_CLASSES = {
    0x00: "error reset or no error",
    0x10: "generic error",
    0x20: "current",
    0x30: "voltage",
    0x40: "temperature",
    0x50: "device hardware",
    0x60: "device software",
    0x70: "additional modules",
    0x80: "monitoring or communication",
    0x90: "external error",
    0xF0: "additional functions",
    0xFF: "device specific",
}


class NetworkWatch:
    """Emergency and heartbeat (or node guarding) frames of the nodes whose PDOs carry the counters."""

    def __init__(self, fields: tuple[CounterField, ...], sync_id: int, events: EventLog) -> None:
        self._events = events
        self._channels = {f.identifier & 0x7F: f.channel for f in fields if not f.extended and FIRST_PDO_ID <= f.identifier <= LAST_PDO_ID}
        wanted = {EMERGENCY + n for n in self._channels} | {HEARTBEAT + n for n in self._channels}
        self._wanted = np.zeros(OTHERS + 1, np.bool_)
        self._wanted[list(wanted - {sync_id} - {f.identifier for f in fields})] = True
        self._state: dict[int, int] = {}

    def feed(self, frames: Frames, sample: int) -> None:
        """Look at a batch; sample is the next one to be given out."""
        for row in np.flatnonzero(self._wanted[np.minimum(frames.identifier, OTHERS)]):
            if frames.flags[row] & (ERROR | REMOTE | EXTENDED):
                continue
            identifier, length, data = int(frames.identifier[row]), int(frames.length[row]), frames.data[row]
            node = identifier & 0x7F
            at = float(frames.time_s[row])
            if identifier < HEARTBEAT and length == 8:
                code = int(data[0]) | int(data[1]) << 8
                kind = ERROR_CLASSES.get(code >> 8, ERROR_CLASSES.get(code >> 8 & 0xF0, "unknown"))
                text = f"node {node}: code {code:04X}h ({kind}), register {int(data[2]):02X}h"
                self._events.add(Event(sample, at, self._channels[node], "emcy", text))
            elif identifier > HEARTBEAT and length == 1:
                state = int(data[0]) & 0x7F  # the highest bit toggles in node guarding
                before = self._state.get(node)
                self._state[node] = state
                if state == 0 or before not in {None, state}:
                    text = f"node {node}: {STATES.get(state, state)}"
                    self._events.add(Event(sample, at, self._channels[node], "heartbeat", text))
