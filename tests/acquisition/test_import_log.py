"""`lmeasure import`: counts, faults, buses, passes, DBC files and the start pose of logs, through the command and through the function."""

import os
import subprocess
import sys
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from in_process import lmeasure
from log_corpus import write
from log_fuzz import START_POSE, counter_log, six_cables

from lmeasure.acquisition import counter_fields, import_logs, with_dbc, write_import
from lmeasure.cli.app import main
from lmeasure.core import AcquisitionError, FileFormatError, LMeasureError
from lmeasure.io import files
from lmeasure.io.tables import read_table
from lmeasure.recording import read_run
from lmeasure.rig import Rig, rig_from_dict, write_rig

POSE = ["--position-mm", "1", "2", "3", "--quaternion-xyzw", "0", "0", "0", "1"]


def counts_of(log: list[can.Message]) -> np.ndarray:
    """(n, 6) what the log's counter frames say, by Python's own integers."""
    rows: list[list[float]] = []
    for m in log:
        if m.is_error_frame or m.is_remote_frame or m.is_extended_id:
            continue
        if m.arbitration_id == 0x80:
            rows.append([np.nan] * 6)
        elif 0x181 <= m.arbitration_id <= 0x186 and len(m.data) == 4:
            rows[-1][m.arbitration_id - 0x181] = int.from_bytes(m.data, "little", signed=True)
    return np.array(rows)


def test_a_recording_is_not_written_over_and_faults_of_an_earlier_import_go(tmp_path: Path) -> None:
    log = counter_log(60, 5)
    path, broken = write(tmp_path / "drive.blf", log), write(tmp_path / "broken.blf", [m for i, m in enumerate(log) if i != 100])
    for source, faults in ((broken, True), (path, False)):
        write_import(tmp_path / "run", import_logs([source], six_cables(), START_POSE))
        events = tmp_path / "run" / "pass1.events.csv"
        assert ("gap" in read_table(events).text("kind")) == faults
    table = files.read_toml(tmp_path / "run" / "run.toml")
    table["recording"][0]["frames"] = "pass1.log"
    files.write_toml(tmp_path / "run" / "run.toml", table)
    write_rig(tmp_path / "rig.toml", six_cables())
    done = lmeasure("import", path, "--rig", tmp_path / "rig.toml", "--out", tmp_path / "run", "--force")
    assert (done.returncode, "is part of a recording, which is never written over" in done.stderr) == (2, True)


def test_the_start_file_states_its_uncertainty_too(tmp_path: Path) -> None:
    path = write(tmp_path / "drive.blf", counter_log(60, 6))
    write_rig(tmp_path / "rig.toml", six_cables())
    files.write_toml(
        tmp_path / "start.toml",
        {"start": {"position_mm": [1, 2, 3], "quaternion_xyzw": [0, 0, 0, 1], "u_position_mm": 0.25, "u_rotation_deg": 0.5}},
    )
    done = lmeasure("import", path, "--rig", tmp_path / "rig.toml", "--out", tmp_path / "run", "--start", tmp_path / "start.toml")
    assert done.returncode == 0, done.stderr
    assert read_run(tmp_path / "run").u_start == pytest.approx((0.25, np.radians(0.5)))


@pytest.mark.parametrize("suffix", [".blf", ".asc", ".log", ".mf4"])
def test_every_format_gives_the_same_counts(tmp_path: Path, suffix: str) -> None:
    log = [m for m in counter_log(300, 3) if suffix != ".mf4" or not m.is_error_frame]
    imported = import_logs([write(tmp_path / f"log{suffix}", log)], six_cables(), START_POSE)
    counts = imported.run.passes[0]
    assert np.array_equal(counts.recorded, counts_of(log))
    assert counts.time_s == pytest.approx(np.arange(300) * 1e-3, abs=1e-6)
    assert set(imported.logs[0].events.tally) <= {"bus_error"}
    assert imported.logs[0].events.tally["bus_error"] == sum(m.is_error_frame for m in log)
    assert "300 samples" in imported.summary()


