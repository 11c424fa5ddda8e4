"""What a log tells of itself: counters in every place and order found, SYNC, cyclic numbers and checksums told from them."""

from pathlib import Path

import numpy as np
import pytest
from in_process import ran, refused
from rigged_feed import cell, frames_of, motion

from lmeasure.acquisition import import_logs, scan_log
from lmeasure.acquisition.bus.frames import Frames, join
from lmeasure.acquisition.recorder import candump_lines
from lmeasure.core import FileFormatError
from lmeasure.io import read_toml
from lmeasure.io.files import write_toml
from lmeasure.recording import read_run
from lmeasure.rig import Rig, read_rig, rig_from_dict, write_rig

RIG = cell()
COUNTS = motion(RIG)
PLACES = (
    {"id": 0x201, "byte_offset": 0, "bits": 16, "byte_order": "little"},
    {"id": 0x201, "byte_offset": 2, "bits": 16, "byte_order": "little"},
    {"id": 0x202, "byte_offset": 4, "bits": 32, "byte_order": "big"},
    {"id": 0x18FF1234, "extended": True, "byte_offset": 4, "bits": 32, "byte_order": "little"},
    {"id": 0x203, "byte_offset": 2, "bits": 24, "byte_order": "big"},
    {"id": 0x204, "byte_offset": 0, "bits": 16, "byte_order": "big"},
)


def placed() -> Rig:
    """The cell's counters in all manner of places."""
    channels = [{"channel": f"ch{i}", "start": 0} | place for i, place in enumerate(PLACES, 1)]
    return rig_from_dict(RIG.to_dict() | {"can": {"decoder": "raw", "sync_id": 0x85, "channel": channels}})


def noise(time_s: np.ndarray, identifier: int, data: np.ndarray) -> Frames:
    """Frames of something that is no drum."""
    n = len(time_s)
    width = np.zeros((n, 8), np.uint8)
    width[:, : data.shape[1]] = data
    one = np.ones(n, np.uint8)
    return Frames(time_s, np.full(n, identifier, np.uint32), 0 * one, data.shape[1] * one, width, np.zeros(n, np.int16))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    frames, time_s = frames_of(placed(), COUNTS), COUNTS.time_s
    rng, n = np.random.default_rng(1), len(time_s)
    k = np.arange(n)
    alive = noise(time_s + 1e-5, 0x300, np.column_stack([k % 256, rng.integers(0, 256, n), 0x5A * (k % 2), np.full(n, 7)]))
    seldom = noise(time_s[::100] + 2e-5, 0x700, np.full((len(time_s[::100]), 1), 5))
    every = join([frames, alive, seldom])
    every = every.take(np.argsort(every.time_s, kind="stable"))
    path = tmp_path_factory.mktemp("scan") / "drive.log"
    path.write_bytes(candump_lines(every))
    return path


def test_the_dialect_and_what_its_times_are_is_reported(log: Path, tmp_path: Path) -> None:
    scan = scan_log(log)
    assert scan.lines()[0].endswith(f"s, candump -L file, {scan.times}")
    screen = tmp_path / "seen.txt"
    screen.write_text("".join(f" (1700000000.{k:02d}0000)  can0  181   [4]  {k:02X} 00 00 00\n" for k in range(30)))
    (line, *_) = scan_log(screen).lines()
    assert line == f"{screen}: 30 frames in 0.29 s, candump screen output, times of day"


def test_the_guess_is_the_table_that_the_log_was_written_by(log: Path, tmp_path: Path) -> None:
    scan = scan_log(log)
    assert scan.sync is not None
    assert scan.sync.identifier == 0x85
    (tmp_path / "guess.toml").write_text("\n".join(scan.table()))
    table = read_toml(tmp_path / "guess.toml")["can"]
    assert table["timing"] == "sync"
    found = {(c["id"], c["byte_offset"], c["bits"], c["byte_order"], c.get("extended", False)) for c in table["channel"]}
    assert found == {(p["id"], p["byte_offset"], p["bits"], p["byte_order"], p.get("extended", False)) for p in PLACES}
    # and the log is read by it: the same counts, whatever the channels are called
    order = {(c["id"], c["byte_offset"]): c["channel"] for c in table["channel"]}
    data = RIG.to_dict() | {"can": table}
    for cable, place in zip(data["cable"], PLACES, strict=True):
        cable["channel"] = order[place["id"], place["byte_offset"]]
    counts = import_logs([log], rig_from_dict(data), None).run.passes[0]
    for cable, was in zip(data["cable"], RIG.cable, strict=True):
        np.testing.assert_array_equal(counts.of(cable["channel"]), COUNTS.of(was.channel))


def test_what_is_no_counter_is_told_as_what_it_is(log: Path) -> None:
    scan = scan_log(log)
    by_name = {c.name: c for c in scan.carried}
    assert by_name["300"].counters == ()
    assert by_name["300"].others[0] == "byte 0: frame counter, step 1"
    assert by_name["300"].others[1].endswith("values, not a counter (a checksum or a measured value)")
    assert by_name["300"].others[2] == "byte 2: alternates between 00 and 5A"
    assert len(by_name["300"].others) == 3
    assert (by_name["700"].others, by_name["700"].counters) == ((), ())
    assert by_name["201"].rate_hz == pytest.approx(1000.0, rel=1e-6)
    assert by_name["700"].rate_hz == pytest.approx(10.0, rel=1e-6)
    text = "\n".join(scan.lines())
    assert "bytes 4-7: counter, 32 bits big" in text
    assert all(len(line) <= 90 for line in scan.lines()[1:])


