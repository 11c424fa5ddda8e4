"""Trajectories of other instruments: each format read without editing, what is missing said, and what cannot be read named."""

import json
import struct
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from in_process import ran, refused
from mcap.writer import Writer
from scipy.spatial.transform import Rotation
from synthetic_trajectories import synthetic_campaign

from lmeasure.cli.app import main
from lmeasure.core import FileFormatError, FloatArray, LMeasureError, SettingsError, Status
from lmeasure.io import columns_of
from lmeasure.io.files import write_toml
from lmeasure.text import common, message, within
from lmeasure.trajectory import Stated, Trajectory, read_trajectory, write_trajectory

U = ("--u-position-mm", "0.01", "--u-rotation-deg", "0.001")


@pytest.fixture(scope="module")
def ours() -> tuple[Trajectory, dict[str, object]]:
    return synthetic_campaign(np.array([0.2, -0.1, 0.3]), 0.02)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_causes_keep_their_ids_in_files(tmp_path: Path, ours: tuple[Trajectory, dict[str, object]], suffix: str) -> None:
    """`certify` gives no verdict on windows with suspected counts, of whichever file."""
    found = ours[0]
    cause = np.full(len(found.time_s), "", dtype=np.object_)
    cause[3:9] = common(6, message("counts.suspected", step=message("channel.cable", name='c1, "quoted"')))
    cause[9] = "a text of another program"
    path = tmp_path / f"t{suffix}"
    write_trajectory(path, replace(found, cause=cause))
    read = read_trajectory(path).cause
    assert [within(one, "counts.suspected") is not None for one in read[2:11]] == [False, *[True] * 6, False, False]
    assert read.tolist() == cause.tolist()


def as_tum(path: Path, found: Trajectory) -> None:
    rows = np.column_stack([found.time_s, found.poses[:, :3] / 1e3, found.poses[:, 3:]])
    lines = [" ".join(map(repr, row)) for row in rows.tolist()]
    path.write_text("\n".join(["# timestamp tx ty tz qx qy qz qw", *lines, ""]), encoding="utf-8")


def as_euroc(path: Path, found: Trajectory) -> None:
    head = "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []\n"
    lines = [
        f"{round(t * 1e9)}," + ",".join(map(repr, [*(p[:3] / 1e3).tolist(), float(p[6]), *p[3:6].tolist()]))
        for t, p in zip(found.time_s, found.poses, strict=True)
    ]
    path.write_text(head + "\n".join(lines) + "\n", encoding="utf-8")