def test_an_import_where_metadata_were_removed_says_that_the_version_is_unknown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Packagers remove them; what reads logs needs none."""

    def gone(name: str) -> str:
        raise PackageNotFoundError(name)

    path = write(tmp_path / "drive.blf", counter_log(20, 4))
    for module in ("lmeasure.core.entry_points", "lmeasure.acquisition.logs.import_log"):
        monkeypatch.setattr(f"{module}.version", gone, raising=False)
    write_rig(tmp_path / "rig.toml", six_cables())
    words = ["lmeasure", "import", path, "--rig", tmp_path / "rig.toml", "--out", tmp_path / "run", *POSE]
    monkeypatch.setattr("sys.argv", [str(word) for word in words])
    with pytest.raises(SystemExit) as ended:
        main()
    assert not ended.value.code
    assert "lmeasure unknown" in (tmp_path / "run" / "run.toml").read_text()


def test_the_command_writes_a_run_folder(tmp_path: Path) -> None:
    log = counter_log(200, 4)
    path = write(tmp_path / "drive.blf", log)
    write_rig(tmp_path / "rig.toml", six_cables())
    done = lmeasure("import", path, "--rig", tmp_path / "rig.toml", "--out", tmp_path / "run", *POSE)
    assert done.returncode == 0, done.stderr
    for words in ("1600 frames", "200 samples", "bus_error", "buses 0 (1600 frames)", "181 (200)", "error frames"):
        assert words in done.stdout
    run = read_run(tmp_path / "run")
    assert np.array_equal(run.passes[0].recorded, counts_of(log))
    assert run.known_start.tolist() == [1, 2, 3, 0, 0, 0, 1]
    entry = files.read_toml(tmp_path / "run" / "run.toml")["recording"][0]
    assert entry["ended"] == "complete"
    assert entry["sha256"] == {"drive.blf": files.sha256(path)}
    assert entry["received"] == 1600
    again = lmeasure(
        "import", path, "--rig", tmp_path / "run" / "rig.toml", "--out", tmp_path / "again", "--start", tmp_path / "run" / "run.toml",
        "--parquet",
    )  # fmt: skip
    assert again.returncode == 0, again.stderr
    assert np.array_equal(read_run(tmp_path / "again").passes[0].recorded, run.passes[0].recorded)


def test_without_a_start_pose_it_is_unknown(tmp_path: Path) -> None:
    path = write(tmp_path / "drive.log", counter_log(5, 4))
    write_rig(tmp_path / "rig.toml", six_cables())
    done = lmeasure("import", path, "--rig", tmp_path / "rig.toml", "--out", tmp_path / "run")
    assert done.returncode == 0, done.stderr
    assert f"note: no start pose. State [start] in {tmp_path / 'run' / 'run.toml'}" in done.stdout
    assert "start" not in files.read_toml(tmp_path / "run" / "run.toml")
    assert read_run(tmp_path / "run").start is None


def test_a_cut_log_says_that_it_ended_early(tmp_path: Path) -> None:
    log = counter_log(300, 5)
    path = write(tmp_path / "drive.blf", log, max_container_size=4000)
    path.write_bytes(path.read_bytes()[:-2000])
    imported = import_logs([path], six_cables(), START_POSE)
    write_import(tmp_path / "run", imported)
    found = imported.run.passes[0].recorded
    assert 200 < len(found) < 300
    whole = np.isfinite(found.sum(axis=1))
    assert whole[:-1].all()
    assert np.array_equal(found[whole], counts_of(log)[: len(found)][whole])
    assert "ended early" in imported.summary()
    entry = files.read_toml(tmp_path / "run" / "run.toml")["recording"][0]
    assert entry["ended"] == "early"
    assert entry["why"].startswith(imported.logs[0].report.ended_early or "no reason")


@pytest.mark.parametrize(
    ("later_s", "reported"),
    [
        (3600.0, "nothing came for 3599.94 s behind 1700000000.059000 s: if these are two recordings, cut the log there"),
        (-0.02, "its clock goes back by 0.0197999 s behind 1700000000.059000 s: if these are two recordings"),
        (4.9, ""),
    ],
)
def test_two_recordings_in_one_log_are_reported(tmp_path: Path, later_s: float, reported: str) -> None:
    first, then = counter_log(60, 3), counter_log(60, 3)
    for m in then:
        m.timestamp += later_s if later_s > 0.0 else 0.04
    lines = import_logs([write(tmp_path / "two.log", first + then)], six_cables(), START_POSE).summary().splitlines()
    assert [line for line in lines if "two recordings" in line] == [line for line in lines if reported and f"two.log: {reported}" in line]
    assert any("two recordings" in line for line in lines) == bool(reported)


def test_buses(tmp_path: Path) -> None:
    """The same identifiers on two buses are two rigs: one must be named. Other traffic on another bus is no matter."""
    log = counter_log(50, 7)
    twin = counter_log(50, 8)
    for m in twin:
        m.channel = 1
    both = sorted(log + twin, key=lambda m: m.timestamp)
    path = write(tmp_path / "both.blf", both)
    with pytest.raises(AcquisitionError, match=r"both\.blf: (channel ch1|SYNC) is on buses 0, 1. Name one with --bus"):
        import_logs([path], six_cables(), START_POSE)
    for bus, alone in (("0", log), ("1", twin)):
        found = import_logs([path], six_cables(), START_POSE, bus=bus).run.passes[0].recorded
        assert np.array_equal(found, counts_of(alone))
    with pytest.raises(LMeasureError, match=r"both\.blf"):
        import_logs([path], six_cables(), START_POSE, bus="7")
    others = [m for m in twin if not (m.arbitration_id == 0x80 or 0x181 <= m.arbitration_id <= 0x186)]
    mixed = write(tmp_path / "mixed.blf", sorted(log + others, key=lambda m: m.timestamp))
    assert np.array_equal(import_logs([mixed], six_cables(), START_POSE).run.passes[0].recorded, counts_of(log))


def test_passes(tmp_path: Path) -> None:
    """A rig of three drums that measures six cables in two passes takes two logs."""
    data = six_cables().to_dict()
    for i, cable in enumerate(data["cable"]):
        cable |= {"pass": 1 + i // 3, "channel": f"ch{1 + i % 3}", "from": f"B{1 + i % 3}"}
    rig = rig_from_dict(data)
    logs = [counter_log(40, 9), counter_log(40, 10)]
    paths = [write(tmp_path / f"pass{i}.log", log) for i, log in enumerate(logs)]
    imported = import_logs(paths, rig, START_POSE)
    for counts, log in zip(imported.run.passes, logs, strict=True):
        assert counts.channels == ("ch1", "ch2", "ch3")
        assert np.array_equal(counts.recorded, counts_of(log)[:, :3])
    with pytest.raises(AcquisitionError, match="need 2 passes, one log each, but 1 given"):
        import_logs(paths[:1], rig, START_POSE)


DBC = (Path(__file__).parent / "inputs" / "three-messages.dbc").read_text(encoding="utf-8")


def without_counter_bits() -> Rig:
    data = six_cables().to_dict()
    for point in data["observation_point"]:
        point["drum"].pop("counter_bits")
    return rig_from_dict(data)


def test_signals_of_a_dbc_file_as_cantools_reads_them(tmp_path: Path) -> None:
    """Any bit, both byte orders, both signs; the counts are the signals' integers, before the file's own scaling."""
    import cantools

    (tmp_path / "rig.dbc").write_text(DBC)
    database: Any = cantools.database.load_string(DBC, database_format="dbc")
    rng = np.random.default_rng(11)
    walk = np.cumsum(rng.integers(-200, 201, (200, 6)), axis=0)
    walk[:, 5] += 2**31 + 10**6
    log = []
    for i, row in enumerate(walk.tolist()):
        t = 1.7e9 + i * 1e-3
        log.append(can.Message(timestamp=t, arbitration_id=0x80, is_extended_id=False, channel=0))
        for name, values in (
            ("Left", {"ch1": row[0], "ch2": row[1]}),
            ("Middle", {"ch3": row[2], "ch4": row[3]}),
            ("Right", {"ch5": row[4], "ch6": row[5]}),
        ):
            message = database.get_message_by_name(name)
            data = message.encode(values, scaling=False)
            log.append(
                can.Message(
                    timestamp=t + 1e-4, arbitration_id=message.frame_id, is_extended_id=message.is_extended_frame, data=data, channel=0
                )
            )
    path = write(tmp_path / "drive.blf", log)
    rig = with_dbc(without_counter_bits(), tmp_path / "rig.dbc")
    imported = import_logs([path], rig, START_POSE)
    found = imported.run.passes[0].recorded
    decoded = np.array(
        [[database.decode_message(m.arbitration_id, m.data, scaling=False) for m in log[4 * i + 1 : 4 * i + 4]] for i in range(200)]
    )
    expected = np.array([[{**a, **b, **c}[f"ch{j}"] for j in range(1, 7)] for a, b, c in decoded], float)
    assert np.array_equal(expected, walk)
    full = np.array([2.0**32, 2.0**24, 2.0**20, 2.0**30, 2.0**32, 2.0**32])
    assert np.array_equal(found, expected - full * np.rint(expected[0] / full))
    write_import(tmp_path / "run", imported)
    write_rig(tmp_path / "rig.toml", without_counter_bits())
    done = lmeasure("import", path, "--rig", tmp_path / "rig.toml", "--dbc", tmp_path / "rig.dbc", "--out", tmp_path / "other", *POSE)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "other" / "pass1.csv").read_bytes() == (tmp_path / "run" / "pass1.csv").read_bytes()
    again = lmeasure("import", path, "--rig", tmp_path / "run" / "rig.toml", "--out", tmp_path / "third", *POSE)
    assert again.returncode == 0, again.stderr  # the DBC file went with the run


LOOSE = """
BO_ 400 Loose: 4 Encoder
 SG_ wide : 16|32@1- (1,0) [0|0] "" Encoder
 SG_ one : 0|8@1- (1,0) [0|0] "" Encoder
 SG_ two : 4|8@1- (1,0) [0|0] "" Encoder
