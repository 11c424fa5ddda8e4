"""Logs as others write them: TRC of every version, candump's screen, SavvyCAN, text of any name; against python-can where it can."""

import contextlib
import gzip
from datetime import UTC, datetime, timedelta
from pathlib import Path

import can
import numpy as np
import pytest
from log_corpus import START, Row, library_rows, messages, rows, write
from log_fuzz import mutated

from lmeasure.acquisition import read_frames
from lmeasure.acquisition.bus.frames import BITRATE_SWITCH, ERROR_STATE, messages_from_frames
from lmeasure.acquisition.logs.lines import FD_LENGTHS
from lmeasure.acquisition.logs.report import LogReport
from lmeasure.core import FileFormatError

DAY_ZERO = datetime(1899, 12, 30, tzinfo=UTC)
EXTENDED, REMOTE, ERROR, FD, SWITCH, STATE, RECEIVED, LENGTH, DATA, BUS = range(2, 12)


def read_rows(path: Path) -> tuple[list[Row], LogReport]:
    frames, report = read_frames(path)
    return rows(messages_from_frames(frames)), report


def fd_log(count: int, seed: int) -> list[can.Message]:
    """Classic and FD traffic of every length, without what the dialects do not hold: error frames."""
    log = [m for m in messages(count, seed, channels=(0, 1)) if not m.is_error_frame]
    every = [
        can.Message(timestamp=START + 1e7 + i, arbitration_id=0x181, is_extended_id=False, is_fd=True, data=bytes(range(n)), channel=0)
        for i, n in enumerate(FD_LENGTHS)
    ]
    return log + every


# TRC --------------------------------------------------------------------------------------------------------------------------------

START_TIME = (datetime.fromtimestamp(START, UTC) - DAY_ZERO) / timedelta(days=1)
TYPES = {(False, False): "FD", (True, False): "FB", (False, True): "FE", (True, True): "BI"}


def trc(log: list[can.Message], version: str, columns: str = "") -> str:
    """The log as PEAK's programs write it. Versions before 2.0 hold classic frames only."""
    lines = [f";$FILEVERSION={version}", f";$STARTTIME={START_TIME!r}"] if version != "1.0" else []
    lines += [f";$COLUMNS={columns}"] * bool(columns) + [";   a comment", ";---+--   ----+----  --+--  ----+---  +  -+ --"]
    for number, m in enumerate(log, 1):
        code = FD_LENGTHS.index(len(m.data)) if m.is_fd else m.dlc
        cell = {
            "N": f"{number}" + ")" * (version < "2"),
            "O": f"{(m.timestamp - START) * 1000:.3f}",
            "T": TYPES[m.bitrate_switch, m.error_state_indicator] if m.is_fd else "RR" if m.is_remote_frame else "DT",
            "B": str(int(str(m.channel)) + 1),
            "I": f"{m.arbitration_id:08X}" if m.is_extended_id else f"{m.arbitration_id:04X}",
            "d": "Rx" if m.is_rx else "Tx",
            "R": "-",
            "L": str(code),
            "l": str(len(m.data) if m.is_fd else m.dlc),
            "D": ("RTR" if version < "2" else "") if m.is_remote_frame else " ".join(f"{byte:02X}" for byte in m.data),
        }
        order = {"1.0": "N,O,I,L,D", "1.1": "N,O,d,I,L,D", "1.2": "N,O,B,d,I,L,D", "1.3": "N,O,B,d,I,R,L,D"}.get(version, columns)
        lines.append("  ".join(cell[name] for name in order.split(",")))
    return "\r\n".join(lines) + "\r\n"


