"""The recorder on real buses: frames cross processes, sockets and a serial port, and not one count is lost or changed."""

import json
import random
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from can_devices import slcan_adapter
from numpy.typing import NDArray

from lmeasure.acquisition import Link, Recording, connect, open_source, record
from lmeasure.acquisition.bus.sources import BusSource
from lmeasure.core import LMeasureError
from lmeasure.recording import read_run
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.simulation import cell_rig

pytestmark = pytest.mark.live

IntArray = NDArray[np.int64]
FEED = Path(__file__).parents[1] / "helpers" / "feed_process.py"


def positions(count: int, rate_hz: float) -> IntArray:
    """(count, 6) positions of six drums going to and fro, up to 1.2 m/s."""
    t = np.arange(count)[:, None] / rate_hz
    sweep = np.sin(2 * np.pi * t * np.array([0.31, 0.43, 0.37, 0.29, 0.53, 0.47])) * 40_000
    return np.rint(sweep).astype(np.int64)


Options = dict[str, str | int]
Process = subprocess.Popen[str]


@contextmanager
def feeding(what: str, counts: IntArray, rate_hz: float, options: Options, folder: Path) -> Iterator[tuple[str, Process]]:
    """The encoders' process, ready and waiting: what it said, and the process."""
    np.save(folder / "counts.npy", counts)
    command = [sys.executable, str(FEED), what, str(folder / "counts.npy"), str(rate_hz), json.dumps(options)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield process.stdout.readline().removeprefix("ready").strip(), process
    finally:
        process.kill()
        process.communicate()


def after(ended: Callable[[], bool]) -> Callable[[], bool]:
    """Return what is true 0.3 s after what sends has ended."""
    at: list[float] = []

    def stop() -> bool:
        if not at and ended():
            at.append(time.monotonic())
        return bool(at) and time.monotonic() - at[0] > 0.3

    return stop


def record_all(rig: Rig, link: Link, process: Process, folder: Path) -> Recording:
    """Begin, and record until the encoders have ended and their last frame is in."""
    assert process.stdin is not None
    process.stdin.write("go\n")
    process.stdin.flush()
    try:
        return record(
            rig,
            link.source,
            link.fields,
            folder,
            devices=[d.identity() for d in link.devices],
            stop=after(lambda: process.poll() is not None),
        )
    finally:
        link.source.close()


def a_group() -> Options:
    """A multicast group and port that nobody else is likely to use; hop_limit 0 stays on this machine."""
    group = f"239.74.{random.randrange(1, 255)}.{random.randrange(1, 255)}"
    return {"channel": group, "port": random.randrange(20000, 60000), "hop_limit": 0}


def the_rig(table: dict[str, Any] | None = None) -> Rig:
    """The cell's rig without a limit of speed: a feed that was held up sends what it missed at once, which no drum could do."""
    data = cell_rig(0).to_dict() | ({} if table is None else {"can": table})
    for point in data["observation_point"]:
        point["drum"]["max_cable_speed_mm_s"] = 1e6
    return rig_from_dict(data)


def assert_all_there(recording: Recording, folder: Path, counts: IntArray) -> None:
    assert recording.ended == "complete"
    assert set(recording.faults) <= {"pause"}  # a busy machine may hold up what sends
    assert recording.frames == 7 * len(counts)
    np.testing.assert_array_equal(read_run(folder).passes[0].recorded, counts)


def record_from(what: str, counts: IntArray, rate_hz: float, folder: Path, rig: Rig | None = None) -> tuple[Recording, str]:
    """Record what another process sends over the bus: the recording, and whose clock stamped the frames."""
    rig, group = rig or the_rig(), a_group()
    folder.mkdir(exist_ok=True)
    with feeding(what, counts, rate_hz, group if what == "udp_multicast" else {}, folder) as (said, process):
        if what == "udp_multicast":
            link = connect(rig, folder, f"udp_multicast:{group['channel']}", options={"port": group["port"]})
        else:
            link = connect(rig, folder, "socketcand:can0", options={"host": "127.0.0.1", "port": int(said)})
        return record_all(rig, link, process, folder / "run"), link.source.timestamp_source


def test_seconds_between_processes_lose_nothing(tmp_path: Path) -> None:
    """The short form of benchmarks/acquisition_endurance.py."""
    counts = positions(2_500, 1000.0)
    with ThreadPoolExecutor() as both:  # at once: two rigs on one computer
        running = {w: both.submit(record_from, w, counts, 1000.0, tmp_path / w) for w in ("udp_multicast", "socketcand")}
    for what, done in running.items():
        recording, clock = done.result()
        assert_all_there(recording, tmp_path / what / "run", counts)
        assert clock == "kernel"


def test_six_cia_406_encoders_at_500_hz(tmp_path: Path) -> None:
    counts, group = positions(750, 500.0), a_group()
    table = {"decoder": "cia406", "channel": [{"channel": f"ch{n}", "node": n, "serial": 9000 + n} for n in range(1, 7)]}
    rig = the_rig(table)
    with feeding("cia406", counts, 500.0, group, tmp_path) as (_, process):
        link = connect(rig, tmp_path, f"udp_multicast:{group['channel']}", options={"port": group["port"]})
        recording = record_all(rig, link, process, tmp_path / "run")
    run = read_run(tmp_path / "run")
    np.testing.assert_array_equal(run.passes[0].recorded, counts)
    assert set(recording.faults) <= {"wrap", "pause"}  # without a sign the way below zero is one
    assert [d.serial for d in link.devices] == [9001, 9002, 9003, 9004, 9005, 9006]


def test_slcan_on_a_serial_port(tmp_path: Path) -> None:
    rate_hz = 300.0
    counts, rig = positions(600, rate_hz), the_rig()
    with slcan_adapter() as (port, say):
        link = connect(rig, tmp_path, f"slcan:{port}", options={"sleep_after_open": 0})

        def feed() -> None:
            begin = time.perf_counter()
            for k, row in enumerate(counts.tolist()):
                time.sleep(max(begin + k / rate_hz - time.perf_counter(), 0.0))
                data = [struct.pack("<i", v).hex().upper() for v in row]
                say("\r".join(["t0800", *(f"t{0x180 + i:03X}4{d}" for i, d in enumerate(data, 1))]).encode())

        thread = threading.Thread(target=feed)
        thread.start()
        try:
            recording = record(rig, link.source, link.fields, tmp_path / "run", stop=after(lambda: not thread.is_alive()))
        finally:
            thread.join()
            link.source.close()
    assert_all_there(recording, tmp_path / "run", counts)


@pytest.mark.parametrize(
    ("bus", "complaint"),
    [
        ("can0", "give INTERFACE:CHANNEL"),
        ("sockercan:can0", "'sockercan' is no interface. Known: .*socketcan"),
        ("slcan:/dev/no-such-port", "slcan:/dev/no-such-port: cannot be opened: .*. `lmeasure scan` lists the adapters of this machine"),
        ("socketcand:can0", "cannot be opened"),
        ("replay:absent.blf", "absent.blf: cannot be read"),
        ("simulated:absent.toml", "absent.toml"),
    ],
)
def test_a_bus_that_is_not_there_is_refused_in_one_line(bus: str, complaint: str, tmp_path: Path) -> None:
    with pytest.raises(LMeasureError, match=complaint) as refused:
        connect(cell_rig(0), tmp_path, bus).source.receive(0.0)
    assert "\n" not in str(refused.value)


def test_a_driver_that_is_not_there_is_said_to_be_none() -> None:
    """python-can then calls a function that it has not found."""

    def opened() -> can.BusABC:
        raise NameError("name 'canGetNumberOfChannels' is not defined")

    with pytest.raises(LMeasureError, match=r"kvaser:0: cannot be opened: its driver is not installed. `lmeasure scan`"):
        BusSource(opened, "kvaser:0")


def test_two_groups_do_not_hear_each_other_and_a_garbled_datagram_costs_nothing() -> None:
    """python-can binds its sockets to every address: what any socket of the machine has joined on that port would come through."""
    groups = [a_group() for _ in range(2)]
    groups[1]["port"] = groups[0]["port"]
    options = [{"port": g["port"], "hop_limit": 0} for g in groups]
    sources = [open_source(f"udp_multicast:{g['channel']}", None, o) for g, o in zip(groups, options, strict=True)]
    opened = [s.bus for s in sources if isinstance(s, BusSource)]
    senders = [can.Bus(interface="udp_multicast", channel=str(g["channel"]), port=g["port"], hop_limit=0) for g in groups]
    stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    stranger.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
    try:
        for i in range(20):
            stranger.sendto(b"no frame", (groups[0]["channel"], groups[0]["port"]))
            stranger.sendto(b"no frame", ("127.0.0.1", groups[0]["port"]))  # to the machine, not to the group
            for j, sender in enumerate(senders):
                sender.send(can.Message(arbitration_id=0x100 * (j + 1) + i, is_extended_id=False, data=b"\x01"))
        found: list[list[int]] = [[], []]
        end = time.monotonic() + 20.0
        while min(map(len, found)) < 20 and time.monotonic() < end:
            for source, ids in zip(sources, found, strict=True):
                frames = source.receive(0.05)
                assert frames is not None
                ids += frames.identifier.tolist()
        assert found == [[0x100 * (j + 1) + i for i in range(20)] for j in range(2)]
        reported = [sum(int(n.text.split()[0]) for n in s.notices() if n.kind == "unread") for s in sources]
        assert reported == [20, 0]
        assert [s.bus for s in sources if isinstance(s, BusSource)] == opened  # none was opened again
    finally:
        stranger.close()
        for source in sources:
            source.close()
        for sender in senders:
            sender.shutdown()
