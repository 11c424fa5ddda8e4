"""The public names of the package: all there, all lazy, all typed and documented; every stage from files or objects, every object shown."""

import inspect
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any, assert_type, get_type_hints

import numpy as np
import plotly.graph_objects as go
import pytest
import xarray as xr

import lmeasure as lm
from lmeasure import api
from lmeasure.accuracy import Placement
from lmeasure.acquisition import scan_log
from lmeasure.core import CalibrationError, CertificationError, LMeasureError, Shown
from lmeasure.report.plots import DRAWN
from lmeasure.robot_programs import Corrected, Outcome, Target
from lmeasure.robots import Limits
from lmeasure.robots.correction.error_map import correct
from lmeasure.robots.identification.measurements import measured
from lmeasure.robots.robot import shipped
from lmeasure.structure import Workspace

CELL = Path(__file__).parents[1] / "authorities" / "truth" / "cell-run"
AXIS = (-100.0, 100.0, 100.0)


OF_STAGES = [name for name in lm.__all__ if getattr(lm, name).__module__ == "lmeasure.api"]


def test_what_is_no_option_or_no_such_object_is_named() -> None:
    box: Any = (AXIS, AXIS, AXIS)
    with pytest.raises(TypeError, match=r"zone\(\) has no option 'limit_deg'; options: angle_deg, .*limits"):
        lm.zone(CELL / "rig.toml", *box, limit_deg=60.0)
    with pytest.raises(TypeError, match=r"calibrate\(\) has no option 'scatter'; options: "):
        lm.calibrate(lm.simulate({"reference_poses": {"count": 7}}), scatter=1.0)
    with pytest.raises(TypeError, match=r"plan_poses\(\) has no option 'count'; options: poses, "):
        lm.plan_poses(CELL / "rig.toml", box=[(0.0, 1.0)] * 3, count=3)
    run: Any = lm.read_run(CELL)
    with pytest.raises(TypeError, match="campaign must be a calibration folder, a Campaign, or the result of `simulate`, not Run"):
        lm.calibrate(run)
    rig: Any = run.rig
    with pytest.raises(TypeError, match="run must be a run folder, a Run, or the result of `simulate`, not Rig"):
        lm.reconstruct(rig)
    with pytest.raises(TypeError, match=r"rig must be a rig.toml, a Rig or a Calibration, not Run"):
        lm.zone(run, *box)
    with pytest.raises(TypeError, match=r"plan_program\(\) has no option 'cube'; options: tests, "):
        lm.plan_program((0.0, 0.0, 0.0), (9.0, 9.0, 9.0), cube=3)
    with pytest.raises(CertificationError, match="a box needs three numbers, along x, y and z"):
        lm.plan_program((0.0, 0.0, 0.0), (9.0, 9.0))
    rule: Any = "strict"
    with pytest.raises(CertificationError, match="rule = 'strict': must be simple or guarded"):
        lm.CertificationSettings(rule=rule)
    with pytest.raises(CertificationError, match="language = 'de': must be en or ru"):
        lm.certify("trajectory.parquet", "program.toml", "out", language="de")
    short: Any = (-100.0, 100.0)
    with pytest.raises(LMeasureError, match=r"y = \(-100.0, 100.0\): needs three numbers, least, greatest and step \[mm\]"):
        lm.zone(CELL / "rig.toml", AXIS, short, AXIS)
    # a field of the limits and one of the scan go together
    seen = lm.zone(CELL / "rig.toml", *box, angle_deg=50.0, refine=None)
    assert seen.attrs


@pytest.mark.parametrize(
    ("poses", "reported"),
    [
        (np.zeros((2, 6)), r"poses of shape \(2, 6\): wanted are rows \(n, 7\) of x, y, z \[mm\], qx, qy, qz, qw"),
        (np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), r"poses of shape \(7,\): wanted are rows \(n, 7\)"),
        (np.zeros((1, 7)), "pose 1: its quaternion is not of length 1 but 0"),
        (np.array([[0.0, 0, 0, 0, 0, 0, 1], [0.0, 0, 0, 0.6, 0, 0, 0.9]]), "pose 2: its quaternion is not of length 1 but 1.08"),
    ],
)
def test_lengths_of_what_are_no_poses_are_not_reported(poses: Any, reported: str) -> None:
    with pytest.raises(LMeasureError, match=reported):
        lm.span_lengths(lm.read_rig(CELL / "rig.toml"), poses)


