"""Recordings in which encoders start again or send values that are no counts, written by python-can: what becomes of the counts.

    python benchmarks/recordings_origins.py [--reboots 1000] [--seed 1] [--write]

Part one: inputs of a kind each, with the right cells known. Part two: random reboots of one of six encoders, with and without a boot-up
frame, behind gaps of 1 to 60 samples and without one, of counters of 16, 24 and 32 bits, at rest and moving, live batches and whole logs.
A cell is wrong when it holds a count that differs from the true one. No wrong cell may be off by more than the step that the events
state for the gap behind which it stands; what a device said of itself leaves no wrong cell at all.
"""

import argparse
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can
import numpy as np

from lmeasure.acquisition.assembly import counts_from_frames
from lmeasure.acquisition.decoders import counter_fields
from lmeasure.acquisition.frames import frames_from_messages
from lmeasure.acquisition.import_log import Imported, import_logs
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.simulation import cell_rig

RESULTS = Path(__file__).parent / "results" / "recordings_origins.md"
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


CANOPEN = {
    "decoder": "cia406",
    "channel": [{"channel": f"ch{n}", "node": n + 10, "cob_id": 0x1C0 + n} for n in range(1, NODES + 1)],
}
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


def motion(rng: np.random.Generator, rows: int) -> np.ndarray:
    """(rows, 6) counts of smooth motions with rests: accelerations of up to 3 m/s^2, 0.012 mm a count."""
    t = np.arange(rows) * PERIOD_S
    out = np.zeros((rows, NODES))
    for n in range(NODES):
        for _ in range(3):
            f, size = rng.uniform(0.05, 0.5), rng.uniform(2.0, 80.0)
            out[:, n] += min(size, 3000.0 / (2 * np.pi * f) ** 2 / 3) * np.sin(2 * np.pi * f * t + rng.uniform(0, 6.3))
    rest = np.maximum.accumulate(t - 0.8 * np.floor(rng.uniform(0, 2)) * (t > 1.0))
    return np.rint((out - out[0]) * np.minimum(rest / 0.5, 1.0)[:, None] ** 2 / 0.012)


STATED = re.compile(r"a step below (\d+) units")


def reboot(rng: np.random.Generator) -> tuple[str, int, bool]:
    """One random reboot: its kind, by how many counts the worst cell is beyond the stated step, whether a word left a wrong one."""
    rows, bits = 240, int(rng.choice([16, 24, 32]))
    true = motion(rng, rows)
    node, at = int(rng.integers(NODES)), int(rng.integers(40, 200))
    gap = int(rng.choice([0, 1, 2, 5, 10, 30, 60], p=[0.1, 0.15, 0.15, 0.2, 0.2, 0.1, 0.1]))
    gap = min(gap, at - 20)
    word = str(rng.choice(["boot", "nmt", "none"])) if gap else "boot"
    first = int(rng.choice([0, 1, int(rng.integers(-5000, 5000)), int(rng.integers(-(2**15), 2**15))]))
    sent = true.copy()
    sent[at:, node] += first - true[at, node]
    gone = rng.random((rows, NODES)) < 0.002
    gone[at - gap : at, node] = True
    messages = []
    for r in range(rows):
        t = r * PERIOD_S
        if r == at and word != "none":
            said = frame(t - 0.001, 0x701 + node, b"\0") if word == "boot" else frame(t - 0.001, 0, bytes([0x81, node + 1]))
            messages.append(said)
        messages.append(frame(t, 0x80))
        for n in range(NODES):
            if not gone[r, n]:
                messages.append(frame(t + 0.0002 * (n + 1), 0x181 + n, (int(sent[r, n]) % 2**bits).to_bytes(bits // 8, "little")))
    table = {"decoder": "raw", "channel": [{"channel": f"ch{n + 1}", "id": 0x181 + n, "bits": bits} for n in range(NODES)]}
    one = rig(table, max_cable_speed_mm_s=2000.0)
    frames = frames_from_messages(messages, "log")
    cuts = np.sort(rng.integers(0, len(frames), 6)).tolist() if rng.random() < 0.5 else []
    pieces = [frames.take(slice(a, b)) for a, b in zip([0, *cuts], [*cuts, len(frames)], strict=True)]
    got = counts_from_frames(one, pieces, counter_fields(one))
    worst, stated = 0.0, np.zeros((rows, NODES))
    for event in got.events.kept:
        if event.kind == "gap_step" and (found := STATED.search(event.text)):
            j = int(event.channel[2:]) - 1
            stated[event.sample :, j] += float(found[1])
    cells = got.counts.recorded
    off = np.abs(np.nan_to_num(cells - (true - true[0])))
    worst = float((off - stated).max())
    said_wrong = bool(word != "none" and (off[:, node] > 0).any())
    kind = "none" if off[:, node].max() == 0 and np.isnan(cells[at:, node]).all() else "hidden" if off[:, node].max() else "kept"
    return f"{word}, {'lost' if kind == 'none' else kind}", int(max(worst, 0.0)), said_wrong


def study(count: int, seed: int) -> tuple[list[str], int]:
    """Lines of the table of random reboots, and how many are not right."""
    rng = np.random.default_rng(seed)
    kinds: Counter[str] = Counter()
    beyond = said = 0
    for _ in range(count):
        kind, worst, wrong = reboot(rng)
        kinds[kind] += 1
        beyond += worst > 0
        said += wrong
    lines = ["| word of the device, origin | reboots |", "|---|---|", *(f"| {k} | {n} |" for k, n in sorted(kinds.items()))]
    lines += ["", f"Of {count} reboots {beyond} leave a count that is wrong by more than the step that the events state for that gap;"]
    lines += [f"{said} leave a wrong count behind a word of the device."]
    return lines, beyond + said


def main() -> int:
    """Print the tables; 1 where something is not right."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reboots", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--write", action="store_true")
    settings = parser.parse_args()
    table, wrong = cases()
    drawn, bad = study(settings.reboots, settings.seed)
    text = "\n".join(
        ["# Recordings whose origins are in question", "", f"`python benchmarks/recordings_origins.py --reboots {settings.reboots}`", ""]
        + ["Inputs written by python-can; cells: whether each has the true count or is rightly empty.", "", *table, ""]
        + ["Random reboots of one of six encoders; lost: its cells are empty from there on.", "", *drawn, ""]
    )
    print(text)
    if settings.write:
        RESULTS.write_text(text, encoding="utf-8")
    return int(bool(wrong or bad))


if __name__ == "__main__":
    sys.exit(main())
