"""`lmeasure structure`: what it writes, and what it refuses in one line."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import typer
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from lmeasure.api import zone
from lmeasure.cli.app import main
from lmeasure.cli.commands import command
from lmeasure.core import FloatArray, se3
from lmeasure.linkages import closed_form, singularity
from lmeasure.robots import Robot, any_shipped, write_robot

TRUTH = Path(__file__).parents[1] / "authorities" / "truth"
BASE = {"B1": (1, 5, 0), "B2": (3, 3, 0), "B3": (4, 2, 0), "B4": (1, 1, 0)}
PLATFORM = {"P1": (0, 0, 0), "P2": (1, 2, 0), "P3": (-2, 2, 0), "P4": (0, 4, 0)}
LINKS = [("B2", "P1", 10.0), ("B3", "P1", 10.5), ("B4", "P1", 11.0), ("B1", "P4", 8.9), ("B1", "P3", 7.98), ("B3", "P2", 9.9)]


def text(links: list[tuple[str, str, float]], lengths: bool = True) -> str:
    """A structure file of the thesis' example."""
    points = [
        f"[{side}]\n" + "".join(f"{n} = {list(map(float, p))}\n" for n, p in of.items())
        for side, of in (("base", BASE), ("platform", PLATFORM))
    ]
    each = [f'[[link]]\nfrom = "{b}"\nto = "{p}"\n' + (f"length_mm = {length}\n" if lengths else "") for b, p, length in links]
    return "\n".join(['schema = "lmeasure.structure/1"', *points, *each])


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):  # type: ignore[no-untyped-def]
    """The command in a folder of its own: exit code, output, errors."""
    monkeypatch.chdir(tmp_path)

    def command(*words: str) -> tuple[int, str, str]:
        monkeypatch.setattr("sys.argv", ["lmeasure", "structure", *words])
        with pytest.raises(SystemExit) as end:
            main()
        printed = capsys.readouterr()
        return int(end.value.code or 0), printed.out, printed.err

    return command


