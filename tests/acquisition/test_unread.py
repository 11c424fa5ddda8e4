"""Every line and object of a log is a frame, of a known other kind, or counted as unread: `lmeasure.read_frames` and `import`."""

import base64
import json
import struct
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from blf_files import blf, blf_object, can_message
from in_process import ran
from log_corpus import messages, write
from log_fuzz import START_POSE, counter_log, six_cables

import lmeasure as lm
from lmeasure.acquisition.bus.canopen import DataSheet
from lmeasure.acquisition.bus.frames import CLASSED, ERROR, EXTENDED
from lmeasure.core import FileFormatError
from lmeasure.io import files
from lmeasure.recording import read_run
from lmeasure.rig import write_rig

CASES = Path(__file__).parents[1] / "authorities" / "recordings-read"


def read(path: Path, content: str | bytes) -> tuple[Any, Any]:
    """The frames and the report of a file of this content; the sum matches the lines that Python counts."""
    raw = content.encode() if isinstance(content, str) else content
    path.write_bytes(raw)
    frames, report = lm.read_frames(path)
    assert report.frames == len(frames)
    assert report.frames + report.known + report.unread == report.total
    if path.suffix != ".blf":
        assert report.total == len(raw.splitlines())
    return frames, report


@pytest.mark.parametrize("name", ["neg.asc", "half.blf", "none.blf", "comma.trc"])
def test_recordings_that_other_readers_lose(name: str) -> None:
    frames, report = lm.read_frames(CASES / name)
    assert (len(frames), report.unread, report.notes()) == (140, 0, [])
    counts = lm.read_log(CASES / name, CASES / "rig.toml", START_POSE).passes[0]
    assert counts.time_s == pytest.approx(np.arange(20) * 0.01, abs=1e-6)
    assert counts.of("ch1").tolist() == [10.0 * i for i in range(20)]


# ASC --------------------------------------------------------------------------------------------------------------------------------


def asc(lines: str, timestamps: str = "absolute", base: str = "hex") -> str:
    return f"base {base}  timestamps {timestamps}\n{lines}\n"


@pytest.mark.parametrize(
    ("line", "time_s", "identifier", "data"),
    [
        ("  -0.100000 1  181             Rx   d 2 01 02", -0.1, 0x181, b"\1\2"),
        ("-12.5 1 18FF0110x Tx d 1 07", -12.5, 0x18FF0110, b"\7"),
        ("-0,000001 CANFD 1 Rx 184 1 0 2 2 01 02", -0.000001, 0x184, b"\1\2"),
        ("\t-3.25\t1\t181\tRx\td\t1\t07\t", -3.25, 0x181, b"\7"),
        ("\u00a0-3.25 1 181 Rx d 1 07", -3.25, 0x181, b"\7"),
        ("+0.5 1 181 Rx d 1 07", 0.5, 0x181, b"\7"),
        ("0,25 1 181 Rx d 1 07", 0.25, 0x181, b"\7"),
    ],
)
def test_times_of_asc_have_signs_and_commas(tmp_path: Path, line: str, time_s: float, identifier: int, data: bytes) -> None:
    frames, report = read(tmp_path / "log.asc", asc(line))
    assert report.notes() == []
    assert (frames.time_s[0], frames.identifier[0], frames.data[0, : frames.length[0]].tobytes()) == (time_s, identifier, data)


def test_relative_times_of_asc_may_begin_before_zero(tmp_path: Path) -> None:
    lines = "-0.100 1 181 Rx d 0\n0.050 1 181 Rx d 0\n0.050 SV: 1\n0.025 1 181 Rx d 0\n0.025 1 Statistic: D 1\n0.5 1 181 Rx d 0"
    frames, report = read(tmp_path / "log.asc", asc(lines, "relative"))
    assert frames.time_s == pytest.approx([-0.1, -0.05, 0.025, 0.55], abs=1e-12)
    assert report.known == 3


@pytest.mark.parametrize(
    ("base", "line", "identifier", "extended"),
    [
        ("hex", "0.1 1 Encoder_1 Rx d 2 0A 0B  Length = 140000 BitCount = 73 ID = 385", 385, False),
        ("hex", "0.1 1 EngineData Rx d 2 0A 0B  Length = 0 BitCount = 0 ID = 419365136x", 419365136, True),
        ("hex", "0.1 1 ABBA Rx d 2 0A 0B  ID = 386", 386, False),  # a name that could be a number
        ("hex", "0.1 1 FF Rx d 2 0A 0B  ID = 386", 386, False),
        ("dec", "0.1 1 Encoder::Two Tx d 2 10 11  ID = 387", 387, False),
        ("hex", "0.1 1 Zähler Rx d 2 0A 0B  ID = 388", 388, False),
        ("hex", "0.1 1 Ask Rx r 2  Length = 0 ID = 389", 389, False),
    ],
)
def test_symbolic_names_of_asc_state_their_identifier(tmp_path: Path, base: str, line: str, identifier: int, extended: bool) -> None:
    frames, report = read(tmp_path / "log.asc", asc(line, base=base))
    assert report.notes() == []
    assert (frames.identifier[0], bool(frames.flags[0] & EXTENDED), frames.length[0]) == (identifier, extended, 2)
    if " d " in line:
        assert frames.data[0, :2].tobytes() == b"\x0a\x0b"


