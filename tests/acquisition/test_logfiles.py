"""Log files against python-can's readers: the same frames, bit for bit, wherever those read the log rightly."""

import gzip
import struct
import tracemalloc
import zlib
from pathlib import Path

import can
import pytest
from blf_files import blf, blf_object, can_message
from can.io.blf import BLFWriter
from log_corpus import library_rows, messages, rows, write
from read_logs import assert_as_the_library, read_rows

from lmeasure.acquisition import read_frames
from lmeasure.acquisition.bus.frames import messages_from_frames
from lmeasure.acquisition.logs.read import log_batches
from lmeasure.acquisition.logs.report import LogReport
from lmeasure.core import FileFormatError

SUFFIXES = (".blf", ".asc", ".log")


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("fd", [False, True])
def test_same_frames_as_the_library(tmp_path: Path, suffix: str, seed: int, fd: bool) -> None:
    path = write(tmp_path / f"log{suffix}", messages(1500, seed, fd=fd))
    assert_as_the_library(path, 1500)


@pytest.mark.parametrize(
    "options", [{"compression_level": 0}, {"max_container_size": 333}, {"compression_level": 0, "max_container_size": 100}]
)
def test_blf_containers(tmp_path: Path, options: dict[str, int], monkeypatch: pytest.MonkeyPatch) -> None:
    """Stored instead of packed, and so small that objects span two and three containers; blocks as small as one container."""
    monkeypatch.setattr("lmeasure.acquisition.logs.blf.BLOCK_BYTES", 1)
    path = write(tmp_path / "log.blf", messages(400, 9), **options)
    assert_as_the_library(path)