def test_every_public_name_is_there_and_documented() -> None:
    assert lm.__all__ == sorted(lm.__all__)
    for name in lm.__all__:
        assert getattr(lm, name).__doc__, name
    assert set(lm.__all__) <= set(dir(lm))


def test_every_stage_is_typed() -> None:
    for name in OF_STAGES:
        stage = getattr(lm, name)
        assert stage is getattr(api, name)
        assert set(stage.__annotations__) == {*inspect.signature(stage).parameters, "return"}, name


def test_version_is_that_of_the_installed_package() -> None:
    assert lm.__version__ == version("lmeasure")


def test_a_name_that_is_not_there() -> None:
    assert not hasattr(lm, "measure")


def test_zones_and_trajectories_load_no_statistics_before_they_use_them() -> None:
    """SciPy's take half a second, and a map of six cables or a run of them asks none."""
    code = "import sys, lmeasure.accuracy.zone, lmeasure.trajectory; print('scipy.stats' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def corrected() -> Corrected:
    """One target of a robot whose link is 0.4 mm too long."""
    nominal = shipped("generic6").model
    change = np.array([0.4 * (p.name == "joint_2.a_mm") for p in nominal.parameters])
    joints = np.radians([20.0, -10.0, 15.0, 30.0, 60.0, 0.0])
    done = correct(nominal, nominal.moved(change), joints, Limits())
    target = Target("P1", 0, 1, True, tuple(np.degrees(joints)), ())
    return Corrected((Outcome(target, "p.csv", done, tuple(np.degrees(done.joints)), "", 0.1, 0.05),), ("",))