def as_mcap(path: Path, found: Trajectory, ros: int = 2) -> None:
    """PoseStamped by hand: CDR aligns doubles to eight behind its first four bytes, ROS 1 packs them."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        name, encoding = ("geometry_msgs/msg/PoseStamped", "cdr") if ros == 2 else ("geometry_msgs/PoseStamped", "ros1")
        schema = writer.register_schema(name=name, encoding="ros2msg" if ros == 2 else "ros1msg", data=b"")
        channel = writer.register_channel(topic="/pose", message_encoding=encoding, schema_id=schema)
        for i, (t, p) in enumerate(zip(found.time_s, found.poses, strict=True)):
            nanoseconds = round(t * 1e9)
            frame = b"world\0" if ros == 2 else b"world"
            head = b"\0\1\0\0" if ros == 2 else struct.pack("<I", i)
            body = struct.pack("<iII", *divmod(nanoseconds, 10**9), len(frame)) + frame
            body += b"\0" * (-len(body) % 8) if ros == 2 else b""
            writer.add_message(channel, nanoseconds, head + body + struct.pack("<7d", *(p[:3] / 1e3), *p[3:]), nanoseconds)
        writer.finish()  # type: ignore[no-untyped-call]


@pytest.mark.parametrize("kind", ["tum", "euroc", "mcap", "mcap of ROS 1"])
def test_formats_of_others_give_the_same_poses(kind: str, ours: tuple[Trajectory, object], tmp_path: Path) -> None:
    found, _ = ours
    path = tmp_path / {"tum": "t.tum", "euroc": "data.csv"}.get(kind, "t.mcap")
    if kind in ("tum", "euroc"):
        {"tum": as_tum, "euroc": as_euroc}[kind](path, found)
    else:
        as_mcap(path, found, ros=1 if kind.endswith("1") else 2)
    read = read_trajectory(path)
    assert read.time_s == pytest.approx(found.time_s, abs=1e-9)
    assert read.poses == pytest.approx(found.poses, abs=1e-9)
    assert read.absent == ("position", "rotation")
    assert (read.status == Status.OK).all()
    determined = read_trajectory(path, Stated(u_position_mm=0.02, u_rotation_rad=1e-4))
    assert determined.absent == ()
    assert determined.u[5] == pytest.approx([0.02] * 3 + [1e-4] * 3)


def test_our_own_messages_bring_their_covariances(ours: tuple[Trajectory, object], tmp_path: Path) -> None:
    found, _ = ours
    root = np.random.default_rng(3).normal(size=(6, 6)) * np.repeat([1e-4, 0.02], 3)[:, None]
    object.__setattr__(found, "random", np.tile(root @ root.T, (len(found.time_s), 1, 1)))
    write_trajectory(tmp_path / "t.mcap", found)
    read = read_trajectory(tmp_path / "t.mcap")
    assert read.absent == ()
    assert read.random[7] == pytest.approx(found.random[7], rel=1e-12)
    object.__setattr__(found, "random", np.zeros_like(found.random))
    write_trajectory(tmp_path / "u.mcap", found)
    assert read_trajectory(tmp_path / "u.mcap").absent == ("position", "rotation")  # ROS: zeros are not known


def test_a_table_under_other_names_units_and_marks(ours: tuple[Trajectory, object], tmp_path: Path) -> None:
    found, _ = ours
    lines = ["Zeit;X (m);Y (m);Z (m);Größe"]
    for t, p in zip(found.time_s[:50], found.poses, strict=False):
        lines.append(";".join(f"{v:.9f}".replace(".", ",") for v in (1e3 * t, *(p[:3] / 1e3))) + ";ä")
    lines[11] = lines[11].split(";")[0] + ";;;;"
    path = tmp_path / "tracker.csv"
    path.write_bytes("\r\n".join(lines).encode("cp1252"))
    stated = Stated(columns_of("time=Zeit[ms],x=X (m)[m],y=Y (m)[m],z=Z (m)[m]"), 0.03)
    read = read_trajectory(path, stated)
    assert read.time_s == pytest.approx(found.time_s[:50], abs=1e-9)
    assert np.delete(read.poses[:, :3], 10, axis=0) == pytest.approx(np.delete(found.poses[:50, :3], 10, axis=0), abs=1e-6)
    assert np.isnan(read.poses[:, 3:]).all()
    assert read.status[10] == Status.GAP
    assert read.absent == ()  # no rotation is measured of which an uncertainty could be missing


@pytest.mark.parametrize(
    ("name", "text", "determined"),
    [
        ("a.tum", "0 1 2 3 0 0 0 1\n1 1 2 3 0 0 0\n", "line 2: is not time x y z qx qy qz qw"),
        ("a.tum", "1 1 2 3 0 0 0 1\n0 1 2 3 0 0 0 1\n", "line 2: its time is not after"),
        ("a.tum", "0 1 2 3 0 0 0 2\n", "line 1: its quaternion is not of length 1"),
        ("a.csv", "time_s,x_mm,y_mm\n0,1,2\n", "column 'z_mm' is missing"),
        ("a.csv", "time_s,x_mm,y_mm,z_mm\n0,1,2,3e9\n", "line 2: is more than"),
        ("a.csv", "time_s,x_mm,y_mm,z_mm,u_position_mm\n0,1,2,3,-1\n", "line 2: a standard uncertainty of the position is negative"),
        ("a.csv", "time_s,x_mm,y_mm,z_mm\n0,,,\n", "no row has a whole pose"),
        ("a.csv", "time_s,x_mm,y_mm,z_mm\n", "has no rows"),
        (
            "a.csv",
            "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m]\n1,2,3\n",
            "line 2 contains numbers, and no line above it names its 3 columns",
        ),
        ("a.mcap", "no such thing", "cannot be read as MCAP"),
        ("a.csv", "time_s,x_mm,y_mm,z_mm,qx,qw\n0,1,2,3,0,1\n", "has qx, qw, but no qy, qz: a quaternion is all four"),
    ],
)
def test_what_cannot_be_read_is_named(name: str, text: str, determined: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    with pytest.raises(LMeasureError, match=determined):
        read_trajectory(path)


@pytest.mark.parametrize(
    ("name", "text", "mapping", "determined"),
    [
        (
            "a.csv",
            "t,x_mm,y_mm,z_mm\n0,1,2,3\n",
            "t=t[s]",
            "column 'time_s' is missing. It has t, x_mm, .*. Choose one with --columns time=COLUMN.s.",
        ),
        (
            "a.csv",
            "time_s,x_mm,y_mm,z_mm\n0,1,2,3\n",
            "speed=x_mm",
            "speed=x_mm: .*a.csv is read for .* time, .* x, y, z and controllers' angles, not for speed",
        ),
        ("a.csv", "time_s,x_mm,y_mm,z_mm\n0,1,2,3\n", "roll=x_mm", "not for roll"),
        ("a.tum", "0 1 2 3 0 0 0 1\n", "x=X", "a.tum is a TUM file, which defines its own columns"),
        ("a.csv", "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m]\n1,2,3,4\n", "x=X", "is an EuRoC file"),
    ],
)
def test_a_mapping_that_says_nothing_of_the_file_is_named(name: str, text: str, mapping: str, determined: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises((FileFormatError, SettingsError), match=determined):
        read_trajectory(tmp_path / name, Stated(columns_of(mapping)))


def test_a_mapping_says_of_messages_their_topic_alone(ours: tuple[Trajectory, object], tmp_path: Path) -> None:
    write_trajectory(tmp_path / "t.mcap", ours[0])
    assert len(read_trajectory(tmp_path / "t.mcap", Stated(columns_of("topic=/lmeasure/pose"))).time_s) == len(ours[0].time_s)
    with pytest.raises(SettingsError, match=r"contains messages. State topic=/NAME for it, not x"):
        read_trajectory(tmp_path / "t.mcap", Stated(columns_of("topic=/lmeasure/pose,x=X")))


def test_a_mapping_that_is_none_is_wrong_use() -> None:
    for mapping, determined in (
        ("x", "'x' is not name=column"),
        ("x=X[furlong]", r"'x=X\[furlong\]' is not"),
        ("x=X,x=Y", "'x' is given twice"),
    ):
        with pytest.raises(SettingsError, match=determined):
            columns_of(mapping)


def test_a_mapping_of_several_files_may_speak_of_others(tmp_path: Path) -> None:
    (tmp_path / "a.tum").write_text("0 1 2 3 0 0 0 1\n", encoding="utf-8")
    (tmp_path / "a.csv").write_text("t,x_mm,y_mm,z_mm\n0,1,2,3\n", encoding="utf-8")
    columns = columns_of("joint_1=A1[rad],time=t[s]")
    for name in ("a.tum", "a.csv"):
        assert len(read_trajectory(tmp_path / name, Stated(columns, of_others=True)).time_s) == 1


def test_certificates_of_other_instruments(ours: tuple[Trajectory, dict[str, object]], tmp_path: Path) -> None:
    """Without uncertainties values and no verdict; with them the verdicts of our own files; the original and the mapping are sealed."""
    found, program = ours
    write_toml(tmp_path / "program.toml", program)
    table = pd.DataFrame({"t": found.time_s, "X[m]": found.poses[:, 0] / 1e3, "Y": found.poses[:, 1] / 25.4, "Z": found.poses[:, 2]})
    table.to_csv(tmp_path / "seen.csv", index=False)
    mapping = ("--columns", "time=t[s],x=X[m][m],y=Y[in],z=Z[mm]")
    common = ("--program", str(tmp_path / "program.toml"), "--trials", "200")
    ran("certify", tmp_path / "seen.csv", *common, *mapping, "--out", tmp_path / "bare")
    bare = json.loads((tmp_path / "bare" / "certificate.json").read_text())
    assert {(c["u95"], c["capable"]) for c in bare["characteristics"]} == {(None, None)}
    assert bare["measurement"]["columns"] == mapping[1]
    assert (tmp_path / "bare" / "inputs" / "trajectory.csv").read_bytes() == (tmp_path / "seen.csv").read_bytes()
    assert "no verdict" in (tmp_path / "bare" / "report.html").read_text()
    ran("verify", tmp_path / "bare")
    ran("certify", tmp_path / "seen.csv", *common, *mapping, *U[:2], "--out", tmp_path / "determined")
    determined = {c["name"]: c for c in json.loads((tmp_path / "determined" / "certificate.json").read_text())["characteristics"]}
    assert determined["AP_p"]["value"] == pytest.approx(np.linalg.norm([0.2, -0.1, 0.3]), abs=0.02)
    assert determined["AP_p"]["capable"]
    ran("verify", tmp_path / "determined")
    refused("compare", tmp_path / "bare", tmp_path / "determined")


def test_motion_of_places_alone(tmp_path: Path) -> None:
    time_s = np.arange(400) / 100.0
    table = pd.DataFrame({"time_s": time_s, "x_mm": 50.0 * time_s**2, "y_mm": 0.0 * time_s, "z_mm": 5.0})
    table.to_csv(tmp_path / "seen.csv", index=False)
    ran("motion", tmp_path / "seen.csv", "--half-width-s", "0.1", "--out", tmp_path / "m.csv")
    made = pd.read_csv(tmp_path / "m.csv")
    assert made["speed_mm_s"].to_numpy() == pytest.approx(100.0 * time_s, abs=1e-6)
    assert made[["u_speed_mm_s", "wx_rad_s", "qx"]].isna().all(axis=None)
    ran("motion", tmp_path / "seen.csv", *U[:2], "--half-width-s", "0.1", "--force", "--out", tmp_path / "m.csv")
    assert (pd.read_csv(tmp_path / "m.csv")["u_speed_mm_s"] > 0.0).all()


Said = Callable[..., tuple[object, dict[str, Any]]]


@pytest.fixture
def said(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Said:
    """Exit code and the JSON document of a command."""

    def of(*words: object) -> tuple[object, dict[str, Any]]:
        monkeypatch.setattr(sys, "argv", ["lmeasure", *map(str, words), "--json"])
        with pytest.raises(SystemExit) as ended:
            main()
        return ended.value.code, json.loads(capsys.readouterr().out)

    return of


def test_motion_says_what_times_and_windows_do_not_fit(said: Said, tmp_path: Path) -> None:
    """A window wider than the trajectory would make one cubic of all of it, nanoseconds taken for seconds leave none full, and millimetres
    taken for metres are a thousand times as fast."""
    time_s = np.arange(400) / 100.0
    places = np.column_stack([500.0 * np.sin(time_s), 0.0 * time_s, 5.0 + 0.0 * time_s])

    def made(name: str, *columns: FloatArray) -> Path:
        rows = np.column_stack([*columns, np.tile([0.0, 0.0, 0.0, 1.0], (len(time_s), 1))])
        (tmp_path / name).write_text("\n".join(" ".join(f"{v:.9g}" for v in row) for row in rows) + "\n", encoding="utf-8")
        return tmp_path / name

    out = tmp_path / "m.csv"
    wide = said("motion", made("t.tum", time_s, places / 1e3), "--half-width-s", "4.5", "--out", out)
    assert (wide[0], "4.5 s to either side of a trajectory that lasts 3.99 s" in str(wide[1]["error"])) == (2, True)
    late = said("motion", made("ns.tum", 1e9 * time_s, places / 1e3), "--out", out)
    assert (late[0], "motion: no window of +-0.02 s contains 8 poses, which are 1e+07 s apart" in str(late[1]["error"])) == (1, True)
    assert not out.exists()
    fast = said("motion", made("mm.tum", time_s, places), "--half-width-s", "0.1", "--out", out)
    assert (fast[0], fast[1]["warnings"]) == (0, ["note: 500 m/s is too fast for a robot. Check the units of positions and times"])
    right = said("motion", tmp_path / "t.tum", "--half-width-s", "0.1", "--force", "--out", out)
    assert (right[0], right[1]["warnings"]) == (0, [])


def test_a_tool_that_is_upside_down_at_every_pose_is_remarked(
    said: Said, ours: tuple[Trajectory, dict[str, object]], tmp_path: Path
) -> None:
    found, program = ours
    write_toml(tmp_path / "program.toml", program)
    as_tum(tmp_path / "t.tum", found)
    rows = [line.split() for line in (tmp_path / "t.tum").read_text().splitlines()[1:]]
    (tmp_path / "w.tum").write_text("".join(" ".join([*row[:4], row[7], *row[4:7]]) + "\n" for row in rows))
    for name, notes in (("t.tum", 0), ("w.tum", 1)):
        words = ["--program", tmp_path / "program.toml", *U, "--trials", "100", "--out", tmp_path / name[0]]
        code, document = said("certify", tmp_path / name, *words)
        assert (code, len(document["warnings"])) == (0, notes), document
    assert document["warnings"][0].startswith("note: at every pose, the tool is turned by at least 180 deg")
    assert "the order of quaternions is x, y, z, w" in document["summary"][-1]


def test_two_angles_of_three_are_not_passed_over_in_silence(said: Said, tmp_path: Path) -> None:
    time_s = np.arange(100) / 100.0
    table = pd.DataFrame({"time_s": time_s, "x_mm": 50.0 * time_s**2, "y_mm": 0.0, "z_mm": 5.0, "o_deg": 0.0, "a_deg": 0.0})
    table.to_csv(tmp_path / "seen.csv", index=False)
    code, document = said("motion", tmp_path / "seen.csv", "--half-width-s", "0.1", "--out", tmp_path / "m.csv")
    assert (code, len(document["warnings"])) == (0, 1)
    assert (
        "no orientation, or not under known column names (qx, qy, qz, qw, or a controller's angles). No result for rotations"
        in document["warnings"][0]
    )


def test_the_convention_of_angles_is_that_of_units_and_program(said: Said, tmp_path: Path) -> None:
    """A rotation vector under a controller's names: what units and program tell is read and named, what they contradict is asked for."""
    time_s, vector = np.arange(400) * 0.002, [0.4, 0.3, 0.2]
    rows = np.column_stack([time_s, np.tile([0.4, -0.1, 0.3, *vector], (400, 1))])
    rows[:, 1:4] += np.random.default_rng(0).normal(0.0, 5e-6, (400, 3))
    (tmp_path / "ur.csv").write_text("t,T0,T1,T2,T3,T4,T5\n" + "\n".join(",".join(f"{v:.7f}" for v in row) for row in rows) + "\n")
    pose = {"name": "P1", "position_mm": [400.0, -100.0, 300.0], "windows_s": [[0.1, 0.3], [0.5, 0.7]]}
    pose["quaternion_xyzw"] = Rotation.from_rotvec(vector).as_quat().tolist()
    columns = "time=t[s],x=T0[m],y=T1[m],z=T2[m],rx=T3[rad],ry=T4[rad],rz=T5[rad]"
    for likely in (None, "ur-rotation-vector", "kuka-abc"):
        read = read_trajectory(tmp_path / "ur.csv", Stated(columns_of(columns), likely=likely))
        assert Rotation.from_quat(read.poses[:, 3:]).as_rotvec() == pytest.approx(np.tile(vector, (400, 1)), abs=1e-9)
    write_toml(tmp_path / "program.toml", {"schema": "lmeasure.program/1", "angles": "staubli-xyz", "pose": [pose]})
    words = ["certify", tmp_path / "ur.csv", "--columns", columns, *U, "--trials", "100", "--program", tmp_path / "program.toml"]
    code, document = said(*words, "--out", tmp_path / "o")
    assert code == 1
    assert "T3, T4, T5 may be angles of staubli-xyz, ur-rotation-vector. Choose one with --angles" in str(document["error"])
    assert not (tmp_path / "o").exists()
    code, document = said(*words, "--angles", "ur-rotation-vector", "--out", tmp_path / "o")
    assert code == 0, document
    made = json.loads((tmp_path / "o" / "certificate.json").read_text())
    assert {c["name"]: c["value"] for c in made["characteristics"]}["AP_rot"] == pytest.approx(0.0, abs=1e-4)
    assert "orientation read from T3 in rad, T4 in rad, T5 in rad: ur-rotation-vector" in made["notes"]
    ran("verify", tmp_path / "o")