@pytest.mark.parametrize(
    "line",
    [
        "0.1 1 Engine Rx d 2 01 02",  # a name without its number
        "0.1 1 181 Rx d 2 01 02 ID = 386",  # contradicts itself
        "0.1 1 981 Rx d 2 01 02",  # no identifier of 11 bits
        "- 0.1 1 181 Rx d 2 01 02",
        "1 1 181 Rx d 2 01 02",
        "anything at all",
        "0.1 Unheard of",
    ],
)
def test_other_lines_of_asc_are_unread(tmp_path: Path, line: str) -> None:
    frames, report = read(tmp_path / "log.asc", asc(f"0.1 1 181 Rx d 1 07\n{line}\n0.2 1 181 Rx d 1 07"))
    assert (len(frames), report.unread) == (2, 1)
    assert f"1 of 4 lines could not be read (1 {next(iter(report.unread_kinds))}); the first is line 3: {line!r}" in report.notes()[0]


def test_events_of_asc_are_known(tmp_path: Path) -> None:
    events = (Path(__file__).parent / "inputs" / "events.asc").read_text(encoding="utf-8")
    for line_end in ("\n", "\r\n", "\r"):
        frames, report = read(tmp_path / "log.asc", events.replace("\n", line_end))
        assert (len(frames), report.known, report.unread) == (1, 20, 0)
        assert report.known_kinds["frame of another bus"] == 2


# BLF --------------------------------------------------------------------------------------------------------------------------------


FRAME = blf_object(1, can_message())


@pytest.mark.parametrize(
    "content",
    [
        blf(FRAME * 3, 5, FRAME * 2),
        blf(FRAME * 3, 5, FRAME * 2, before=True),
        blf(b"", 5, FRAME * 5),
        blf(FRAME * 3, 5, blf_object(115, bytes(16)) + FRAME * 2),  # a restore point, which most recorders do not count
        blf(FRAME * 4, 5, blf_object(1, can_message(), 3)),
        blf(blf_object(1, can_message(), 3) * 5, 5),
        blf(b"".join(blf_object(1, can_message(), v) for v in (1, 2, 3, 1, 2)), 5),
        blf(FRAME * 5, 0),
    ],
)
def test_frames_of_blf_wherever_they_are(tmp_path: Path, content: bytes) -> None:
    frames, report = read(tmp_path / "log.blf", content)
    assert (len(frames), report.notes()) == (5, [])
    assert set(frames.time_s.tolist()) == {1.0}
    assert frames.data.tolist() == [[1, 2, 3, 4, 0, 0, 0, 0]] * 5


def test_fd_frames_of_blf_with_headers_of_version_3(tmp_path: Path) -> None:
    body = struct.pack("<BBBBLLLLLLLHBBL", 2, 9, 12, 0, 0x123, 0, 0x1000, 0, 0, 0, 0, 0, 0, 0, 0) + bytes(range(12))
    frames, report = read(tmp_path / "log.blf", blf(blf_object(101, body, 3), 1, blf_object(101, body)))
    assert (frames.length.tolist(), len(report.remarks)) == ([12, 12], 1)
    assert "the header states 1 objects, but there are 2, and all were read" in report.notes()[0]


def test_error_frames_of_blf_are_frames(tmp_path: Path) -> None:
    """CAN_ERROR (2), CAN_ERROR_EXT (73) and CAN_FD_ERROR_64 (104), which python-can passes over but for the second."""
    fd = struct.pack("<BBBBHHHBBLLLLLLLHH", 1, 2, 2, 0, 0, 0, 0, 0, 0, 0x123, 0, 0, 0, 0, 0, 0, 0, 0) + b"ab"
    errors = blf_object(2, struct.pack("<HHL", 1, 0, 0)) + blf_object(104, fd)
    errors += blf_object(73, struct.pack("<HHLBBBxLLH2x8s", 1, 0, 0, 0, 0, 2, 0, 7, 0, b"ab"))
    frames, report = read(tmp_path / "log.blf", blf(errors, 3))
    assert report.notes() == []
    assert (frames.flags & ERROR != 0).all()
    assert [f[: int(n)].tobytes() for f, n in zip(frames.data, frames.length, strict=True)] == [b"", b"ab", b"ab"]