@pytest.fixture(scope="module")
def nouns(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """One of every object, most of them from the others."""
    rig = lm.read_rig(CELL / "rig.toml")
    at = {"P1": [30.0, 0.0, 10.0], "P2": [-30.0, 20.0, 0.0]}
    made = lm.simulate(
        rig=rig, rate_hz=50.0, waypoint=[{"position_mm": p} for p in at.values()], motion={"cycles": 3, "dwell_s": 0.8},
        reference_poses={"count": 8, "u_position_mm": 0.02, "u_rotation_deg": 0.01},
    )  # fmt: skip
    assert made.run is not None
    calibration = lm.calibrate(made, solve=("position",))
    # held by mypy, which sees through the lazy names
    assert_type(calibration, lm.Calibration)
    trajectory = assert_type(lm.reconstruct(made, rig=calibration), lm.Trajectory)
    program = lm.Program.model_validate(
        {
            "schema": "lmeasure.program/1",
            "pose": [{"name": name, "position_mm": p, "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0]} for name, p in at.items()],
            "path": [{"name": "line", "kind": "linear", "start_mm": at["P1"], "end_mm": at["P2"], "speed_mm_s": 100.0}],
        }
    )
    folder = tmp_path_factory.mktemp("api") / "certificate"
    arm, rng = shipped("ur5").model, np.random.default_rng(3)
    joints = rng.uniform(-1.5, 1.5, (25, 6))
    identified = lm.identify(arm, measured(joints, arm.forward(joints)[:, :3] + rng.normal(0.0, 0.02, (25, 3))))
    task = {"low_mm": [-50.0] * 3, "high_mm": [50.0] * 3, "nodes": 2, "tilt_steps": 1}
    mount = [{"points": ["B1"], "low_mm": [p - 1.0 for p in rig.observation_point[0].position_mm],
              "high_mm": [p + 1.0 for p in rig.observation_point[0].position_mm]}]  # fmt: skip
    wanted = Placement.model_validate({"schema": "lmeasure.placement/1", "task": task, "mount": mount})
    poses_alone = program.model_copy(update={"path": ()})
    links = lm.analyse_structure(rig, np.array([0.0, 0, 0, 0, 0, 0, 1]), workspace=Workspace("xy", reach_mm=300.0, limit_deg=40.0))
    return {
        "made": made, "rig": rig, "poses": calibration.campaign.poses, "counts": made.run.run.passes[0], "run": made.run.run,
        "lengths": lm.lengths_from_counts(made.run.run), "calibration": calibration, "record": calibration.record,
        "trajectory": trajectory, "zone": lm.zone(calibration, AXIS, AXIS, np.array([0.0]), u95_mm=1.0, full=True),
        "plan": lm.plan_poses(rig, poses=2, box=[(-100.0, 100.0)] * 3, tilt_deg=5.0, solve=("position",), further=0),
        "placed": lm.place(rig, wanted, generations=1), "program": program, "identified": identified, "corrected": corrected(),
        "described": links, "boundary": links.boundary, "scan": scan_log(CELL.parents[1] / "scan-sync-with-counter" / "sync.log"),
        "evaluation": lm.evaluate(trajectory, poses_alone, run=made, rig=calibration, trials=100),
        "certificate": lm.certify(trajectory, poses_alone, folder, run=made, rig=calibration, trials=100),
    }  # fmt: skip


def test_every_object_is_drawn_and_shown(nouns: dict[str, Any]) -> None:
    assert {xr.DataArray, *map(type, nouns.values())} == set(DRAWN)
    for name, noun in nouns.items():
        for rig in (None, nouns["rig"]):
            figure = lm.plot(noun, rig)
            assert isinstance(figure, go.Figure), name
            assert len(figure.data), name
        if isinstance(noun, xr.Dataset):
            continue
        assert isinstance(noun, Shown)
        assert repr(noun).startswith(f"<{type(noun).__name__} "), name
        assert len(repr(noun)) < 300, name
        assert noun._repr_html_().startswith("<table><caption>"), name
        assert str(noun) == repr(noun), name
        assert get_type_hints(type(noun).about)["return"] == dict[str, str]
        frame = noun.to_frame()
        assert len(frame), name
        assert len(frame.columns), name
    with pytest.raises(LMeasureError, match=r"dict cannot be drawn. These can: Rig, "):
        lm.plot({})


def test_what_is_not_drawn_is_shown_too(nouns: dict[str, Any]) -> None:
    covariances = lm.covariances(lm.reconstruct(nouns["run"]), nouns["run"], slice(0, 5))
    assert repr(covariances).startswith("<PoseCovariances poses: 5, largest random u: 0.0")
    frame = covariances.to_frame()
    np.testing.assert_allclose(frame["u_x_mm"] ** 2, covariances.random[:, 3, 3])
    np.testing.assert_allclose(frame["u_systematic_rz_rad"] ** 2, covariances.systematic[:, 2, 2])
    campaign = nouns["calibration"].campaign
    assert repr(campaign).startswith(
        "<Campaign rig: cell-a, channels: c1, c2, c3, c4, c5, c6, counts: 48 of 48, poses: 8, u of position: 0.02 mm"
    )
    np.testing.assert_array_equal(campaign.to_frame()["c2"], campaign.counts[:, 1])
    assert list(campaign.to_frame()["x_mm"]) == list(campaign.poses.rows[:, 0])


def test_what_is_shown_cannot_be_markup(nouns: dict[str, Any]) -> None:
    named = nouns["rig"].model_copy(update={"name": "<script>"})
    assert "&lt;script&gt;" in named._repr_html_()
    assert "<script>" not in named._repr_html_()


def test_frames_hold_the_figures(nouns: dict[str, Any]) -> None:
    trajectory, rig = nouns["trajectory"], nouns["rig"]
    np.testing.assert_array_equal(trajectory.to_frame()["u_x_mm"], trajectory.u[:, 0])
    dataset = trajectory.to_xarray()
    np.testing.assert_array_equal(dataset["random"].sel(time_s=trajectory.time_s[3]), trajectory.random[3])
    np.testing.assert_array_equal(dataset["x_mm"], trajectory.poses[:, 0])
    frame = rig.to_frame().set_index("cable")
    assert frame.loc["c1", "x_mm"] == rig.point(rig.cable[0].from_point).position_mm[0]
    assert list(nouns["record"].to_frame()["u"]) == [p.u for p in nouns["record"].parameters]
    assert list(nouns["evaluation"].to_frame()["value"]) == list(nouns["certificate"].to_frame()["value"])


def test_stages_take_files_as_well(nouns: dict[str, Any], tmp_path: Path) -> None:
    lm.write_run(tmp_path / "run", nouns["run"])
    lm.write_trajectory(tmp_path / "t.parquet", nouns["trajectory"])
    lm.write_program(tmp_path / "p.toml", nouns["program"].model_copy(update={"path": ()}))
    lm.write_rig(tmp_path / "rig.toml", nouns["calibration"].rig)
    lm.write_calibration_record(tmp_path / "calibration.json", nouns["record"])
    again = lm.reconstruct(str(tmp_path / "run"), rig=tmp_path / "rig.toml")
    np.testing.assert_allclose(again.poses, nouns["trajectory"].poses, atol=1e-9)
    evaluation = lm.evaluate(tmp_path / "t.parquet", tmp_path / "p.toml", run=tmp_path / "run", rig=tmp_path / "rig.toml", trials=100)
    np.testing.assert_allclose(evaluation.to_frame()["value"], nouns["evaluation"].to_frame()["value"], atol=1e-9)
    zone = lm.zone(tmp_path / "rig.toml", AXIS, AXIS, (0.0, 0.0, 1.0), u95_mm=1.0)
    np.testing.assert_allclose(zone["u95_position_mm"], nouns["zone"]["u95_position_mm"], rtol=1e-12)
    certificate = nouns["certificate"]
    assert lm.verify(certificate.folder).exit_code == 0
    assert repr(lm.Certificate.read(certificate.folder)) == repr(certificate)


def test_keywords_are_the_settings(nouns: dict[str, Any]) -> None:
    settings = lm.CertificationSettings(capability=0.5, trials=100)
    poses = nouns["program"].model_copy(update={"path": ()})
    one = lm.evaluate(nouns["trajectory"], poses, settings=settings)
    other = lm.evaluate(nouns["trajectory"], poses, capability=0.5, trials=100)
    assert one.settings == other.settings == settings
    with pytest.raises(TypeError, match=r"evaluate\(\) has no option 'capabilty'; options: .*capability"):
        lm.evaluate(nouns["trajectory"], poses, capabilty=0.5)
    assert lm.zone(nouns["rig"], AXIS, AXIS, np.array([0.0]), angle_deg=30.0).attrs["limit_deg"] == 30.0
    with pytest.raises(CalibrationError, match="state the region of the robot"):
        lm.plan_poses(nouns["rig"])
    plan = lm.plan_program([0.0] * 3, [100.0] * 3, tests=("pose",), cycles={"pose": 2}, speeds_percent=(100.0,))
    assert [p.name for p in plan.program.pose] == ["P1", "P2", "P3", "P4", "P5"]
    with pytest.raises(CertificationError, match="give the box by low_mm and high_mm, or a zone"):
        lm.plan_program()


@pytest.mark.parametrize("shape", [(2, 6), (7, 2), (1, 1, 7)])
def test_poses_of_another_shape_are_refused(shape: tuple[int, ...]) -> None:
    """Two columns of seven rows have as many numbers as two poses."""
    with pytest.raises(LMeasureError, match="poses of shape"):
        lm.poses_from_rows(np.zeros(shape))


def test_the_readme_goes_from_a_rig_to_a_certificate_in_fifteen_lines() -> None:
    """That it runs, and prints what it says, is a test of the documents."""
    page = (CELL.parents[3] / "README.md").read_text(encoding="utf-8")
    code = page.split("```python\n")[1].split("```")[0]
    assert len(code.splitlines()) <= 15
    assert {name for name in OF_STAGES if f"lm.{name}(" in code} >= {"simulate", "calibrate", "reconstruct", "certify", "plot"}
