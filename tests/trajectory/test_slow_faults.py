"""Slow faults of six cables, by a forward model that shares no code: what returns and paths forth and back show, and from which size on."""

import itertools
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import real_rig
from test_unsolved import START, nominal, truth

from lmeasure.core import FloatArray
from lmeasure.recording import Counts, Run
from lmeasure.rig import rig_from_dict
from lmeasure.trajectory import Trajectory, covariances, proposed_returns, reconstruct

STOPS = np.array([[0.0, 0, 0], [200, 0, 0], [0, 180, 60], [-120, 60, -150]])
ORDER = (0, 1, 0, 2, 0, 3, 0, 1, 0, 2, 0, 3, 0)
RATE_HZ, SPEED_MM_S = 100.0, 400.0
LATE = 2
"""The channel that errs."""


def motion(rng: np.random.Generator, order: tuple[int, ...] = ORDER, repeats_mm: float = 0.02) -> tuple[FloatArray, FloatArray]:
    """Times (n,) and poses (n, 7) of a robot that rests at stops and moves between them by minimum jerk, off its path by up to 0.03 mm."""
    stops = STOPS[list(order)] + rng.normal(0, repeats_mm, (len(order), 3))
    stops[0] = 0.0
    parts = []
    for a, b in itertools.pairwise(stops):
        s = np.linspace(0.0, 1.0, int(1.875 * np.linalg.norm(b - a) / SPEED_MM_S * RATE_HZ))
        off = rng.normal(0, 0.03, 3) * np.sin(np.pi * s)[:, None]
        parts += [np.tile(a, (int(0.5 * RATE_HZ), 1)), a + (b - a) * (10 * s**3 - 15 * s**4 + 6 * s**5)[:, None] + off]
    places = np.concatenate([*parts, np.tile(stops[-1], (int(0.5 * RATE_HZ), 1))])
    poses = np.tile(START, (len(places), 1))
    poses[:, :3] += places
    return np.arange(len(poses)) / RATE_HZ, poses


def measured(
    seed: int = 1, late_s: float = 0.0, lost: float = 0.0, moved: Any = None, order: tuple[int, ...] = ORDER
) -> tuple[Trajectory, Run]:
    """The trajectory of such a run with a channel that is late, that loses counts evenly, or whose point moves half-way [mm]."""
    true = truth(2)
    time_s, poses = motion(np.random.default_rng(seed), order)
    counts = true.true_counts(poses, START)
    if moved is not None:
        base = true.base.copy()
        base[LATE] += moved
        other = replace(true, base=base)
        # what was out where the counters were zeroed was out of the old point
        begun = (other.spans(START[None])[0] - true.spans(START[None])[0])[0, LATE] / real_rig.COUNT_MM
        share = np.clip(5.0 * time_s / time_s[-1] - 2.0, 0.0, 1.0)
        counts[:, LATE] += share * (other.true_counts(poses, START)[:, LATE] + begun - counts[:, LATE])
    counts[:, LATE] = np.interp(time_s - late_s, time_s, counts[:, LATE]) - lost * time_s / time_s[-1]
    rig = rig_from_dict(nominal(true))
    run = Run(rig, START, (Counts(time_s, rig.channels, np.rint(counts)),), unstated="exact")
    return reconstruct(run), run


def said(found: Trajectory) -> str:
    return "; ".join(map(str, found.notes))


def sizes(found: Trajectory) -> dict[str, float]:
    """The sizes that the notes state."""
    text = said(found)
    shapes = {
        "lost_mm": r"lost counts of ([0-9.]+) mm",
        "along_mm": r"moved by ([0-9.]+) mm along",
        "late_ms": r"late by ([0-9.]+) ms",
        "warmer_k": r"warmed by ([0-9.]+) K",
    }
    return {name: float(m[1]) for name, shape in shapes.items() if (m := re.search(shape, text))}


def accused(found: Trajectory) -> bool:
    text = said(found)
    return "behind the others" in text or "does not close" in text or "suspected" in text


def test_sound_runs_are_not_accused_and_state_their_sizes() -> None:
    for seed in range(4):
        found, _ = measured(seed)
        assert not accused(found)
        assert set(sizes(found)) == {"lost_mm", "along_mm", "late_ms", "warmer_k"}


@pytest.mark.parametrize("seed", [1, 2])
def test_faults_somewhat_larger_than_the_stated_sizes_show(seed: int) -> None:
    least = sizes(measured(seed)[0])
    for sign in (1.0, -1.0):
        assert "channel ch3 is behind the others" in said(measured(seed, late_s=sign * 1.3e-3 * least["late_ms"])[0])
    assert accused(measured(seed, lost=1.3 * least["lost_mm"] / real_rig.COUNT_MM)[0])
    # the point moves along its cable at the first stop
    arm = truth(2).base[LATE] / np.linalg.norm(truth(2).base[LATE])
    assert accused(measured(seed, moved=2.0 * least["along_mm"] * arm)[0])


def test_a_late_channel_is_in_the_uncertainty() -> None:
    found, run = measured(late_s=0.004)
    true = motion(np.random.default_rng(1))[1]
    error = np.linalg.norm(found.poses[:, :3] - true[:, :3], axis=1)
    u = np.sqrt(np.einsum("nii->n", (found.random + found.systematic)[:, 3:, 3:]))
    fast = error > 0.5 * error.max()
    assert error.max() > 0.2
    np.testing.assert_array_less(error[fast], 2.0 * u[fast])
    np.testing.assert_allclose(covariances(found, run).systematic[fast], found.systematic[fast], rtol=1e-9, atol=1e-15)


def test_a_run_without_returns_says_what_would_help() -> None:
    text = said(measured(order=(0, 1, 2, 3))[0])
    assert "no position was visited again" in text
    assert "no path was followed forth and back" in text


def test_a_plan_proposes_returns() -> None:
    rig = rig_from_dict(nominal(truth(2)))
    poses = real_rig.path(np.random.default_rng(3), 12)
    (line,) = proposed_returns(rig, poses, [f"p{i}" for i in range(12)], 500.0)
    assert re.match(r"rest again at p0, p\d+, p\d+ at the end, and follow one path forth and back at 500 mm/s. This shows ", str(line))
    assert "a rig that warmed by" in str(line)
    assert proposed_returns(rig, poses[:2], ["a", "b"]) == []
