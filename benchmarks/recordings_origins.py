"""Recordings in which encoders start again, send values that are no counts, or the bus has errors: what becomes of counts and events.

    python benchmarks/recordings_origins.py [--write]

Inputs of a kind each, written by python-can or by own bytes, with the right cells and events known. A cell is wrong when it holds a count
that differs from the true one. Random restarts: recordings_study.py.
"""

import struct
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can
import numpy as np
from study import options, show

from lmeasure.acquisition import Imported, import_logs, read_frames, write_import
from lmeasure.acquisition.bus.network import NetworkWatch
from lmeasure.io.tables import read_table
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.simulation import cell_rig

PERIOD_S, ROWS, NODES = 0.01, 60, 6
T0 = 1_700_000_000.0
Message = can.Message


def rig(table: dict[str, Any] | None = None, **drum: Any) -> Rig:
    """The simulated cell with a `[can]` table and drums changed alike."""
    data = cell_rig(4).to_dict()
    for point in data["observation_point"]:
        point["drum"] |= drum
    return rig_from_dict(data | ({"can": table} if table else {}))


def frame(t: float, identifier: int, data: bytes = b"", extended: bool = False, error: bool = False) -> Message:
    """A frame at t [s] from the beginning."""
    return Message(timestamp=T0 + t, arbitration_id=identifier, data=data, is_extended_id=extended, is_error_frame=error)


def even(row: int, node: int) -> int:
    """The true count of a node: cables at constant speeds, some of them backwards."""
    return (10 + 7 * node) * row * (1 if node % 2 else -1)


