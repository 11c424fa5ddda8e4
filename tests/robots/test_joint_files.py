"""Measurements of a robot from what other programs write: rests of trajectories and runs, labelled markers, points by name."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, LMeasureError, se3
from lmeasure.io import columns_of
from lmeasure.rig import read_rig
from lmeasure.robots import Settings, identify, read_robot_measurements
from lmeasure.robots.identification.read_measurements import MeasurementFile, aligned
from lmeasure.robots.robot import shipped
from lmeasure.sensors import counts_from_poses
from lmeasure.trajectory import Stated, read_trajectory
from lmeasure.trajectory.files.markers import body_of, read_markers

CELL = Path(__file__).parents[1] / "authorities" / "truth" / "cell-run" / "rig.toml"
ROBOT = shipped("generic6").model
RATE, REST_S, MOVE_S = 100.0, 0.6, 0.4
NAMES = [f"joint_{i}_deg" for i in range(1, 7)]


def motion(count: int = 12, seed: int = 3) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Joint values (count, 6) that a robot rests at, times (n,), poses (n, 7) of the target in the instrument's frame, joints (n, 6)."""
    rng = np.random.default_rng(seed)
    middle = np.radians([10.0, -60.0, 70.0, 20.0, 50.0, 10.0])
    joints = middle + np.radians(6.0) * rng.uniform(-1.0, 1.0, (count, 6))
    joints[0] = middle
    ends = np.concatenate([[k * (REST_S + MOVE_S), k * (REST_S + MOVE_S) + REST_S] for k in range(count)])
    time_s = np.arange(0.0, ends[-1] + 1e-9, 1.0 / RATE)
    part = np.clip(np.interp(time_s, ends, np.repeat(np.arange(count, dtype=float), 2)), 0, count - 1)
    low = np.minimum(part.astype(int), count - 2)
    smooth = part - low
    smooth = smooth * smooth * (3.0 - 2.0 * smooth)
    way = joints[low] + smooth[:, None] * (joints[low + 1] - joints[low])
    flange = ROBOT.forward(way)
    tool = np.array([20.0, -10.0, 80.0, 0.0, 0.0, 0.0, 1.0])
    base = se3.inverse(se3.compose(flange[0], tool))  # the first pose is the cell's origin
    return joints, time_s, se3.compose(se3.compose(np.tile(base, (len(flange), 1)), flange), np.tile(tool, (len(flange), 1))), way


def table(path: Path, joints: FloatArray, names: list[str] | None = None, time_s: FloatArray | None = None) -> Path:
    names = [f"P{i + 1}" for i in range(len(joints))] if names is None else names
    head = ["name", *NAMES, *(["time_s"] if time_s is not None else [])]
    rows = [
        [n, *(repr(float(v)) for v in np.degrees(q)), *([repr(float(time_s[i]))] if time_s is not None else [])]
        for i, (n, q) in enumerate(zip(names, joints, strict=True))
    ]
    path.write_text("\n".join(",".join(row) for row in [head, *rows]) + "\n", encoding="utf-8")
    return path


def trajectory(path: Path, time_s: FloatArray, poses: FloatArray, *, oriented: bool = True) -> Path:
    columns = ["time_s", "x_mm", "y_mm", "z_mm", *(["qx", "qy", "qz", "qw"] if oriented else []), "u_position_mm", "u_rotation_deg"]
    values = np.column_stack([time_s, poses if oriented else poses[:, :3], np.full((len(poses), 2), [0.01, 0.001])])
    np.savetxt(path, values, delimiter=",", header=",".join(columns), comments="", fmt="%.15g")
    return path


def codes(got: MeasurementFile) -> list[tuple[str, str]]:
    return [(note.code, note.of) for note in got.notes if note.said.code != "orientation.read"]


