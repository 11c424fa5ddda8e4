"""Start pose and dimensions that nobody stated are one error of a whole run: they widen pose accuracy, and not repeatability."""

import itertools
from typing import Literal

import numpy as np
import pytest
import real_rig
from test_unsolved import START, nominal, truth

from lmeasure.core import se3
from lmeasure.iso9283 import CertificationSettings, Evaluation, evaluate
from lmeasure.recording import Counts, Program, Run
from lmeasure.rig import rig_from_dict
from lmeasure.trajectory import ErrorsOfRun, align, reconstruct

RATE_HZ, CYCLES = 50.0, 8
PLACES = np.array([[100.0, 50, 20], [130, 50, 20], [-150, 120, -80]])


def certified(seed: int, unstated: Literal["typical", "exact"]) -> tuple[Evaluation, np.ndarray]:
    """The figures of a run that states nothing but its temperature, and the true positions (3, cycles, 3), by an independent forward
    model with start pose, count lengths and attachment points off by typical sizes."""
    rng, plain = np.random.default_rng(seed), truth(20)
    true = real_rig.without(plain, stretch=rng.normal(0, 5e-4, 6), tool=rng.normal(0, 0.3, (3, 3)))
    order = np.tile(np.arange(3), CYCLES)
    stops = np.vstack([np.zeros(3), PLACES[order] + rng.normal(0, 0.05, (len(order), 3))])
    rest, way = 30, 40
    s = np.linspace(0.0, 1.0, way)[:, None]
    parts = [np.tile(stops[0], (rest, 1))]
    for a, b in itertools.pairwise(stops):
        parts += [a + (b - a) * (10 * s**3 - 15 * s**4 + 6 * s**5), np.tile(b, (rest, 1))]
    x = np.vstack(parts)
    poses = np.tile(START, (len(x), 1))
    poses[:, :3] += x
    begun = se3.displaced(START[None], np.r_[rng.normal(0, np.radians(0.05), 3), rng.normal(0, 0.3, 3)][None])[0]
    rig = rig_from_dict(nominal(plain) | {"unstated": unstated})
    time_s = np.arange(len(x)) / RATE_HZ
    counts = Counts(time_s, rig.channels, np.rint(true.true_counts(poses, begun)))
    run = Run(rig, START, (counts,), unstated=unstated, temperature_c=20.0)
    windows = [(np.array([5, rest - 5]) + way * (n + 1) + rest * (n + 1)) / RATE_HZ for n in range(len(order))]
    stated = [
        {
            "name": f"P{i + 1}",
            "position_mm": PLACES[i].tolist(),
            "quaternion_xyzw": START[3:].tolist(),
            "windows_s": [windows[n].tolist() for n in np.flatnonzero(order == i)],
        }
        for i in range(3)
    ]
    program = Program.model_validate({"schema": "lmeasure.program/1", "pose": stated})
    aligned = align(run)
    found = reconstruct(aligned, covariances=False)
    figures = evaluate(found, program, ErrorsOfRun(aligned), run=run, settings=CertificationSettings(trials=300))
    return figures, np.array([stops[1:][order == i] for i in range(3)])


def test_common_effects_widen_pose_accuracy_and_not_repeatability_or_near_distances() -> None:
    by_kind = {}
    kinds: tuple[Literal["typical", "exact"], ...] = ("exact", "typical")
    for unstated in kinds:
        figures = certified(1, unstated)[0].characteristics
        by_kind[unstated] = {name: max(c.u95 for c in figures if c.name == name and c.u95) for name in ("AP_p", "RP_l", "RD", "AD_p")}
    exact, typical = by_kind["exact"], by_kind["typical"]
    assert typical["AP_p"] > 100.0 * exact["AP_p"]
    assert typical["RP_l"] < 0.2 * typical["AP_p"]
    assert typical["RD"] < 0.2 * typical["AP_p"]
    assert typical["AD_p"] < 0.25 * typical["AP_p"]


@pytest.mark.parametrize("seed", range(5))
def test_figures_hold_the_truth(seed: int) -> None:
    figures, true = certified(seed, "typical")
    for i, places in enumerate(true):
        mean = places.mean(axis=0)
        away = np.linalg.norm(places - mean, axis=1)
        expected = {"AP_p": np.linalg.norm(mean - PLACES[i]), "RP_l": away.mean() + 3.0 * away.std(ddof=1)}
        for c in figures.characteristics:
            if c.name in expected and c.pose == f"P{i + 1}":
                assert c.u95 is not None
                assert abs(c.value - expected[c.name]) <= 1.3 * c.u95