@pytest.mark.parametrize(("version", "columns"), [("2.1", "N,O,T,B,I,d,R,L,D"), ("2.0", "N,O,T,I,d,l,D"), ("2.1", "N,O,T,B,I,d,l,D")])
def test_trc_of_every_fd_length(tmp_path: Path, version: str, columns: str) -> None:
    """The column L is a length code (9 means 12 bytes), l a length; types as PEAK's document names them."""
    log = fd_log(600, 1)
    path = tmp_path / "log.trc"
    path.write_text(trc(log, version, columns), newline="")
    found, report = read_rows(path)
    assert report.notes() == []
    assert [f[1:BUS] for f in found] == [r[1:BUS] for r in rows(log)]
    assert [f[0] for f in found] == pytest.approx([m.timestamp for m in log], abs=1e-6)
    assert {f[BUS] for f in found} == ({"1", "2"} if "B" in columns else {"1"})
    assert {f[LENGTH] for f in found if f[FD]} == set(FD_LENGTHS)


def test_trc_whose_writer_put_the_length_where_the_code_belongs(tmp_path: Path) -> None:
    """The example in PEAK's own document of 2016 says 12 with 12 bytes behind it."""
    path = tmp_path / "log.trc"
    text = trc(fd_log(0, 1), "2.1", "N,O,T,B,I,d,R,l,D").replace("R,l,D", "R,L,D")
    path.write_text(text)
    assert read_frames(path)[0].length.tolist() == list(FD_LENGTHS)
    path.write_text(text.replace("  -  64  00", "  -  64  00 00"))
    found, report = read_rows(path)
    assert len(found) == len(FD_LENGTHS) - 1
    assert "64 bytes are announced and 65 are there" in report.notes()[0] or "65 bytes, 64 are the most" in report.notes()[0]


@pytest.mark.parametrize("version", ["1.0", "1.1", "1.3", "2.1"])
def test_trc_as_the_library_reads_it(tmp_path: Path, version: str) -> None:
    log = [m for m in messages(500, 2, fd=False, channels=(0, 1)) if not m.is_error_frame]
    path = tmp_path / "log.trc"
    path.write_text(trc(log, version, "N,O,T,B,I,d,R,L,D" if version == "2.1" else ""), newline="")
    expected, whole = library_rows(path)
    found, report = read_rows(path)
    assert whole
    assert found == expected
    assert len(found) == len(log)
    assert report.notes() == []