@pytest.mark.parametrize(
    ("content", "frames", "known", "unread", "words"),
    [
        (blf(FRAME + blf_object(4, bytes(32)) + FRAME, 3), 2, 1, 0, ""),
        (blf(FRAME + blf_object(1, can_message(), 7) + FRAME, 3), 2, 0, 1, "1 of 3 objects could not be read (1 with header version 7)"),
        (blf(FRAME, 2, blf_object(200, bytes(8))), 1, 0, 1, "of kind 200); the first is object 2"),
        (blf(FRAME * 3, 5), 3, 0, 2, "ended early: the header states 5 objects, and 3 are there"),
        (blf(FRAME + blf_object(125, bytes(32)), 2), 1, 1, 0, "the recorder itself states 1 times that it lost data"),
        (blf(FRAME * 3, 4, FRAME[:-8]), 3, 0, 1, "ended early: the last log container is not whole"),
    ],
)
def test_objects_of_blf_are_accounted_for(tmp_path: Path, content: bytes, frames: int, known: int, unread: int, words: str) -> None:
    _, report = read(tmp_path / "log.blf", content)
    assert (report.frames, report.known, report.unread) == (frames, known, unread)
    assert words in "; ".join(report.notes())
    assert bool(report.notes()) == bool(words)


# TRC, candump, CSV ------------------------------------------------------------------------------------------------------------------

TRC_2 = ";$FILEVERSION=2.1\n;$STARTTIME=41766,4\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n"


@pytest.mark.parametrize(
    ("name", "text", "time_s"),
    [
        ("a.trc", ";$FILEVERSION=1,1\n;$STARTTIME=25569,5\n 1) 2,25 Rx 0181 2 01 02\n", 43200.00225),
        ("b.trc", ";$FILEVERSION=1.3\n;$STARTTIME=25569,5\n1) 2,25 1 Rx 0181 - 2 01 02 junk\n", 43200.00225),
        ("c.trc", " x) 7 0181 2 01 02\n", 0.007),
        ("d.trc", TRC_2.replace("41766,4", "25569,5") + "? -2,25 DT 1 0181 Rx - 2 01 02\n", 43199.99775),
        ("e.log", "(12,25) can0 181#0102\n", 12.25),
        ("f.log", "(-0.5) can0 181#0102\n", -0.5),
        ("g.txt", " (12,25)  can0  181   [2]  01 02\n", 12.25),
        ("h.csv", "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2\n12250000.5,00000181,false,Rx,0,2,01,02,\n", 12.2500005),
        ("i.csv", "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2\n-100.25,181,0,Rx,0,2,1,2\n", -0.00010025),
        ("j.csv", "Time Stamp;ID;Extended;Dir;Bus;LEN;D1;D2\n-100,25;181;0;Rx;0;2;1;2\n", -0.00010025),
        ("k.csv", "timestamp;arbitration_id;extended;remote;error;dlc;data\n12,25;0x181;0;0;0;2;AQI=\n", 12.25),
        ("l.csv", '"timestamp","arbitration_id","extended","remote","error","dlc","data"\n5e-05,0x181,0,0,0,2,AQI=\n', 5e-5),
    ],
)
def test_numbers_as_other_computers_write_them(tmp_path: Path, name: str, text: str, time_s: float) -> None:
    frames, report = read(tmp_path / name, text)
    assert report.notes() == []
    assert (frames.time_s.tolist(), frames.identifier.tolist()) == ([pytest.approx(time_s, abs=1e-9)], [0x181])
    assert frames.data[0].tolist() == [1, 2, 0, 0, 0, 0, 0, 0]


def test_lines_of_trc_that_are_no_frames_are_named(tmp_path: Path) -> None:
    lines = " 1 1.0 DT 1 0300 Rx - 1 05\n 2 1.5 ST 1 - Rx - 4 00 00 00 08\n 3 2 XX 1 0300 Rx - 1 05\n 4 3 DT 1 0300 Rx - 1 05 06\n"
    _, report = read(tmp_path / "log.trc", f"{TRC_2}; text\n{lines}")
    assert (report.frames, report.known, report.unread) == (2, 4, 2)
    assert report.unread_kinds == {"unknown": 1, "broken": 1}