def test_rests_in_order_by_time_and_with_some_missing(tmp_path: Path) -> None:
    joints, time_s, poses, way = motion()
    there = trajectory(tmp_path / "t.csv", time_s, poses)
    ends = time_s[0] + np.arange(12) * (REST_S + MOVE_S) + 0.5 * REST_S
    everything = read_robot_measurements(there, table(tmp_path / "all.csv", joints), ROBOT, Stated())
    assert everything.rows.names == tuple(f"P{i + 1}" for i in range(12))
    assert [code for code, _ in codes(everything)] == ["rests"]
    assert everything.rows.covariance[0, 3, 3] == pytest.approx(1e-4)
    found = identify(ROBOT, everything.rows, Settings(("links",)))
    assert np.linalg.norm(found.nominal_errors_mm(), axis=1).max() < 0.01
    # a log of the controller, with times and no names
    log = read_robot_measurements(
        there, table(tmp_path / "log.csv", way[::3], names=[""] * len(way[::3]), time_s=time_s[::3]), ROBOT, Stated()
    )
    assert log.rows.joints == pytest.approx(joints, abs=1e-9)
    # times of commands, some time before the robot came to rest
    few = [0, 1, 2, 4, 5, 7, 8, 9, 10, 11]
    sparse = read_robot_measurements(there, table(tmp_path / "few.csv", joints[few], time_s=ends[few] - 0.35), ROBOT, Stated())
    assert sparse.rows.joints == pytest.approx(joints[few])
    assert [round(float(of.split()[0])) for code, of in codes(sparse) if code == "unmatched"] == [3, 6]
    # no times: rests without a row and rows without a rest are told by the angles between them
    stranger = np.insert(joints[few], 6, np.radians([60.0, -90.0, 10.0, 80.0, -20.0, 0.0]), axis=0)
    names = [f"P{i + 1}" for i in few]
    lost = read_robot_measurements(there, table(tmp_path / "lost.csv", stranger, names=[*names[:6], "never", *names[6:]]), ROBOT, Stated())
    assert lost.rows.names == tuple(names)
    assert [of for code, of in codes(lost) if code == "unmatched"][2:] == ["never"]
    assert {note.said.text("ru")[:3] for note in lost.notes} == {"ори", "ост", "стр"}


def test_places_alone_ask_for_times_where_numbers_differ(tmp_path: Path) -> None:
    joints, time_s, poses, _ = motion()
    there = trajectory(tmp_path / "t.csv", time_s, poses, oriented=False)
    assert len(read_robot_measurements(there, table(tmp_path / "all.csv", joints), ROBOT, Stated()).rows) == 12
    with pytest.raises(LMeasureError, match=r"has 11 rows, but the trajectory has 12 rests without orientations, .* Add a column time_s"):
        read_robot_measurements(there, table(tmp_path / "some.csv", joints[1:]), ROBOT, Stated())
    with pytest.raises(LMeasureError, match="State the joint values at its rests with --joints FILE"):
        read_robot_measurements(Path("t.tum"), None, ROBOT, Stated())
    with pytest.raises(LMeasureError, match=r"late.csv: only 0 of 12 rests of the trajectory belong to one of its 12 rows. .* times"):
        read_robot_measurements(there, table(tmp_path / "late.csv", joints, time_s=1e3 + np.arange(12.0)), ROBOT, Stated())
    with pytest.raises(LMeasureError, match="its time is before that of the row before"):
        read_robot_measurements(there, table(tmp_path / "back.csv", joints, time_s=-np.arange(12.0)), ROBOT, Stated())


def test_an_alignment_is_the_best_of_all_by_brute_force() -> None:
    rng = np.random.default_rng(5)
    flange = np.column_stack([rng.uniform(-300, 300, (6, 3)), Rotation.random(6, rng=rng).as_quat()])
    seen = se3.compose(np.array([500.0, 1, 2, *Rotation.random(rng=rng).as_quat()]), flange[[0, 2, 3, 5]])
    assert aligned(seen, flange).tolist() == [[0, 0], [1, 2], [2, 3], [3, 5]]
    assert aligned(flange, flange[1:]).tolist() == [[1, 0], [2, 1], [3, 2], [4, 3], [5, 4]]


def test_a_run_keeps_what_its_rests_share_apart(tmp_path: Path) -> None:
    joints, time_s, poses, _ = motion()
    run = tmp_path / "run"
    run.mkdir()
    rig = read_rig(CELL)
    (run / "rig.toml").write_bytes(CELL.read_bytes())
    counts = np.round(counts_from_poses(rig, poses, poses[0]))
    head = ["time_s", *(c.channel for c in rig.cable)]
    rows = [f"{t:.6f},{','.join(str(int(v)) for v in row)}" for t, row in zip(time_s, counts, strict=True)]
    (run / "pass1.csv").write_text("\n".join([",".join(head), *rows]) + "\n", encoding="utf-8")
    start = '[start]\nposition_mm = [0.0, 0.0, 0.0]\nquaternion_xyzw = [0.0, 0.0, 0.0, 1.0]\n[[pass]]\ncounts = "pass1.csv"\n'
    (run / "run.toml").write_text('schema = "lmeasure.run/1"\nrig = "rig.toml"\n' + start, encoding="utf-8")
    got = read_robot_measurements(run, table(tmp_path / "joints.csv", joints), ROBOT, Stated())
    assert len(got.rows) == 12
    shared = got.rows.systematic
    assert shared.shape == (12, 6, 7)  # where each drum was zeroed, at a start of a typical size, and the temperature that nobody stated
    own = np.sqrt(np.einsum("nii->ni", got.rows.covariance)[:, 3:])
    assert 0.0 < own.max() < 0.02
    found = identify(ROBOT, got.rows)
    assert np.linalg.norm(found.errors_mm(), axis=1).max() < 0.02
    # what all have in common is known less well than what each has for itself, and is no unknown that is asked for
    unknowns = found.fit.problem.unknowns
    assert len(unknowns) - unknowns.asked == 7
    z = found.fit.x[unknowns.asked :]
    assert np.abs(z).max() < 3.0


