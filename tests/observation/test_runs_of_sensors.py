"""Runs of an independent simulator with swivel encoders, and with eight drums, by the reference solver (tests/authorities/truth)."""

import gzip
import json
from pathlib import Path
from tomllib import loads
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lmeasure import se3
from lmeasure.observation import Solved, SwivelAngle, follow, predictions, shared_errors, twists
from lmeasure.observation.joint import solve_jointly, with_values
from lmeasure.observation.of_rig import cable_lengths, swivel_angle
from lmeasure.rig import rig_from_dict

FloatArray = NDArray[np.float64]
AUTHORITY = Path(__file__).parents[1] / "authorities" / "truth"
START = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


class Set:
    """A set's channels, readings (n, m), drums first, and true poses (n, 7)."""

    def __init__(self, name: str, start: FloatArray | None) -> None:
        data: dict[str, Any] = loads((AUTHORITY / name / "rig.toml").read_text())
        encoders = data.pop("swivel", [])
        rig = rig_from_dict(data)
        self.cables = cable_lengths(rig, start)
        to = {c.from_point: c.to_point for c in rig.cable}
        self.swivels: list[SwivelAngle] = [
            swivel_angle(
                rig, e["channel"], e["point"], to[e["point"]], counts_per_revolution=e["counts_per_revolution"], zero_deg=e["zero_deg"]
            )
            for e in encoders
        ]
        with (AUTHORITY / name / "pass1.csv").open() as file:
            columns = file.readline().strip().split(",")
            table = dict(zip(columns, np.loadtxt(file, delimiter=",").T, strict=True))
        signs = [rig.point(c.from_point).drum.count_sign for c in rig.cable]
        lengths = [o.readings(table[o.name], sign) for o, sign in zip(self.cables, signs, strict=True)]
        codes = [2.0 * np.pi * table[e["channel"]] / e["counts_per_revolution"] for e in encoders]
        self.readings = np.stack(lengths + codes, axis=1)
        with gzip.open(AUTHORITY / name / "truth.csv.gz", "rt") as file:
            self.truth = np.loadtxt(file, delimiter=",", skiprows=1)[:, 1:]

    def errors(self, found: Solved) -> tuple[float, float]:
        """Root mean square errors of position [mm] and rotation [rad] over all samples."""
        assert (found.status == 0).all()
        square = (se3.displacement(found.poses, self.truth) ** 2).mean(axis=0)
        return float(np.sqrt(square[3:].sum())), float(np.sqrt(square[:3].sum()))


def test_three_drums_and_three_swivels() -> None:
    run = Set("swivel-three", START)
    found = follow([*run.cables, *run.swivels], run.readings, START)
    position, rotation = run.errors(found)
    assert position == pytest.approx(0.02330, rel=0.05)
    assert rotation == pytest.approx(1.741e-4, rel=0.05)
    # codes of swivels at rest stand still, and so do their errors: 15 % on the rms of a few hundred that are independent
    stated = np.sqrt(np.einsum("nii->i", found.covariance[:, 3:, 3:]).sum() / len(found.poses))
    assert position == pytest.approx(stated, rel=0.15)


def test_eight_drums_whose_zero_phases_are_found() -> None:
    run = Set("eight-run", START)
    alone = follow(run.cables, run.readings, START)
    assert run.errors(alone)[0] == pytest.approx(0.0064, rel=0.05)
    phases = [f"{o.name}.zero_mm" for o in run.cables]
    position, rotation = run.errors(solve_jointly(run.cables, run.readings, alone.poses, phases).poses)
    assert position == pytest.approx(0.005329, rel=0.05)
    assert rotation == pytest.approx(6.260e-5, rel=0.05)


def test_swivels_tell_the_pose_and_what_the_drums_had_out() -> None:
    """No start pose, only a place about a hand away: the motion that the drums would make from there, and six absolute encoders beside it
    all along, tell what the drums counted from."""
    run, rough = Set("swivel-run", None), se3.displaced(START, [0.1, -0.1, 0.16, 80.0, -60.0, 40.0])
    zeros = [f"{o.name}.zero_mm" for o in run.cables]
    there = dict(zip(zeros, predictions(run.cables, rough[None])[0], strict=True))
    about = follow([with_values(o, there) for o in run.cables], run.readings[:, :6], rough)
    assert np.linalg.norm(about.poses[:, :3] - run.truth[:, :3], axis=1).max() > 50.0
    joint = solve_jointly([*run.cables, *run.swivels], run.readings, about.poses, zeros)
    position, rotation = run.errors(joint.poses)
    assert position == pytest.approx(0.004527, rel=0.05)
    assert rotation == pytest.approx(3.751e-5, rel=0.05)
    assert np.linalg.norm(joint.poses.poses[0, :3] - run.truth[0, :3]) < 0.0034
    # what is stated of the zeros: the length at the start and the phase, which is known here
    phases = 0.012 * np.array(json.loads((AUTHORITY / "swivel-run" / "truth.json").read_text())["phase_counts"])
    u = np.sqrt(np.diag(joint.covariance))
    assert (np.abs(predictions(joint.channels[:6], run.truth[:1])[0] - phases) < 4.0 * u).all()
    assert (u < 0.01).all()
    # and the first pose is off by no more than both parts of its uncertainty
    G = twists(joint.channels, joint.poses.poses[:1])
    root = np.asarray(np.linalg.cholesky(joint.covariance))
    shared = shared_errors(joint.channels, joint.poses.poses[:1], G, tuple(zeros), root)[0]
    total = np.sqrt(np.diag(joint.poses.covariance[0] + shared @ shared.T))
    assert (np.abs(se3.displacement(joint.poses.poses[:1], run.truth[:1])[0]) < 4.0 * total).all()