def test_error_frames_of_candump_keep_class_and_data(tmp_path: Path) -> None:
    """Bus-off is class 40h, the controller's state is in data byte 1 of class 4, a bus error has bit 80h."""
    lines = {
        "log.log": "(1.0) can0 2000008C#0010000000000060\n",
        "odd.log": "(1,0)  can0\t2000008C#0010000000000060\n",
        "screen.txt": " (1.0)  can0  2000008C   [8]  00 10 00 00 00 00 00 60   ERRORFRAME\n",
    }
    for name, line in lines.items():
        frames, _ = read(tmp_path / name, line)
        assert (frames.identifier[0], frames.flags[0], frames.data[0].tobytes().hex()) == (
            0x8C,
            ERROR | EXTENDED | CLASSED,
            "0010000000000060",
        )


@pytest.mark.parametrize("suffix", [".csv"])
def test_csv_of_python_can_goes_on_behind_a_broken_line(tmp_path: Path, suffix: str) -> None:
    log = [m for m in messages(60, 22, fd=False) if not (m.is_error_frame or m.is_remote_frame)]
    lines = write(tmp_path / f"whole{suffix}", log).read_text().splitlines()
    lines[10] = lines[10].replace(",", ",x", 1)
    frames, report = read(tmp_path / f"cut{suffix}", "\n".join(lines) + "\n")
    assert (len(frames), report.known, report.unread) == (len(log) - 1, 1, 1)
    assert "line 11" in report.first_unread
    assert frames.data[-1, : frames.length[-1]].tobytes() == base64.b64decode(lines[-1].split(",")[-1])


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.csv", "Time,Channel,ID,Flags,DLC,Data0,Data1\n0.1,1,385,0,2,1,2\n", "a table of Kvaser's"),
        ("b.csv", "Chn Identifier Flg   DLC  D0...1...2\n 0    000000AD         8  FF\n", "a table of Kvaser's"),
        ("c.csv", '"IXXAT MiniMon V3"\n"Date:","01.02.2024"\n', "IXXAT"),
        ("d.csv", "CANopen Magic Ultimate\n,,,\n", "CANopen Magic"),
        ("e.csv", "a,b\n1,2\n", "begins with 'a,b'"),
        ("f.db3", "SQLite format 3", "a ROS 2 bag"),
        ("g.bag", "#ROSBAG V2.0\n", "a ROS bag"),
    ],
)
def test_other_formats_are_named_with_a_converter(tmp_path: Path, name: str, content: str, words: str) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(FileFormatError) as caught:
        lm.read_frames(tmp_path / name)
    assert words in str(caught.value)
    assert any(tool in str(caught.value) for tool in ("SavvyCAN", "kmeconvert", "candump"))
    assert "\n" not in str(caught.value)


CANDUMP, SCREEN, ASC = "(1.0) can0 181#01", " (1.0)  can0  181   [1]  05", "1.0 1 181 Rx d 1 01"
GVRET = "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2\n"
UNREADABLE = {
    "a.log": ("", CANDUMP, ["(1.0) can0 181#012", "(1.0) can0 181", "(1.0) can0 x81#01", "(1.0) can0 181#0g"]),
    "b.log": ("", CANDUMP, ["(x) can0 181#01", "(nan) can0 181#01", "can0  181   [4]  01 02 03 04"]),
    "a.txt": ("", SCREEN, ["(1.0)  can0  181   [2]  01", "(1.0)  can0  181   [2]  01 0", "(1.0)  can0  181   [1]  00000001"]),
    "b.txt": ("", SCREEN, ["(x)  can0  181   [0]"]),
    "a.asc": ("base hex timestamps absolute\n", ASC, ["1.0 1 181 Rx d 4 01 02 03", "1.0 1 Engine Rx d 2 01 02", "1.0 1 181 Rx d 2 01 100"]),
    "b.asc": ("base hex timestamps absolute\n", ASC, ["1.0 1 FFFFFFFFx Rx d 2 01 10", "1.0 CANFD 1 Rx 181 0 0 9 12 01 02"]),
    "a.trc": (TRC_2, "1 1.0 DT 1 0300 Rx - 1 05", ["2 x DT 1 0300 Rx - 1 05", "2 1.0 DT 1 0300 Rx - 2 05", "2 1.0 FD 1"]),
    "b.trc": (TRC_2, "1 1.0 DT 1 0300 Rx - 1 05", ["2 1.0 DT 1 03_0 Rx - 1 05", "2 1.0 DT 1 0900 Rx - 1 05"]),
    "a.csv": (GVRET, "100,181,false,Rx,0,2,01,02", ["1e2,181,false,Rx,0,2,01,02", "100,181,maybe,Rx,0,0", "100,981,false,Rx,0,0", "100"]),
    "b.csv": (GVRET, "100,181,false,Rx,0,2,01,02", ["100,181,false,Rx,0,3,01,02"]),
}


