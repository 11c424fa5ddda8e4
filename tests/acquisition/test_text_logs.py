"""Text logs as programs of others write them: ASC of CANoe, candump of can-utils, lines that nobody can read."""

import itertools
from decimal import Decimal
from pathlib import Path

import pytest
from log_corpus import library_rows
from read_logs import ERROR_COLUMN, assert_as_the_library, read_rows

# ASC and candump as other programs write them ---------------------------------------------------------------------------------------

ASC = (Path(__file__).parent / "inputs" / "canoe.asc").read_text(encoding="utf-8")


@pytest.mark.parametrize("base", ["hex", "dec"])
def test_asc_of_canoe(tmp_path: Path, base: str) -> None:
    path = tmp_path / "log.asc"
    text = ASC.format(base=base, timestamps="absolute")
    path.write_text(
        text.replace(" 181 ", " 385 ").replace("18FF0110x", "419365136x").replace("7ff", "2047").replace("0F", "15")
        if base == "dec"
        else text
    )
    assert_as_the_library(path, 11)


def test_a_blank_that_is_not_ascii_parts_words_too(tmp_path: Path) -> None:
    path = tmp_path / "log.asc"
    path.write_bytes(b"base hex  timestamps absolute\n 0.5 CANFD\xa0  1 Rx 184 1 0 2 2 01 02\n")
    assert [(r[0], r[1], r[10]) for r in read_rows(path)[0]] == [(0.5, 0x184, b"\1\2")]


def test_asc_times_that_count_from_the_event_before(tmp_path: Path) -> None:
    """`timestamps relative`: python-can gives the differences as they stand; events that are no frames count too."""
    path = tmp_path / "log.asc"
    path.write_text(ASC.format(base="hex", timestamps="relative"))
    found, _ = read_rows(path)
    texts = [line.split()[0] for line in path.read_text().splitlines()[5:-1]]
    sums = list(itertools.accumulate(Decimal(t) for t in texts))
    frames = [i for i in range(len(texts)) if i not in {0, 3, 7, 8, 15}]
    start = found[0][0] - float(sums[1])
    assert [r[0] - start for r in found] == pytest.approx([float(sums[i]) for i in frames], abs=1e-6)
    assert [r[1:] for r in found] == [r[1:] for r in library_rows(path)[0]]


def test_asc_without_a_header_keeps_its_first_frame(tmp_path: Path) -> None:
    """python-can takes the first line for the header, whatever it holds."""
    path = tmp_path / "log.asc"
    path.write_text("0.1 1 181 Rx d 1 07\n0.2 1 181 Rx d 1 08\n")
    assert [r[10] for r in read_rows(path)[0]] == [b"\7", b"\10"]
    assert [r[10] for r in library_rows(path)[0]] == [b"\10"]


CANDUMP = (
    """(1436509052.249713) vcan0 044#2A366C2BBA
(1436509052.449847) vcan0 0F6#7ADFE07BD2 R
(1436509052.650004) can1 123ABC78#R8 T
(1436509052.7) can1 12#r
(1436509052.850183) a_longer_name_than_the_scan_keeps_for_itself 181##311223344 T
(1436509053.050400) 3 181##0
  (1436509053.1)  can1   1FFFFFFF#0011223344556677

(12) can0 7FF#
(13) 0000 7FF#01
(0.000001) can0 20000088#0000000000000000
(1436509053.250600) can1 181##5"""
    + "ab" * 64
    + "\n"
)


def test_candump_of_can_utils(tmp_path: Path) -> None:
    path = tmp_path / "log.log"
    path.write_text(CANDUMP)
    assert_as_the_library(path, 11)


def test_candump_error_frames_of_every_class(tmp_path: Path) -> None:
    """python-can takes an error frame without the bus-error bit for data of an extended identifier."""
    path = tmp_path / "log.log"
    path.write_text("(1.0) can0 20000004#0010000000000000\n(2.0) can0 00000004#0010000000000000\n")
    found, _ = read_rows(path)
    assert [r[ERROR_COLUMN] for r in found] == [True, False]
    assert [r[ERROR_COLUMN] for r in library_rows(path)[0]] == [False, False]