def test_trc_1_2_and_errors_of_the_adapter(tmp_path: Path) -> None:
    """Version 1.2, which python-can refuses, warnings and errors of the adapter in every version: error frames with SocketCAN's data."""
    path = tmp_path / "log.trc"
    path.write_text(
        ";$FILEVERSION=1.2 \n;$STARTTIME=39878.6772258947;\n"
        "  1)  1059.900  1  Rx      0300  7  00 00 00 00 04 00 00\n  2)  1298.945  2  Tx  0400  2  00 01  \n"
        "  3)  1346.834  1  Warng  FFFFFFFF  4  00 00 00 04  BUSLIGHT\n  4)  1349.222  1  Error  0008  4  00 19 08 08\n"
        "  5)  1352.743  1  Rx  0100  3  RTR\n"
    )
    found, report = read_rows(path)
    assert [(f[1], f[REMOTE], f[LENGTH], f[DATA], f[BUS]) for f in found] == [
        (0x300, False, 7, b"\0\0\0\0\4\0\0", "1"),
        (0x400, False, 2, b"\0\1", "2"),
        (0x004, False, 8, b"\0\x0c\0\0\0\0\0\0", "1"),
        (0x288, False, 8, b"\0\0\x80\x19\0\0\x08\x08", "1"),
        (0x100, True, 3, b"", "1"),
    ]
    assert report.notes() == []
    path.write_text(
        ";$FILEVERSION=2.1\n;$STARTTIME=41766.46\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n 1 1.0 DT 1 0300 Rx - 1 05\n"
        " 2 2.0 EV 1 text\n 6 1334.522 ER 1 - Rx - 5 04 00 02 00 00\n 7 1334.5 ST 1 - Rx - 4 00 00 00 08\n 8 1334.643 EC 1 - Rx - 2 02 02\n"
    )
    found, report = read_rows(path)
    assert [(f[1], f[DATA]) for f in found[1:]] == [(0x288, b"\0\0\x84\2\0\0\0\0"), (0x004, b"\0\x0c\0\0\0\0\0\0")]
    assert report.notes() == []


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (";$FILEVERSION=3.0\n 1 1.0 DT 1 0300 Rx - 1 05\n", "is TRC of version '3.0'; 1.0 to 1.3, 2.0 and 2.1 are read"),
        (";$FILEVERSION=2.1\n 1 1.0 DT 1 0300 Rx - 1 05\n", "has no line ;$COLUMNS= before its frames"),
        (";$FILEVERSION=2.1\n;$COLUMNS=N,O,T,B,I,d,R,D\n 1 1.0 DT 1 0300 Rx - 1 05\n", "column L is missing"),
    ],
)
def test_trc_that_cannot_be_read(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "log.trc"
    path.write_text(text)
    with pytest.raises(FileFormatError, match=r"log\.trc") as caught:
        read_frames(path)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    "bad", ["2 x DT 1 0300 Rx - 1 05", "2 1.0 DT 1 0300 Rx - 2 05", "2 1.0 DT 1 03_0 Rx - 1 05", "2 1.0 DT 1 0900 Rx - 1 05", "2 1.0 FD 1"]
)
def test_a_line_of_trc_that_nobody_can_read_is_counted(tmp_path: Path, bad: str) -> None:
    path = tmp_path / "log.trc"
    good = "1 1.0 DT 1 0300 Rx - 1 05\n"
    path.write_text(f";$FILEVERSION=2.1\n;$STARTTIME=41766.4\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n{good}{bad}\n{good}")
    found, report = read_rows(path)
    assert len(found) == 2
    assert report.unread == 1
    assert bad in report.notes()[0]


# candump on a screen ----------------------------------------------------------------------------------------------------------------


def screen(log: list[can.Message], way: str = "a", extra: bool = False, text: bool = False, swapped: bool = False) -> str:
    """The log as `candump -t way` shows it; with -x, -a and -S."""
    lines, before = [], log[0].timestamp
    for m in log:
        stamp = {
            "a": f"{m.timestamp:017.6f}",
            "z": f"{m.timestamp - log[0].timestamp:010.6f}",
            "d": f"{m.timestamp - before:010.6f}",
            "A": datetime.fromtimestamp(m.timestamp).strftime("%Y-%m-%d %H:%M:%S.%f"),
            "": "",
        }[way]
        before = m.timestamp
        flags = f"{'RX' if m.is_rx else 'TX'} {'B' if m.bitrate_switch else '-'} {'E' if m.error_state_indicator else '-'}  " * extra
        identifier = f"{m.arbitration_id:08X}" if m.is_extended_id else f"{m.arbitration_id:03X}"
        data = "`".join(f"{b:02X}" for b in m.data[::-1]) if swapped else " ".join(f"{b:02X}" for b in m.data)
        shown = f"   '{''.join(chr(b) if 32 <= b < 127 else '.' for b in m.data)}'" * (text and not m.is_remote_frame)
        length = f"[{m.dlc:02d}]" if m.is_fd and not m.is_remote_frame else f"[{m.dlc}] "
        body = " remote request" if m.is_remote_frame else f" {data}{shown}"
        lines.append(f" ({stamp})" * bool(stamp) + f"  can{m.channel}  {flags}{identifier}  {length}{body}")
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("way", ["a", "A", "z", "d"])
@pytest.mark.parametrize("name", ["log.log", "log.txt"])
def test_screen_output_gives_the_frames_of_the_log(tmp_path: Path, way: str, name: str) -> None:
    """The same traffic as candump -L writes it, which python-can reads."""
    log = fd_log(400, 3)
    for m in log:
        m.dlc = 0 if m.is_remote_frame else m.dlc  # python-can's writer leaves it out
    known, _ = library_rows(write(tmp_path / "known.log", log))
    (tmp_path / name).write_text(screen(log, way, extra=True))
    found, report = read_rows(tmp_path / name)
    assert report.notes() == []
    start = 0.0 if way in "aA" else log[0].timestamp
    assert [f[1:BUS] for f in found] == [k[1:BUS] for k in known]
    assert [f[0] for f in found] == pytest.approx([k[0] - start for k in known], abs=1e-3 if way == "d" else 2e-6)
    assert {f[BUS] for f in found} == {"can0", "can1"}


