import itertools
import math
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
import scipy.stats
from recordings import HOME, SINGLE, scalars, stored
from rerun.chunk import RrdReader
from scipy.spatial.transform import Rotation

from lmeasure.accuracy import stated_radii_95
from lmeasure.core import FileFormatError, FloatArray, LMeasureError
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.simulation import Leg, SimulatedRun, cell_rig, scattered_poses, simulate_run, smooth_path
from lmeasure.trajectory import Trajectory, reconstruct
from lmeasure.view import open_viewer, write_recording
from lmeasure.view.recording import RERUN, ZONE_COLOURS, check_recording

GAP = slice(120, 130)


@pytest.fixture(autouse=True)
def _strict() -> Iterator[None]:
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


def moved(rig: Rig, seconds: float = 0.5, rate_hz: float = 1000.0) -> SimulatedRun:
    rng = np.random.default_rng(5)
    legs = [Leg(p, 300.0, 1.0) for p in scattered_poses(30, (150.0,) * 3, 0.2, HOME, rng=rng)]
    time_s, poses = smooth_path(HOME, legs, rate_hz)
    n = round(seconds * rate_hz)
    return simulate_run(rig, time_s[:n], poses[:n], noise_mm=0.0, rng=rng)


def with_gap(simulated: SimulatedRun) -> SimulatedRun:
    counts = simulated.run.passes[0]
    recorded = counts.recorded.copy()
    recorded[GAP, 2] = np.nan
    return replace(simulated, run=replace(simulated.run, passes=(replace(counts, recorded=recorded),)))


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, SimulatedRun, Trajectory]:
    """A recording of a run of 500 samples with a gap, its run and its trajectory."""
    rr.set_strict_mode(True)
    simulated = with_gap(moved(cell_rig(3)))
    trajectory = reconstruct(simulated.run)
    errors = {"x_mm": trajectory.poses[:, 0] - simulated.poses[:, 0]}
    path = tmp_path_factory.mktemp("view") / "run.rrd"
    write_recording(path, simulated.run.rig, run=simulated.run, trajectory=trajectory, truth=simulated.poses, errors=errors)
    return path, simulated, trajectory


def rounded(values: FloatArray) -> FloatArray:
    return values.astype(np.float32).astype(np.float64)


def test_tool_follows_the_trajectory_in_metres(written: tuple[Path, SimulatedRun, Trajectory]) -> None:
    path, simulated, trajectory = written
    nanoseconds, translation = stored(path, "/world/tool", "Transform3D:translation", "time")
    quaternion = stored(path, "/world/tool", "Transform3D:quaternion", "sample")[1]
    ok = np.isfinite(trajectory.poses[:, 0])
    assert ok.sum() == len(ok) - (GAP.stop - GAP.start)
    np.testing.assert_array_equal(nanoseconds, np.arange(len(ok)) * 1_000_000)
    np.testing.assert_array_equal([bool(cell) for cell in translation], ok)
    found = np.array([cell[0] for cell, good in zip(translation, ok, strict=True) if good])
    np.testing.assert_allclose(found, trajectory.poses[ok, :3] / 1000.0, rtol=SINGLE, atol=1e-12)
    turned = np.array([cell[0] for cell, good in zip(quaternion, ok, strict=True) if good])
    np.testing.assert_allclose(turned, trajectory.poses[ok, 3:], rtol=SINGLE, atol=1e-12)
    np.testing.assert_allclose(1000.0 * found, simulated.poses[ok, :3], atol=0.1)


def test_a_gap_shows_nothing_instead_of_the_last_pose(written: tuple[Path, SimulatedRun, Trajectory]) -> None:
    path, _, trajectory = written
    expected = [not GAP.start <= i < GAP.stop for i in range(len(trajectory.time_s))]
    for entity, component in (
        ("/world/tool", "TransformAxes3D:axis_length"),
        ("/world/cables/c3", "LineStrips3D:strips"),
        ("/world/pulleys", "LineStrips3D:strips"),
        ("/world/platform", "LineStrips3D:strips"),
        ("/world/tangent_points", "Points3D:positions"),
    ):
        assert [bool(cell) for cell in stored(path, entity, component, "sample")[1]] == expected, entity