def bytes_of(values: np.ndarray, dtype: str) -> np.ndarray:
    """The bytes of whole numbers, a row for each."""
    return values.astype(dtype).view(np.uint8).reshape(len(values), -1)


WAY = np.cumsum(np.rint(60.0 * np.sin(np.arange(2000) / 150.0)).astype(np.int64))
STATUS, RANDOM = np.full((2000, 1), 0x81, np.uint8), np.random.default_rng(3).integers(0, 256, (2000, 1)).astype(np.uint8)
ZERO = 0 * STATUS


@pytest.mark.parametrize(
    ("parts", "found"),
    [
        ((STATUS, bytes_of(WAY, "<i4")), [(1, 4, "little")]),
        ((STATUS, bytes_of(WAY, ">i4"), RANDOM, ZERO), [(1, 4, "big")]),
        ((STATUS, bytes_of(WAY + 7_995_000, ">i4")[:, 1:]), [(1, 3, "big")]),
        ((bytes_of(WAY, "<i4")[:, :3], bytes_of(2 * WAY + 7, "<i4")[:, :3]), [(0, 3, "little"), (3, 3, "little")]),
        ((bytes_of(WAY, "<i4"), ZERO, RANDOM, ZERO), [(0, 4, "little")]),
        ((bytes_of(WAY, ">i4"), bytes_of(np.gradient(WAY), ">i2")), [(0, 4, "big")]),
        ((bytes_of(6 * np.arange(2000), "<i4"), STATUS), [(0, 4, "little")]),
        ((bytes_of(np.arange(500, 2500), ">i2"), ZERO, bytes_of(np.arange(2000), "<i2"), ZERO), []),
    ],
)
def test_counters_are_found_at_every_byte_and_beside_numbers_that_are_none(
    parts: tuple[np.ndarray, ...], found: list[tuple[int, int, str]], tmp_path: Path
) -> None:
    (tmp_path / "drive.log").write_bytes(candump_lines(noise(np.arange(2000) / 1000.0, 0x181, np.hstack(parts))))
    (carried,) = scan_log(tmp_path / "drive.log").carried
    assert [(c.first, c.size, c.order) for c in carried.counters] == found


def test_a_byte_that_selects_the_counter_is_named_and_nothing_is_guessed(tmp_path: Path) -> None:
    selector = np.tile(np.arange(4, dtype=np.uint8), 500)[:, None]
    ways = (WAY + 300_000 * selector[:, 0].astype(np.int64)) * (1 + selector[:, 0])
    (tmp_path / "drive.log").write_bytes(
        candump_lines(noise(np.arange(2000) / 1000.0, 0x181, np.hstack([selector, bytes_of(ways, "<i4")])))
    )
    scan = scan_log(tmp_path / "drive.log")
    assert scan.table() == []
    assert scan.lines()[2].strip() == "byte 0 selects one of 4 counters: give a DBC file (--dbc)"


def test_a_log_in_which_nothing_moved_says_so(tmp_path: Path) -> None:
    time_s = np.arange(50) / 100.0
    (tmp_path / "still.log").write_bytes(candump_lines(noise(time_s, 0x181, np.tile([1, 2, 3, 0], (50, 1)))))
    scan = scan_log(tmp_path / "still.log")
    assert scan.table() == []
    assert scan.lines()[-1] == "no byte changes like a counter. Log again while the robot moves"
    (tmp_path / "none.log").write_text("(0.000000) can0 20000080#\n")
    with pytest.raises(FileFormatError, match="contains no CAN frame"):
        scan_log(tmp_path / "none.log")


def test_the_command_scans_without_a_rig_and_asks_for_one_otherwise(log: Path) -> None:
    assert 'decoder = "raw"' in ran("import", log, "--scan")
    assert "--scan` lists the content of the log" in " ".join(refused("import", log, code=2).replace("│", " ").split())


@pytest.mark.parametrize(
    ("words", "reported"),
    [
        (["--position-mm", "0", "0", "0"], "The tool orientation is missing: give --quaternion-xyzw too, or all by --start X,Y,Z,O,A,T"),
        (["--quaternion-xyzw", "0", "0", "0", "1"], "The tool position is missing: give --position-mm too"),
        (["--start", "0,0,0,0,-90,90", "--position-mm", "0", "0", "0"], "is given together with --position-mm"),
        (["--start", "0,0,0,0,-90"], "'0,0,0,0,-90' is 5 numbers. Wanted are x,y,z in mm and three angles"),
    ],
)
def test_half_a_start_pose_is_asked_for_by_name(words: list[str], reported: str, log: Path, tmp_path: Path) -> None:
    write_rig(tmp_path / "rig.toml", placed())
    said = refused("import", log, "--rig", tmp_path / "rig.toml", "--out", tmp_path / "run", *words, code=2)
    assert reported in " ".join(said.replace("│", " ").split())
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(("angles", "typed"), [("puma-oat", "0,-90,90"), ("kuka-abc", "0,0,0"), ("ur-rotation-vector", "0,0,0")])
def test_a_start_is_typed_in_the_rigs_own_angles(angles: str, typed: str, log: Path, tmp_path: Path) -> None:
    write_toml(tmp_path / "rig.toml", placed().to_dict() | {"angles": angles})
    words = [str(log), "--rig", str(tmp_path / "rig.toml"), "--out", str(tmp_path / "run"), "--start", f"1.5,-2,3,{typed}"]
    ran("import", *words)
    run = read_run(tmp_path / "run")
    assert run.start is not None
    np.testing.assert_allclose(run.start, [1.5, -2.0, 3.0, 0.0, 0.0, 0.0, 1.0], atol=1e-12)
    assert read_rig(tmp_path / "run" / "rig.toml").angles == angles