@pytest.mark.parametrize("options", [("a", False, True), ("a", False, False, True), ("a", True, True)])
def test_screen_options(tmp_path: Path, options: tuple[str, *tuple[bool, ...]]) -> None:
    log = [m for m in fd_log(200, 4) if not m.is_remote_frame]
    path = tmp_path / "log.txt"
    path.write_text(screen(log, *options))
    found, report = read_rows(path)
    assert report.notes() == []
    assert [f[DATA] for f in found] == [bytes(m.data) for m in log]


def test_screen_colours_and_error_frames(tmp_path: Path) -> None:
    path = tmp_path / "log.log"
    path.write_text(
        "\x1b[31m (1436509052.249713)  can0  181   [2]  01 02\x1b[0m\n"
        " (1436509052.3)  can0  20000088   [8]  00 00 08 00 00 00 00 00   ERRORFRAME\n"
    )
    found, report = read_rows(path)
    assert [(f[ERROR], f[DATA]) for f in found] == [(False, b"\1\2"), (True, b"\0\0\10\0\0\0\0\0")]
    assert report.notes() == []


def test_screen_output_without_times_says_what_writes_them(tmp_path: Path) -> None:
    path = tmp_path / "log.log"
    path.write_text(screen(fd_log(5, 5), ""))
    found, report = read_rows(path)
    assert found == []
    assert "it has no time: candump -L or candump -ta writes it" in report.notes()[0]


@pytest.mark.parametrize(
    "bad", ["(1.0)  can0  181   [2]  01", "(1.0)  can0  181   [2]  01 0", "(1.0)  can0  181   [1]  00000001", "(x)  can0  181   [0]"]
)
def test_a_line_of_the_screen_that_nobody_can_read_is_counted(tmp_path: Path, bad: str) -> None:
    path = tmp_path / "log.txt"
    good = " (1.0)  can0  181   [1]  05\n"
    path.write_text(f"{good} {bad}\n{good}")
    found, report = read_rows(path)
    assert len(found) == 2
    assert report.unread == 1


# SavvyCAN ---------------------------------------------------------------------------------------------------------------------------


def gvret(log: list[can.Message], *, direction: bool = True) -> str:
    lines = ["Time Stamp,ID,Extended," + "Dir," * direction + "Bus,LEN," + ",".join(f"D{i}" for i in range(1, 9))]
    for m in log:
        cells = [str(round((m.timestamp - START) * 1e6)), f"{m.arbitration_id:08X}", str(m.is_extended_id).lower()]
        cells += ["Rx" if m.is_rx else "Tx"] * direction
        cells += [str(m.channel), str(len(m.data)), *(f"{b:02X}" for b in m.data)]
        lines.append(",".join(cells) + "," * (8 - len(m.data) if len(m.data) < 8 else 1))
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("direction", [True, False])
@pytest.mark.parametrize("name", ["log.csv", "log.txt", "log.csv.gz"])
def test_gvret_csv(tmp_path: Path, direction: bool, name: str) -> None:
    log = [m for m in fd_log(400, 6) if not m.is_remote_frame]
    path = tmp_path / name
    text = gvret(log, direction=direction).encode()
    path.write_bytes(gzip.compress(text) if name.endswith(".gz") else text)
    found, report = read_rows(path)
    assert report.notes() == []
    assert [f[0] for f in found] == [round((m.timestamp - START) * 1e6) / 1e6 for m in log]
    assert [(f[1], f[EXTENDED], f[DATA]) for f in found] == [(m.arbitration_id, m.is_extended_id, bytes(m.data)) for m in log]
    assert [f[RECEIVED] for f in found] == [m.is_rx or not direction for m in log]
    assert {f[BUS] for f in found} == {"0", "1"}


