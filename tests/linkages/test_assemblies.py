"""Every pose that has given lengths: the thesis' example, rigs of tetrahedra, and rigs of none."""

import numpy as np
import pytest
from cells import FloatArray, cell, motion

from lmeasure.kernels import CABLE_COLUMNS, span_lengths
from lmeasure.linkages import closed_form, distances, wrapped_assemblies

THREE_TWO_ONE = ("P1", "P1", "P1", "P2", "P2", "P3")


def rows_of(pairs: tuple[str, ...]) -> FloatArray:
    data = cell().to_dict()
    return cell(cable=[dict(c, to=point) for c, point in zip(data["cable"], pairs, strict=True)]).cable_rows()


def thesis() -> tuple[FloatArray, FloatArray]:
    """4.1 as corrected: legs B2P1, B3P1, B4P1, B1P4, B1P3, B3P2 in centimetres, say."""
    base = {1: (1, 5, 0), 2: (3, 3, 0), 3: (4, 2, 0), 4: (1, 1, 0)}
    tool = {1: (0, 0, 0), 2: (1, 2, 0), 3: (-2, 2, 0), 4: (0, 4, 0)}
    rows = np.zeros((6, CABLE_COLUMNS))
    for row, (b, p) in zip(rows, ((2, 1), (3, 1), (4, 1), (1, 4), (1, 3), (3, 2)), strict=True):
        row[:3], row[3:6], row[7:10] = base[b], (0, 0, 1), tool[p]
    return rows, np.array([10.0, 10.5, 11.0, 8.9, 7.98, 9.9])


@pytest.mark.parametrize("pairs", [THREE_TWO_ONE, ("P1", "P1", "P2", "P2", "P3", "P3")])
def test_the_true_pose_is_among_them_whatever_the_starts(pairs: tuple[str, ...]) -> None:
    rows, poses = rows_of(pairs), motion(1500)[1][::500]
    for pose in poses:
        lengths = span_lengths(rows, pose[None])[0]
        found, sure = wrapped_assemblies(rows, lengths)
        assert sure
        assert distances(found, pose[:3], pose[3:], 150.0).min() < 1e-6
        assert np.abs(span_lengths(rows, found) - lengths).max() < 1e-9
        assert len(wrapped_assemblies(rows, lengths, seed=1)[0]) == len(found)


def test_tetrahedra_find_all_that_many_starts_find_of_straight_cables() -> None:
    rows = rows_of(THREE_TWO_ONE)
    rows[:, 6] = 0.0
    lengths = span_lengths(rows, motion(700)[1][600:601])[0]
    direct, closes = closed_form(rows[:, :3], rows[:, 7:10], lengths)
    exact = direct[closes]
    assert np.abs(span_lengths(rows, exact) - lengths).max() < 1e-9
    found, sure = wrapped_assemblies(rows, lengths)
    assert sure
    assert len(found) == len(exact)
    for pose in exact:
        assert distances(found, pose[:3], pose[3:], 150.0).min() < 1e-6


def test_lengths_that_cannot_be_have_none() -> None:
    found, sure = wrapped_assemblies(rows_of(THREE_TWO_ONE), np.full(6, 20.0))
    assert found.shape == (0, 7)
    assert not sure
