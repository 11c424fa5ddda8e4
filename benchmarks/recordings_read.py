"""Recordings that other readers lose: logs by independent writers, read whole or refused, beside python-can.

    python benchmarks/recordings_read.py [--write]

The logs are written by python-can's writers, by cantools' encoder, or byte by byte here, never by lmeasure. Expected numbers of frames are
known from the writing; "same" says that identifiers, data and times (from the first frame) are those that were written. --write writes the
table to benchmarks/results/recordings_read.md.
"""

import logging
import struct
import tempfile
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import can
import cantools
import numpy as np
from study import options, show

import lmeasure as lm

FRAMES = 70
SAMPLES = 10


def traffic() -> list[can.Message]:
    """Ten SYNCs, each with six counters whose bytes cantools encodes."""
    blocks = [f'BO_ {385 + j} Count{j}: 4 Encoder\n SG_ ch{j} : 0|32@1- (1,0) [0|0] "" Encoder\n' for j in range(6)]
    database: Any = cantools.database.load_string('VERSION ""\n\nBU_: Encoder\n\n' + "\n".join(blocks), database_format="dbc")
    log = []
    for i in range(SAMPLES):
        t = i * 0.01
        log.append(can.Message(timestamp=t, arbitration_id=0x80, is_extended_id=False, channel=0))
        for j in range(6):
            data = database.encode_message(385 + j, {f"ch{j}": 1000 * j - 37 * i})
            log.append(can.Message(timestamp=t + (j + 1) * 2e-4, arbitration_id=385 + j, is_extended_id=False, channel=0, data=data))
    return log


def asc(
    log: list[can.Message], shift: float = 0.0, comma: bool = False, sign: str = "", symbolic: bool = False, relative: bool = False
) -> str:
    """ASC as Vector's document describes it."""
    lines = [
        "date Mon Jan 1 10:00:00.000 am 2024",
        f"base hex  timestamps {'relative' if relative else 'absolute'}",
        "no internal events logged",
    ]
    before = 0.0
    for m in log:
        time = f"{m.timestamp + shift - (before if relative else 0.0):.6f}"
        before = m.timestamp + shift
        time = sign + time if not time.startswith("-") else time
        name = f"Encoder_{m.arbitration_id}" if symbolic else f"{m.arbitration_id:X}"
        tail = f"  Length = 0 BitCount = 0 ID = {m.arbitration_id}" if symbolic else ""
        lines.append(f"  {time.replace('.', ',') if comma else time} 1  {name}  Rx   d {m.dlc} {m.data.hex(' ').upper()}{tail}")
    return "\n".join(lines) + "\n"


def trc(log: list[can.Message], version: str, comma: bool = True, note: str = "") -> str:
    """TRC as PEAK's document describes it."""
    lines = [f";$FILEVERSION={version}", ";$STARTTIME=25569,0" if comma else ";$STARTTIME=25569.0"]
    lines += [";$COLUMNS=N,O,T,I,d,l,D"] * (version >= "2")
    for n, m in enumerate(log, 1):
        offset = f"{m.timestamp * 1000:.3f}"
        offset = offset.replace(".", ",") if comma else offset
        head, data = f"{m.arbitration_id:04X}", f"{m.dlc} {m.data.hex(' ').upper()}{note}"
        lines.append(
            {
                "1.0": f"{n}) {offset} {head} {data}",
                "1.1": f"{n}) {offset} Rx {head} {data}",
                "1.2": f"{n}) {offset} 1 Rx {head} {data}",
                "1.3": f"{n}) {offset} 1 Rx {head} - {data}",
            }.get(version, f"{n} {offset} DT {head} Rx {data}")
        )
    return "\r\n".join(lines) + "\r\n"


def gvret(
    log: list[can.Message], scale: float = 1e6, shift: float = 0.0, form: str = ".3f", separator: str = ",", comma: bool = False
) -> str:
    """CSV of SavvyCAN."""
    lines = [separator.join(["Time Stamp", "ID", "Extended", "Dir", "Bus", "LEN", *(f"D{i}" for i in range(1, 9))])]
    for m in log:
        time = f"{(m.timestamp + shift) * scale:{form}}"
        cells = [time.replace(".", ",") if comma else time, f"{m.arbitration_id:08X}", "false", "Rx", "0", str(m.dlc)]
        lines.append(separator.join([*cells, *(f"{b:02X}" for b in m.data)]))
    return "\n".join(lines) + "\n"