def test_the_example_of_4_1_is_written(run, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    (tmp_path / "s.toml").write_text(text(LINKS))
    code, out, _ = run("s.toml", "--out", "s.json", "--position-mm", "2.5625,6.6875,9.285", "--quaternion", "0,0,0,1")
    assert code == 0
    record = json.loads((tmp_path / "s.json").read_text())
    assert (record["class"], record["freedoms"], record["closed_form"], record["complex_assemblies"]) == ("L-3111-2211", 6, True, 8)
    assert (record["degenerate"], record["architecturally_singular"], record["status"]) == (False, False, "all accounted for")
    assert len(record["assemblies"]) == 8
    assert all(one["certified"] for one in record["assemblies"])
    assert (record["rank"], len(record["gradient"]), len(record["pressure_angles_deg"])) == (6, 6, 6)
    assert "8 real assembly modes, 8 with complex ones of 8: all accounted for" in out


def test_without_lengths_or_a_pose_only_the_structure_is_reported(run, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    (tmp_path / "s.toml").write_text(text(LINKS, lengths=False))
    assert run("s.toml", "--out", "s.json")[0] == 0
    assert not {"assemblies", "status", "determinant"} & set(json.loads((tmp_path / "s.json").read_text()))


def test_a_singular_pose_has_its_measures(run, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    """The three columns of 4.5: the gradient is (0, 0, 6.5; 0, 0, 0)."""
    base = {"B1": (0, -1, -1.6), "B2": (1, 0, -1.6), "B3": (0, 1, -1.6), "B4": (0, -2.6, 0), "B5": (2.6, 0, 0), "B6": (0, 2.6, 0)}
    points = "[base]\n" + "".join(f"{n} = {list(map(float, p))}\n" for n, p in base.items())
    points += "[platform]\nP1 = [0.0, -1.0, 0.0]\nP2 = [1.0, 0.0, 0.0]\nP3 = [0.0, 1.0, 0.0]\n"
    links = "".join(f'[[link]]\nfrom = "B{i + 1}"\nto = "P{i % 3 + 1}"\n' for i in range(6))
    (tmp_path / "s.toml").write_text('schema = "lmeasure.structure/1"\n' + points + links)
    assert run("s.toml", "--out", "s.json", "--position-mm", "0,0,0")[0] == 0
    record = json.loads((tmp_path / "s.json").read_text())
    assert (record["class"], record["rank"], record["condition"]) == ("L-222-111111", 5, None)
    assert record["gradient"] == pytest.approx([0, 0, 6.5, 0, 0, 0], abs=1e-12)
    assert record["determinant"] == pytest.approx(0.0, abs=1e-12)


def test_a_rig_is_read_as_straight_links(run, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    assert run(str(TRUTH / "cell-run" / "rig.toml"), "--out", "s.json")[0] == 0
    assert json.loads((tmp_path / "s.json").read_text())["class"] == "L-222-111111"


def test_the_list_has_every_structure(run, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    code, out, _ = run("--list", "--out", "l.json")
    every = json.loads((tmp_path / "l.json").read_text())
    assert (code, len(every), len(out.splitlines())) == (0, 60, 61)  # and the command to type next
    assert all({"notation", "class", "closed_form", "complex_assemblies", "degenerate"} <= set(s) for s in every)
    assert [s["notation"] for s in every if s["degenerate"]] == ["L-3111-3111:bcd-a-a-a"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t.replace('from = "B2"', 'from = "B7"'), "s.toml: link 1: the base has no point 'B7'. It has B1, B2, B3, B4"),
        (lambda t: t.replace("length_mm = 10.5\n", ""), "s.toml: link 2: length_mm is missing. All links have it or none"),
        (lambda t: t.replace("length_mm = 10.5", "length_mm = -1.0"), "length_mm: must be positive"),
        (lambda t: t[: t.rindex("[[link]]")], "s.toml: has 5 links. A pose needs 6"),
        (lambda t: t.replace("length_mm = 10.5", "length = 10.5"), "unknown key 'length'"),
        (lambda t: t.replace("structure/1", "structure/9"), "schema: must be 'lmeasure.structure/1'"),
        (lambda t: "x = ", "s.toml"),
    ],
)
def test_a_file_that_is_wrong_is_one_line(run, tmp_path: Path, change, words: str) -> None:  # type: ignore[no-untyped-def]
    (tmp_path / "s.toml").write_text(change(text(LINKS)))
    code, _, err = run("s.toml", "--out", "s.json")
    assert (code, err.count("\n")) == (1, 1)
    assert words in err
    assert not (tmp_path / "s.json").exists()


@pytest.mark.parametrize(
    "words",
    [
        [], ["s.toml", "--list"], ["--list", "--position-mm", "0,0,0"], ["s.toml", "--quaternion", "0,0,0,1"],
        ["s.toml", "--position-mm", "1,2"], ["s.toml", "--to-mm", "1,2,3"], ["s.toml", "--boundary", "xz"],
        ["s.toml", "--position-mm", "1,2,3", "--levels", "0:1:1"],
        ["s.toml", "--position-mm", "1,2,3", "--boundary", "xz", "--levels", "1:0:1"],
        ["s.toml", "--position-mm", "1,2,3", "--boundary", "zx"], ["--list", "--design"], ["--list", "--lengths-mm", "1,2,3,4,5,6"],
    ],
)  # fmt: skip
def test_wrong_use_has_exit_code_2(run, tmp_path: Path, words: list[str]) -> None:  # type: ignore[no-untyped-def]
    (tmp_path / "s.toml").write_text(text(LINKS))
    assert run(*words)[0] == 2


def test_a_pose_that_is_none_is_refused(run, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    (tmp_path / "s.toml").write_text(text(LINKS))
    assert run("s.toml", "--position-mm", "0,0,0", "--quaternion", "0,0,0,2")[0] == 2
    code, _, said = run("s.toml", "--position-mm", "3,3,0")
    assert (code, "a link has no length at this pose" in said) == (1, True)


def test_a_rig_that_is_singular_everywhere_has_no_assemblies(run, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    """Similar regular hexagons: lengths fit a whole motion, or nothing."""
    corners = [(2, 0), (1, 2), (-1, 2), (-2, 0), (-1, -2), (1, -2)]
    points = []
    for side, size in (("base", 300.0), ("platform", 100.0)):
        points.append(
            f"[{side}]\n" + "".join(f"{side[0]}{i} = {[size * x, size * y * 0.75**0.5, 0.0]}\n" for i, (x, y) in enumerate(corners))
        )
    links = "".join(f'[[link]]\nfrom = "b{i}"\nto = "p{i}"\nlength_mm = 700.0\n' for i in range(6))
    (tmp_path / "s.toml").write_text('schema = "lmeasure.structure/1"\n' + "".join(points) + links)
    code, out, _ = run("s.toml", "--out", "s.json")
    record = json.loads((tmp_path / "s.json").read_text())
    assert (code, record["architecturally_singular"], record["degenerate"]) == (0, True, False)
    assert (record["assemblies"], record["status"]) == ([], "not proved")
    assert "singular at every pose: base and platform are similar plane figures on conics that map onto each other" in out


def random_file(
    rng: np.random.Generator, links: int = 6, shared: bool = True
) -> tuple[str, FloatArray, FloatArray, FloatArray, FloatArray]:
    """A file as a stranger writes it: points under any names, in any order, some without a link and two names for one place; with the
    lengths of a pose. The text, base and platform points of its links, lengths, and the pose."""
    count = rng.integers(3, 7, size=2) if shared else np.array([links, links])
    while True:
        ends = np.column_stack([rng.integers(0, n, links) if shared else rng.permutation(n) for n in count])
        if len(np.unique(ends, axis=0)) == links and min(len(np.unique(ends[:, i])) for i in (0, 1)) >= 3:
            break
    points = [rng.normal(size=(n, 3)).round(3) * size for n, size in zip(count, (400.0, 120.0), strict=True)]
    pose = se3.pose(100.0 * rng.normal(size=3), Rotation.random(rng=rng))
    base, platform = points[0][ends[:, 0]], points[1][ends[:, 1]]
    lengths = np.linalg.norm(se3.apply(pose, platform) - base, axis=1)
    names = [[f"{side} {chr(97 + int(i))}" for i in rng.permutation(int(n))] for side, n in zip(("Basis.", "π "), count, strict=True)]
    text = 'schema = "lmeasure.structure/1"\n'
    for side, own, at in (("base", *(names[0], points[0])), ("platform", *(names[1], points[1]))):
        text += f"[{side}]\n" + "".join(f'"{own[i]}" = {at[i].tolist()}\n' for i in rng.permutation(len(own)))
        text += '"no link" = [7.0, 7.0, 7.0]\n' + f'"again" = {at[ends[0, 0 if side == "base" else 1]].tolist()}\n'
    for i, (b, p) in enumerate(ends):
        text += "[[link]]\n" + f'from = "{"again" if i == 0 else names[0][b]}"\nto = "{names[1][p]}"\nlength_mm = {float(lengths[i])!r}\n'
    return text, base, platform, lengths, pose


@pytest.mark.parametrize("seed", range(2))
def test_files_of_strangers_against_brute_force(run, tmp_path: Path, seed: int) -> None:  # type: ignore[no-untyped-def]
    """Class by counting, assemblies against SciPy from many starts, determinant, gradient and pressure angles from their definitions."""
    rng = np.random.default_rng(seed)
    text, base, platform, lengths, pose = random_file(rng)
    (tmp_path / "s.toml").write_text(text)
    there = ["--position-mm=" + ",".join(map(repr, pose[:3].tolist())), "--quaternion=" + ",".join(map(repr, pose[3:].tolist()))]
    assert run("s.toml", "--out", "s.json", *there)[::2] == (0, "")
    record = json.loads((tmp_path / "s.json").read_text())
    degrees = ["".join(map(str, sorted(np.unique(p, axis=0, return_counts=True)[1], reverse=True))) for p in (platform, base)]
    assert record["class"] == f"L-{degrees[0]}-{degrees[1]}"
    if record["architecturally_singular"]:
        assert record["rank"] < 6
        return

    def missed(x: FloatArray) -> FloatArray:
        return np.linalg.norm(Rotation.from_rotvec(x[:3]).apply(platform) + x[3:] - base, axis=1) - lengths

    found = np.array([one["position_mm"] + one["quaternion_xyzw"] for one in record["assemblies"]])
    assert np.abs(np.linalg.norm(se3.apply(found[:, None], platform) - base, axis=2) - lengths).max() < 1e-9
    for _ in range(12):
        near = np.concatenate([Rotation.random(rng=rng).as_rotvec(), 200.0 * rng.normal(size=3)])
        end = least_squares(missed, near, xtol=1e-14, ftol=1e-14, gtol=1e-14)
        if np.abs(end.fun).max() < 1e-9:
            other = np.concatenate([end.x[3:], Rotation.from_rotvec(end.x[:3]).as_quat()])
            assert np.abs(se3.displacement(found, other) * np.repeat([100.0, 1.0], 3)).max(axis=1).min() < 1e-3
    points = se3.apply(pose, platform)
    e = (points - base) / np.linalg.norm(points - base, axis=1, keepdims=True)
    M = np.hstack([e, np.cross(base, e)])
    assert record["determinant"] == pytest.approx(np.linalg.det(M), rel=1e-9)
    twists = np.linalg.inv(np.hstack([np.cross(base, e), e])).T
    v = twists[:, 3:] + np.cross(twists[:, :3], points)
    angles = np.degrees(np.arccos(np.abs((v * e).sum(axis=1)) / np.linalg.norm(v, axis=1)))
    np.testing.assert_allclose(record["pressure_angles_deg"], angles, atol=1e-5)

    def determinant(twist: FloatArray) -> float:
        turned = Rotation.from_rotvec(twist[:3]).apply(points) + twist[3:]
        e = (turned - base) / np.linalg.norm(turned - base, axis=1, keepdims=True)
        return float(np.linalg.det(np.hstack([e, np.cross(base, e)])))

    steps = np.repeat([1e-5, 1e-3], 3)
    slopes = [(determinant(h * axis) - determinant(-h * axis)) / (2.0 * h) for h, axis in zip(steps, np.eye(6), strict=True)]
    np.testing.assert_allclose(record["gradient"], slopes, rtol=1e-5, atol=1e-6 * np.abs(slopes).max())


@pytest.mark.parametrize("links", [7, 8])
def test_redundant_links_leave_one_assembly(run, tmp_path: Path, links: int) -> None:  # type: ignore[no-untyped-def]
    text, _, _, lengths, pose = random_file(np.random.default_rng(links), links, shared=False)
    (tmp_path / "s.toml").write_text(text)
    assert run("s.toml", "--out", "s.json", "--position-mm=" + ",".join(map(repr, pose[:3].tolist())))[0] == 0
    record = json.loads((tmp_path / "s.json").read_text())
    assert (record["freedoms"], record["redundant"], record["status"], len(record["assemblies"])) == (6, links - 6, "all accounted for", 1)
    assert record["assemblies"][0]["position_mm"] == pytest.approx(pose[:3].tolist(), abs=1e-6)
    assert record["assemblies"][0]["misses_mm"] < 1e-9
    assert (record["determinant"], len(record["pressure_angles_deg"])) == (None, links)
    # one length 30 mm off fits nothing within half a millimetre
    wrong = ",".join(map(repr, (lengths + 30.0 * np.eye(links)[0]).tolist()))
    code, out, _ = run("s.toml", "--lengths-mm", wrong)
    assert (code, "0 real assembly modes close all links within 0.5 mm" in out) == (0, True)


def test_cables_over_pulleys_are_found_from_their_lengths(run, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    """The pose from which a rig's lengths come is among their assemblies, and the figures at it are those of `zone`."""
    rig = str(TRUTH / "cell-run" / "rig.toml")
    assert run(rig, "--out", "p.json", "--position-mm", "40,-30,60")[0] == 0
    at = json.loads((tmp_path / "p.json").read_text())
    lengths = ",".join(map(repr, at["wrapped"]["lengths_mm"]))
    code, out, _ = run(rig, "--out", "s.json", "--lengths-mm", lengths)
    record = json.loads((tmp_path / "s.json").read_text())
    assert (code, record["status"], "with pulleys, from straight cables and from many starts" in out) == (0, "not proved", True)
    assert min(np.abs(np.array(one["position_mm"]) - (40, -30, 60)).max() for one in record["assemblies"]) < 1e-6
    assert len(record["assemblies"]) == 1 + len(at["other_assemblies"])
    data = zone(rig, x=(40, 40, 1), y=(-30, -30, 1), z=(60, 60, 1))
    assert at["wrapped"]["u95_position_mm"] == pytest.approx(float(data["u95_position_mm"].values[0, 0, 0]), rel=1e-3)
    assert at["wrapped"]["worst_pressure_angle_deg"] == pytest.approx(float(data["worst_pressure_angle_deg"].values[0, 0, 0]), abs=1e-6)


def test_a_way_a_boundary_a_page_and_a_recording(run, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    (tmp_path / "s.toml").write_text(text(LINKS))
    words = ["--position-mm", "2.5625,6.6875,9.285", "--to-mm", "2.5,6,-9", "--boundary", "xz", "--levels", "4:12:4", "--limit-deg", "85"]
    code, out, _ = run("s.toml", *words, "--reach-mm", "30", "--out", "s.json", "--report", "page", "--rerun", "s.rrd")
    assert out.splitlines()[-2] == f"written: {Path('page') / 'structure.html'}"
    record = json.loads((tmp_path / "s.json").read_text())
    assert (code, [p["closed"] for p in record["boundary"]["slices"]]) == (0, [True, True])
    assert "boundary at y = 12 mm: no position of the window is within the limits" in out
    (share,) = record["way"]["singular_at_share"]
    near = [d for s, d in zip(record["way"]["share"], record["way"]["determinant"], strict=True) if abs(s - share) < 0.01]
    assert min(near) < 0.0 < max(near)
    page = (tmp_path / "page" / "structure.html").read_text()
    assert all(word in page for word in ("Drag to turn", "On the path", "Boundary of the workspace", "Assembly modes", "tetrahedron 3"))
    assert (tmp_path / "s.rrd").stat().st_size > 10_000
    code, out, _ = run("--list", "--report", "all")
    assert (code, out.splitlines()[-2]) == (0, f"written: {Path('all') / 'structure.html'}")
    assert (tmp_path / "all" / "structure.html").read_text().count("<svg") == 61  # every one, and the first above all


def test_limits_are_cut_until_nothing_is_singular(run, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    """4.2 with its sides: the limits printed there are not free of singular poses, those found are."""
    base, platform = ({"B1": (0.0, 0.0, 0.0), "B2": (1.5, 0.0, 0.0)}, {"P1": (0.0, 0.0, 0.0), "P2": (1.5, 0.0, 0.0)})
    # B3 and P3 from their distances: 2.4 and 2.4, 1.25 and 1.25
    base["B3"], platform["P3"] = (0.75, float(np.sqrt(2.4**2 - 0.75**2)), 0.0), (0.75, 1.0, 0.0)
    links = [("B1", "P1", 3.0, 3.5), ("B2", "P1", 3.0, 3.5), ("B3", "P1", 4.5, 5.0), ("B2", "P2", 3.5, 4.0), ("B3", "P2", 3.5, 4.0)]
    links.append(("B3", "P3", 3.5, 4.0))
    parts = ['schema = "lmeasure.structure/1"']
    parts += [
        f"[{side}]\n" + "".join(f"{n} = {list(map(float, p))}\n" for n, p in of.items())
        for side, of in (("base", base), ("platform", platform))
    ]
    parts += [f'[[link]]\nfrom = "{b}"\nto = "{p}"\nlimits_mm = [{low}, {high}]' for b, p, low, high in links]
    (tmp_path / "s.toml").write_text("\n".join(parts))
    code, out, _ = run("s.toml", "--design", "--out", "s.json")
    made = json.loads((tmp_path / "s.json").read_text())["design"]
    assert (code, made["clear_as_given"]) == (0, [True, False, False])
    assert "within these limits, no pose is singular and every length can be assembled" in out
    # tried at random: whatever is drawn within the limits can be assembled, far from singular
    rng = np.random.default_rng(0)
    low, high = np.array(list(made["free"].values())).T
    of = np.array([platform[p] for _, p, *_ in links]), np.array([base[b] for b, *_ in links])
    drawn = rng.uniform(low, high, (50, 6))
    poses, closes = closed_form(of[1], of[0], drawn)
    assert closes.all()
    assert np.abs(singularity.determinants(of[1], of[0], poses)).min() > 1e-3
    (tmp_path / "s.toml").write_text(text(LINKS))
    assert "the links have no limits_mm" in run("s.toml", "--design")[2]


@pytest.mark.parametrize("name", ["logos", "rotopod-cell", "gough"])
def test_platforms_of_robots_are_structures(name: str, run, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    """Hexapods, and a rotopod whose carriages stand: home is among the poses that their lengths allow."""
    robot = any_shipped(name)
    assert not isinstance(robot, Robot)
    write_robot(tmp_path / "robot.toml", robot)
    assert run("robot.toml", "--out", "s.json")[0] == 0
    record = json.loads((tmp_path / "s.json").read_text())
    places = np.array([one["position_mm"] for one in record["assemblies"]])
    assert len(places) >= 2
    assert np.abs(places - robot.model.home[:3]).max(axis=1).min() < 1e-5


def test_a_robot_that_is_not_held_by_six_lengths_is_no_structure(run, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    for name in ("four-chains", "ur5"):
        write_robot(tmp_path / "robot.toml", any_shipped(name))
        code, _, said = run("robot.toml")
        assert code == 1
        assert f"robot.toml: robot '{name}' is not held by six lengths" in said


def test_the_page_that_help_names_has_the_format() -> None:
    (named,) = [str(o.help) for o in command("structure").params if isinstance(o, typer.core.TyperArgument)]
    page = re.search(r"\((docs/\S+\.md)\)", named)
    assert page is not None
    assert '"lmeasure.structure/1"' in (Path(__file__).parents[2] / page[1]).read_text(encoding="utf-8")