@pytest.mark.parametrize("suffix", [".asc", ".log"])
def test_text_blocks_break_anywhere(tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lmeasure.acquisition.logs.report.BLOCK_BYTES", 97)
    path = write(tmp_path / f"log{suffix}", messages(300, 10))
    assert read_rows(path)[0] == library_rows(path)[0]


@pytest.mark.parametrize("line_end", [b"\r\n", b"\r"])
@pytest.mark.parametrize("suffix", [".asc", ".log"])
def test_line_ends_of_other_systems(tmp_path: Path, suffix: str, line_end: bytes) -> None:
    path = write(tmp_path / f"log{suffix}", messages(200, 11))
    path.write_bytes(path.read_bytes().replace(b"\n", line_end))
    found, report = read_rows(path)
    assert found == library_rows(path)[0]
    assert len(found) == 200
    assert report.notes() == []


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_gzip(tmp_path: Path, suffix: str) -> None:
    path = write(tmp_path / f"log{suffix}", messages(200, 12))
    packed = tmp_path / f"log{suffix}.gz"
    packed.write_bytes(gzip.compress(path.read_bytes()))
    assert rows(messages_from_frames(read_frames(packed)[0])) == rows(messages_from_frames(read_frames(path)[0]))
    packed.write_bytes(packed.read_bytes()[:-3000])
    assert "ended early" in read_frames(packed)[1].notes()[0]


@pytest.mark.parametrize("suffix", [".csv", ".trc", ".mf4"])
def test_other_formats_through_the_library(tmp_path: Path, suffix: str) -> None:
    path = write(tmp_path / f"log{suffix}", [m for m in messages(200, 13, fd=suffix == ".mf4", channels=(0, 1)) if not m.is_error_frame])
    found, report = read_rows(path)
    assert found == library_rows(path)[0]
    assert len(found) > 100
    assert report.notes() == []


# truncation -------------------------------------------------------------------------------------------------------------------------


def test_a_cut_blf_gives_everything_up_to_the_break_and_says_so(tmp_path: Path) -> None:
    whole = write(tmp_path / "whole.blf", messages(400, 20), max_container_size=4096).read_bytes()
    complete = library_rows(tmp_path / "whole.blf")[0]
    cut = tmp_path / "cut.blf"
    lengths = []
    for size in range(144, len(whole), 211):
        cut.write_bytes(whole[:size])
        found, report = read_rows(cut)
        assert found == library_rows(cut)[0] == complete[: len(found)]
        assert report.ended_early is not None
        lengths.append(len(found))
    assert lengths[-1] > 350
    assert lengths == sorted(lengths)


@pytest.mark.parametrize("suffix", [".asc", ".log"])
def test_a_cut_text_log_gives_its_whole_lines_and_says_so(tmp_path: Path, suffix: str) -> None:
    """A number cut short would pass for another: the line that has no end is not read."""
    whole = write(tmp_path / f"whole{suffix}", messages(60, 21)).read_bytes()
    complete, _ = read_rows(tmp_path / f"whole{suffix}")
    cut = tmp_path / f"cut{suffix}"
    for size in range(200, len(whole) - 17, 7):
        cut.write_bytes(whole[:size])
        found, report = read_rows(cut)
        lines = whole[:size].count(b"\n")
        assert found == complete[: len(found)]
        assert len(found) == lines - (5 if suffix == ".asc" else 0)
        assert (report.ended_early is not None) == (suffix == ".asc" or not whole[:size].endswith(b"\n"))


def test_a_broken_mf4_says_no_more_than_one_line(tmp_path: Path) -> None:
    whole = write(tmp_path / "whole.mf4", [m for m in messages(60, 23) if not m.is_error_frame]).read_bytes()
    cut = tmp_path / "cut.mf4"
    for size in (3, 50, 200, len(whole) // 2, len(whole) - 100):
        cut.write_bytes(whole[:size])
        with pytest.raises(FileFormatError, match="cannot be read"):
            read_frames(cut)


def test_a_recorder_that_was_killed(tmp_path: Path) -> None:
    """python-can writes the sizes into the header when it closes the file; killed, it never does."""
    path = tmp_path / "log.blf"
    writer = BLFWriter(path, max_container_size=1000)
    for message in messages(200, 22):
        writer.on_message_received(message)
    writer.file.flush()
    found, report = read_rows(path)
    writer.file.close()
    assert found == library_rows(path)[0]
    assert len(found) > 150
    assert report.notes()[0] == "ended early: the recorder did not close the file. Everything before it was read"


# BLF objects that python-can's writer does not write --------------------------------------------------------------------------------


def fd_message_64(dlc: int, valid: int, flags: int, data: bytes, direction: int = 0, beyond: int = 0) -> bytes:
    return struct.pack("<BBBBLLLLLLLHBBL", 2, dlc, valid, 0, 0x80000123, 0, flags, 0, 0, 0, 0, 0, direction, beyond, 0) + data


OBJECTS = {
    "ten microseconds": blf_object(1, can_message(), flags=1),
    "version 2 header": blf_object(1, can_message(), version=2),
    "message 2": blf_object(86, can_message(0x9ABCDEF0) + struct.pack("<LBBH", 120, 64, 0, 0)),
    "sent remote": blf_object(1, can_message(dlc=5, flags=0x81)),
    "ninth channel": blf_object(1, can_message(channel=9)),
    "channel zero": blf_object(1, can_message(channel=0)),
    "code above eight": blf_object(1, can_message(data=bytes(range(8)), dlc=15)),
    "error": blf_object(73, struct.pack("<HHLBBBxLLH2x8s", 3, 0, 0, 0, 0, 2, 0, 0x80000007, 0, b"ab")),
    "fd 64": blf_object(101, fd_message_64(13, 32, 0x7000, bytes(range(32)), direction=1)),
    "fd 64, bytes left out": blf_object(101, fd_message_64(15, 64, 0x1000, bytes(range(20)))),
    "fd 64, trailer": blf_object(101, fd_message_64(9, 12, 0x1000, bytes(range(12)) + b"xxxx", beyond=32 + 40 + 12)),
    "fd 64, classic remote": blf_object(101, fd_message_64(8, 0, 0x0010, b"")),
    "fd, classic": blf_object(100, struct.pack("<HBBLLBBB5x64s", 1, 0, 8, 0x7FF, 0, 0, 0, 8, bytes(range(64)))),
    "unknown kind": blf_object(64, b"12345678"),
    "unknown header version": blf_object(1, can_message(), version=1).replace(b"\x20\x00\x01\x00", b"\x20\x00\x07\x00", 1),
    "beyond 2^53 ns": blf_object(1, can_message(), time=1_700_000_000_123_456_789),
    "all ones": blf_object(1, can_message(), time=2**64 - 1),
}


@pytest.mark.parametrize("name", OBJECTS)
def test_blf_objects(tmp_path: Path, name: str) -> None:
    path = tmp_path / "log.blf"
    path.write_bytes(blf(blf_object(1, can_message()) + OBJECTS[name] + blf_object(1, can_message(0x182))))
    found, report = read_rows(path)
    assert found == library_rows(path)[0]
    assert found[-1][1] == 0x182
    assert len(found) == (2 if name.startswith("unknown") else 3)
    assert bool(report.notes()) == (name == "unknown header version")


BROKEN = {
    "an object without size": blf_object(1, can_message(), size=0),
    "an object too small for its kind": blf_object(1, can_message(), size=40),
    "an object of four gigabytes": blf_object(1, can_message(), size=2**32 - 16),
    "no object": b"nothing that begins with four letters",
    "65 bytes": blf_object(101, fd_message_64(15, 65, 0x1000, bytes(80))),
}


@pytest.mark.parametrize("name", BROKEN)
def test_blf_that_contradicts_itself_ends_there(tmp_path: Path, name: str) -> None:
    path = tmp_path / "log.blf"
    path.write_bytes(blf(blf_object(1, can_message()) + BROKEN[name] + blf_object(1, can_message())))
    found, report = read_rows(path)
    assert len(found) == 1
    assert report.notes()[0] == "ended early: after frame 1 an object contradicts itself. Everything before it was read"


def container(body: bytes, *, size: int | None = None, unpacked: int = 0) -> bytes:
    stated = 32 + len(body) if size is None else size
    return b"LOBJ" + struct.pack("<HHLL", 16, 1, stated, 10) + struct.pack("<H6xL4x", 2, unpacked) + body


def test_sizes_are_not_believed(tmp_path: Path) -> None:
    """Headers that promise four gigabytes, and a container that would unpack to 300 megabytes: none is given the memory."""
    head = blf(b"x")[:144]
    bomb = zlib.compressobj(9)
    zeros = b"".join(bomb.compress(bytes(1 << 20)) for _ in range(300)) + bomb.flush()
    path = tmp_path / "log.blf"
    read_rows(write(tmp_path / "warm.blf", messages(10, 0)))
    for text in (
        container(zlib.compress(blf_object(1, can_message())), size=2**32 - 1, unpacked=2**32 - 1),
        container(zlib.compress(blf_object(1, can_message())), unpacked=2**32 - 1),
        container(zeros),
    ):
        path.write_bytes(head + text)
        tracemalloc.start()
        _, report = read_rows(path)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 100e6
        assert len(report.notes()) == (0 if text[8:12] != b"\xff\xff\xff\xff" and len(text) < 1000 else 1)


# refusals ---------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("log.blf", b"no log at all", "does not begin with LOGG"),
        ("log.blf", b"LOGG\x90\0\0\0", "breaks off inside the file header"),
        ("log.blf", b"LOGG" + bytes(140), "its file header states a length of 0 bytes"),
        ("log.blf", b"", "is empty"),
        ("log.txt", b"some text\n", "It begins with 'some text'. For others, open it in SavvyCAN"),
        ("log.log", b"***BUSMASTER Ver 3.2.2***\n", "a BUSMASTER log: open it in SavvyCAN and save it as GVRET log (.csv)"),
        ("log.txt", b"1320745424.000 1R11 181 01 02\n", "a CRTD log: open it in SavvyCAN"),
        ("log.pcapng", b"x", "a capture of Wireshark: open it in SavvyCAN"),
        ("log.db", b"x", "a python-can database: can_logconvert FILE.db FILE.blf; .blf, .asc, .log, .txt, .trc, .csv, .mf4 are read"),
        ("log.dat", b"x", "asammdf saves MDF 3 as .mf4"),
        ("log", b"x", "is no log this program reads: .blf, .asc, .log, .txt, .trc, .csv, .mf4 are read"),
        ("log.mf4.gz", b"x", "is no log this program reads: .mf4 only unpacked"),
        ("log.log", b"x" * 200_000, "a line is longer than 65536 bytes"),
        ("log.mf4", b"no log at all", "cannot be read"),
        ("log.csv", b"timestamp,arbitration_id,\n1,zz\n", "column 'extended' is missing"),
    ],
)
def test_refused_in_one_line(tmp_path: Path, name: str, content: bytes, words: str) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(FileFormatError, match=str(path)) as caught:
        read_frames(path)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", [*SUFFIXES, ".trc", ".csv", ".mf4", ".csv.gz"])
def test_progress_reaches_the_end_of_a_short_log(tmp_path: Path, suffix: str) -> None:
    data = [m for m in messages(50, 1, fd=False, channels=(1,)) if not (m.is_error_frame or m.is_remote_frame)]
    path = write(tmp_path / f"log{suffix}", data)
    seen: list[tuple[int, int]] = []
    assert sum(len(batch) for batch in log_batches(path, LogReport(), lambda done, of: seen.append((done, of)))) > 30
    assert seen == sorted(seen)
    assert seen[-1] == (path.stat().st_size, path.stat().st_size)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_batches_are_bounded(tmp_path: Path, suffix: str) -> None:
    times = (1e9 + i * 1e-3 for i in range(120_000))
    log = [can.Message(timestamp=t, arbitration_id=0x181, is_extended_id=False, data=bytes(4), channel=0) for t in times]
    path = write(tmp_path / f"log{suffix}", log)
    sizes = [len(batch) for batch in log_batches(path, LogReport())]
    assert sum(sizes) == len(log)
    assert max(sizes) < 80_000
    assert len(sizes) > 1