"""


def test_a_dbc_file_is_held_to_the_signals_that_are_read(tmp_path: Path) -> None:
    """Signals that lie upon each other or beyond their frame are no matter where nobody reads them, and refused where somebody does."""
    import cantools
    from cantools.database.errors import Error

    def fields(text: str) -> tuple[object, ...]:
        (tmp_path / "rig.dbc").write_text(text, newline="")
        rig = with_dbc(without_counter_bits(), tmp_path / "rig.dbc")
        return tuple(f.row() for f in counter_fields(rig, 1, tmp_path))

    known = fields(DBC)
    with pytest.raises(Error):
        cantools.database.load_string(DBC + LOOSE, database_format="dbc")
    assert fields(DBC + LOOSE) == known
    beside = ' SG_ ch4 : 27|30@0- (1,0) [0|0] "" Encoder\n'
    assert fields(DBC.replace(beside, beside + ' SG_ unread : 20|60@1- (1,0) [0|0] "" Encoder\n')) == known
    assert fields((DBC + LOOSE).replace("\n", "\r\n")) == known
    for text, words in (
        (DBC.replace("ch4 : 27|30@0-", "ch4 : 16|20@1-"), "channel ch3: message 'Middle': The signals ch4 and ch3 are overlapping"),
        (DBC.replace("ch4 : 27|30@0-", "ch4 : 60|20@1-"), "message 'Middle': The signal ch4 does not fit in message Middle"),
    ):
        with pytest.raises(FileFormatError, match=r"rig\.dbc") as caught:
            fields(text)
        assert words in str(caught.value)


def test_a_multiplexed_signal_beside_one_that_does_not_fit(tmp_path: Path) -> None:
    """cantools decodes a message of overlapping signals wrongly where it is not told to refuse them."""
    text = """VERSION ""
