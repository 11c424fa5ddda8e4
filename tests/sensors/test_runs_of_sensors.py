"""Runs of an independent simulator with swivel encoders, and with eight drums, by the reference solver (tests/authorities/truth)."""

import gzip
import json

import numpy as np
import pytest
from rigs import HOME as START
from rigs import FloatArray
from truth_sets import Set

from lmeasure.core import se3
from lmeasure.sensors import follow, shared_errors, twists
from lmeasure.sensors.channel import predictions
from lmeasure.sensors.joint import solve_jointly, with_values
from lmeasure.sensors.solver import Solved


def truth_of(run: Set) -> FloatArray:
    """(n, 7) true poses."""
    with gzip.open(run.folder / "truth.csv.gz", "rt") as file:
        return np.loadtxt(file, delimiter=",", skiprows=1)[:, 1:]


def errors(run: Set, found: Solved) -> tuple[float, float]:
    """Root mean square errors of position [mm] and rotation [rad] over all samples."""
    assert (found.status == 0).all()
    square = (se3.displacement(found.poses, truth_of(run)) ** 2).mean(axis=0)
    return float(np.sqrt(square[3:].sum())), float(np.sqrt(square[:3].sum()))


def test_three_drums_and_three_swivels() -> None:
    run = Set("swivel-three", START)
    found = follow([*run.cables, *run.swivels], run.readings, START)
    position, rotation = errors(run, found)
    assert position == pytest.approx(0.02330, rel=0.05)
    assert rotation == pytest.approx(1.741e-4, rel=0.05)
    # codes of swivels at rest stand still, and so do their errors: 15 % on the rms of a few hundred that are independent
    stated = np.sqrt(np.einsum("nii->i", found.covariance[:, 3:, 3:]).sum() / len(found.poses))
    assert position == pytest.approx(stated, rel=0.15)


def test_eight_drums_whose_zero_phases_are_found() -> None:
    run = Set("eight-run", START)
    alone = follow(run.cables, run.readings, START)
    assert errors(run, alone)[0] == pytest.approx(0.0064, rel=0.05)
    phases = [f"{o.name}.zero_mm" for o in run.cables]
    position, rotation = errors(run, solve_jointly(run.cables, run.readings, alone.poses, phases).poses)
    assert position == pytest.approx(0.005329, rel=0.05)
    assert rotation == pytest.approx(6.260e-5, rel=0.05)


def test_swivels_tell_the_pose_and_what_the_drums_had_out() -> None:
    """No start pose, only a place about a hand away: the motion that the drums would make from there, and six absolute encoders beside it
    all along, tell what the drums counted from."""
    run, rough = Set("swivel-run", None), se3.displaced(START, [0.1, -0.1, 0.16, 80.0, -60.0, 40.0])
    zeros, truth = [f"{o.name}.zero_mm" for o in run.cables], truth_of(run)
    there = dict(zip(zeros, predictions(run.cables, rough[None])[0], strict=True))
    about = follow([with_values(o, there) for o in run.cables], run.readings[:, :6], rough)
    assert np.linalg.norm(about.poses[:, :3] - truth[:, :3], axis=1).max() > 50.0
    joint = solve_jointly([*run.cables, *run.swivels], run.readings, about.poses, zeros)
    position, rotation = errors(run, joint.poses)
    assert position == pytest.approx(0.004527, rel=0.05)
    assert rotation == pytest.approx(3.751e-5, rel=0.05)
    assert np.linalg.norm(joint.poses.poses[0, :3] - truth[0, :3]) < 0.0034
    # what is stated of the zeros: the length at the start and the phase, which is known here
    phases = 0.012 * np.array(json.loads((run.folder / "truth.json").read_text())["phase_counts"])
    u = np.sqrt(np.diag(joint.covariance))
    assert (np.abs(predictions(joint.channels[:6], truth[:1])[0] - phases) < 4.0 * u).all()
    assert (u < 0.01).all()
    # and the first pose is off by no more than both parts of its uncertainty
    G = twists(joint.channels, joint.poses.poses[:1])
    root = np.asarray(np.linalg.cholesky(joint.covariance))
    shared = shared_errors(joint.channels, joint.poses.poses[:1], G, tuple(zeros), root=root)[0]
    total = np.sqrt(np.diag(joint.poses.covariance[0] + shared @ shared.T))
    assert (np.abs(se3.displacement(joint.poses.poses[:1], truth[:1])[0]) < 4.0 * total).all()
