"""Maps of errors: kriging beside its dense equations, points left out beside leaving them out, coverage, and programs corrected by one."""

import json
from pathlib import Path

import numpy as np
import pytest
from in_process import code_and_text, ran
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, RobotError, se3
from lmeasure.robots import error_map, identify_with_choice, predict
from lmeasure.robots.correction.error_map import NUGGET, Process, _affine, _apart, _covariance, inside
from lmeasure.robots.identification.measurements import measured
from lmeasure.robots.robot import shipped
from lmeasure.robots.serial import SerialRobot

HALF_MM, TILT_RAD, NOISE_MM = 250.0, 0.25, 0.02
NEAR = np.radians([0.0, 10.0, 10.0, 0.0, 60.0, 0.0])
MIDDLE = shipped("generic6").model.forward(NEAR[None])[0]


def poses_of(rng: np.random.Generator, count: int, part: float = 1.0) -> FloatArray:
    moves = np.column_stack([rng.uniform(-TILT_RAD, TILT_RAD, (count, 3)), rng.uniform(-HALF_MM, HALF_MM, (count, 3))])
    return np.asarray(se3.displaced(MIDDLE, part * moves))


def built(rng: np.random.Generator) -> SerialRobot:
    nominal = shipped("generic6").model
    size = np.array([0.3 if p.unit == "mm" else 5e-4 for p in nominal.parameters])
    ends = ("theta_deg", "d_mm", "a_mm", "alpha_deg", "beta_deg")
    links = np.array([p.name.rpartition(".")[2] in ends for p in nominal.parameters])
    return nominal.moved(rng.normal(size=len(size)) * size * links)


def true_errors(robot: SerialRobot, poses: FloatArray) -> FloatArray:
    """(N, 6) of a robot that is told these poses of its flange, on one branch."""
    nominal = shipped("generic6").model
    joints = []
    for pose in poses:
        ways = nominal.inverse(pose)
        joints.append(ways[np.argmin(np.abs(ways - NEAR).max(axis=1))])
    return np.asarray(se3.displacement(robot.forward(np.array(joints)), poses))