@pytest.mark.parametrize("name", UNREADABLE)
def test_lines_that_nobody_can_read_are_counted(tmp_path: Path, name: str) -> None:
    head, good, bad = UNREADABLE[name]
    frames, report = read(tmp_path / name, head + "".join(f"{line}\n" for line in [good, *bad, good]))
    assert (len(frames), report.unread) == (2, len(bad))
    assert bad[0] in report.notes()[0]


# what the import says ---------------------------------------------------------------------------------------------------------------


def test_an_import_says_what_it_did_not_read(tmp_path: Path) -> None:
    path = write(tmp_path / "drive.log", [m for m in counter_log(40, 4) if not m.is_error_frame])
    lines = path.read_text().splitlines()
    lines[100] = "something else"
    path.write_text("\n".join(lines) + "\n")
    write_rig(tmp_path / "rig.toml", six_cables())
    words = ["import", path, "--rig", tmp_path / "rig.toml", "--out", tmp_path / "run", "--start", "0,0,0,0,0,0,1", "--json"]
    done = ran(*words)
    reported = json.loads(done)
    note = f"1 of {len(lines)} lines could not be read (1 unknown); the first is line 101: 'something else' (not as candump writes it)"
    assert (reported["figures"]["unread"], reported["figures"]["lines"]) == (1, len(lines))
    assert any(note in warning for warning in reported["warnings"])
    assert any(note in line for line in reported["summary"])
    entry = files.read_toml(tmp_path / "run" / "run.toml")["recording"][0]
    assert (entry["ended"], entry["faults"]["unread"], entry["read"]["unread"]) == ("complete", 1, 1)
    assert entry["read"]["first_unread"] in entry["why"]
    assert any("1 unread" in str(note) for one in read_run(tmp_path / "run").recorded for note in one.notes())


@pytest.mark.parametrize(
    ("name", "content", "why"),
    [
        ("a.asc", "date Mon Jan 1 10:00:00 2024\nbase hex  timestamps absolute\n// nothing\n", r"its 3 lines: 2 header, 1 comment"),
        ("b.log", "nothing here\n", r"1 of 1 lines could not be read .*line 1: 'nothing here'"),
        ("c.blf", blf(blf_object(1, can_message(), 9) * 4, 4), r"4 of 4 objects could not be read \(4 with header version 9\)"),
    ],
)
def test_a_log_without_a_frame_says_why(tmp_path: Path, name: str, content: str | bytes, why: str) -> None:
    read(tmp_path / name, content)
    with pytest.raises(FileFormatError, match=f"contains no CAN frame: .*{why}"):
        lm.read_log(tmp_path / name, six_cables())


# data sheets ------------------------------------------------------------------------------------------------------------------------

SHEET = (Path(__file__).parent / "inputs" / "odd.dcf").read_text(encoding="utf-8")


def test_data_sheets_with_odd_entries(tmp_path: Path) -> None:
    path = tmp_path / "encoder.dcf"
    path.write_bytes(b"\xef\xbb\xbf" + SHEET.encode())
    sheet = DataSheet(path, 5)
    places = {(0x1800, 1): 0x190, (0x1800, 2): 254, (0x1801, 1): 0x285, (0x1018, 2): 0x12, (0x1A00, 0): 2, (0x1A00, 2): 0x60040020}
    places |= {(0x1A01, 0): 1, (0x1A01, 1): 0x60040020}
    assert {place: sheet.read(*place) for place in places} == places
    assert [sheet.read(0x6500), sheet.read(0x2000), sheet.read(0x1800, 9)] == [None, None, None]
    for place in ((0x6200, 0), (0x1018, 1)):
        with pytest.raises(FileFormatError, match="may be octal or decimal"):
            sheet.read(*place)


def test_a_frame_of_the_library_is_read_as_it_is(tmp_path: Path) -> None:
    """The names of the public arrays, and the channel's name."""
    log = [can.Message(timestamp=1_700_000_000.5, arbitration_id=0x123, is_extended_id=True, data=b"\1\2", channel=3)]
    frames, report = lm.read_frames(write(tmp_path / "log.blf", log))
    columns = (frames.time_s, frames.identifier, frames.flags, frames.length, frames.data[:, :2], frames.channel)
    assert [column.tolist() for column in columns] == [[1_700_000_000.5], [0x123], [EXTENDED], [2], [[1, 2]], [0]]
    assert (frames.buses, report.dialect) == (("3",), "Vector's BLF")
