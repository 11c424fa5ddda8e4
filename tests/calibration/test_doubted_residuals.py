"""Residuals somewhat larger than chance has them: no alarm, and yet lengths that err are reckoned with, by as much as is likeliest."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy.stats
from random_campaigns import draw

from lmeasure.calibration import misfit
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


@pytest.mark.parametrize(
    ("name", "size", "said", "value"),
    [
        ("position", 0.3, "reference poses in error by 0.3 mm (1 sigma per axis) more than stated", 0.3),
        # at an arm of 200 mm
        ("rotation", 0.3, "reference poses in error by 0.0859 deg (1 sigma per axis) more than stated", 0.0859),
        ("pose", 0.3, "reference poses in error by 0.3 mm and 0.0859 deg (1 sigma per axis) more than stated", 0.3),
        ("stated", 1.5, "reference poses 1.8 times as uncertain as stated", 1.5),
        ("length", 0.02, "lengths of each cable that err by 0.02 mm on their own", 0.02),
    ],
)
def test_what_explains_residuals_is_said_in_its_unit(
    name: str, size: float, said: str, value: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(misfit, "arm_mm", lambda _: 200.0)
    monkeypatch.setattr(misfit, "_rms", lambda _: 0.0421)
    state: Any = SimpleNamespace(groups=(), sizes={("length", "ch1"): 0.5, (name, None): size}, problem=None, doubt=0.0, fit=None)
    begun: Any = SimpleNamespace(sizes={("length", "ch1"): 0.5}, fit=None)
    (found,) = misfit._told(state, begun)
    assert str(found.text).startswith("residuals of 0.0421 mm rms exceed the stated noise; " + said)
    assert found.channel is None
    assert found.value == pytest.approx(value, rel=1e-2)
    (doubted,) = misfit._told(SimpleNamespace(**vars(state) | {"doubt": 0.013}), begun)  # type: ignore[arg-type]
    rival = ". Lengths of all cables that err by 0.013 mm on their own explain nearly as much, and are reckoned with"
    assert str(doubted.text) == str(found.text) + ("" if name == "length" else rival)
    state.sizes[name, None] = 0.0
    assert misfit._told(state, begun) == []


def test_channels_that_err_are_said_by_their_kind() -> None:
    """A cable by a length, an encoder by an angle."""
    drawn = draw(4, points=6, poses=20).campaign
    cables = drawn.cables
    found = SimpleNamespace(chi2=1.0, residuals=np.full(4, 0.01), V=np.eye(4))
    for group, words in (("scale", "drums' circumferences (scales)"), ("radius", "pulleys' radii")):
        state: Any = SimpleNamespace(
            groups=(group,), sizes={("length", cables[1].channel): 0.2}, problem=SimpleNamespace(campaign=drawn), doubt=0.0, fit=found
        )
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(misfit, "_rms", lambda _: 0.5)
            told = misfit._told(state, SimpleNamespace(sizes={}, fit=found))  # type: ignore[arg-type]
        assert [f.channel for f in told] == [None, cables[1].channel]
        assert f"errors of the {words} explain them best" in str(told[0].text)
        assert str(told[0].text).endswith(f"(ask for it: --solve ...,{group})")
        assert told[0].value == 0.5
        assert f"lengths of channel {cables[1].channel} that err by 0.2 mm on their own" in str(told[1].text)
