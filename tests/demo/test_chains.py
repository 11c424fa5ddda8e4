import csv
import json
import math
import re
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from in_process import lmeasure
from rerun.chunk import RrdReader
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, LMeasureError, Status
from lmeasure.demo import OF_CELL, demo, existing
from lmeasure.demo.calibrated_cell import count_at_stops, record_motion
from lmeasure.demo.cell_demo import STAGES, errors_of, held_out_length_error
from lmeasure.io.tables import read_table
from lmeasure.recording import read_run
from lmeasure.rig import rig_from_dict
from lmeasure.simulation import Leg, cell_rig, scattered_poses, simulate_run, smooth_path
from lmeasure.simulation.instrument import simulate_campaign
from lmeasure.trajectory import Trajectory, read_trajectory, reconstruct

HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Ran:
    """A demo run by its command: its folder, its table, what it printed and told on the way."""

    out: Path
    table: list[dict[str, str]]
    printed: str
    reported: str

    def line(self, what: str) -> tuple[float, str]:
        """(error, what is stated) of the table's line that begins so."""
        found = next(x for x in self.table if x["what"].startswith(what))
        return float(found["error"].split()[0]), found["stated"]


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    out = tmp_path_factory.mktemp("demo") / "out"
    done = lmeasure("demo", "--out", out)
    assert done.returncode == 0, done.stderr
    mark = json.loads((out / "demo.json").read_text())
    assert mark["finished"] is True
    return Ran(out, mark["table"], done.stdout, done.stderr)


def points(path: Path) -> FloatArray:
    return np.array([p["position_mm"] for p in tomllib.loads(path.read_text())["observation_point"]])


def rms_length(vectors: FloatArray) -> float:
    return math.sqrt(float((vectors**2).sum(axis=1).mean()))


def test_demo_leaves_the_folders_of_every_stage(ran: Ran) -> None:
    out = ran.out
    expected = {
        "campaign/rig.toml", "campaign/reference_poses.csv", "campaign/counts.csv", "campaign/true/rig.toml",
        "campaign/true/reference_poses.csv", "calibration/rig.toml", "calibration/calibration.json", "calibration/report.html",
        "run/run.toml", "run/rig.toml", "run/calibration.json", "run/pass1.csv", "trajectory.parquet", "truth.parquet", "zone.nc",
        "zone.html", "demo.rrd", "demo.json", "demo.html",
    }  # fmt: skip
    # tests/demo/test_robot_demo.py knows the files of a robot
    assert {str(p.relative_to(out)) for p in out.rglob("*") if p.is_file() and p.relative_to(out).parts[0] != "robot"} == expected


def test_demo_tells_its_stages_and_where_to_look(ran: Ran) -> None:
    places = [ran.reported.index(stage) for stage in STAGES]
    assert places == sorted(places)
    error, _ = ran.line("gripper position")
    first, second, robot, third, following = ran.printed.splitlines()
    assert f"{error:.3f} mm (rms) from the true ones" in first
    assert second.endswith("without knowing the truth")
    certificates = [
        json.loads((ran.out / "robot" / name / "certificate.json").read_text()) for name in ("certificate", "again/certificate")
    ]
    before, after = (np.mean([c["value"] for c in one["characteristics"] if c["name"] == "AP_p"]) for one in certificates)
    assert f"by {before:.3f} mm on average" in robot
    assert robot.endswith(f"{after:.3f} mm.")
    assert after < 0.3 * before
    assert following.startswith("next: lmeasure ")
    page = Path(third.partition(": ")[2])
    text = page.read_text(encoding="utf-8")
    # the path plays, and each step has a link to a file that is there and its command
    assert "Plotly.addFrames" in text
    links = re.findall(r'<a href="([^"]+)">', text)
    assert len(links) == 6
    # the terminal and the page state the same, and no sentence is on the page twice
    share = second.partition(" %")[0]
    assert f"{share}\u00a0%" in text
    sentences = re.findall(r"<p(?: [^>]*)?>([^<]{40,})</p>", text)
    assert len(set(sentences)) == len(sentences) >= 7
    assert all((page.parent / link).exists() for link in links)
    assert len(re.findall(r"<code>(?:<span[^>]*>)?lmeasure", text)) == len(links)