def test_gvret_lines_that_nobody_can_read(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    good = "100,00000181,false,Rx,0,2,01,02\n"
    bad = [
        "1e2,00000181,false,Rx,0,2,01,02",
        "100,00000181,maybe,Rx,0,0",
        "100,00000981,false,Rx,0,0",
        "100,00000181,false,Rx,0,3,01,02",
        "100",
    ]
    path.write_text("Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2\n" + good + "\n".join(bad) + "\n" + good)
    found, report = read_rows(path)
    assert len(found) == 2
    assert report.unread == len(bad)
    path.write_text("Time Stamp,ID,Extended,Dir,LEN,D1\n" + good)
    with pytest.raises(FileFormatError, match="column 'bus' is missing in the first line"):
        read_frames(path)


# one suffix, many dialects ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".log", ".asc", ".trc", ".csv"])
@pytest.mark.parametrize("name", ["log.txt", "log.txt.gz"])
def test_text_is_told_by_what_stands_in_it(tmp_path: Path, suffix: str, name: str) -> None:
    log = [m for m in messages(100, 7, fd=False, channels=(0,)) if not m.is_error_frame]
    whole = write(tmp_path / f"known{suffix}", log)
    path = tmp_path / name
    path.write_bytes(gzip.compress(whole.read_bytes()) if name.endswith(".gz") else whole.read_bytes())
    known, _ = read_frames(whole)
    found, report = read_frames(path)
    assert report.notes() == []
    assert len(found) > 80
    for column in ("time_s", "identifier", "flags", "length", "data"):
        assert np.array_equal(getattr(found, column), getattr(known, column))


def test_flags_of_fd_frames_are_those_of_the_document(tmp_path: Path) -> None:
    path = tmp_path / "log.trc"
    lines = "".join(f"{i} 1.0 {kind} 1 0300 Rx - 1 05\n" for i, kind in enumerate(["FD", "FB", "FE", "BI"]))
    path.write_text(";$FILEVERSION=2.1\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n" + lines)
    flags = read_frames(path)[0].flags & (BITRATE_SWITCH | ERROR_STATE)
    assert flags.tolist() == [0, BITRATE_SWITCH, ERROR_STATE, BITRATE_SWITCH | ERROR_STATE]


def test_more_buses_than_anybody_has(tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    path.write_text("".join(f" (1.0)  bus{i}  181   [1]  05\n" for i in range(1200)))
    found, report = read_rows(path)
    assert len(found) == 1000
    assert report.unread == 200


@pytest.mark.parametrize("seed", range(3))
def test_mutated_dialects_are_read_or_refused(tmp_path: Path, seed: int) -> None:
    """Bytes, digits and lines changed at random: frames, counted lines or one line of refusal, never anything else."""
    rng = np.random.default_rng(seed)
    log = fd_log(8, seed)
    whole = {
        "log.trc": trc(log, "2.1", "N,O,T,B,I,d,R,L,D"),
        "old.trc": trc([m for m in log if not m.is_fd], "1.3"),
        "log.txt": screen(log, "Ad"[seed % 2], extra=True, text=True),
        "log.csv": gvret([m for m in log if not m.is_remote_frame]),
    }
    for name, text in whole.items():
        for _ in range(60):
            path = tmp_path / name
            path.write_bytes(mutated(text.encode(), rng))
            with contextlib.suppress(FileFormatError):
                assert len(read_rows(path)[0]) <= 3 * len(log)
