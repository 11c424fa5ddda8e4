"""Residuals somewhat larger than chance has them: no alarm, and yet lengths that err are reckoned with, by as much as is likeliest."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats
from random_campaigns import draw

from lmeasure.calibration.misfit import explain_misfit
from lmeasure.calibration.residuals import unknowns_of
from lmeasure.calibration.unknowns import Model
from lmeasure.estimation import Fit, fit


def fitted(times: float) -> Fit:
    """A campaign whose errors are so many times those that are stated."""
    drawn = draw(4, points=6, poses=20)
    campaign = drawn.campaign
    model = Model(campaign, unknowns_of(campaign, ("position", "guide")))
    found = fit(model, model.start)
    modelled = campaign.counts.copy()
    # a count is so much of a length here
    per_count = 0.012
    modelled[model.pose_index, model.cable_index] += found.residuals / per_count
    counts = modelled + times * (campaign.counts - modelled)
    louder = Model(replace(campaign, counts=counts), unknowns_of(campaign, ("position", "guide")))
    return fit(louder, louder.start)


def likeliest(found: Fit) -> float:
    """The size of errors that each length has on its own, that of its zero reading in all of its cable, by restricted likelihood: brute
    force over sizes."""
    model = found.problem
    assert isinstance(model, Model)
    J = model.jacobian(found.theta)
    same = model.cable_index[:, None] == model.cable_index
    S = np.eye(len(J)) + same
    best, least = 0.0, np.inf
    for u in np.linspace(0.0, 0.02, 401):
        V = found.V + u**2 * S
        W = np.linalg.inv(V)
        N = J.T @ W @ J
        P = W - W @ J @ np.linalg.solve(N, J.T @ W)
        loss = np.linalg.slogdet(V)[1] + np.linalg.slogdet(N)[1] + float(found.residuals @ P @ found.residuals)
        if loss < least:
            best, least = float(u), loss
    return best


@pytest.mark.parametrize(("chance", "doubted"), [(0.3, False), (0.03, False), (0.015, True), (0.002, True)])
def test_what_is_doubted_is_the_likeliest_error_of_lengths(chance: float, doubted: bool) -> None:
    found = fitted(1.0)
    times = float(np.sqrt(scipy.stats.chi2.isf(chance, found.freedom) / found.chi2))
    found = fitted(times)
    model = found.problem
    assert isinstance(model, Model)
    assert scipy.stats.chi2.sf(found.chi2, found.freedom) == pytest.approx(chance, rel=0.2)
    told = explain_misfit(model, found, [])
    assert told.findings == []
    assert not told.estimated
    assert told.fit is found
    np.testing.assert_allclose(told.u_length_mm, likeliest(found) if doubted else 0.0, atol=1e-4)
    assert (told.u_length_mm > 0.0).all() == doubted