def test_demo_table_against_its_own_files(ran: Ran) -> None:
    """Every figure again, from the files alone."""
    out = ran.out
    found = pd.read_parquet(out / "trajectory.parquet")
    truth = pd.read_parquet(out / "truth.parquet")
    assert (found["status"] == "ok").all()
    np.testing.assert_array_equal(found["time_s"], truth["time_s"])
    at = ["x_mm", "y_mm", "z_mm"]
    error, stated = ran.line("gripper position")
    assert error == pytest.approx(rms_length((found[at] - truth[at]).to_numpy()), abs=6e-5)
    assert stated.startswith(f"u {rms_length(found[['u_x_mm', 'u_y_mm', 'u_z_mm']].to_numpy()):.4f};")
    turned = ["qx", "qy", "qz", "qw"]
    # twice the angle of the quaternion between them
    cosine = np.abs((found[turned].to_numpy() * truth[turned].to_numpy()).sum(axis=1)).clip(max=1.0)
    sine = np.sqrt(1.0 - cosine**2)
    error, _ = ran.line("gripper rotation")
    assert error == pytest.approx(1e3 * math.sqrt(float(((2.0 * sine) ** 2).mean())), rel=1e-2)

    true, nominal, calibrated = (points(out / name) for name in ("campaign/true/rig.toml", "campaign/rig.toml", "calibration/rig.toml"))
    assert ran.line("observation points before")[0] == pytest.approx(rms_length(nominal - true), abs=6e-3)
    assert ran.line("observation points [mm")[0] == pytest.approx(rms_length(calibrated - true), abs=6e-4)
    with xr.open_dataset(out / "zone.nc", engine="h5netcdf") as zone:
        assert ran.line("zone volume")[1] == f"{float(zone['in_zone'].sum()) * 0.15**3:.4f}"


def test_demo_measures_well(ran: Ran) -> None:
    assert ran.line("counts lost")[0] == 0
    # nominal points up to 30 mm off; a length is then known ten times better than what the reference poses are good for
    assert ran.line("observation points before")[0] > 10.0
    assert ran.line("cable lengths")[0] < 0.03
    assert ran.line("gripper position")[0] < 0.06
    assert ran.line("gripper rotation")[0] < 0.3


def test_demo_run_folder_gives_the_same_trajectory(ran: Ran) -> None:
    out = ran.out
    run = read_run(out / "run")
    assert run.calibration is not None
    assert run.rig.to_dict() | {"calibration": None} == rig_of(out / "calibration/rig.toml") | {"calibration": None}
    again = reconstruct(run)
    stored = read_trajectory(out / "trajectory.parquet")
    np.testing.assert_array_equal(again.poses, stored.poses)
    np.testing.assert_allclose(again.u, stored.u, rtol=1e-14)  # kept as the whole and its systematic part


def rig_of(path: Path) -> dict[str, object]:
    return rig_from_dict(tomllib.loads(path.read_text())).to_dict()


def test_demo_recording_holds_all_stages(ran: Ran) -> None:
    entities = {chunk.entity_path for chunk in RrdReader(ran.out / "demo.rrd").stream()}
    assert {
        "/world/rig/observation_points", "/world/nominal/observation_points", "/world/cables/c6", "/world/tool", "/world/path",
        "/world/truth", "/world/reference_poses", "/world/zone/inside", "/world/zone/outside", "/residual_mm/c1",
        "/calibration_residual_mm/ch1", "/counts/pass1/ch1", "/errors/x_mm", "/u_position_mm/u_x_mm", "/status", "/notes",
    } <= entities  # fmt: skip


