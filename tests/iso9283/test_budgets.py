"""Budgets of results, recomputed by GTC. Published examples through the same propagation are in the qualification."""

from typing import Any

import GTC
import numpy as np
import pytest
from synthetic_trajectories import StatedErrors, some_law, synthetic_campaign

from lmeasure.core import FloatArray
from lmeasure.iso9283 import CertificationSettings, Spread, Subject, evaluate, propagate
from lmeasure.recording import Program
from lmeasure.trajectory import PoseErrors


def u_of(found: Spread) -> float:
    return float(np.hypot(found.u_random, found.u_systematic))


def correlation_of(one: Spread, other: Spread) -> float:
    return float(one.sensitivities @ other.sensitivities / np.linalg.norm(one.sensitivities) / np.linalg.norm(other.sensitivities))


@pytest.fixture(scope="module")
def certified() -> Any:
    trajectory, program = synthetic_campaign(np.array([0.3, -0.2, 0.1]), 0.05)
    model = StatedErrors(some_law(1), some_law(2))
    return evaluate(trajectory, Program.model_validate(program), model, settings=CertificationSettings(trials=500))


def test_another_program_recomputes_every_result_from_its_budget(certified: Any) -> None:
    for c in certified.characteristics:
        table = c.as_dict()
        rows = [
            r["sensitivity"] * GTC.ureal(r["value"], r["u"], r["degrees_of_freedom"] or np.inf)
            for r in table["budget"]
            if r["contribution"]
        ]
        y = sum(rows, start=GTC.ureal(table["value"], 0.0))
        assert GTC.value(y) == pytest.approx(table["value"], rel=1e-12)
        assert GTC.uncertainty(y) == pytest.approx(table["u"], rel=1e-6, abs=1e-15), c.key
        assert table["u"] == pytest.approx(np.hypot(c.u_random, c.u_systematic), rel=1e-9)
        assert table["u95"] == pytest.approx(table["u"] * table["coverage_factor"], rel=1e-9)
        assert sum(r["share_percent"] for r in table["budget"]) == pytest.approx(100.0, rel=1e-9)
        freedom = GTC.dof(y)
        assert (table.get("degrees_of_freedom") or np.inf) == (pytest.approx(freedom, rel=1e-6) if freedom < 1e4 else np.inf)


def test_means_distances_and_their_correlation_are_those_of_gtc(certified: Any) -> None:
    """Independent errors of each cycle and common ones, written out for GTC: the linear results to 1e-6, lengths to the step's square."""
    rng = np.random.default_rng(3)
    cycles, own, common = 7, 0.02 * rng.normal(size=(3, 3)), 0.1 * rng.normal(size=(3, 2))
    places = {Subject("pose", n): rng.normal(size=(cycles, 3)) for n in ("P1", "P2")}

    class Cycles:
        def __init__(self, positions: FloatArray) -> None:
            self.positions = positions
            own_, shared = np.zeros((cycles, 6, 3)), np.zeros((cycles, 6, 2))
            own_[:, 3:], shared[:, 3:] = own, common
            self.errors = PoseErrors.of(own_, shared)

        def state(self, errors: FloatArray, reduced: bool) -> FloatArray:
            return np.asarray(self.positions + errors[..., 3:])

    one, two = places
    figures = [
        lambda s: s[one].mean(axis=-2)[..., 0],
        lambda s: s[two].mean(axis=-2)[..., 1],
        lambda s: np.linalg.norm(s[one].mean(axis=-2) - s[two].mean(axis=-2), axis=-1),
    ]
    found = propagate({k: Cycles(p) for k, p in places.items()}, figures, trials=200, seed=1)
    z = [GTC.ureal(0.0, 1.0) for _ in range(2)]
    means = {}
    for k, p in places.items():
        poses = []
        for at in p:
            w = [GTC.ureal(0.0, 1.0) for _ in range(3)]
            poses.append([at[i] + sum(own[i, j] * w[j] for j in range(3)) + sum(common[i, j] * z[j] for j in range(2)) for i in range(3)])
        means[k] = [sum(pose[i] for pose in poses) / cycles for i in range(3)]
    apart = [a - b for a, b in zip(means[one], means[two], strict=True)]
    wanted = [means[one][0], means[two][1], GTC.sqrt(sum(d * d for d in apart))]
    for mine, theirs, close in zip(found, wanted, (1e-6, 1e-6, 1e-4), strict=True):
        assert u_of(mine) == pytest.approx(GTC.uncertainty(theirs), rel=close)
    for a, b, close in ((0, 1, 1e-6), (0, 2, 1e-3), (1, 2, 1e-3)):
        assert correlation_of(found[a], found[b]) == pytest.approx(GTC.get_correlation(wanted[a], wanted[b]), abs=close)