def test_the_way_has_the_colours_of_its_95_percent_radius(written: tuple[Path, SimulatedRun, Trajectory]) -> None:
    """A strip for each colour, begun where the one before it ended but for the gap; the larger the radius the farther its colour."""
    path, _, trajectory = written
    strips = stored(path, "/world/path", "LineStrips3D:strips")[1][0]
    colours = stored(path, "/world/path", "LineStrips3D:colors")[1][0]
    (gap,) = [i for i, (a, b) in enumerate(itertools.pairwise(strips)) if a[-1] != b[0]]
    steps = [len(strip) - 1 for strip in strips]
    assert (sum(steps[: gap + 1]) + 1, sum(steps[gap + 1 :]) + 1) == (GAP.start, len(trajectory.time_s) - GAP.stop)
    radii = stated_radii_95((trajectory.random + trajectory.systematic)[:, 3:, 3:])
    radii = np.concatenate([radii[: GAP.start - 1], radii[GAP.stop : -1]])
    of_steps = np.repeat(colours, steps)
    scale = np.array([np.interp(np.linspace(0.0, 1.0, 101), (0.0, 0.5, 1.0), channel) for channel in zip(*ZONE_COLOURS, strict=True)]).T
    found = np.column_stack([of_steps >> bits & 255 for bits in (24, 16, 8)])
    level = np.linalg.norm(found[:, None] - scale, axis=2).argmin(axis=1)
    assert len(set(of_steps.tolist())) > 8
    assert scipy.stats.spearmanr(level, radii).statistic > 0.98


def test_scalars_are_whole_and_exact(written: tuple[Path, SimulatedRun, Trajectory]) -> None:
    path, simulated, trajectory = written
    np.testing.assert_array_equal(scalars(path, "/worst_pressure_angle_deg"), trajectory.worst_pressure_angle_deg)
    for i, axis in enumerate("xyz"):
        of = f"/position_mm/{axis}_mm"
        np.testing.assert_array_equal(scalars(path, of, component="Measurements:values"), trajectory.poses[:, i])
        np.testing.assert_allclose(scalars(path, of, component="Measurements:variances"), trajectory.u[:, i] ** 2, rtol=1e-14)
        np.testing.assert_array_equal(scalars(path, f"/u_position_mm/u_{axis}_mm", "sample"), trajectory.u[:, i])
        np.testing.assert_array_equal(scalars(path, f"/u_rotation_rad/u_r{axis}_rad"), trajectory.u[:, 3 + i])
    errors = scalars(path, "/errors/x_mm", component="Measurements:values")
    np.testing.assert_array_equal(errors, trajectory.poses[:, 0] - simulated.poses[:, 0])
    np.testing.assert_allclose(scalars(path, "/errors/x_mm", component="Measurements:variances"), trajectory.u[:, 0] ** 2, rtol=1e-14)
    counts = simulated.run.passes[0]
    for j, channel in enumerate(counts.channels):
        np.testing.assert_array_equal(scalars(path, f"/counts/pass1/{channel}"), counts.recorded[:, j])


def test_residuals_of_each_cable(tmp_path: Path) -> None:
    # a trajectory that is off by a known shift: every residual is the change of that cable's length, here along a straight line
    simulated = moved(cell_rig(3), 0.2)
    trajectory = reconstruct(simulated.run)
    off = trajectory.poses.copy()
    off[:, 2] += 0.5
    write_recording(tmp_path / "off.rrd", simulated.run.rig, run=simulated.run, trajectory=replace(trajectory, poses=off))
    for c in simulated.run.rig.cable:
        last = [np.array(cell[0]) for cell in stored(tmp_path / "off.rrd", f"/world/cables/{c.name}", "LineStrips3D:strips", "sample")[1]]
        along = np.array([(strip[-1] - strip[-2]) / np.linalg.norm(strip[-1] - strip[-2]) for strip in last])
        residual = scalars(tmp_path / "off.rrd", f"/residual_mm/{c.name}")
        np.testing.assert_allclose(residual, -0.5 * along[:, 2], atol=2e-4)


