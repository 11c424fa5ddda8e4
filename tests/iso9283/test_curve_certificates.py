"""Characteristics of a curve in continuous time, of a simulated robot that turns corners, against its true path."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from cornering import cornering
from in_process import refused
from moving_robot import TRUTH, Cornering, FreeRunning, Instrument

import lmeasure as lm
from lmeasure.cli.app import main
from lmeasure.iso9283 import CertificationSettings, Evaluation, evaluate
from lmeasure.recording import read_counts, write_program, write_run
from lmeasure.trajectory import ErrorsOfCurve, reconstruct, reconstruct_curve

SETTINGS = CertificationSettings(trials=200)


def both(rate_hz: float, cycles: int, begin_s: float) -> tuple[Evaluation, Evaluation]:
    run, program, _ = cornering(rate_hz, cycles, begin_s)
    trajectory, curve = reconstruct_curve(run)
    of_samples = evaluate(reconstruct(run), program, run=run, settings=SETTINGS)
    return of_samples, evaluate(trajectory, program, ErrorsOfCurve(curve), run=run, settings=SETTINGS)


@pytest.mark.parametrize("begin_s", [0.304, 0.309])
def test_a_corner_between_samples_is_within_its_uncertainty(begin_s: float) -> None:
    of_samples, of_curve = both(80.0, 1, begin_s)
    single, found = ({c.name: c for c in e.characteristics} for e in (of_samples, of_curve))
    assert abs(found["CR"].value - 2.0) < found["CR"].u95 < 0.3 * single["CR"].u95
    assert found["CO"].value <= found["CO"].u95


def test_where_samples_are_dense_the_curve_is_less_uncertain() -> None:
    of_samples, of_curve = both(1000.0, 2, 0.3)
    motion = cornering(1000.0, 2, 0.3)[2]
    start, end = motion.windows()[0]
    time_s = np.arange(start + 0.5, end + 0.55, 1e-5)
    away = np.linalg.norm(motion.places(time_s) - motion.places(time_s[-1:]), axis=1)
    inside = np.flatnonzero(away <= 0.1)
    settled_s, overshoot = time_s[np.flatnonzero(away > 0.1)[-1]] - time_s[inside[0]], away[inside[0] :].max()
    single, found = ({c.name: c for c in e.characteristics} for e in (of_samples, of_curve))
    expected = (("CR", 2.0, 0.7), ("CO", 0.0, 0.5), ("AP_p", 0.0, 3.0), ("OV", overshoot, 1.1), ("t_s", settled_s, 1.1))
    for name, true, part in expected:
        assert abs(found[name].value - true) <= found[name].u95 + 1e-9, name
        assert found[name].u95 < part * single[name].u95, name
    for name in ("AV", "RV", "FV"):
        assert found[name].u95 < 0.5 * single[name].u95, name
    # the extreme of a smooth path is corrected by what errors add to it, and says so
    assert found["FV"].note is not None
    assert found["FV"].note.code == "figure.corrected"


GANTRY = """
schema = "lmeasure.robot/1"
name = "gantry"
kind = "serial"
[[joint]]
name = "joint_1"
type = "prismatic"
alpha_deg = 90.0
min_mm = -1000.0
max_mm = 1000.0
[[joint]]
name = "joint_2"
type = "prismatic"
theta_deg = 90.0
alpha_deg = 90.0
min_mm = -1000.0
max_mm = 1000.0
[[joint]]
name = "joint_3"
type = "prismatic"
min_mm = -1000.0
max_mm = 1000.0
"""


def test_a_certificate_says_that_a_joint_log_was_used_and_gives_results_without_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The log claims that the tool passes the corner at 1.8 mm. It does so at 2 mm."""

    def command(*arguments: str) -> int:
        monkeypatch.setattr("sys.argv", ["lmeasure", *arguments])
        with pytest.raises(SystemExit) as stop:
            main()
        return int(stop.value.code or 0)

    run, program, motion = cornering(100.0, 1, 0.3)
    folder, log, robot, out = str(tmp_path / "run"), tmp_path / "joints.csv", tmp_path / "gantry.toml", str(tmp_path / "smooth.csv")
    write_run(tmp_path / "run", run)
    write_program(tmp_path / "program.toml", program)
    robot.write_text(GANTRY)
    claimed = Cornering(1, begin_s=0.3, distance=1.8, swing_mm=0.5)
    time_s = np.arange(0.0, motion.lasts_s, 0.004)
    x, y, z = claimed.places(time_s).T
    rows = np.column_stack([time_s + 0.05, z, -y, x])
    np.savetxt(log, rows, "%.17g", ",", header="time_s,joint_1_mm,joint_2_mm,joint_3_mm", comments="")
    by = ["--continuous", "--joints", str(log), "--robot", str(robot)]
    assert command("reconstruct", folder, "--out", out, *by[1:]) == 2
    assert "go together, and with --continuous" in capsys.readouterr().err
    assert command("reconstruct", folder, "--out", out, *by) == 0
    assert "the joint log joints.csv is " in capsys.readouterr().out
    trajectory, _ = lm.reconstruct_curve(folder, joints=log, robot=robot)
    np.testing.assert_allclose(lm.read_trajectory(Path(out)).poses, trajectory.poses, atol=1e-9)
    with pytest.raises(TypeError, match="joints and robot go together"):
        lm.reconstruct_curve(folder, joints=log)
    sealed = ["--program", str(tmp_path / "program.toml"), "--run", folder, "--out", str(tmp_path / "sealed"), "--trials", "100"]
    assert command("certify", out, *sealed, *by) == 0
    assert command("verify", str(tmp_path / "sealed")) == 0, capsys.readouterr()
    certificate = json.loads((tmp_path / "sealed" / "certificate.json").read_text())
    assert certificate["measurement"]["joints"] == "inputs/joints.csv"
    found = {c["name"]: c for c in certificate["characteristics"]}
    assert abs(found["CR"]["value"] - 2.0) < found["CR"]["u95"]
    notes = " ".join(certificate["notes"])
    assert "the joint log joints.csv is " in notes
    assert re.search(r"without the joint log: CR L .* mm \(U95", notes)


