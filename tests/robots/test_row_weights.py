"""Rows that count by what the others say of them: what the weights are worth, that bad rows lose them, and what is refused."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from in_process import ran, refused
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, RobotError, se3
from lmeasure.estimation import biweights, normal_deviates, scatter, trust
from lmeasure.robots import Identified, Measurements, Settings, identify, predict
from lmeasure.robots.identification import hold_out
from lmeasure.robots.identification.measurements import measured
from lmeasure.robots.identification.observability import determined_parameters
from lmeasure.robots.identification.problem import solved, stay_distances
from lmeasure.robots.robot import shipped
from lmeasure.robots.serial import SerialRobot

BASE = np.array([2000.0, -300.0, 500.0, *Rotation.from_rotvec([0.4, 2.0, -1.0]).as_quat()])
TOOL = np.array([40.0, -25.0, 110.0, 0.0, 0.0, 0.0, 1.0])
BAD = np.arange(0, 60, 5)
WEIGHED = Settings(weights="biweight")


def places(seed: int, bad: float) -> tuple[SerialRobot, Measurements, FloatArray]:
    """A built arm, 60 places of it measured to 0.05 mm, of which twelve err so many times as much, and the true ones."""
    rng = np.random.default_rng(seed)
    nominal = shipped("generic6").model
    links = [p.name.rsplit(".", 1)[1] in {"theta_deg", "d_mm", "a_mm", "alpha_deg", "beta_deg"} for p in nominal.parameters]
    true = nominal.moved(rng.normal(size=len(links)) * np.array([0.3 if p.unit == "mm" else 5e-4 for p in nominal.parameters]) * links)
    joints = rng.uniform(np.maximum(true.limits[0], -2.5), np.minimum(true.limits[1], 2.5), (60, 6))
    place = se3.compose(se3.compose(BASE, true.forward(joints)), TOOL)[:, :3]
    errors = 0.05 * rng.normal(size=(60, 3))
    errors[BAD] *= bad
    return true, measured(joints, place + errors), place


@pytest.fixture(scope="module")
def fourfold() -> tuple[SerialRobot, Identified[SerialRobot], FloatArray]:
    true, rows, place = places(3, 5.0)
    return true, identify(shipped("generic6").model, rows, WEIGHED), place


@pytest.mark.parametrize(("bad", "size"), [(0.0, 1.0), (0.2, 4.0)])
@pytest.mark.parametrize("m", [1, 6])
def test_what_weighted_blocks_are_worth_is_how_their_mean_scatters(m: int, bad: float, size: float) -> None:
    rng = np.random.default_rng(5)
    draws, n = 300, 120
    r = rng.normal(size=(draws, n, m)) * np.where(rng.uniform(size=(draws, n)) < bad, size, 1.0)[:, :, None]
    mean, freedom = np.zeros((draws, m)), np.full(draws * n, m)
    for _ in range(12):
        square = ((r - mean[:, None]) ** 2).sum(axis=2)
        weight = biweights(normal_deviates(square.reshape(-1), freedom)).reshape(draws, n)
        mean = (weight[:, :, None] * r).sum(axis=1) / weight.sum(axis=1)[:, None]
    worth = [trust(s, freedom[:n], w, float(m)) * w.sum() for s, w in zip(square, weight, strict=True)]
    # the scatter of 300 draws of m components is known to 8 % and better
    assert float((mean**2).mean() * np.mean(worth)) == pytest.approx(1.0, abs=0.15)
    if not bad:
        assert np.mean(worth) / n == pytest.approx(0.95, abs=0.05)
        assert float((weight * square).sum() / (m * weight.sum())) == pytest.approx(scatter(m), rel=0.02)


def test_distances_of_weighted_rows_are_those_from_fits_without_them(
    fourfold: tuple[SerialRobot, Identified[SerialRobot], FloatArray],
) -> None:
    fit = fourfold[1].fit
    problem, squares = fit.problem, stay_distances(fit)[0]
    assert problem.weight is not None
    for i in (int(np.argmin(problem.weight)), 7, 30):
        others = np.delete(np.arange(len(problem.rows)), i)
        rest = solved(replace(problem, rows=problem.rows.of(others), weight=problem.weight[others]), fit.theta)
        alone = replace(problem, rows=problem.rows.of(np.array([i])), weight=None)
        residuals, J = alone.residuals(rest.theta), alone.jacobian(rest.theta)
        V = alone.covariance(rest.theta) + J @ rest.covariance @ J.T
        assert squares[i] == pytest.approx(float(residuals @ np.linalg.solve(V, residuals)), rel=2e-3)


def test_bad_rows_lose_their_weight_and_the_others_keep_what_they_say(
    fourfold: tuple[SerialRobot, Identified[SerialRobot], FloatArray],
) -> None:
    true, found, place = fourfold
    weight = found.weight
    sound = np.delete(np.arange(60), BAD)
    assert weight[BAD].mean() < 0.4 < 0.8 < weight[sound].mean()
    said = next(f for f in found.findings if f.code == "down-weighted")
    assert said.value == np.count_nonzero((weight < 0.5) & found.kept)
    assert f"row {int(np.argmin(np.where(found.kept, weight, 2.0))) + 1} for " in said.text
    # nearer to the truth than with all rows alike, and as near as is said
    alike = identify(shipped("generic6").model, found.rows, Settings(outliers=False))
    u = [np.linalg.norm(f.state.predicted(f.rows)[:, :3] - place, axis=1).mean() for f in (found, alike)]
    assert u[0] < 0.7 * u[1]
    assert found.noise.position_mm == pytest.approx(0.05, rel=0.2)
    value = {p.name: p.value for p in true.parameters}
    determined, s = determined_parameters(found.fit), np.sqrt(np.diag(found.fit.covariance))
    names, values = found.fit.problem.unknowns.names, found.fit.problem.unknowns.values(found.fit.x)
    off = np.array([(v - value[n]) / e for n, v, e, t in zip(names, values, s, determined, strict=True) if t and n in value])
    assert 0.6 < np.sqrt(np.mean(off**2)) < 1.5
    assert np.mean(predict(found, found.rows.joints).u95_mm) < 0.5 * np.mean(predict(alike, found.rows.joints).u95_mm)
    # rows held out are judged with weights of their own
    held = hold_out.cross_validation(found)
    assert held is not None
    assert held.misfit < 1.3
    assert len(held.rows) == found.kept.sum()


def test_weights_cost_little_where_nothing_is_wrong() -> None:
    _, rows, _ = places(4, 1.0)
    one, other = (identify(shipped("generic6").model, rows, s) for s in (Settings(), WEIGHED))
    determined = determined_parameters(one.fit)
    ratio = np.sqrt(np.diag(other.fit.covariance) / np.diag(one.fit.covariance))[determined]
    assert 0.85 < ratio.mean() < 1.15
    assert other.weight.sum() == pytest.approx(55.0, abs=3.0)
    # and rows that only nominal values hold are held as before
    assert np.sqrt(np.diag(other.fit.covariance))[~determined] == pytest.approx(np.sqrt(np.diag(one.fit.covariance))[~determined], rel=0.05)


def test_too_few_rows_are_refused() -> None:
    _, rows, _ = places(4, 1.0)
    with pytest.raises(RobotError, match="measured values leave no redundancy, so no row's weight"):
        identify(shipped("generic6").model, rows.of(np.arange(9)), WEIGHED)
    wild = 5.0 * np.random.default_rng(1).normal(size=(60, 3)) * (np.arange(60) < 29)[:, None]
    with pytest.raises(RobotError, match=r"weights leave 2\d\.\d of 60 rows, too few: they contradict each other"):
        identify(shipped("generic6").model, replace(rows, position=rows.position + wild), WEIGHED)


def test_by_command(tmp_path: Path) -> None:
    _, rows, _ = places(3, 5.0)
    names = ",".join(f"joint_{i}_deg" for i in range(1, 7))
    lines = [",".join(map(repr, r)) for r in np.column_stack([np.degrees(rows.joints), rows.position]).tolist()]
    path = tmp_path / "m.csv"
    path.write_text("\n".join([f"name,{names},x_mm,y_mm,z_mm", *(f"P{i},{line}" for i, line in enumerate(lines, 1))]), encoding="utf-8")
    arguments = ["--robot", "generic6", "--measurements", str(path), "--out", str(tmp_path / "out"), "--free", "links"]

    assert "with --weights biweight every row has the weight that the others leave it" in refused(
        "identify", *arguments, "--weights", "biweight", "--keep-outliers", code=2
    )
    said = ran("identify", *arguments, "--weights", "biweight", "--language", "ru")
    assert "weights by Tukey's biweight, equal to 4" in said
    assert "warning down-weighted: " in said
    record = json.loads((tmp_path / "out" / "identified.json").read_text(encoding="utf-8"))
    weights = [r["weight"] for r in record["residuals"]]
    assert record["weights"] == "biweight"
    assert record["rows"] == pytest.approx(sum(weights))
    assert all((w > 0.0) == r["used"] for w, r in zip(weights, record["residuals"], strict=True))
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "Веса строк" in page
    assert "трок с весом меньше половины" in page
