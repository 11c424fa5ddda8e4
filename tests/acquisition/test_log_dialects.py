"""Logs as others write them: TRC of every version, candump's screen, SavvyCAN, text of any name; against python-can where it can."""

import gzip
from pathlib import Path

import can
import numpy as np
import pytest
from log_corpus import START, Row, library_rows, messages, rows, write
from log_dialects import gvret, screen, trc
from read_logs import assert_as_the_library

from lmeasure.acquisition import read_frames
from lmeasure.acquisition.bus.frames import BITRATE_SWITCH, ERROR_STATE, messages_from_frames
from lmeasure.acquisition.logs.report import FD_LENGTHS, LogReport
from lmeasure.core import FileFormatError

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
    assert_as_the_library(path, len(log))


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
        (0x300, False, 7, b"\0\0\0\0\4\0\0", "1"), (0x400, False, 2, b"\0\1", "2"), (0x004, False, 8, b"\0\x0c\0\0\0\0\0\0", "1"),
        (0x288, False, 8, b"\0\0\x80\x19\0\0\x08\x08", "1"), (0x100, True, 3, b"", "1"),
    ]  # fmt: skip
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
        (";$FILEVERSION=3.0\n 1 1.0 DT 1 0300 Rx - 1 05\n", "is TRC of version '3.0'. Readable versions are 1.0 to 1.3, 2.0 and 2.1"),
        (";$FILEVERSION=2.1\n 1 1.0 DT 1 0300 Rx - 1 05\n", "has no line ;$COLUMNS= before its frames"),
        (";$FILEVERSION=2.1\n;$COLUMNS=N,O,T,B,I,d,R,D\n 1 1.0 DT 1 0300 Rx - 1 05\n", "Column L is missing"),
    ],
)
def test_trc_that_cannot_be_read(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "log.trc"
    path.write_text(text)
    with pytest.raises(FileFormatError, match=r"log\.trc") as caught:
        read_frames(path)
    assert words in str(caught.value)


# candump on a screen ----------------------------------------------------------------------------------------------------------------


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


# SavvyCAN ---------------------------------------------------------------------------------------------------------------------------


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
