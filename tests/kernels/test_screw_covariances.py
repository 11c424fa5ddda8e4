"""Covariances of poses by the screw method: difference quotients, noise, a start pose that is known."""

import math

import numpy as np
import pytest
from rows import HOME, cell_rows
from scipy.spatial.transform import Rotation
from screw_poses import U, changes_of, random_pose

from lmeasure.core import FloatArray, Status
from lmeasure.kernels import PARAMETERS, cable, pose_covariances, screw

# --- covariance --------------------------------------------------------------------------------------------------------------------


def pose_error(found: FloatArray, pose: FloatArray) -> FloatArray:
    """(6,) delta = (rotation; translation) of R_found = Exp(delta) R, base axes."""
    turn = Rotation.from_quat(found[3:]) * Rotation.from_quat(pose[3:]).inv()
    return np.r_[turn.as_rotvec(), found[:3] - pose[:3]]


def refound(rows: FloatArray, start: FloatArray, counts: FloatArray, pose: FloatArray, noise: FloatArray | None = None) -> FloatArray:
    """The pose that a rig finds from counts."""
    change = cable.changes_from_counts(rows, counts[None])[0] + (0 if noise is None else noise)
    targets = cable.span_lengths(rows, start[None])[0] + change
    status, _, _, found = screw.solve_pose(rows, targets, pose)
    assert status == Status.OK
    return np.asarray(found)


def with_parameter(rows: FloatArray, j: int, name: str, step: float) -> FloatArray:
    """The rig with one parameter of cable j changed; scale acts on the counts and is left to the caller."""
    out = rows.copy()
    column = {
        "x_mm": 0, "y_mm": 1, "z_mm": 2, "pulley_radius_mm": 6, "attachment_x_mm": 7, "attachment_y_mm": 8, "attachment_z_mm": 9,
        "tangent_length_mm": 10, "axial_offset_mm": 11, "guide_alpha_rad": 14, "guide_beta_rad": 15,
    }  # fmt: skip
    if name == "groove_pitch_mm":
        out[j, 12] += step / out[j, 16]
    elif name != "scale":
        out[j, column[name]] += step
        a, b = out[j, 14:16]
        out[j, 3:6] = -math.cos(a) * math.sin(b), -math.cos(a) * math.cos(b), math.sin(a)
    return out


@pytest.mark.parametrize("seed", range(3))
def test_covariances_against_difference_quotients(seed: int) -> None:
    """Each length and each of the 78 parameters is moved and the pose found again: J S J' for a full random covariance S."""
    rows, g = cell_rows(seed), np.random.default_rng(seed)
    start, pose = random_pose(g, 100.0, 0.1), random_pose(g, 200.0, 0.25)
    lengths = cable.span_lengths(rows, np.array([start, pose]))
    counts = cable.counts_from_changes(rows, lengths[1:] - lengths[:1])[0]
    scales = np.array([1.0, 0.5, 1, 2, 1, 1])
    variance = g.uniform(1e-6, 1e-4, 6)
    width = len(PARAMETERS)
    factor = g.normal(size=(6 * width, 6 * width)) * 1e-2
    covariance = factor @ factor.T
    random, systematic = pose_covariances(rows, start, pose[None], counts[None], scales, variance, covariance)

    h = 1e-3
    by_length = np.empty((6, 6))
    for j in range(6):
        ends = [pose_error(refound(rows, start, counts, pose, sign * h * np.eye(6)[j]), pose) for sign in (1, -1)]
        by_length[:, j] = (ends[0] - ends[1]) / (2 * h)
    assert random[0] == pytest.approx(by_length @ np.diag(variance) @ by_length.T, rel=1e-5, abs=1e-5 * np.abs(random[0]).max())

    by_parameter = np.empty((6, 6 * width))
    for j in range(6):
        for i, name in enumerate(PARAMETERS):
            step = 1e-6 if name == "scale" or name.startswith("guide") else 1e-3
            ends = []
            for sign in (1, -1):
                moved = counts.copy()
                if name == "scale":
                    moved[j] *= scales[j] / (scales[j] + sign * step)
                ends.append(pose_error(refound(with_parameter(rows, j, name, sign * step), start, moved, pose), pose))
            by_parameter[:, width * j + i] = (ends[0] - ends[1]) / (2 * step)
    expected = by_parameter @ covariance @ by_parameter.T
    size = np.sqrt(np.diag(expected))
    assert systematic[0] / np.outer(size, size) == pytest.approx(expected / np.outer(size, size), abs=1e-5)


def test_random_covariance_is_what_noise_does() -> None:
    """Monte Carlo: poses found from counts that were rounded scatter as the covariance says."""
    rows, g = cell_rows(), np.random.default_rng(9)
    truth = random_pose(g)
    counts = cable.counts_from_changes(rows, changes_of(truth[None], rows))[0]
    noise = g.uniform(-0.006, 0.006, (4000, 6))
    errors = np.array([pose_error(refound(rows, HOME, counts, truth, e), truth) for e in noise])
    random, _ = pose_covariances(
        rows, HOME, truth[None], counts[None], np.ones(6), np.full(6, 0.012**2 / 12), np.zeros((6 * len(PARAMETERS),) * 2)
    )
    size = np.sqrt(np.diag(random[0]))
    assert np.cov(errors.T) / np.outer(size, size) == pytest.approx(random[0] / np.outer(size, size), abs=0.08)


def test_start_pose_is_known_whatever_the_rig() -> None:
    """At the pose where the counters were zeroed an error of the rig moves nothing: systematic covariance 0."""
    rows = cell_rows()
    width = 6 * len(PARAMETERS)
    random, systematic = pose_covariances(rows, HOME, HOME[None], np.zeros((1, 6)), np.ones(6), U**2, np.eye(width))
    assert np.abs(systematic).max() < 1e-20
    assert np.isfinite(random).all()


def test_no_pose_has_no_covariance() -> None:
    width = 6 * len(PARAMETERS)
    random, systematic = pose_covariances(cell_rows(), HOME, np.full((1, 7), np.nan), np.zeros((1, 6)), np.ones(6), U**2, np.eye(width))
    assert np.isnan(random).all()
    assert np.isnan(systematic).all()
