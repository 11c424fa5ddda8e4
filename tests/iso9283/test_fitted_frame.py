"""The frame that is fitted to attained poses, and what it takes of their errors, against frames fitted to erring poses."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lmeasure.core import CertificationError, FloatArray, se3
from lmeasure.iso9283.attainment import fit_frame, follows
from lmeasure.iso9283.figure import Subject

CORNERS = np.array([[0.0, 0.0, 0.0], [300.0, 20.0, 0.0], [-40.0, 250.0, 10.0], [70.0, 60.0, 200.0]])


def attained(commanded: FloatArray, cycles: FloatArray) -> Any:
    """A pose that is commanded at (3,), attained at poses (n, 7)."""
    return SimpleNamespace(commanded=np.r_[commanded, 0.0, 0.0, 0.0, 1.0], poses=cycles)


def at(positions: FloatArray) -> FloatArray:
    """(n, 7) poses at (n, 3), all turned alike."""
    return se3.pose(positions, Rotation.identity(len(positions)))


@pytest.mark.parametrize("places", [CORNERS, CORNERS[:3]])
def test_a_frame_brings_commanded_poses_to_the_means_of_the_attained_ones(places: FloatArray) -> None:
    """Whatever their cycles scatter by, and a pose with many of them weighs no more than another."""
    rng = np.random.default_rng(1)
    turn, shift = Rotation.from_rotvec([2.0, -0.4, 0.7]), np.array([1500.0, -200.0, 30.0])
    poses = []
    for i, place in enumerate(places):
        away = 5.0 * rng.normal(size=(3 + 4 * i, 3))
        poses.append(attained(place, at(turn.apply(place) + shift + away - away.mean(axis=0))))
    frame = fit_frame(poses)
    np.testing.assert_allclose(frame[:3], shift, atol=1e-9)
    assert (se3.rotation(frame[None]) * turn.inv()).magnitude()[0] < 1e-12


@pytest.mark.parametrize(("high", "fixed"), [(1.21, False), (1.24, True)])
@pytest.mark.parametrize("away", [0.0, 1000.0])
def test_poses_fix_a_frame_where_they_are_a_millimetre_across(high: float, fixed: bool, away: float) -> None:
    """By the root of the sum of squares across their line: of three of which the middle one is h aside, the root of two thirds times h."""
    places = np.array([[-100.0, 0.0, 0.0], [0.0, high, 0.0], [100.0, 0.0, 0.0]]) + away
    poses = [attained(place, at(place[None])) for place in places]
    if fixed:
        np.testing.assert_allclose(fit_frame(poses)[:3], 0.0, atol=1e-6)
        return
    with pytest.raises(CertificationError, match="3 poses with windows, or poses on one line, fix no frame"):
        fit_frame(poses)


@pytest.mark.parametrize("number", [1, 2])
def test_fewer_than_three_poses_fix_no_frame(number: int) -> None:
    with pytest.raises(CertificationError, match=f"alignment: {number} poses"):
        fit_frame([attained(place, at(place[None])) for place in CORNERS[:number]])


def test_what_a_frame_takes_of_errors_is_what_a_frame_fitted_to_erring_poses_does() -> None:
    """Derivatives of poses in such a frame, of those it is fitted to and of a place on a path, to which it is not."""
    rng, step = np.random.default_rng(2), 1e-5
    cycles = {Subject("pose", f"P{i}"): place + rng.normal(size=(2 + i, 3)) for i, place in enumerate(CORNERS)}
    places = cycles | {Subject("path", "line"): np.array([[500.0, -300.0, 80.0], [0.0, 0.0, -900.0]])}
    parts: Any = {key: SimpleNamespace(positions=positions) for key, positions in places.items()}
    errors = {key: rng.normal(size=(2, len(positions), 6)) * np.repeat([1e-3, 1.0], 3) for key, positions in places.items()}
    found = follows(parts)(errors)
    for draw in range(2):
        alone = follows(parts)({key: e[draw] for key, e in errors.items()})
        assert all(np.allclose(alone[key], found[key][draw], rtol=1e-12, atol=1e-15) for key in places)
        moved = {key: se3.displaced(at(places[key]), step * errors[key][draw]) for key in places}
        frame = fit_frame([attained(cycles[key].mean(axis=0), moved[key]) for key in cycles])
        for key, positions in places.items():
            derivative = se3.displacement(se3.between(frame, moved[key]), at(positions)) / step
            assert np.abs((found[key][draw] - derivative) / np.repeat([1e-3, 1.0], 3)).max() < 1e-3
