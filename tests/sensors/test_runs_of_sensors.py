"""A run of three drums and three swivel encoders of an independent simulator, by the reference solver (tests/authorities/truth)."""

import gzip

import numpy as np
import pytest
from reference.continuation import follow
from reference.solver import Solved
from rigs import HOME as START, FloatArray
from truth_sets import Set

from lmeasure.core import se3


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