def free_running_log(path: Path, motion: Cornering, rate_hz: float) -> list[float]:
    """Write a candump log of encoders that send by their own timers; return the times of their first frames."""
    instrument, rng = Instrument("cell-run"), np.random.default_rng(5)
    m = len(instrument.channels)
    frames = FreeRunning(rng, m, motion.lasts_s, rate_hz)
    # microseconds, as a log has them
    stamps = np.round(frames.true_s, 6)
    recorded = instrument.recorded(motion, stamps).astype(np.int32)
    every = sorted((float(stamps[i, j]), j, int(recorded[i, j])) for i in range(len(stamps)) for j in range(m))
    path.write_text("".join(f"({t:.6f}) can0 {0x181 + j:03X}#{np.int32(k).tobytes().hex().upper()}\n" for t, j, k in every))
    return [float(s) for s in stamps[0]]


def test_from_a_log_of_free_running_encoders_to_a_certificate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def command(*arguments: str) -> str:
        monkeypatch.setattr("sys.argv", ["lmeasure", *arguments])
        with pytest.raises(SystemExit) as stop:
            main()
        said = capsys.readouterr()
        assert stop.value.code in (0, None), said.err
        return said.out

    motion = Cornering(2, begin_s=0.302)
    log, rig, run = tmp_path / "drive.log", tmp_path / "rig.toml", str(tmp_path / "run")
    stamps = free_running_log(log, motion, 100.0)
    channels = Instrument("cell-run").channels
    table = '\n[can]\ndecoder = "raw"\ntiming = "free"\n' + "".join(
        f'[[can.channel]]\nchannel = "{name}"\nid = {0x181 + j}\nbits = 32\n' for j, name in enumerate(channels)
    )
    exact = re.sub(r"(count_sign = .*)", r"\1\nzero_exact = true", (TRUTH / "cell-run" / "rig.toml").read_text())
    rig.write_text(exact + table)
    command("import", str(log), "--rig", str(rig), "--out", run, "--position-mm", "0,0,0", "--quaternion-xyzw", "0,0,0,1")
    counts = read_counts(tmp_path / "run" / "pass1.csv").by_frames()
    assert counts.stamp_s is not None
    apart = counts.stamp_s + stamps[0] - np.array(stamps)
    apart = apart[np.isfinite(counts.recorded)]
    np.testing.assert_allclose(apart, np.rint(apart / 0.01) * 0.01, atol=2e-6)
    assert np.abs(counts.stamp_s - counts.time_s[:, None]).max() <= 0.005 + 2e-6
    assert (counts.recorded[np.isfinite(counts.recorded)] % 1.0 == 0.0).all()
    text = (tmp_path / "run" / "run.toml").read_text()
    (tmp_path / "run" / "run.toml").write_text(text.replace('rig = "rig.toml"', 'rig = "rig.toml"\nunstated = "exact"'))
    begin = stamps[0]
    windows = [[a - begin, b - begin] for a, b in motion.windows()]
    corner, end = motion.corner.tolist(), [motion.LEG_MM, motion.LEG_MM, 0.0]
    (tmp_path / "program.toml").write_text(
        f'schema = "lmeasure.program/1"\n[[path]]\nname = "L"\nkind = "points"\npoints_mm = [[0.0, 0.0, 0.0], {corner}, {end}]\n'
        f"speed_mm_s = {motion.speed}\nwindows_s = {windows}\n"
    )
    out, program = str(tmp_path / "smooth.csv"), str(tmp_path / "program.toml")
    command("reconstruct", run, "--continuous", "--out", out)
    found = {}
    for name, more in (("curve", ["--continuous"]), ("samples", [])):
        if not more:
            command("reconstruct", run, "--out", out, "--force")
        folder = str(tmp_path / name)
        command("certify", out, "--program", program, "--run", run, "--out", folder, "--trials", "200", *more)
        command("verify", folder)
        certificate = json.loads((tmp_path / name / "certificate.json").read_text())
        found[name] = {c["name"]: c for c in certificate["characteristics"]}
        assert certificate["measurement"].get("continuous", False) == bool(more)
    assert abs(found["curve"]["CR"]["value"] - 2.0) < found["curve"]["CR"]["u95"] < 0.3 * found["samples"]["CR"]["u95"]
    # the file is that of samples now
    assert "differs from" in refused("certify", out, "--program", program, "--run", run, "--out", run + "2", "--continuous")