MARKERS = np.array([[0.0, 0, 0], [80, 0, 0], [0, 60, 0], [30, 20, 50], [-40, 10, 20]])
LABELS = ["A", "B", "C", "D", "E"]


def marked(path: Path, places: FloatArray, *, rate: float = RATE, missing: str = "") -> Path:
    n = len(places)
    head = ["NO_OF_CAMERAS\t8", f"NO_OF_MARKERS\t{len(LABELS)}", f"FREQUENCY\t{rate:g}", "NO_OF_ANALOG\t0", "DESCRIPTION\t--"]
    head += ["TIME_STAMP\t2024-05-06, 10:11:12.131\t1234.5", "DATA_INCLUDED\t3D", "MARKER_NAMES\t" + "\t".join(LABELS)]
    head = [f"NO_OF_FRAMES\t{n}", *head, "Frame\tTime\t" + "\t".join(f"{m} {a}" for m in LABELS for a in "XYZ")]
    lines = [
        "\t".join([str(i + 1), f"{i / rate:.5f}", *(missing if np.isnan(v) else f"{v:.4f}" for v in row.reshape(-1))])
        for i, row in enumerate(places)
    ]
    path.write_text("\r\n".join([*head, *lines]) + "\r\n", encoding="utf-8")
    return path


def body_places(poses: FloatArray, rng: np.random.Generator, u_mm: float = 0.1) -> FloatArray:
    turn = se3.matrices(poses)
    there = np.einsum("nij,mj->nmi", turn, MARKERS) + poses[:, None, :3]
    return there + u_mm * rng.normal(size=there.shape)


def test_markers_are_a_body_with_the_uncertainty_that_they_scatter_by(tmp_path: Path) -> None:
    _, _, poses, _ = motion(8)
    rng = np.random.default_rng(1)
    places = body_places(poses, rng)
    clean = body_of(read_markers(marked(tmp_path / "clean.tsv", places)), tmp_path / "clean.tsv")
    assert clean.u_marker_mm == pytest.approx(0.1, rel=0.05)
    assert [note.code for note in clean.notes] == ["markers.body"]
    # the motion from frame to frame is the true one, within what is stated of it
    relative = se3.rotation(clean.poses) * se3.rotation(poses).inv()
    error = (relative * relative.mean().inv()).as_rotvec()
    square = np.einsum("ni,nij,nj->n", error, np.linalg.inv(clean.covariance[:, :3, :3]), error)
    assert square.mean() == pytest.approx(3.0, rel=0.15)
    middle = poses[:, :3] + se3.rotation(poses).apply(MARKERS.mean(axis=0))
    off = clean.poses[:, :3] - middle
    assert off.std(axis=0) == pytest.approx(np.sqrt(np.einsum("nii->ni", clean.covariance)[:, 3:].mean(axis=0)), rel=0.1)
    # missing ones, swapped labels, one that lies off: told, and the poses hardly move
    spoilt = places.copy()
    spoilt[50:80, 1] = np.nan
    spoilt[100:130, [0, 3]] = spoilt[100:130, [3, 0]]
    spoilt[200:205, 2] += [5.0, -3.0, 4.0]
    spoilt[300, :3] = np.nan
    path = marked(tmp_path / "spoilt.tsv", spoilt)
    body = body_of(read_markers(path), path)
    said = [str(note) for note in body.notes]
    assert "markers A and D are swapped in 30 frames, the first at 1 s (line 111). This is corrected" in said
    assert "marker C is off the body in 5 frames, the first at 2 s (line 211). It is not used there" in said
    assert f"marker B is missing in 31 of {len(poses)} frames" in said
    assert np.flatnonzero(np.isnan(body.poses[:, 0])).tolist() == [300]
    there = ~np.isnan(body.poses[:, 0])
    assert np.abs(body.poses[there, :3] - clean.poses[there, :3]).max() < 0.5
    assert body.covariance[60, 3, 3] > body.covariance[40, 3, 3]


