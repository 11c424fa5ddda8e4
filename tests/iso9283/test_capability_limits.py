"""What may be said of a figure: verdicts just inside and just outside of each limit, and whose verdict a component takes."""

import math
from dataclasses import replace
from typing import Any

import pytest
from scipy.stats import norm

from lmeasure.iso9283 import CertificationSettings, undecided
from lmeasure.iso9283.characteristic import Characteristic
from lmeasure.iso9283.evaluation import conformity, limit_of, tolerance_of, with_verdict, with_verdicts
from lmeasure.recording import Tolerance
from lmeasure.text import message


def tolerance(lower: float | None = None, upper: float | None = None, **more: Any) -> Tolerance:
    return Tolerance(characteristic=more.pop("characteristic", "AP_x"), lower=lower, upper=upper, **more)


def figure(name: str = "AP_x", value: float = 2.0, u95: float = 0.4, **more: Any) -> Characteristic:
    return Characteristic(name=name, clause="7.2.1", value=value, unit="mm", u95=u95, capable=False, cycles=3, **more)


@pytest.mark.parametrize(
    ("value", "simple", "guarded"),
    [
        (1.0, "conforms", "not decided"), (0.999, "does not conform", "not decided"), (1.25, "conforms", "conforms"),
        (1.249, "conforms", "not decided"), (0.75, "does not conform", "not decided"), (0.749, "does not conform", "does not conform"),
        (3.0, "conforms", "not decided"), (3.001, "does not conform", "not decided"), (2.75, "conforms", "conforms"),
        (2.751, "conforms", "not decided"), (3.25, "does not conform", "not decided"), (3.251, "does not conform", "does not conform"),
    ],
)  # fmt: skip
def test_a_guard_band_of_u95_stands_on_both_sides_of_each_limit(value: float, simple: str, guarded: str) -> None:
    limits = tolerance(1.0, 3.0)
    assert conformity(value, 0.25, limits, "simple").verdict == simple
    found = conformity(value, 0.25, limits, "guarded")
    assert (found.verdict, found.lower, found.upper, found.rule) == (guarded, 1.0, 3.0, "guarded")
    law = norm(value, 0.25 / norm.ppf(0.975))
    assert found.probability == pytest.approx(law.cdf(3.0) - law.cdf(1.0), abs=1e-12)
    # of one side the other is anywhere
    assert conformity(value, 0.25, tolerance(1.0), "simple").verdict == ("conforms" if value >= 1.0 else "does not conform")
    assert conformity(value, 0.25, tolerance(upper=3.0), "simple").probability == pytest.approx(law.cdf(3.0), abs=1e-12)


def test_a_tolerance_may_state_its_own_rule() -> None:
    assert conformity(1.1, 0.25, tolerance(1.0, rule="guarded"), "simple").verdict == "not decided"
    assert conformity(1.1, 0.25, tolerance(1.0, rule="simple"), "guarded").verdict == "conforms"
    assert conformity(1.1, 0.0, tolerance(1.0), "simple").probability == 1.0


@pytest.mark.parametrize(
    ("value", "limits", "limit"),
    [
        (-2.0, None, 0.5), (0.2, tolerance(-3.0, 5.0), 1.0), (-8.0, tolerance(-3.0, 5.0), 2.0), (0.2, tolerance(upper=6.0), 0.75),
        (0.2, tolerance(-6.0), 0.75),
    ],
)  # fmt: skip
def test_a_value_may_be_stated_to_a_part_of_it_or_of_half_its_tolerance(value: float, limits: Tolerance | None, limit: float) -> None:
    assert limit_of(value, limits, 0.25) == pytest.approx(limit)