BU_: E
BO_ 385 Left: 8 E
 SG_ page M : 0|8@1+ (1,0) [0|0] "" E
 SG_ ch1 m3 : 8|32@1- (1,0) [0|0] "" E
 SG_ unread m3 : 12|32@1- (1,0) [0|0] "" E
"""
    (tmp_path / "rig.dbc").write_text(text)
    data = six_cables().to_dict()
    data["observation_point"] = [p for p in data["observation_point"] if p["name"] == "B1"]
    data["observation_point"][0]["drum"].pop("counter_bits")
    data["cable"] = data["cable"][:1]
    field = counter_fields(with_dbc(rig_from_dict(data), tmp_path / "rig.dbc"), 1, tmp_path)[0]
    assert field.reader is not None
    assert field.reader(bytes([3]) + (-123456).to_bytes(4, "little", signed=True) + bytes(3)) == -123456
    assert field.reader(bytes([2]) + bytes(7)) is None


@pytest.mark.parametrize("braked", [False, True])
def test_a_braked_winch_is_no_dead_encoder_where_the_rig_says_so(tmp_path: Path, braked: bool) -> None:
    log = counter_log(2500, 14)
    for m in log:
        if m.arbitration_id == 0x183 and len(m.data) == 4 and not m.is_extended_id:
            m.data = bytearray(4)
    data = six_cables().to_dict()
    data["observation_point"][2]["drum"]["braked"] = braked
    imported = import_logs([write(tmp_path / "drive.blf", log)], rig_from_dict(data), START_POSE)
    column = imported.run.passes[0].recorded[:, 2]
    assert imported.logs[0].events.tally["stall"] == (0 if braked else 1)
    assert bool(np.count_nonzero(column == 0) > 2490) == braked


def test_what_is_no_regular_file_is_refused_at_once(tmp_path: Path) -> None:
    """A pipe without a writer would be waited for for ever, a device never ends."""
    os.mkfifo(tmp_path / "log.log")
    (tmp_path / "zero.blf").symlink_to("/dev/zero")
    for log in (tmp_path / "log.log", tmp_path / "zero.blf"):
        with pytest.raises(FileFormatError, match="it is no regular file but a pipe or a device"):
            import_logs([log], six_cables(), START_POSE)


def test_what_the_log_lacks_is_said(tmp_path: Path) -> None:
    rig = six_cables()
    log = [m for m in counter_log(30, 12) if m.arbitration_id != 0x80]
    with pytest.raises(AcquisitionError, match=r"drive\.log: \d+ frames, but no SYNC 0x80"):
        import_logs([write(tmp_path / "drive.log", log)], rig, START_POSE)
    log = [m for m in counter_log(30, 12) if m.arbitration_id != 0x184]
    with pytest.raises(AcquisitionError, match=r"less\.log: channel ch4: not one count in frames 184. Identifiers in the log: "):
        import_logs([write(tmp_path / "less.log", log)], rig, START_POSE)


LOADED = """
import sys
from lmeasure.cli.app import main
try:
    main()
except SystemExit as end:
    assert not end.code
print([name for name in ("asammdf", "sympy", "pandas") if name in sys.modules])
"""


def test_a_log_that_is_no_mf4_file_loads_no_reader_of_them(tmp_path: Path) -> None:
    """asammdf brings SymPy and pandas, a second in all."""
    path = write(tmp_path / "drive.log", counter_log(20, 4))
    write_rig(tmp_path / "rig.toml", six_cables())
    arguments = ["import", path, "--rig", tmp_path / "rig.toml", "--out", tmp_path / "run", *POSE]
    done = subprocess.run([sys.executable, "-c", LOADED, *map(str, arguments)], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