def test_markers_of_a_robot_at_its_rests(tmp_path: Path) -> None:
    joints, _, poses, _ = motion()
    path = marked(tmp_path / "m.tsv", body_places(poses, np.random.default_rng(2), 0.02))
    got = read_robot_measurements(path, table(tmp_path / "j.csv", joints), ROBOT, Stated())
    assert got.rows.stated == (True, True)
    found = identify(ROBOT, got.rows)
    assert np.linalg.norm(found.nominal_errors_mm(), axis=1).max() < 0.05
    assert "A marker's coordinate scatters by" in " ".join(note.text for note in got.notes)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("NO_OF_FRAMES\t1\nFREQUENCY\t10\n1\t2\t3\n", "has no MARKER_NAMES"),
        ("NO_OF_FRAMES\t1\nFREQUENCY\t10\nDATA_INCLUDED\t6D\nMARKER_NAMES\tA\tB\tC\n", "Export the positions of the markers"),
        ("NO_OF_FRAMES\t1\nMARKER_NAMES\tA\tB\tC\n" + "1\t" * 8 + "1\n", "neither columns Frame and Time nor a FREQUENCY"),
        ("NO_OF_FRAMES\t1\nFREQUENCY\t10\nMARKER_NAMES\tA\tB\tC\n" + "1\t" * 8 + "x\n", "line 4: 'x' is no number"),
        ("NO_OF_FRAMES\t1\nFREQUENCY\t10\nMARKER_NAMES\tA\tB\tC\n" + "1\t" * 9 + "1\n", "line 4: has 10 cells, but 3 markers need 9"),
        ("NO_OF_FRAMES\t1\nFREQUENCY\t10\nMARKER_NAMES\tA\tB\n" + "1\t2\t3\t4\t5\t6\n", "no frame shows 3 of its markers"),
        ("NO_OF_FRAMES\t1\nFREQUENCY\t10\nMARKER_NAMES\tA\tB\tC\n" + "1\t1\t1\t2\t2\t2\t3\t3\t3\n" * 3, "are on one line"),
        ("PathFileType\t4\t(X/Y/Z)\ta.trc\nRate\tUnits\n1\tft\nFrame#\tTime\tA\n\t\tX1\n1\t0\t1\n", "Units 'ft' is none of mm, cm, m"),
    ],
)
def test_markers_that_cannot_be_read_are_named(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "m.tsv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(LMeasureError, match=said):
        read_trajectory(path)


def test_markers_in_metres_of_a_trc(tmp_path: Path) -> None:
    _, _, poses, _ = motion(4)
    places = body_places(poses, np.random.default_rng(2), 0.02) / 1e3
    head = ["PathFileType\t4\t(X/Y/Z)\ta.trc", "DataRate\tNumMarkers\tUnits", "100\t5\tm"]
    head += ["Frame#\tTime\t" + "\t\t\t".join(LABELS), "\t\t" + "\t".join(f"{a}{i + 1}" for i in range(5) for a in "XYZ")]
    rows = ["\t".join([str(i), f"{i / RATE:.4f}", *(f"{v:.7f}" for v in row.reshape(-1))]) for i, row in enumerate(places)]
    path = tmp_path / "a.trc"
    path.write_text("\n".join([*head, *rows]) + "\n", encoding="utf-8")
    read = read_trajectory(path)
    assert np.linalg.norm(read.poses[-1, :3] - read.poses[0, :3]) == pytest.approx(
        np.linalg.norm(
            poses[-1, :3] + se3.rotation(poses[-1]).apply(MARKERS.mean(axis=0)) - se3.rotation(poses[0]).apply(MARKERS.mean(axis=0))
        ),
        abs=0.1,
    )


def test_points_of_a_tracker_find_their_joint_values_by_name(tmp_path: Path) -> None:
    joints, _, poses, _ = motion()
    places = poses[[int(k * (REST_S + MOVE_S) * RATE + 10) for k in range(12)], :3]
    lines = ["// exported points", "Collection::Group;Point;X [in];Y [in];Z [in]"]
    order = [3, 0, 1, 2, *range(4, 12)]
    lines += [f"A::Main;P{i + 1};" + ";".join(f"{v / 25.4:.6f}".replace(".", ",") for v in places[i]) for i in order]
    path = tmp_path / "points.csv"
    path.write_bytes(("\r\n".join([*lines, "A::Main;P99;1,0;2,0;3,0"]) + "\r\n").encode("cp1252"))
    got = read_robot_measurements(
        path, table(tmp_path / "j.csv", joints[:11]), ROBOT, Stated(columns_of("name=Point,x=X [in][in],y=Y [in][in],z=Z [in][in]"))
    )
    assert got.rows.names == tuple(f"P{i + 1}" for i in range(11))
    assert got.rows.position == pytest.approx(places[:11], abs=1e-4)
    assert sorted(of for code, of in codes(got) if code == "unmatched") == ["P12", "P99"]
    with pytest.raises(LMeasureError, match="name 'P1' is given 2 times"):
        read_robot_measurements(
            path, table(tmp_path / "twice.csv", joints[:2], names=["P1", "P1"]), ROBOT, Stated(columns_of("name=Point"))
        )
