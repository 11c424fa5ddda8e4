"""Controller angles: each convention against matrices written out by hand, and there and back."""

import numpy as np
import oracles
import pytest
from hypothesis import given, settings, strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from lmeasure.core import CONVENTIONS, FileFormatError, FloatArray, angles_from_rotation, convention, rotation_from_angles
from lmeasure.core.conventions import DEFAULT, OF_DOCUMENTS


def written_out(name: str, angles: FloatArray) -> FloatArray:
    """base_from_tool as the convention's manual writes it."""
    a, b, c = (float(x) for x in angles)
    if name == "puma-oat":
        return oracles.puma_oat(a, b, c)
    if name == "kuka-abc":
        return np.asarray(oracles.rz(a) @ oracles.ry(b) @ oracles.rx(c))
    if name == "fanuc-wpr":
        return np.asarray(oracles.rz(c) @ oracles.ry(b) @ oracles.rx(a))
    if name == "staubli-xyz":
        return np.asarray(oracles.rx(a) @ oracles.ry(b) @ oracles.rz(c))
    if name == "zyz":
        return np.asarray(oracles.rz(a) @ oracles.ry(b) @ oracles.rz(c))
    if name == "fixed-xyz":
        return np.asarray(oracles.rz(c) @ oracles.ry(b) @ oracles.rx(a))
    if name == "zxz":
        return np.asarray(oracles.rz(a) @ oracles.rx(b) @ oracles.rz(c))
    return np.asarray(expm(oracles.skew([a, b, c])))


NAMES = sorted(CONVENTIONS | OF_DOCUMENTS)


@pytest.mark.parametrize("name", NAMES)
def test_angles_are_the_matrix_of_the_manual(name: str) -> None:
    g = np.random.default_rng(2)
    angles = g.uniform(-400, 400, (200, 3))
    if name == "ur-rotation-vector":
        angles = np.radians(angles)
    for row, matrix in zip(angles, rotation_from_angles(name, angles).as_matrix(), strict=True):
        assert matrix == pytest.approx(written_out(name, row), abs=1e-12)


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: sum(x * x for x in q) > 1e-3))
def test_every_rotation_goes_there_and_back(name: str, q: list[float]) -> None:
    rotation = Rotation.from_quat(q)
    angles = angles_from_rotation(name, rotation)
    # near a singular orientation two angles share one turn: compare the rotations. arcsin loses half the digits there
    assert (rotation_from_angles(name, angles).inv() * rotation).magnitude() < 2e-7
    if name != "ur-rotation-vector":
        assert (angles > -180).all()
        assert (angles <= 180).all()


@pytest.mark.parametrize("name", NAMES)
def test_singular_orientations_are_rotations_like_others(name: str) -> None:
    """The identity is singular for puma-oat and zyz, and a middle angle of 90 degrees for the rest."""
    for rotation in (
        Rotation.identity(),
        *(Rotation.from_matrix(written_out(name, np.array(row))) for row in ([10.0, 90, 20], [10, -90, 20], [3, 0, 5])),
    ):
        angles = angles_from_rotation(name, rotation)
        assert np.isfinite(angles).all()
        assert (rotation_from_angles(name, angles).inv() * rotation).magnitude() < 5e-8


def test_angles_wrap_around() -> None:
    for name in NAMES:
        if name == "ur-rotation-vector":
            continue
        near, far = rotation_from_angles(name, [179.0, 20, -170]), rotation_from_angles(name, [179.0 - 360, 20 + 360, -170 + 720])
        assert (near.inv() * far).magnitude() < 1e-13


def test_identity_is_singular_in_the_puma_convention() -> None:
    assert rotation_from_angles("puma-oat", [0.0, -90, 90]).as_matrix() == pytest.approx(np.eye(3), abs=1e-15)
    assert angles_from_rotation("puma-oat", Rotation.identity())[1] == pytest.approx(-90)


def test_thesis_poses_are_proper_rotations() -> None:
    """Thesis 5.5: M orthogonal with determinant +1, which the printed M11 and M21 are not."""
    g = np.random.default_rng(0)
    for o, a, t in g.uniform(-180, 180, (50, 3)):
        m = oracles.puma_oat(o, a, t)
        assert m @ m.T == pytest.approx(np.eye(3), abs=1e-14)
        assert np.linalg.det(m) == pytest.approx(1)


def test_many_angles_at_once() -> None:
    angles = np.zeros((5, 3)) + [1, 2, 3]
    assert angles_from_rotation("kuka-abc", rotation_from_angles("kuka-abc", angles)) == pytest.approx(angles, abs=1e-12)


def test_default_and_unknown() -> None:
    assert DEFAULT == "puma-oat"
    assert convention("kuka-abc").columns == ("a_deg", "b_deg", "c_deg")
    with pytest.raises(FileFormatError, match=r"angles = 'euler' is not a known convention. Use one of puma-oat, kuka-abc"):
        convention("euler")