@dataclass
class Recording:
    """Frames of a cell: counts of (row, node), silent cells, what is sent instead, and other frames by the row before which they come."""

    count: Callable[[int, int], int | None] = even
    bits: int = 32
    identifier: Callable[[int], int] = lambda node: 0x180 + node
    others: tuple[tuple[int, Message], ...] = ()
    sync: Callable[[int], bool] = lambda row: True
    between: bool = False
    """Whether other frames come between a SYNC and its answers."""

    def messages(self) -> list[Message]:
        """The frames in their order."""
        out: list[Message] = []
        for row in range(ROWS):
            mine = [m for at, m in self.others if at == row]
            t = row * PERIOD_S
            for k, m in enumerate(mine):
                m.timestamp = T0 + t + (0.0001 if self.between else -0.002 + 0.0001 * k)
            out += [] if self.between else mine
            if self.sync(row):
                out.append(frame(t, 0x80))
            out += mine if self.between else []
            for node in range(1, NODES + 1):
                value = self.count(row, node)
                if value is not None:
                    data = (value % 2**self.bits).to_bytes(self.bits // 8, "little")
                    out.append(frame(t + 0.0002 * node, self.identifier(node), data))
        return out


def boot(node: int, state: int = 0) -> Message:
    """A boot-up message, or another state."""
    return frame(0, 0x700 + node, bytes([state]))


def restarted(at: int, first: int | None, node: int = 3, silent: int = 5, base: Callable[[int, int], int] = even) -> Any:
    """Counts of which one node's are silent before row `at` and go on from `first` there; None: from where they were."""

    def count(row: int, n: int) -> int | None:
        if n != node or row < at - silent:
            return base(row, n)
        if row < at:
            return None
        return base(row, n) if first is None else first + base(row, n) - base(at, n)

    return count


def read(one: Rig, messages: list[Message], suffix: str = ".blf") -> Imported:
    """What import makes of the frames, written by python-can."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"log{suffix}"
        with can.Logger(str(path)) as logger:
            for m in messages:
                logger(m)
        return import_logs([path], one, None)


CANOPEN = {"decoder": "cia406", "channel": [{"channel": f"ch{n}", "node": n + 10, "cob_id": 0x1C0 + n} for n in range(1, NODES + 1)]}
NO = None
Case = tuple[str, Rig, list[Message], Callable[[np.ndarray], str]]


def column(good: range | list[int] | None, channel: int = 3, truth: Callable[[int, int], int] = even) -> Callable[[np.ndarray], str]:
    """A check: the channel has its true counts in these rows and none elsewhere, the others theirs."""

    def check(got: np.ndarray) -> str:
        want = np.array([[truth(r, n) for n in range(1, NODES + 1)] for r in range(ROWS)], np.float64)
        if good is not None:
            want[np.setdiff1d(np.arange(ROWS), list(good)), channel - 1] = np.nan
        if got.shape != want.shape:
            return f"{got.shape} cells"
        bad = ~((got == want) | (np.isnan(got) & np.isnan(want)))
        return "" if not bad.any() else f"{bad.sum()} cells, first row {np.argwhere(bad)[0][0]} ch{np.argwhere(bad)[0][1] + 1}"

    return check


def restarts() -> list[Case]:
    """Restarts, announced and not."""
    plain, from_30 = rig(), restarted(30, 57)
    emcy = frame(0, 0x83, bytes([0x00, 0x73, 0x81, 0, 0, 0, 0, 0]))
    warm = frame(0, 0x83, bytes([0x10, 0x42, 0x09, 0, 0, 0, 0, 0]))
    multiturn = {"decoder": "raw", "channel": [{"channel": f"ch{n}", "id": 0x180 + n, "absolute": True} for n in range(1, 7)]}
    return [
        ("boot-up, goes on from 57", plain, Recording(from_30, others=((29, boot(3)),)).messages(), column(range(25))),
        (
            "boot-up between SYNC and answer, no gap",
            plain,
            Recording(restarted(30, 57, silent=0), others=((30, boot(3)),), between=True).messages(),
            column(range(30)),
        ),
        (
            "boot-up at rest, the same counts",
            plain,
            Recording(lambda r, n: 1000 * n, others=((30, boot(3)),)).messages(),
            column(range(30), truth=lambda r, n: 1000 * n),
        ),
        ("two reboots", plain, Recording(from_30, others=((29, boot(3)), (45, boot(3)))).messages(), column(range(25))),
        ("boot-up of a node that the rig does not have", plain, Recording(others=((30, boot(9)),)).messages(), column(None)),
        ("NMT reset of node 3", plain, Recording(from_30, others=((26, frame(0, 0, bytes([0x81, 3]))),)).messages(), column(range(25))),
        (
            "NMT reset communication of another node",
            plain,
            Recording(others=((30, frame(0, 0, bytes([0x82, 9]))),)).messages(),
            column(None),
        ),
        ("emergency of the sensor", plain, Recording(from_30, others=((29, emcy),)).messages(), column(range(25))),
        ("emergency of temperature: nothing is lost", plain, Recording(others=((30, warm),)).messages(), column(None)),
        (
            "CiA 406 table, other COB-IDs: boot-up of node 13",
            rig(CANOPEN),
            Recording(from_30, identifier=lambda n: 0x1C0 + n, others=((29, boot(13)),)).messages(),
            column(range(25)),
        ),
        (
            "CiA 406 table, other COB-IDs: boot-up of node 67",
            rig(CANOPEN),
            Recording(identifier=lambda n: 0x1C0 + n, others=((29, boot(67)),)).messages(),
            column(None),
        ),
        (
            "boot-up of a multiturn absolute encoder",
            rig(multiturn),
            Recording(restarted(30, None), others=((29, boot(3)),)).messages(),
            column([*range(25), *range(30, ROWS)]),
        ),
        (
            "zero_exact, its counts go on",
            rig(zero_exact=True),
            Recording(restarted(30, None), others=((29, boot(3)),)).messages(),
            column([*range(25), *range(30, ROWS)]),
        ),
        ("brown-out without a word, goes on from 57", plain, Recording(from_30).messages(), column(range(25))),
        ("brown-out without a word, goes on from 5000", plain, Recording(restarted(30, 5000)).messages(), column(range(25))),
        (
            "brown-out of the whole bus, SYNC too",
            plain,
            Recording(
                lambda r, n: even(r, n) if r < 25 else None if r < 30 else even(r, n) - even(30, n) + 57, sync=lambda r: not 25 <= r < 30
            ).messages(),
            lambda got: "" if np.isnan(got[25:]).all() else "counts behind it",
        ),
        (
            "silence without a restart: counts go on",
            plain,
            Recording(restarted(30, None)).messages(),
            column([*range(25), *range(30, ROWS)]),
        ),
    ]


def j1939(bits: int, order: Any, whole: bool = False) -> Rig:
    """A rig of J1939 sensors."""
    channel = [
        {"channel": f"ch{n}", "pgn": 65268, "source_address": n, "bits": bits, "byte_order": order, "whole_range": whole}
        for n in range(1, 7)
    ]
    return rig({"decoder": "j1939", "timing": "sync", "channel": channel}, max_cable_speed_mm_s=2000.0)


def sent_by_j1939(bits: int, order: Any, instead: dict[tuple[int, int], int]) -> list[Message]:
    """Frames with counts, in some cells other raw values."""
    out = []
    for row in range(ROWS):
        out.append(frame(row * PERIOD_S, 0x80))
        for n in range(1, NODES + 1):
            raw = instead.get((row, n), 3 * n * row)
            out.append(frame(row * PERIOD_S + 0.0002 * n, 0x18FEF400 | n, raw.to_bytes(bits // 8, order), extended=True))
    return out


DBC = """VERSION ""
BU_: Sensor
{messages}
{values}
"""


def dbc(limits: str, values: str = "", signed: str = "-", factor: str = "1,0") -> Rig:
    """A rig of a DBC file."""
    messages = "\n".join(
        f'BO_ {0x180 + n} M{n}: 4 Sensor\n SG_ Count : 0|32@1{signed} ({factor}) {limits} "" Sensor\n' for n in range(1, 7)
    )
    named = "\n".join(f"VAL_ {0x180 + n} Count {values} ;" for n in range(1, 7)) if values else ""
    path = Path(tempfile.mkdtemp()) / "rig.dbc"
    path.write_text(DBC.format(messages=messages, values=named), encoding="ascii")
    channel = [{"channel": f"ch{n}", "message": f"M{n}", "signal": "Count"} for n in range(1, 7)]
    return rig({"decoder": "dbc", "dbc": str(path), "channel": channel})


def no_values() -> list[Case]:
    """Values that mean that there is none."""

    def but(*rows: int) -> Callable[[np.ndarray], str]:
        return column(sorted(set(range(ROWS)) - set(rows)), 2, lambda r, n: 3 * n * r)

    def recorded(instead: dict[tuple[int, int], int]) -> list[Message]:
        return Recording(lambda r, n: instead.get((r, n), 3 * n * r)).messages()

    out: list[Case] = []
    for bits, order in ((16, "little"), (16, "big"), (24, "little"), (24, "big"), (32, "big")):
        instead = {(20, 2): 2**bits - 1, (21, 2): 0xFE << bits - 8, (22, 2): 0xFB << bits - 8}
        out.append(
            (f"J1939, {bits} bits, {order}: FF.., FE.., FB..", j1939(bits, order), sent_by_j1939(bits, order, instead), but(20, 21, 22))
        )
    below = {(20, 2): 0xFAFFFFFF}
    whole = {(r, 2): (3 * 2 * r - 60) % 2**32 for r in range(ROWS)}
    out += [
        (
            "J1939: FAFFFFFFh is a count",
            j1939(32, "little"),
            sent_by_j1939(32, "little", below),
            lambda got: "" if np.isfinite(got[20, 1]) else "empty",
        ),
        (
            "J1939 with whole_range: counts below zero",
            j1939(32, "little", whole=True),
            sent_by_j1939(32, "little", whole),
            column(None, 2, lambda r, n: 6 * r - 60 if n == 2 else 3 * n * r),
        ),
        ("DBC: outside [min|max]", dbc("[-100000|100000]"), recorded({(20, 2): 100001, (21, 2): -(2**31)}), but(20, 21)),
        (
            "DBC: outside a scaled [min|max]",
            dbc("[-1000|1000]", factor="0.01,5"),
            recorded({(20, 2): 99501, (21, 2): -100501}),
            but(20, 21),
        ),
        ("DBC: [0|0] is no range", dbc("[0|0]"), recorded({}), but()),
        ("DBC: named SNA", dbc("[0|0]", '2147483647 "SNA"'), recorded({(20, 2): 2**31 - 1}), but(20)),
        (
            "DBC: named Signal_Not_Available, Error",
            dbc("[0|0]", '-1 "Signal_Not_Available" -2 "SensorError" 0 "No error"'),
            recorded({(20, 2): -1, (22, 2): -2}),
            but(20, 22),
        ),
    ]
    return out


def cases() -> tuple[list[str], int]:
    """Lines of the table, and how many inputs are not right."""
    lines, wrong = ["| input | cells | events |", "|---|---|---|"], 0
    for name, one, messages, check in [*restarts(), *no_values()]:
        log = read(one, messages).logs[0]
        said = check(log.counts.recorded)
        wrong += bool(said)
        lines.append(f"| {name} | {said or 'right'} | {log.events.summary()} |")
    return lines, wrong


TRC_1 = ";$FILEVERSION=1.1\n;$STARTTIME=45000.5\n"
TRC_2 = ";$FILEVERSION=2.1\n;$STARTTIME=45000.5\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n"
ASC = "date Fri Nov 17 10:00:00.000 2023\nbase hex  timestamps absolute\nno internal events logged\n"
BIT, OFF, PASSIVE = "bus_error", "bus_off", "error_passive"
Errors = tuple[str, str | bytes | list[Message], list[tuple[str, float]]]


def blf(*objects: tuple[int, bytes]) -> bytes:
    """A BLF file of so many objects (kind, body) outside containers, one each 10 ms."""
    body = b""
    for k, (kind, content) in enumerate(objects, 1):
        header = struct.pack("<4sHHLLLHHQ", b"LOBJ", 32, 1, 32 + len(content), kind, 2, 0, 0, k * 10_000_000)
        body += header + content + bytes(-len(content) % 4)
    head = struct.pack("<4sLBBBBBBBBQQLL", b"LOGG", 144, 0, 0, 0, 0, 2, 6, 8, 1, 144 + len(body), 144 + len(body), len(objects), 0)
    return (head + struct.pack("<8H8H", *(2023, 11, 5, 17, 10, 0, 0, 0) * 2)).ljust(144, b"\0") + body


def error_frames() -> list[Errors]:
    """Errors of the bus: name of a file, its content, kinds of events and their times [s] behind a frame at 0."""
    coded = ((0x40, bytes(8)), (0x204, b"\0\x20\0\0\0\0\x84\0"), (0x204, b"\0\x04\0\0\0\0\0\x60"), (0x88, b"\0\0\x08\x19" + bytes(4)))
    said = [frame(0.02 * k, i, data, error=True) for k, (i, data) in enumerate(coded)]
    kinds = [(OFF, 0.0), (PASSIVE, 0.02), (BIT, 0.04), (BIT, 0.06)]
    lines = "".join(f"({m.timestamp:.6f}) can0 {0x20000000 | m.arbitration_id:08X}#{m.data.hex()}\n" for m in said)
    screen = "".join(f" ({m.timestamp:.6f})  can0  {0x20000000 | m.arbitration_id:08X}   [8]  {m.data.hex(' ').upper()}   ERRORFRAME\n\t"
                     "bus-off\n" for m in said)  # fmt: skip
    ext = struct.Struct("<HHLBBBxLLH2x8s")
    return [
        ("python-can.blf", said, kinds),
        ("python-can.csv", said, kinds),
        ("plain.log", lines, kinds),
        ("comma.log", lines.replace(".", ","), kinds),
        ("screen.txt", screen, kinds),
        ("python-can.log", said, [(BIT, t) for _, t in kinds]),
        ("python-can.asc", said, [(BIT, t) for _, t in kinds]),
        ("status.asc", f"{ASC}0.01 1 181 Rx d 1 00\n0.02 CAN 1 Status:chip status error passive - TxErr: 132 RxErr: 0\n"
         "0.03 CAN 1 Status:chip status busoff\n0.04 CAN 1 Status:chip status error active\n"
         "0.05 1  Statistic: D 0 R 0 XD 0 XR 0 E 9 O 0 B 0%\n"
         "0.06 CAN 1 Status:chip status warning level\n"
         "0.07 1 ErrorFrame Flags = 0xe CodeExt = 0x20a2 Code = 0x82 ID = 40 DLC = 0 Position = 5\n",
         [(PASSIVE, 0.01), (OFF, 0.02), (BIT, 0.05), (BIT, 0.06)]),
        ("one.trc", f"{TRC_1} 1) 10.0 Rx 0181 1 00\n 2) 20.0 Warng FFFFFFFF 4 00 00 00 08 BUSHEAVY\n 3) 30.0 Error 0004 4 00 19 08 88\n"
         " 4) 40.0 Warng FFFFFFFF 4 00 00 00 08 BUSHEAVY\n 5) 50.0 Warng FFFFFFFF 4 00 00 00 10 BUSOFF\n"
         " 6) 60.0 Warng FFFFFFFF 4 00 00 00 00\n",
         [(BIT, 0.01), (BIT, 0.02), (PASSIVE, 0.03), (OFF, 0.04)]),
        ("two.trc", f"{TRC_2} 1 10.0 DT 1 0181 Rx - 1 00\n 2 20.0 ER 1 - Rx - 5 04 00 02 00 00\n 3 30.0 ST 1 - Rx - 4 00 00 00 08\n"
         " 4 40.0 ST 1 - Rx - 4 00 04 00 00\n 5 50.0 ST 1 - Rx - 4 00 00 00 10\n 6 60.0 EC 1 - Rx - 2 02 02\n",
         [(BIT, 0.01), (BIT, 0.02), (PASSIVE, 0.03), (OFF, 0.04)]),
        ("vector.blf", blf((1, struct.pack("<HBBL8s", 1, 0, 1, 0x181, bytes(8))), (2, struct.pack("<HHL", 1, 0, 0)),
                           (73, ext.pack(1, 0, 1, 0x82, 5, 8, 0, 0x40, 0x20A2, bytes(8))), (31, struct.pack("<HBBL", 1, 132, 0, 7)),
                           (74, struct.pack("<HBBLLB3x16x", 1, 0, 100, 7, 0, 0)), (31, struct.pack("<HBBL", 1, 0, 0, 0))),
         [(BIT, 0.01), (BIT, 0.02), (PASSIVE, 0.03), (BIT, 0.04)]),
    ]  # fmt: skip


def errors_of(name: str, content: str | bytes | list[Message]) -> tuple[list[tuple[str, float]], list[str]]:
    """Kinds and times [s] of the errors in a log of this content, and their texts, as the program has them."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        if isinstance(content, list):
            with can.Logger(str(path)) as logger:
                for m in content:
                    logger(m)
        else:
            path.write_bytes(content.encode() if isinstance(content, str) else content)
        frames, report = read_frames(path)
    assert report.unread == 0
    words = NetworkWatch((), 0x80).words(frames)
    return [(w.kind, round(float(frames.time_s[w.row] - frames.time_s[0]), 6)) for w in words], [w.text for w in words]


def beside_counts() -> list[tuple[str, str]]:
    """Names of recordings, and how the events of their imports miss the samples and times of pass1.csv."""
    off = frame(0, 0x40, bytes(8), error=True)
    given = [
        (f"{name}, first sample {begin}", begin, at, Recording(count, others=((at, other),)).messages()[7 * begin :])
        for begin in (0, 7)
        for name, at, count, other in (
            ("bus-off", 30, even, off),
            ("boot-up", 30, even, boot(3)),
            ("emergency", 22, even, frame(0, 0x83, bytes([0, 0x73, 0x81, 0, 0, 0, 0, 0]))),
        )
    ]
    out = []
    for name, begin, at, messages in given:
        with tempfile.TemporaryDirectory() as folder:
            write_import(Path(folder) / "run", read(rig(), messages, ".blf"))
            counts, found = (read_table(Path(folder) / "run" / f"pass1{end}.csv") for end in ("", ".events"))
            times, samples, events_s = counts.numbers("time_s"), found.numbers("sample"), found.numbers("time_s")
        row = at - begin
        good = row in samples and all(abs(events_s[samples == row] - times[row]) <= PERIOD_S / 2)
        out.append((name, "" if good else f"samples {samples.tolist()}, times {events_s.tolist()}"))
    return out


def events() -> tuple[list[str], int]:
    """Lines of the table of errors and events, and how many inputs are not right."""
    lines, wrong = ["| input | events | text of each |", "|---|---|---|"], 0
    for name, content, reported in error_frames():
        found, texts = errors_of(name, content)
        wrong += found != reported
        lines.append(f"| {name} | {'right' if found == reported else found} | {'; '.join(texts)} |")
    for name, said in beside_counts():
        wrong += bool(said)
        lines.append(f"| {name} | {said or 'right'} | |")
    return lines, wrong


def main() -> int:
    """Print the tables; 1 where something is not right."""
    parser = options(__doc__)
    settings = parser.parse_args()
    table, wrong = cases()
    more, bad = events()
    text = "\n".join(
        ["# Recordings whose origins are in question, and events", "", "`python benchmarks/recordings_origins.py`", ""]
        + ["Inputs written by python-can; cells: whether each has the true count or is rightly empty.", "", *table, ""]
        + ["Errors of the bus as written by python-can or by own bytes, and events of imports beside pass1.csv.", "", *more, ""]
    )
    show(settings, text, "recordings_origins")
    return int(bool(wrong or bad))


if __name__ == "__main__":
    sys.exit(main())