def test_demo_needs_a_folder(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("precious")
    for out in (tmp_path / "thesis.txt", tmp_path / "thesis.txt" / "below"):
        with pytest.raises(LMeasureError, match="cannot be written"):
            demo(out)
    assert (tmp_path / "thesis.txt").read_text() == "precious"


def test_the_command_knows_every_file_of_the_demo(ran: Ran) -> None:
    made = {path for path in ran.out.rglob("*") if path.is_file()}
    assert set(existing(ran.out, OF_CELL)) == made


def test_demo_says_that_it_was_stopped(ran: Ran, tmp_path: Path) -> None:
    class StoppedError(Exception):
        pass

    def stop(stage: str, done: int, of: int) -> None:
        if stage == STAGES[1]:
            raise StoppedError

    for _ in range(2):
        with pytest.raises(StoppedError):
            demo(tmp_path / "out", stop)
    assert json.loads((tmp_path / "out" / "demo.json").read_text())["finished"] is False


def test_counts_at_stops_are_those_of_a_robot_that_rests_there() -> None:
    rig = cell_rig(4)
    wanted = simulate_campaign(rig, 5, np.random.default_rng(1), centre=HOME, half_mm=(200.0,) * 3, tilt_rad=0.2)
    # both draw the phases first from a generator of that seed
    np.testing.assert_array_equal(count_at_stops(rig, wanted.poses, np.random.default_rng(1)), wanted.recorded)


def test_what_comes_from_the_bus_is_what_was_sent() -> None:
    rng = np.random.default_rng(1)
    time_s, poses = smooth_path(HOME, [Leg(p) for p in scattered_poses(2, (100.0,) * 3, 0.1, HOME, rng=rng)], 500.0)
    sent = simulate_run(cell_rig(2), time_s, poses, noise_mm=0.0, rng=rng)
    received = record_motion(sent)
    np.testing.assert_array_equal(received.passes[0].time_s, time_s)
    np.testing.assert_array_equal(received.passes[0].recorded, sent.run.passes[0].recorded)


def drawn(n: int, rng: np.random.Generator, factor: float = 1.0) -> tuple[Trajectory, FloatArray]:
    """A trajectory whose true poses are drawn from its stated covariance, errors multiplied by the factor."""
    poses = scattered_poses(n, (100.0,) * 3, 0.3, HOME, rng=rng)
    root = rng.normal(size=(n, 6, 6)) * np.array([1e-4] * 3 + [0.01] * 3)[:, None]
    delta = factor * np.einsum("nij,nj->ni", root, rng.normal(size=(n, 6)))
    truth = poses.copy()
    truth[:, :3] += delta[:, 3:]
    truth[:, 3:] = (Rotation.from_rotvec(delta[:, :3]) * Rotation.from_quat(poses[:, 3:])).as_quat()
    text = np.full(n, "", dtype=np.object_)
    nothing = np.zeros(n)
    status = np.full(n, Status.OK)
    random = 0.25 * root @ np.swapaxes(root, 1, 2)
    return Trajectory(nothing, poses, nothing, status, status, text, text, nothing, random, 3.0 * random, "test"), truth


def test_coverage_of_regions_that_are_right_and_too_small() -> None:
    rng = np.random.default_rng(8)
    right = errors_of(*drawn(4000, rng))
    assert right.inside_position == pytest.approx(0.95, abs=0.015)
    assert right.inside_rotation == pytest.approx(0.95, abs=0.015)
    # chi-squared of three degrees of freedom at 7.8147 / 4
    small = errors_of(*drawn(4000, rng, 2.0))
    assert small.inside_position == pytest.approx(0.418, abs=0.03)
    assert small.inside_rotation == pytest.approx(0.418, abs=0.03)


def test_errors_are_truth_less_result_where_it_is_known() -> None:
    trajectory, truth = drawn(10, np.random.default_rng(3))
    status = trajectory.status.copy()
    status[4] = Status.GAP
    poses = trajectory.poses.copy()
    poses[4] = np.nan
    random = trajectory.random.copy()
    random[4] = np.nan
    errors = errors_of(replace(trajectory, status=status, poses=poses, random=random), truth)
    assert np.isnan(errors.position_mm[4]).all()
    assert np.isnan(errors.rotation_rad[4]).all()
    others = np.delete(np.arange(10), 4)
    np.testing.assert_allclose(errors.position_mm[others], (truth - trajectory.poses)[others, :3], atol=1e-12)
    for i in others:
        turned = Rotation.from_rotvec(errors.rotation_rad[i]).as_matrix() @ Rotation.from_quat(trajectory.poses[i, 3:]).as_matrix()
        np.testing.assert_allclose(turned, Rotation.from_quat(truth[i, 3:]).as_matrix(), atol=1e-12)


def test_held_out_error_sees_a_shift_across_and_not_a_longer_cable() -> None:
    rig = cell_rig(0)
    data = rig.to_dict()
    assert held_out_length_error(rig, rig, np.random.default_rng(0)) == 0.0
    for p in data["observation_point"]:
        p["position_mm"] = [p["position_mm"][0] + 1.0, *p["position_mm"][1:]]
    error = held_out_length_error(rig, rig_from_dict(data), np.random.default_rng(0))
    # a millimetre seen along cables whose directions scatter by the work space over the cables' lengths
    assert 0.03 < error < 0.3


def test_campaign_counts_are_whole_numbers(ran: Ran) -> None:
    rows = list(csv.DictReader((ran.out / "campaign" / "counts.csv").read_text().splitlines()))
    assert len(rows) == 20
    assert {rows[0][c] for c in ("ch1", "ch2", "ch3", "ch4", "ch5", "ch6")} == {"0"}
    assert all(cell.lstrip("-").isdigit() for row in rows for name, cell in row.items() if name != "pose")
    assert len(read_table(ran.out / "campaign" / "reference_poses.csv")) == 20
