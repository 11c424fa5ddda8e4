import math
from pathlib import Path

import numpy as np
import pytest
from zeroed import exactly

from lmeasure.core import FileFormatError, FloatArray, GeometryError
from lmeasure.io import files
from lmeasure.recording import read_poses, read_run
from lmeasure.rig import read_rig, rig_from_dict, write_rig
from lmeasure.sensors import counts_from_poses, span_lengths
from lmeasure.simulation import Leg, cell_rig, read_scenario, scattered_poses, simulate, simulate_run, smooth_path, write_simulated

HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def rotation(q: FloatArray) -> FloatArray:
    x, y, z, w = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def worst_pressure_angle_deg(places: FloatArray, tool: FloatArray, pose: FloatArray) -> float:
    """Straight cables only: angle between a cable and the motion of its end when it alone is paid out."""
    arms = tool @ rotation(pose[3:]).T
    e = pose[:3] + arms - places
    e /= np.linalg.norm(e, axis=1)[:, None]
    twists = np.linalg.inv(np.hstack([e, np.cross(arms, e)]))
    motion = twists[:3].T + np.cross(twists[3:].T, arms)
    cosine = np.abs(np.einsum("mi,mi->m", motion, e)) / np.linalg.norm(motion, axis=1)
    return float(np.degrees(np.arccos(cosine.min())))


@pytest.mark.parametrize("seed", range(5))
def test_the_cell_measures_all_of_its_work_space_well(seed: int) -> None:
    rig = cell_rig(seed)
    rig.require_pose()
    poses = scattered_poses(200, (300.0, 300.0, 300.0), 0.3, HOME, rng=np.random.default_rng(seed))
    places = np.array([rig.point(c.from_point).position_mm for c in rig.cable])
    tool = np.array([rig.tool[c.to_point] for c in rig.cable])
    assert max(worst_pressure_angle_deg(places, tool, p) for p in poses) < 40.0
    assert np.isfinite(span_lengths(rig, poses)).all()


def test_a_path_is_smooth_keeps_its_speeds_and_rests() -> None:
    there = np.array([300.0, 0.0, 400.0, 0.0, 0.0, math.sin(0.25), math.cos(0.25)])
    time_s, rows = smooth_path(HOME, [Leg(there, 200.0, 10.0, dwell_s=0.5), Leg(HOME, 1000.0, 0.2)], 1000.0)
    velocity = np.diff(rows[:, :3], axis=0) * 1000.0
    speed = np.linalg.norm(velocity, axis=1)
    first = 1.875 * 500.0 / 200.0
    assert speed[time_s[1:] <= first].max() == pytest.approx(200.0, rel=1e-4)
    rest = (time_s >= first) & (time_s <= first + 0.5)
    assert rest.sum() == 500
    np.testing.assert_allclose(rows[rest], np.tile(there, (500, 1)), atol=1e-12)
    # the way back is limited by the rotation: 0.5 rad at 0.2 rad/s
    assert time_s[-1] == pytest.approx(first + 0.5 + 1.875 * 0.5 / 0.2, abs=1e-3)
    np.testing.assert_allclose(rows[-1], HOME, atol=1e-6)
    # minimum jerk: the acceleration is at most 10/sqrt(3) D/T^2 and has no steps
    acceleration = np.diff(velocity, axis=0) * 1000.0
    assert np.linalg.norm(acceleration, axis=1).max() <= 10 / math.sqrt(3) * 500.0 / first**2 * 1.001
    assert np.linalg.norm(np.diff(acceleration, axis=0), axis=1).max() <= 60 * 500.0 / first**3 * 1e-3 * 1.001
    np.testing.assert_allclose(np.linalg.norm(rows[:, 3:], axis=1), 1.0, rtol=0, atol=1e-12)


def test_counts_are_whole_zero_at_the_start_and_noise_has_its_size() -> None:
    rig = cell_rig(1)
    still = np.tile(scattered_poses(1, (100.0,) * 3, 0.2, HOME, rng=np.random.default_rng(3)), (4000, 1))
    time_s = np.arange(4000) / 1000.0
    exact = simulate_run(rig, time_s, still, noise_mm=0.0, rng=np.random.default_rng(0))
    assert not exact.run.passes[0].recorded.any()
    noisy = simulate_run(rig, time_s, still, noise_mm=0.12, rng=np.random.default_rng(0)).run.passes[0].recorded
    assert (noisy == np.rint(noisy)).all()
    # 0.12 mm is 10 counts; rounding adds 1/12
    np.testing.assert_allclose(noisy.std(axis=0), math.sqrt(100 + 1 / 12), rtol=0.05)


SCENARIO = (Path(__file__).parent / "inputs" / "scenario.toml").read_text(encoding="utf-8")