def blf_object(m: can.Message, version: int, kind: int) -> bytes:
    """An object after Wireshark's blf.h."""
    ticks = round(m.timestamp * 1e9)
    head = struct.pack("<LBxHQ8x", 2, 0, 0, ticks) if version == 2 else struct.pack("<LHHQ", 2, 0, 0, ticks)
    if kind == 101:
        body = struct.pack("<BBBBLLLLLLLHBBL", 1, m.dlc, m.dlc, 0, m.arbitration_id, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0) + bytes(m.data)
    elif kind == 100:
        body = struct.pack("<HBBLLBBB5x64s", 1, 0, m.dlc, m.arbitration_id, 0, 0, 0, m.dlc, bytes(m.data))
    else:
        body = struct.pack("<HBBL8s", 1, 0, m.dlc, m.arbitration_id, bytes(m.data)) + bytes(8 if kind == 86 else 0)
    size = 16 + len(head) + len(body)
    return b"LOBJ" + struct.pack("<HHLL", 16 + len(head), version, size, kind) + head + body + bytes(size % 4)


def blf(parts: Iterable[tuple[bool, bytes]], stated: int) -> bytes:
    """A BLF file: containers (True) and objects outside (False)."""
    content = b""
    for packed, objects in parts:
        body = zlib.compress(objects)
        box = b"LOBJ" + struct.pack("<HHLL", 16, 1, 32 + len(body), 10) + struct.pack("<H6xL4x", 2, len(objects)) + body
        content += box + bytes(len(box) % 4) if packed else objects
    head = struct.pack("<4sLBBBBBBBBQQLL", b"LOGG", 144, 5, 0, 0, 0, 2, 6, 8, 1, 144 + len(content), 0, stated, 0)
    return head.ljust(144, b"\0") + content


