"""A process of its own that plays the encoders: `feed_process.py WHAT COUNTS.npy RATE_HZ OPTIONS-as-JSON`, then a line on stdin to begin.

WHAT is a python-can interface (raw frames: SYNC and one frame per column; with the option `hold` the last row comes again and
again), `socketcand` (which brings the daemon along) or `cia406`
(CANopen encoders on udp_multicast that produce the SYNC themselves). It says `ready ...` when it can be connected to. It knows nothing
of lmeasure.
"""

import itertools
import json
import struct
import sys
import time
from typing import Any

import can
import numpy as np
from can_devices import Encoders, Socketcand

UNSENT = -(2**31)
"""Of a frame that does not come."""


def feed_raw(bus: can.BusABC, counts: Any, rate_hz: float, hold: bool) -> None:
    """SYNC 80h and then frames 181h, 182h, ... with the counts as signed little-endian 32 bits, row by row."""
    begin, rows = time.perf_counter(), counts.tolist()
    sync = can.Message(arbitration_id=0x80, is_extended_id=False)
    for k in itertools.count():
        if k >= len(rows) and not hold:
            return
        wait = begin + k / rate_hz - time.perf_counter()
        if wait > 0:
            time.sleep(wait)
        bus.send(sync)
        for i, value in enumerate(rows[min(k, len(rows) - 1)], 1):
            if value == UNSENT:
                continue
            bus.send(can.Message(arbitration_id=0x180 + i, is_extended_id=False, data=struct.pack("<i", value)))


def main() -> None:
    """Connect, say so, wait for the word, play."""
    what, path, rate, options = sys.argv[1], sys.argv[2], float(sys.argv[3]), json.loads(sys.argv[4])
    counts, hold = np.load(path), bool(options.pop("hold", False))
    if what == "cia406":
        bus = can.Bus(interface="udp_multicast", **options)
        encoders = Encoders(bus, lambda k, n: int(counts[k, n - 1]), {n: {} for n in range(1, counts.shape[1] + 1)})
        print("ready", flush=True)
        sys.stdin.readline()
        encoders.produce_sync(len(counts), 1.0 / rate)
        time.sleep(0.5)
        encoders.close()
        return
    daemon = Socketcand() if what == "socketcand" else None
    if daemon is not None:
        options |= {"host": "127.0.0.1", "port": daemon.port, "channel": "can0"}
    with can.Bus(interface=what, **options) as bus:
        print("ready", daemon.port if daemon else "", flush=True)
        sys.stdin.readline()
        feed_raw(bus, counts, rate, hold)
        time.sleep(0.5)
    if daemon is not None:
        daemon.close()


if __name__ == "__main__":
    main()