def test_a_scenario_becomes_a_run_folder_with_the_truth_beside_it(tmp_path: Path) -> None:
    (tmp_path / "scenario.toml").write_text(SCENARIO)
    scenario, rig = read_scenario(tmp_path / "scenario.toml")
    simulated = simulate(scenario, rig)
    write_simulated(tmp_path / "run", simulated)
    assert simulated.campaign is not None
    off = simulated.campaign.recorded - counts_from_poses(rig, simulated.campaign.poses, simulated.campaign.poses[0])
    # zeroed anywhere within a count
    assert 0.5 < np.abs(off).max() < 1.0
    rig = exactly(rig)
    simulated = simulate(scenario, rig)
    write_simulated(tmp_path / "run", simulated)
    run = read_run(tmp_path / "run")
    assert simulated.run is not None
    np.testing.assert_array_equal(run.passes[0].recorded, simulated.run.run.passes[0].recorded)
    truth = files.read_table(tmp_path / "run" / "truth.parquet")
    poses = truth.matrix(["x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw"])
    np.testing.assert_array_equal(poses, simulated.run.poses)
    assert np.abs(counts_from_poses(rig, poses, poses[0]) - run.passes[0].recorded).max() < 0.5 + 6 * 0.02 / 0.012
    campaign = tmp_path / "run" / "calibration"
    nominal, true = read_rig(campaign / "rig.toml"), read_rig(campaign / "true" / "rig.toml")
    shift = np.array([a.position_mm for a in nominal.observation_point]) - [b.position_mm for b in true.observation_point]
    assert 5.0 < np.abs(shift).max() <= 30.0
    measured = read_poses(campaign / "reference_poses.csv", nominal.angles)
    exact = read_poses(campaign / "true" / "reference_poses.csv", nominal.angles)
    assert 0.01 < np.abs(measured.rows[:, :3] - exact.rows[:, :3]).max() < 0.3
    assert (measured.u_position_mm == 0.05).all()
    counts = files.read_table(campaign / "counts.csv").matrix([f"ch{i}" for i in range(1, 7)])
    assert not counts[0].any()
    np.testing.assert_array_equal(counts, np.rint(counts_from_poses(true, exact.rows, exact.rows[0])))
    again = simulate(scenario, rig)
    assert again.run is not None
    np.testing.assert_array_equal(again.run.run.passes[0].recorded, run.passes[0].recorded)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ('schema = "lmeasure.scenario/1"\n', "nothing to simulate"),
        ('schema = "lmeasure.scenario/2"\n', "schema"),
        (SCENARIO.replace("speed_mm_s = 800.0", "speed_m_s = 0.8"), "motion.speed_m_s: unknown key 'speed_m_s'"),
        (SCENARIO.replace("cycles = 2", "cycles = 2\ndwel_s = 1"), "Did you mean 'dwell_s'"),
        (SCENARIO.replace("0.99498743710662", "0.9"), "[waypoint 2].quaternion_xyzw: the quaternion's length is"),
        (SCENARIO.replace("seed = 7", 'rig = "absent.toml"'), "absent.toml"),
    ],
)
def test_a_wrong_scenario_is_refused_in_one_line(text: str, complaint: str, tmp_path: Path) -> None:
    (tmp_path / "scenario.toml").write_text(text)
    with pytest.raises(FileFormatError) as refused:
        read_scenario(tmp_path / "scenario.toml")
    assert complaint in str(refused.value)
    assert "scenario.toml" in str(refused.value) or "absent.toml" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_motion_that_no_cable_allows_and_one_without_end_are_refused(tmp_path: Path) -> None:
    rig = cell_rig(0)
    write_rig(tmp_path / "rig.toml", rig)
    point = rig.observation_point[0].position_mm
    place = [p - t for p, t in zip(point, rig.tool["P1"], strict=True)]
    text = f'schema = "lmeasure.scenario/1"\nrig = "rig.toml"\nrate_hz = 50\n[[waypoint]]\nposition_mm = {place}\n'
    (tmp_path / "scenario.toml").write_text(text)
    with pytest.raises(GeometryError, match="cable c1"):
        simulate(*read_scenario(tmp_path / "scenario.toml"))
    (tmp_path / "slow.toml").write_text(SCENARIO.replace("speed_mm_s = 800.0", "speed_mm_s = 1e-6"))
    with pytest.raises(FileFormatError, match="are simulated"):
        simulate(*read_scenario(tmp_path / "slow.toml"))


def test_two_passes_of_three_drums_share_the_motion() -> None:
    rig = cell_rig(2)
    data = rig.to_dict()
    for i, cable in enumerate(data["cable"]):
        cable["pass"], cable["channel"] = 1 + i % 2, f"ch{1 + i // 2}"
    two = rig_from_dict(data)
    time_s, rows = smooth_path(HOME, [Leg(np.array([100.0, 50.0, 0.0, 0.0, 0.0, 0.0, 1.0]))], 100.0)
    one = simulate_run(rig, time_s, rows, noise_mm=0.0, rng=np.random.default_rng(0)).run.passes[0]
    both = simulate_run(two, time_s, rows, noise_mm=0.0, rng=np.random.default_rng(0)).run.passes
    for i in range(6):
        np.testing.assert_array_equal(both[i % 2].of(f"ch{1 + i // 2}"), one.of(f"ch{i + 1}"))


@pytest.mark.parametrize(
    ("name", "motion"),
    [("cell-run", "cell-run"), ("cell-run-16-bit", "cell-run-long"), ("three-drums-two-passes", "three-drums-two-passes")],
)
def test_the_counts_are_those_of_an_independent_simulator(name: str, motion: str) -> None:
    authority = Path(__file__).parent.parent / "authorities" / "truth"
    recorded = read_run(authority / name)
    poses = np.loadtxt(authority / motion / "truth.csv.gz", delimiter=",", skiprows=1)[:, 1:]
    simulated = simulate_run(exactly(recorded.rig), recorded.passes[0].time_s, poses, noise_mm=0.0, rng=np.random.default_rng(0)).run
    for mine, theirs in zip(simulated.passes, recorded.passes, strict=True):
        np.testing.assert_array_equal(mine.recorded, theirs.recorded)