def test_cables_run_over_their_pulleys(written: tuple[Path, SimulatedRun, Trajectory]) -> None:
    path, simulated, trajectory = written
    rig = simulated.run.rig
    shown = np.flatnonzero(np.isfinite(trajectory.poses[:, 0]))
    circles = [np.array(cell) for cell in stored(path, "/world/pulleys", "LineStrips3D:strips", "sample")[1]]
    tangents = [np.array(cell) for cell in stored(path, "/world/tangent_points", "Points3D:positions", "sample")[1]]
    for j, c in enumerate(rig.cable):
        point = rig.point(c.from_point)
        base, radius = np.array(point.position_mm) / 1000.0, point.pulley_radius_mm / 1000.0
        strips = stored(path, f"/world/cables/{c.name}", "LineStrips3D:strips", "sample")[1]
        a, b = math.radians(point.guide_alpha_deg), math.radians(point.guide_beta_deg)
        u = np.array([-math.cos(a) * math.sin(b), -math.cos(a) * math.cos(b), math.sin(a)])
        for i in shown[::50]:
            strip, circle, tangent = np.array(strips[i][0]), circles[i][j], tangents[i][j]
            pose = trajectory.poses[i]
            end = (pose[:3] + Rotation.from_quat(pose[3:]).apply(rig.tool[c.to_point])) / 1000.0
            centre = circle[:-1].mean(axis=0)
            np.testing.assert_allclose(strip[0], base, atol=2e-7)
            np.testing.assert_allclose(strip[-1], end, atol=2e-7)
            np.testing.assert_allclose(strip[-2], tangent, atol=2e-7)
            for arc in (circle, strip[:-1]):
                np.testing.assert_allclose(np.linalg.norm(arc - centre, axis=1), radius, atol=1e-6)
            # it starts along u and leaves along the tangent
            first, straight = strip[1] - strip[0], end - tangent
            assert first @ u > (1.0 - 0.0005 / radius) * np.linalg.norm(first)  # chords are at most 0.5 mm off the arc
            assert abs(straight @ (tangent - centre)) < 1e-6
            assert straight @ (strip[-2] - strip[-3]) > 0


def test_without_orientation_the_point_is_shown(tmp_path: Path) -> None:
    data = cell_rig(3).to_dict()
    for c in data["cable"]:
        c["to"] = "P1"
    data["cable"] = data["cable"][:4]
    simulated = moved(rig_from_dict(data), 0.1)
    trajectory = reconstruct(simulated.run)
    path = tmp_path / "point.rrd"
    write_recording(path, simulated.run.rig, run=simulated.run, trajectory=trajectory)
    poses = simulated.poses
    point = (poses[:, :3] + Rotation.from_quat(poses[:, 3:]).apply(data["tool"]["P1"])) / 1000.0
    assert stored(path, "/world/tool", "Transform3D:quaternion", "sample")[1] == []
    shown = [cell[0] for cell in stored(path, "/world/tool", "Points3D:positions", "sample")[1]]
    np.testing.assert_allclose(shown, point, atol=1e-4)
    ends = [cell[0][-1] for cell in stored(path, "/world/cables/c4", "LineStrips3D:strips", "sample")[1]]
    np.testing.assert_allclose(ends, shown, atol=2e-7)


def test_status_changes_are_said(written: tuple[Path, SimulatedRun, Trajectory]) -> None:
    path, _, _ = written
    samples, texts = stored(path, "/status", "TextLog:text", "sample")
    levels = stored(path, "/status", "TextLog:level", "sample")[1]
    assert samples.tolist() == [0, GAP.start, GAP.stop]
    assert [level[0] for level in levels] == ["INFO", "WARN", "INFO"]
    assert texts[1][0] == "samples 120 to 129: gap: channel ch3 has no count, cable c3"
    lane = stored(path, "/status_lane", "StateChange:state", "time")[1]
    assert [state[0] for state in lane] == ["ok", "gap", "ok"]


def test_a_long_run_thins_the_picture_but_not_the_figures(tmp_path: Path) -> None:
    simulated = with_gap(moved(cell_rig(3), 7.0))
    trajectory = reconstruct(simulated.run)
    path = tmp_path / "long.rrd"
    write_recording(path, simulated.run.rig, run=simulated.run, trajectory=trajectory)
    n = len(trajectory.time_s)
    samples = stored(path, "/world/cables/c1", "LineStrips3D:strips", "sample")[0]
    assert n / 4 < len(samples) < n / 2
    assert {0, GAP.start, GAP.stop, n - 1} <= set(samples.tolist())
    assert len(stored(path, "/world/tool", "Transform3D:translation", "sample")[0]) == n
    assert len(scalars(path, "/residual_mm/c1")) == n
    notes = stored(path, "/notes", "TextDocument:text")[1][0][0]
    assert f"drawn at {len(samples)} of {n} samples" in notes
    assert trajectory.covers in notes


def test_observation_points_and_guides(written: tuple[Path, SimulatedRun, Trajectory]) -> None:
    path, simulated, _ = written
    points = simulated.run.rig.observation_point
    at = np.array(stored(path, "/world/rig/observation_points", "Points3D:positions")[1][0])
    np.testing.assert_allclose(at, rounded(np.array([p.position_mm for p in points]) / 1000.0), atol=2e-7)
    assert stored(path, "/world/rig/observation_points", "Points3D:labels")[1][0] == [p.name for p in points]
    origins = np.array(stored(path, "/world/rig/guides", "Arrows3D:origins")[1][0])
    vectors = np.array(stored(path, "/world/rig/guides", "Arrows3D:vectors")[1][0])
    np.testing.assert_allclose(origins + vectors, at, atol=2e-7)
    # the drums stand below the points: the cable comes up to them
    assert (vectors[:, 2] > 0).all()