def test_the_first_tolerance_that_names_a_figure_is_its_own() -> None:
    at_pose, at_path, anywhere, other = (
        tolerance(upper=1.0, pose="P2"),
        tolerance(upper=2.0, path="line"),
        tolerance(upper=3.0),
        tolerance(upper=4.0, characteristic="RP_l"),
    )
    every = [at_pose, at_path, anywhere, other]
    assert tolerance_of(figure(pose="P2"), every) is at_pose
    assert tolerance_of(figure(path="line"), every) is at_path
    assert tolerance_of(figure(pose="P1"), every) is anywhere
    assert tolerance_of(figure(pose="P1"), every[:2]) is None
    assert tolerance_of(figure(pose="P2", path=None), [anywhere, at_pose]) is anywhere
    assert tolerance_of(figure("RP_l"), every) is other
    assert tolerance_of(figure("RP_l"), every[:3]) is None
    figures = [figure(pose="P2"), figure(path="line"), figure(pose="P1")]
    assert undecided(figures, every) is other
    assert undecided(figures, every[:3]) is None
    assert undecided(figures, [anywhere, at_pose, at_path]) is at_pose


SETTINGS = CertificationSettings(capability=0.25, rule="guarded")


@pytest.mark.parametrize(("u95", "capable"), [(0.5, True), (0.5001, False)])
def test_a_figure_is_stated_where_u95_is_small_beside_it(u95: float, capable: bool) -> None:
    found = with_verdict(figure(u95=u95), [], SETTINGS, signed=True)
    assert (found.capable, found.limit_u95, found.conformity) == (capable, 0.5, None)
    # a tolerance counts for a figure that may be zero alone
    limits = [tolerance(-6.0, 6.0)]
    assert with_verdict(figure(u95=u95), limits, SETTINGS, signed=True).limit_u95 == 1.5
    unsigned = with_verdict(figure(u95=u95), limits, SETTINGS, signed=False)
    assert (unsigned.capable, unsigned.limit_u95) == (capable, 0.5)
    assert unsigned.conformity is not None
    assert (unsigned.conformity.verdict, unsigned.conformity.rule) == ("conforms", "guarded")
    excluded = with_verdict(figure(u95=0.01, excluded=message("time.end")), limits, SETTINGS, signed=True)
    assert (excluded.capable, excluded.limit_u95, excluded.conformity) == (False, None, None)


def test_a_component_takes_the_verdict_of_its_vector() -> None:
    vector = figure("AP_p", value=4.0, u95=0.6, pose="P1")
    near_zero = figure("AP_x", value=0.1, u95=0.6, pose="P1")
    toleranced = figure("AP_y", value=1.0, u95=0.5, pose="P1")
    far = figure("AP_z", value=3.9, u95=0.6, pose="P1")
    alone = figure("AV", value=0.1, u95=0.3, path="line")
    vectors = {c.key: vector.key for c in (near_zero, toleranced, far)}
    tolerances = [tolerance(-8.0, 8.0, characteristic="AP_y"), tolerance(-4.0, 4.0, characteristic="AV")]
    given = (vector, near_zero, toleranced, far, alone)

    def judged(some: tuple[Characteristic, ...]) -> dict[str, Characteristic]:
        found = with_verdicts(some, vectors=vectors, signed=("AV",), tolerances=tolerances, settings=SETTINGS)
        return {c.name: c for c in found}

    found = judged(given)
    assert list(found) == ["AP_p", "AP_x", "AP_y", "AP_z", "AV"]
    verdicts = {name: (c.capable, c.limit_u95, c.capable_alone) for name, c in found.items()}
    assert verdicts == {
        "AP_p": (True, 1.0, None), "AP_x": (True, 1.0, False), "AP_y": (True, 2.0, False), "AP_z": (True, 1.0, True),
        "AV": (True, 1.0, None),
    }  # fmt: skip
    assert found["AP_x"].note == found["AP_z"].note == message("verdict.of_vector", vector="AP_p")
    assert found["AP_y"].note is None
    # of an instrument too coarse for the vector none is stated
    assert not judged((replace(vector, u95=1.1), *given[1:]))["AP_z"].capable
    # without its vector a component has its own
    assert not judged((near_zero, alone))["AP_x"].capable
    excluded = judged((vector, replace(far, excluded=message("time.end"))))["AP_z"]
    assert (excluded.capable, excluded.capable_alone, excluded.note) == (False, False, None)
    assert judged((vector, replace(far, u95=3.9 * 0.25), alone))["AP_z"].capable_alone
    assert not judged((vector, replace(far, u95=math.nextafter(3.9 * 0.25, 9.0)), alone))["AP_z"].capable_alone