def inputs(log: list[can.Message]) -> dict[str, tuple[str, str | bytes]]:
    """(file name, content) of each recording, by what is odd in it."""
    objects = {(v, k): b"".join(blf_object(m, v, k) for m in log) for v in (1, 2, 3) for k in (1, 86, 100, 101)}
    half = b"".join(blf_object(m, 1, 1) for m in log[:35]), b"".join(blf_object(m, 3, 86) for m in log[35:])
    python_can = "timestamp;arbitration_id;extended;remote;error;dlc;data\n"
    return {
        "ASC: all times before zero": ("a.asc", asc(log, -1.0)),
        "ASC: times from -0.05 s, relative": ("b.asc", asc(log, -0.05, relative=True)),
        "ASC: plus signs": ("c.asc", asc(log, 0.0, sign="+")),
        "ASC: decimal commas, negative": ("d.asc", asc(log, -0.05, comma=True)),
        "ASC: tabs and line ends of DOS": ("e.asc", asc(log, -0.05).replace("  ", "\t").replace("\n", "\r\n")),
        "ASC: message names, ID = n": ("f.asc", asc(log, symbolic=True)),
        "ASC: message names, decimal base": ("g.asc", asc([m for m in log if not m.data], symbolic=True).replace("hex", "dec")),
        "ASC: message names and negative times": ("h.asc", asc(log, -0.05, symbolic=True)),
        "ASC: names that could be numbers": ("i.asc", asc(log, symbolic=True).replace("Encoder_38", "AF")),
        "ASC: names of other alphabets": ("j.asc", asc(log, symbolic=True).replace("Encoder_", "Датчик_")),
        "BLF: all outside containers": ("a.blf", blf([(False, objects[1, 1])], FRAMES)),
        "BLF: half outside, header 3": ("b.blf", blf([(True, half[0]), (False, half[1])], FRAMES)),
        "BLF: outside, then a container": ("c.blf", blf([(False, half[0]), (True, half[1])], FRAMES)),
        "BLF: header 3, CAN_MESSAGE": ("d.blf", blf([(True, objects[3, 1])], FRAMES)),
        "BLF: header 3, CAN_FD_MESSAGE": ("e.blf", blf([(True, objects[3, 100])], FRAMES)),
        "BLF: header 3, CAN_FD_MESSAGE_64": ("f.blf", blf([(True, objects[3, 101])], FRAMES)),
        "BLF: header 2 outside, CAN_MESSAGE2": ("g.blf", blf([(False, objects[2, 86])], FRAMES)),
        "BLF: header states one more": ("h.blf", blf([(True, objects[1, 1])], FRAMES + 1)),
        "BLF: header of version 4": ("i.blf", blf([(True, objects[3, 1].replace(b"\x20\x00\x03\x00", b"\x20\x00\x04\x00"))], FRAMES)),
        **{f"TRC {v}: decimal commas": (f"{v}.trc", trc(log, v)) for v in ("1.0", "1.1", "1.2", "1.3", "2.0", "2.1")},
        "TRC 1.1: notes behind the data": ("n.trc", trc(log, "1.1", note="  note")),
        "candump: decimal commas": (
            "a.log",
            "".join(f"({m.timestamp:.6f}) can0 {m.arbitration_id:03X}#{m.data.hex()}\n".replace(".", ",") for m in log),
        ),
        "python-can CSV: semicolons, commas": (
            "p.csv",
            python_can + "".join(f"{m.timestamp:.6f};{m.arbitration_id:#x};0;0;0;{m.dlc};{_base64(m)}\n".replace(".", ",") for m in log),
        ),
        "GVRET: fractions of microseconds": ("a.csv", gvret(log)),
        "GVRET: negative times": ("b.csv", gvret(log, shift=-0.05, form=".0f")),
        "GVRET: negative fractions": ("c.csv", gvret(log, shift=-0.05)),
        "GVRET: semicolons and commas": ("d.csv", gvret(log, separator=";", comma=True)),
        "GVRET: tabs": ("e.csv", gvret(log, separator="\t")),
    }


def _base64(m: can.Message) -> str:
    import base64

    return base64.b64encode(bytes(m.data)).decode()


def by_library(path: Path) -> str:
    """Frames that python-can reads, and how it ends."""
    try:
        with can.LogReader(path) as reader:
            return f"{sum(1 for _ in reader)}"
    except Exception as error:
        return type(error).__name__


def main() -> None:
    """Read all, and print the table."""
    parser = options(__doc__)
    asked = parser.parse_args()
    logging.disable(logging.ERROR)
    log = traffic()
    lines = ["| recording | frames written | read | same | known | unread | said | python-can |", "|---|---|---|---|---|---|---|---|"]
    with tempfile.TemporaryDirectory() as folder:
        for title, (name, content) in inputs(log).items():
            path = Path(folder) / name
            path.write_bytes(content.encode() if isinstance(content, str) else content)
            wanted = [m for m in log if not m.data] if "decimal base" in title else log
            frames, report = lm.read_frames(path)
            if report.frames + report.known + report.unread != report.total:
                raise SystemExit(f"{title}: the sum does not match")
            same = len(frames) == len(wanted) and [(m.arbitration_id, bytes(m.data)) for m in wanted] == [
                (int(i), d[:n].tobytes()) for i, d, n in zip(frames.identifier, frames.data, frames.length, strict=True)
            ]
            times = np.array([m.timestamp for m in wanted])
            same = same and bool(np.allclose(frames.time_s - frames.time_s[0], times - times[0], atol=1e-6))
            said = "; ".join(report.notes()).replace("|", " ")[:90]
            row = [title, len(wanted), len(frames), "yes" if same else "no", report.known, report.unread, said, by_library(path)]
            lines.append(f"| {' | '.join(map(str, row))} |")
    head = "# Recordings that other readers lose\n\n`python benchmarks/recordings_read.py --write`\n\n"
    show(asked, head + "\n".join(lines), "recordings_read")


if __name__ == "__main__":
    main()
