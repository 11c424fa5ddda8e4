"""What is worth freeing: what a robot has is found, with its value, and what it has not is freed as seldom as is stated."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from lmeasure.core import se3
from lmeasure.robots import Identified, Measurements, Settings, freed, identify, identify_with_choice, predict, workspace, worth_freeing
from lmeasure.robots.identification.hold_out import AMONG, FALSE_ALARM
from lmeasure.robots.identification.measurements import measured
from lmeasure.robots.robot import Payload, shipped
from lmeasure.robots.serial import SerialRobot

PAYLOAD = Payload(mass_kg=8.0, centre_mm=(0.0, 0.0, 120.0))
NOMINAL = shipped("generic6").model_copy(update={"payload": PAYLOAD}).model
TOOL = np.array([60.0, -40.0, 120.0, 0.0, 0.0, 0.0, 1.0])
U_MM = 0.03
PLANTED = {
    "once": {"joint_2.sin1_deg": 0.012, "joint_4.cos1_deg": -0.02},
    "twice": {"joint_1.cos2_deg": 0.01, "joint_3.sin2_deg": 0.01},
    "scale": {"joint_2.scale": 1.0003, "joint_5.scale": 0.9995},
    "stiffness": {"joint_2.compliance_deg_per_nm": 2e-4, "joint_3.compliance_deg_per_nm": 4e-4},
    "backlash": {"joint_1.backlash_deg": 0.02, "joint_5.backlash_deg": 0.05},
}


def built(seed: int, planted: dict[str, float]) -> SerialRobot:
    """Links off by 0.3 mm and 0.5 mrad, and what is planted."""
    rng = np.random.default_rng(seed)
    change = np.array([0.3 if p.unit == "mm" else 5e-4 for p in NOMINAL.parameters]) * rng.normal(size=len(NOMINAL.parameters))
    change *= np.isin(np.arange(len(change)), freed(NOMINAL, ("links",)))
    for i, p in enumerate(NOMINAL.parameters):
        if p.name in planted:
            change[i] = (planted[p.name] - p.value) * p.size
    return NOMINAL.moved(change)


def seen(true: SerialRobot, seed: int, count: int = 80, most_rad: float = 2.5, wave_deg: float = 0.0) -> Measurements:
    """Joints within most_rad; each errs by wave_deg six times per turn, which no parameter describes."""
    rng = np.random.default_rng([seed, 1])
    low, high = (np.clip(limit, -most_rad, most_rad) for limit in NOMINAL.limits)
    rows = measured(rng.uniform(low, high, (count, len(low))))
    turned = rows.joints + np.radians(wave_deg) * np.sin(6.0 * rows.joints + np.arange(6))
    place = se3.compose(true.forward(turned, rows.side), TOOL)[:, :3]
    return replace(rows, position=place + U_MM * rng.normal(size=place.shape))


def found_values(found: Identified[SerialRobot]) -> dict[str, tuple[float, float]]:
    unknowns = found.fit.problem.unknowns
    u = np.sqrt(np.diag(found.fit.covariance))
    return {n: (float(v), float(s)) for n, v, s in zip(unknowns.names, unknowns.values(found.fit.x), u, strict=True)}


@pytest.mark.parametrize("kind", PLANTED)
def test_what_is_planted_is_found_and_nothing_else(kind: str) -> None:
    off = []
    for seed in range(2):
        rows = seen(built(seed, PLANTED[kind]), seed)
        found = identify_with_choice(NOMINAL, rows, among=(*AMONG, "backlash"))
        assert found.settings.free == ("links", kind)
        values = found_values(found)
        off += [(values[name][0] - value) / values[name][1] for name, value in PLANTED[kind].items()]
        # many times what it is known to, so that finding it means something
        for name, value in PLANTED[kind].items():
            assert abs(value - (1.0 if kind == "scale" else 0.0)) > 3.0 * values[name][1]
    assert max(map(abs, off)) < 3.5
    assert float(np.square(off).sum()) < 18.5  # chi-squared of four, once in a thousand


def test_a_part_of_a_turn_frees_what_the_robot_has_and_no_stand_in_for_what_the_model_lacks() -> None:
    true = built(0, PLANTED["scale"])
    assert identify_with_choice(NOMINAL, seen(true, 0, 200, 0.8)).settings.free == ("links", "scale")
    rows, beyond = seen(built(0, {}), 0, 200, 0.8, 0.02), seen(built(0, {}), 1, 200, 1.2, 0.02)
    found = identify_with_choice(NOMINAL, rows)
    assert found.settings.free == ("links",)
    assert [(f.code, f.of) for f in found.findings] == [("worth-freeing", "twice, once")]
    assert found.findings[0].value == pytest.approx(2.0, abs=0.3)
    off = [
        np.linalg.norm(predict(one, beyond.joints).pose[:, :3] - beyond.position, axis=1).mean()
        for one in (found, identify(NOMINAL, rows, Settings(("links", "harmonics"))))
    ]
    assert off[0] < 0.5 * off[1]


def test_play_is_told_and_freed_only_when_asked_for() -> None:
    found = identify_with_choice(NOMINAL, seen(built(0, PLANTED["backlash"]), 0))
    assert found.settings.free == ("links",)
    assert [(f.code, f.of) for f in found.findings] == [("worth-freeing", "backlash")]
    assert found.findings[0].said.text("ru").startswith("backlash: уменьшает")


def test_what_is_not_there_is_found_as_seldom_as_is_stated() -> None:
    chances: list[float] = []
    for seed in range(20):
        found = identify(NOMINAL, seen(built(seed + 100, {}), seed + 100, 40))
        chances += [w.chance for w in worth_freeing(found) if not w.freed]
    assert len(chances) == 20 * 5
    assert min(chances) > FALSE_ALARM / 10
    for level in (0.05, 0.3):
        low, high = binom.interval(0.998, len(chances), level)
        assert low <= (np.array(chances) < level).sum() <= high


def test_the_workspace_is_predicted_as_exactly_as_is_said() -> None:
    true = built(7, PLANTED["once"])
    found = identify_with_choice(NOMINAL, seen(true, 7), Settings())
    over = workspace(found, 512)
    assert over is not None
    low, high = NOMINAL.limits
    assert ((over.joints >= low) & (over.joints <= high)).all()
    place = se3.compose(true.forward(over.joints), TOOL)[:, :3]
    off = np.linalg.norm(predict(found, over.joints).pose[:, :3] - place, axis=1)
    assert np.mean(off <= over.u95_mm) > 0.93
    assert np.median(over.u95_mm) > over.at_measured_mm * 0.8
    # cells hold the poses that lie in them
    inside = np.asarray((np.abs(over.places[:, None] - over.cells[None]) <= 0.5 * over.edge_mm).all(axis=2))
    assert inside.sum(axis=0).tolist() == over.poses.tolist()
    assert over.largest_mm[3] == over.u95_mm[inside[:, 3]].max()
    assert over.median_mm[3] == pytest.approx(np.median(over.u95_mm[inside[:, 3]]))