def plain_kriging(of: Process, poses: FloatArray, errors: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The best linear unbiased prediction by the dense equations with a multiplier for each function of the trend."""
    n, H = len(poses), _affine(poses, of.poses)
    q = H.shape[1]
    K = _covariance(_apart(poses, poses), of.length_mm, of.angle_rad) + (of.share + NUGGET) * np.eye(n)
    k, h = _covariance(_apart(at, poses), of.length_mm, of.angle_rad), _affine(at, of.poses)
    whole = np.block([[K, H], [H.T, np.zeros((q, q))]])
    weights = np.linalg.solve(whole, np.concatenate([k, h], axis=1).T)
    variance = 1.0 - np.einsum("nm,nm->m", weights, np.concatenate([k, h], axis=1).T)
    return weights[:n].T @ errors, np.sqrt(np.maximum(variance, 0.0))


@pytest.fixture(scope="module")
def sample() -> tuple[SerialRobot, FloatArray, FloatArray]:
    rng = np.random.default_rng(3)
    robot, poses = built(rng), poses_of(rng, 80)
    noise = np.column_stack([rng.normal(0.0, 1e-4, (80, 3)), rng.normal(0.0, NOISE_MM, (80, 3))])
    return robot, poses, true_errors(robot, poses) + noise


def test_predictions_are_those_of_the_dense_equations(sample: tuple[SerialRobot, FloatArray, FloatArray]) -> None:
    _, poses, errors = sample
    found = error_map(poses, errors[:, 3:]).place
    at = poses_of(np.random.default_rng(4), 15, 1.2)
    value, u = found.at(at)
    expected, spread = plain_kriging(found, poses, errors[:, 3:], at)
    np.testing.assert_allclose(value, expected, atol=1e-8)
    np.testing.assert_allclose(u, found.misfit * spread[:, None] * np.sqrt(found.sizes), rtol=1e-5, atol=1e-8)


def test_what_is_left_out_is_what_all_others_predict(sample: tuple[SerialRobot, FloatArray, FloatArray]) -> None:
    _, poses, errors = sample
    found = error_map(poses, errors[:, 3:]).place
    for i in (0, 17, 79):
        others = np.delete(np.arange(80), i)
        expected, spread = plain_kriging(found, poses[others], errors[others, 3:], poses[i : i + 1])
        np.testing.assert_allclose(found.left_out[i], errors[i, 3:] - expected[0], atol=1e-8)
        # a new measurement has its own noise besides
        alone = np.sqrt((spread[0] ** 2 + found.share + NUGGET) * found.sizes)
        np.testing.assert_allclose(found.left_out_u[i], alone, rtol=1e-6)


def test_the_radius_holds_what_it_says() -> None:
    """Five robots, 25 new places of each within the region; the share within U95 is not far from 95 %."""
    within, before, after = [], [], []
    for seed in range(5):
        rng = np.random.default_rng([seed, 9])
        robot, poses, later = built(rng), poses_of(rng, 60), poses_of(rng, 25, 0.8)
        found = error_map(poses, true_errors(robot, poses)[:, 3:] + rng.normal(0.0, NOISE_MM, (60, 3)))
        truth = true_errors(robot, later)[:, 3:]
        off = np.linalg.norm(truth + rng.normal(0.0, NOISE_MM, (25, 3)) - found.errors(later)[:, 3:], axis=1)
        within.append(np.mean(off <= found.u95_mm(later)))
        before.append(np.linalg.norm(truth, axis=1).mean())
        after.append(off.mean())
        assert found.place.noise / found.place.misfit == pytest.approx(NOISE_MM, rel=0.5)
    assert 0.90 <= np.mean(within) <= 0.995
    assert np.mean(after) < 0.08 * np.mean(before)


def test_regions_in_space_in_a_plane_and_on_a_line() -> None:
    rng = np.random.default_rng(0)
    turn = Rotation.random(rng=rng).as_matrix()
    for rank, out in ((3, [0.0, 0.0, 60.0]), (2, [0.0, 0.0, 1.0]), (1, [0.0, 1.0, 0.0])):
        places = rng.uniform(-50.0, 50.0, (40, 3)) * (np.arange(3) < rank)
        for point, expected in (([1.0, 0.5, 0.5], True), (out, False), ([60.0, 0.0, 0.0], False)):
            at = np.array(point) * (1.0 if point is out else np.arange(3) < rank)
            assert inside(places @ turn.T, (at @ turn.T)[None])[0] == expected, (rank, point)
    # corners of a grid are of the region
    grid = np.stack(np.meshgrid(*[np.arange(3.0)] * 3), axis=-1).reshape(-1, 3)
    assert inside(grid, grid).all()


@pytest.mark.parametrize(("count", "text"), [(39, "needs 40 to 4000 points, not 39"), (40, "are at one position")])
def test_what_is_no_map(count: int, text: str) -> None:
    with pytest.raises(RobotError, match=text):
        error_map(np.tile(MIDDLE, (count, 1)), np.zeros((count, 3)))


HEADER = "x_mm,y_mm,z_mm,qx,qy,qz,qw,dx_mm,dy_mm,dz_mm,drx_deg,dry_deg,drz_deg"


def tables(folder: Path, sample: tuple[SerialRobot, FloatArray, FloatArray], targets: FloatArray) -> tuple[Path, Path]:
    _, poses, errors = sample
    rows = np.column_stack([poses, errors[:, 3:], np.degrees(errors[:, :3])])
    (folder / "map.csv").write_text("\n".join([HEADER, *(",".join(f"{v:.10g}" for v in row) for row in rows)]) + "\n")
    lines = [",".join([f"T{i}", *(f"{v:.9f}" for v in row)]) for i, row in enumerate(targets)]
    (folder / "p.csv").write_text("\n".join(["name,x_mm,y_mm,z_mm,qx,qy,qz,qw", *lines]) + "\n")
    return folder / "map.csv", folder / "p.csv"


def test_a_program_is_corrected_where_the_map_reaches(sample: tuple[SerialRobot, FloatArray, FloatArray], tmp_path: Path) -> None:
    robot = sample[0]
    rng = np.random.default_rng(6)
    targets = poses_of(rng, 20, 0.6)
    far = se3.displaced(MIDDLE, [0.0, 0.0, 0.0, 2.0 * HALF_MM, 0.0, 0.0])
    tilted = se3.displaced(MIDDLE, [0.8, 0.0, 0.0, 0.0, 0.0, 0.0])
    measured, program = tables(tmp_path, sample, np.concatenate([targets, far[None], tilted[None]]))
    given = ["correct", str(program), "--map", str(measured), "--out", str(tmp_path / "out")]
    done = ran(*given)
    assert "20 of 22 targets corrected (csv)" in done
    assert "T20: outside the measured region" in done
    assert "T21: its orientation is" in done
    record = json.loads((tmp_path / "out" / "corrections.json").read_text())["targets"]
    determined = np.array([row["corrected_values"] for row in record[:20]])
    off = se3.displacement(se3.displaced(determined, true_errors(robot, determined)), targets)
    before = np.linalg.norm(true_errors(robot, targets)[:, 3:], axis=1)
    after = np.linalg.norm(off[:, 3:], axis=1)
    assert after.mean() < 0.1 * before.mean()
    assert np.mean(after <= [row["u95_mm"] for row in record[:20]]) >= 0.9
    assert np.linalg.norm(off[:, :3], axis=1).mean() < 0.4 * np.linalg.norm(true_errors(robot, targets)[:, :3], axis=1).mean()
    assert all(row["error_left_mm"] < 1e-6 for row in record[:20])
    # another tool than the one that was measured
    _, other = code_and_text(*given, "--force", "--tool", "0,0,100")
    assert "0 of 22 targets corrected" in other
    assert "its tool tool differs from the map's tool" in other
    ran(*given, "--force", "--most-mm", "0.2", "--clip")
    clipped = json.loads((tmp_path / "out" / "corrections.json").read_text())["targets"][:20]
    assert all(row["size_mm"] <= 0.2 + 1e-9 for row in clipped)
    assert any(row["clipped"] and row["error_left_mm"] > 0.05 for row in clipped)


@pytest.mark.parametrize(
    ("change", "arguments", "text"),
    [
        (("dx_mm", "ex_mm"), [], "column 'dx_mm' is missing"),
        (("dx_mm,dy_mm", "dx_m,dy_mm"), [], "an error of"),
        (("qw", "qv"), ["--near", "1,2"], "is for an identified robot"),
        (("qw", "qw"), ["--identified", "x"], "one of the two"),
    ],
)
def test_a_map_that_is_none_is_one_line(
    sample: tuple[SerialRobot, FloatArray, FloatArray], tmp_path: Path, change: tuple[str, str], arguments: list[str], text: str
) -> None:
    measured, program = tables(tmp_path, sample, poses_of(np.random.default_rng(1), 2))
    measured.write_text(measured.read_text().replace(*change))
    code, said = code_and_text("correct", program, "--map", measured, "--out", tmp_path / "o", *arguments)
    assert code in (1, 2)
    assert text in " ".join(said.split())
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize("method", ["model", "map"])
def test_what_is_left_of_a_real_robots_errors(method: str) -> None:
    """120 of the UR5's 1,000 poses, and what both make of 100 others (benchmarks/error_map.py has folds of all)."""
    table = np.genfromtxt(Path(__file__).parents[2] / "datasets" / "ur5" / "grid.csv", delimiter=",", names=True)
    rows = np.random.default_rng(5).permutation(len(table))[:220]
    joints = np.radians(np.column_stack([table[f"joint_{i}"] for i in range(1, 7)]))[rows]
    place, errors = (np.column_stack([table[f"{axis}_{kind}"] for axis in "xyz"])[rows] for kind in ("t", "dif"))
    if method == "map":
        poses = np.column_stack([place, shipped("ur5").model.forward(joints)[:, 3:]])
        found = error_map(poses[:120], errors[:120])
        left, radius = np.linalg.norm(errors[120:] - found.errors(poses[120:])[:, 3:], axis=1), found.u95_mm(poses[120:])
        assert found.within >= 0.9
    else:
        determined = predict(identify_with_choice(shipped("ur5").model, measured(joints[:120], (place + errors)[:120])), joints[120:])
        left, radius = np.linalg.norm((place + errors)[120:] - determined.pose[:, :3], axis=1), determined.u95_mm
    assert np.linalg.norm(errors, axis=1).mean() > 2.0
    assert left.mean() < 0.14
    assert np.mean(left <= radius) >= 0.88