def test_names_with_a_slash_stay_one_part(tmp_path: Path) -> None:
    data = cell_rig(0).to_dict()
    data["cable"][0]["name"] = "left/1"
    simulated = moved(rig_from_dict(data), 0.05)
    write_recording(tmp_path / "n.rrd", simulated.run.rig, run=simulated.run, trajectory=reconstruct(simulated.run))
    assert len(stored(tmp_path / "n.rrd", r"/world/cables/left\/1", "LineStrips3D:strips", "sample")[1]) == 50


def test_opens_with_a_blueprint(written: tuple[Path, SimulatedRun, Trajectory]) -> None:
    (blueprint,) = RrdReader(written[0]).blueprints()
    origins, timeline, names = set(), "", set()
    for chunk in RrdReader(written[0]).stream(store=blueprint):
        values = chunk.to_record_batch().to_pydict()
        origins |= {v[0] for v in values.get("ViewBlueprint:space_origin", []) if v}
        names |= {v[0] for v in values.get("ViewBlueprint:display_name", []) if v}
        timeline = next((v[0] for v in values.get("TimePanelBlueprint:timeline", []) if v), timeline)
    assert {"/world", "/worst_pressure_angle_deg", "/u_position_mm", "/status", "/notes"} <= origins
    # six cables leave nothing over but rounding: it is kept, and not plotted
    assert "/residual_mm" not in origins
    assert "rounding errors below" in stored(written[0], "/notes", "TextDocument:text")[1][0][0]
    assert "Rig and gripper" in names
    assert timeline == "time"


def test_rerun_verifies_it(written: tuple[Path, SimulatedRun, Trajectory]) -> None:
    done = subprocess.run([*RERUN, "rrd", "verify", str(written[0])], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "verified without error" in done.stdout + done.stderr


def test_nothing_is_left_of_a_recording_that_fails(tmp_path: Path) -> None:
    trajectory = reconstruct(moved(cell_rig(0), 0.05).run)
    late = replace(trajectory, time_s=trajectory.time_s + 1e10)
    with pytest.raises(LMeasureError, match=r"time_s = 1e\+10: a recording contains times up to 9e\+09 s"):
        write_recording(tmp_path / "late.rrd", cell_rig(0), trajectory=late)
    with pytest.raises(FileFormatError, match=r"must end in \.rrd"):
        write_recording(tmp_path / "late.txt", cell_rig(0), trajectory=trajectory)
    assert list(tmp_path.iterdir()) == []


def test_a_recording_that_was_cut_off(tmp_path: Path, written: tuple[Path, SimulatedRun, Trajectory]) -> None:
    whole = written[0].read_bytes()
    for length in (len(whole) // 2, len(whole) - 1):
        (tmp_path / "cut.rrd").write_bytes(whole[:length])
        with pytest.raises(FileFormatError, match="is not a whole rerun recording"):
            check_recording(tmp_path / "cut.rrd")


def test_no_recording_and_no_display(
    tmp_path: Path, written: tuple[Path, SimulatedRun, Trajectory], monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(FileFormatError, match=r"none\.rrd: cannot be read: No such file"):
        open_viewer(tmp_path / "none.rrd")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    with pytest.raises(LMeasureError, match="there is no display here"):
        open_viewer(written[0])


def test_viewer_listens_on_this_machine_only(
    tmp_path: Path, written: tuple[Path, SimulatedRun, Trajectory], monkeypatch: pytest.MonkeyPatch
) -> None:
    viewer = tmp_path / "viewer"
    viewer.write_text(f'#!/bin/sh\nprintf "%s\\n" "$@" > {tmp_path / "arguments"}\nexit $(cat {tmp_path / "code"})\n')
    viewer.chmod(0o755)
    monkeypatch.setenv("RERUN_CLI_PATH", str(viewer))
    monkeypatch.setenv("DISPLAY", ":0")
    (tmp_path / "code").write_text("0")
    open_viewer(written[0])
    assert (tmp_path / "arguments").read_text().split("\n")[:3] == [str(written[0]), "--bind", "127.0.0.1"]
    (tmp_path / "code").write_text("3")
    with pytest.raises(LMeasureError, match="the rerun viewer ended with code 3"):
        open_viewer(written[0])
