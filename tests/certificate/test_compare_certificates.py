"""Certificates compared: chance is called chance, a moved robot is found, one calibration cancels, and nonsense is one line."""

import contextlib
import json
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaigns import write_campaign
from in_process import ran, refused

from lmeasure.certificate import (
    SIGNIFICANT,
    Improvement,
    Inputs,
    Pair,
    as_dict,
    canonical,
    compare_certificates,
    improvement,
    lines,
    read_certificate,
)
from lmeasure.certificate.content import METHOD
from lmeasure.core import FloatArray, LMeasureError
from lmeasure.iso9283 import CertificationSettings
from lmeasure.report import Choices, write_certificate

POSES = ("P1", "P2", "P3", "P4", "P5")


def certificate(
    means: FloatArray, scatter_mm: float, rng: np.random.Generator, number: int = 0, *, cycles: int = 10, systematic_mm: float = 0.0,
    random_mm: float = 0.0, digest: str | None = None, details: dict[str, Any] | None = None, day: str = "2026-03-01",
) -> dict[str, Any]:  # fmt: skip
    """As `certify` writes it, of a robot that scatters about these means (5, 3)."""
    figures, attained = [], []
    for pose, mean in zip(POSES, means, strict=True):
        positions = mean + rng.normal(0.0, scatter_mm, (cycles, 3)) + rng.normal(0.0, random_mm, (cycles, 3))
        entry = {"pose": pose, "cycles": cycles, "commanded_mm": [0.0, 0.0, 0.0], "mean_mm": positions.mean(axis=0).tolist()}
        attained.append(entry | {"covariance_mm2": np.cov(positions.T).tolist()})
        u = {"u_random": random_mm / np.sqrt(cycles) + 1e-9, "u_systematic": systematic_mm}
        for axis, value in zip("xyz", positions.mean(axis=0), strict=True):
            u95 = 2.0 * float(np.hypot(*u.values()))
            figures.append({"name": f"AP_{axis}", "pose": pose, "value": float(value), "unit": "mm", "u95": u95, "capable": True, **u})
    return {
        "schema": "lmeasure.certificate/1", "id": f"LM-{number}", "method": METHOD, "created": f"{day}T00:00:00Z", "language": "en",
        "details": details or {},
        "measurement": {}, "inputs": [], "settings": {"align": False}, "environment": {}, "trajectory": {}, "characteristics": figures,
        "excluded": [], "attained": attained, "notes": [], "figures_sha256": "", "base_from_program": None,
        "instrument": {"systematic_sha256": digest},
    }  # fmt: skip


def pair(a: dict[str, Any], b: dict[str, Any]) -> Pair:
    return compare_certificates([("a", a), ("b", b)]).pairs[0]


def test_a_robot_that_did_not_move_is_seldom_said_to_have() -> None:
    """Per campaign of five poses, Holm over them: at most SIGNIFICANT; single probabilities are uniform where scatter dominates."""
    rng = np.random.default_rng(1)
    still, probabilities, trials = np.zeros((5, 3)), [], 400
    alarms = 0
    for _ in range(trials):
        found = pair(certificate(still, 0.05, rng), certificate(still, 0.05, rng, 1))
        alarms += any(s.moved for s in found.shifts)
        probabilities += [s.probability for s in found.shifts if s.probability is not None]
    assert alarms / trials < SIGNIFICANT + 3 * np.sqrt(SIGNIFICANT / trials)
    assert alarms > 0
    for level in (0.05, 0.5, 0.95):
        assert abs(np.mean(np.array(probabilities) < level) - level) < 4 * np.sqrt(level * (1 - level) / len(probabilities)) + 0.01


def test_the_u95_of_a_figures_difference_holds_what_it_says() -> None:
    """Scatter of the robot aside, 95 % of differences of one robot lie within it, with calibrations of their own or the same."""
    rng = np.random.default_rng(2)
    inside: dict[bool, list[bool]] = {True: [], False: []}
    for shared in (True, False):
        for _ in range(150):
            first = rng.normal(0.0, 0.03, 3)
            errors = first, (first if shared else rng.normal(0.0, 0.03, 3))
            both = [
                certificate(np.tile(e, (5, 1)), 0.0, rng, i, random_mm=0.02, systematic_mm=0.03, digest="same" if shared else str(i))
                for i, e in enumerate(errors)
            ]
            found = pair(both[0], both[1])
            assert found.shared == shared
            inside[shared] += [not c.beyond for c in found.changes[:3]]
    for shared, reported in inside.items():
        # the coverage factor of the two is 2
        assert abs(np.mean(reported) - 0.9545) < 4 * np.sqrt(0.95 * 0.05 / len(reported)), shared


def test_a_moved_pose_is_named_and_the_others_are_not() -> None:
    rng = np.random.default_rng(3)
    still = np.zeros((5, 3))
    moved = still + [[0, 0, 0], [0.4, 0.0, 0.3], [0, 0, 0], [0, 0, 0], [0, 0, 0]]
    found = compare_certificates([("a", certificate(still, 0.05, rng)), ("b", certificate(moved, 0.05, rng, 1, day="2026-04-01"))])
    shifts = found.pairs[0].shifts
    assert [s.pose for s in shifts if s.moved] == ["P2"]
    assert shifts[1].distance_mm == pytest.approx(0.5, abs=0.1)
    assert abs(shifts[1].distance_mm - 0.5) < shifts[1].u95_mm
    assert found.exchangeability[1].between == ("a", "b")
    assert found.exchangeability[1].value_mm == shifts[1].distance_mm
    json.loads(canonical(as_dict(found)))
    assert any("moved" in line for line in lines(found))


def test_a_systematic_error_of_its_own_calibration_is_not_a_move() -> None:
    rng = np.random.default_rng(4)
    off = np.full((5, 3), 0.1)
    a = certificate(np.zeros((5, 3)), 0.01, rng, systematic_mm=0.1, digest="a")
    assert not any(s.moved for s in pair(a, certificate(off, 0.01, rng, 1, systematic_mm=0.1, digest="b")).shifts)
    assert all(s.moved for s in pair(a, certificate(off, 0.01, rng, 1, systematic_mm=0.1, digest="a")).shifts)


def test_exchangeability_is_the_largest_distance_of_any_two() -> None:
    rng = np.random.default_rng(5)
    places = [np.tile([x, 0.0, 0.0], (5, 1)) for x in (0.0, 0.3, -0.5)]
    robots = [(f"r{i}", certificate(p, 0.001, rng, i, details={"item": {"model": "R", "serial": str(i)}})) for i, p in enumerate(places)]
    found = compare_certificates(robots)
    assert found.kind == "3 robots of one model, R"
    assert {e.between for e in found.exchangeability} == {("r1", "r2")}
    assert found.exchangeability[0].value_mm == pytest.approx(0.8, abs=0.01)


def test_what_was_commanded_otherwise_is_not_compared() -> None:
    rng = np.random.default_rng(5)
    made = [certificate(np.zeros((5, 3)), 0.05, rng, number) for number in (0, 1)]
    made[0]["characteristics"].append({"name": "AD_p", "pose": "P2-P4", "value": 0.1, "unit": "mm", "u95": 0.01, "capable": True})
    made[1]["characteristics"].append({"name": "AD_p", "pose": "P2-P4", "value": 0.9, "unit": "mm", "u95": 0.01, "capable": True})
    assert any(c.figure == "AD_p of P2-P4" for c in pair(*made).changes)  # earlier certificates do not say what was commanded
    for content in made:
        rows = [{"name": name, "position_mm": [1.0, 2.0, 3.0], "cycles": 10} for name in POSES]
        content["program"] = {"load_kg": 5.0, "pose": rows, "path": []}
    made[1]["program"]["pose"][0]["cycles"] = 30
    assert pair(*made).otherwise == ()
    made[1]["program"]["pose"][1]["position_mm"] = [1.0, 2.0, 4.0]
    made[1]["program"]["pose"][2]["load_kg"] = 10.0
    found = compare_certificates([("a", made[0]), ("b", made[1])])
    assert found.pairs[0].otherwise == ("pose P2 (position_mm)", "pose P3 (load_kg)")
    assert {c.figure.split()[-1] for c in found.pairs[0].changes} == {"P1", "P4", "P5"}
    assert [s.pose for s in found.pairs[0].shifts] == [e.pose for e in found.exchangeability] == ["P1", "P4", "P5"]
    assert "  different commands, not compared: pose P3 (load_kg)" in lines(found)
    assert as_dict(found)["pairs"][0]["commanded_otherwise"] == ["pose P2 (position_mm)", "pose P3 (load_kg)"]
    for row in made[1]["program"]["pose"]:
        row["load_kg"] = 10.0
    with pytest.raises(LMeasureError, match=r"no characteristic in common with a: pose P1 \(load_kg\) was commanded differently"):
        compare_certificates([("a", made[0]), ("b", made[1])])


def test_numbers_of_a_change_end_where_its_u95_does() -> None:
    made = [certificate(np.zeros((5, 3)), 0.0, np.random.default_rng(0), number) for number in (0, 1)]
    for content, value in zip(made, (0.1447123, 0.2324512), strict=True):
        content["characteristics"] = [{"name": "AP_p", "pose": "P9", "value": value, "unit": "mm", "u95": 0.00566, "capable": True}]
    assert "  AP_p of P9: 0.1447 -> 0.2325 mm, difference +0.0877 (U95 0.0080)" in lines(
        compare_certificates([("a", made[0]), ("b", made[1])])
    )


def test_kinds_order_and_notes() -> None:
    rng = np.random.default_rng(6)
    item = {"item": {"serial": "7"}}
    early = certificate(np.zeros((5, 3)), 0.01, rng, 1, details=item | {"dates": {"measured_from": "2025-01-01"}}, day="2026-05-01")
    late = certificate(np.zeros((5, 3)), 0.01, rng, 2, details=item)
    late["settings"] = {"align": True}
    late["base_from_program"] = [0.0] * 7
    found = compare_certificates([("late", late), ("early", early)])
    assert found.names == ("early", "late")
    assert found.kind == "one robot over time, serial number 7"
    assert len(found.notes) == 2
    few = certificate(np.zeros((5, 3)), 0.01, rng, 3, cycles=2)
    assert all(s.probability is None and not s.moved for s in pair(few, few | {"id": "other"}).shifts)


def test_what_cannot_be_compared_is_one_line(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    a, b = (certificate(np.zeros((5, 3)), 0.01, rng, i) for i in range(2))
    for given in ([("a", a)], [("a", a), ("b", a)], [("a", a), ("b", b | {"characteristics": [], "attained": []})]):
        with pytest.raises(LMeasureError):
            compare_certificates(given)
    r = random.Random(1)
    values: list[Any] = [None, True, "x", [], {}, [1], 3, [{"pose": "P1"}], [[1]]]
    for key in sorted(b):
        for value in values:
            path = tmp_path / "certificate.json"
            path.write_text(json.dumps(b | {key: value}))
            compared_or_refused(a, path)
    for _ in range(200):
        changed = json.loads(json.dumps(b))
        entry = r.choice(changed["attained"] + changed["characteristics"])
        entry[r.choice(list(entry))] = r.choice(values)
        path.write_text(json.dumps(changed))
        compared_or_refused(a, path)


def compared_or_refused(a: dict[str, Any], path: Path) -> None:
    """Anything else than an LMeasureError is the failure this looks for."""
    with contextlib.suppress(LMeasureError):
        compare_certificates([("a", a), ("b", read_certificate(path))])


def test_two_real_certificates(tmp_path: Path) -> None:
    """The same robot twice by the same instrument, and 0.4 mm further off: found at every pose."""
    read = []
    for number, offset in enumerate((0.3, 0.3, 0.7)):
        folder = tmp_path / str(number)
        write_campaign(folder, seed=0, offset_mm=offset)
        given = Inputs(folder / "trajectory.parquet", folder / "program.toml", folder / "run")
        write_certificate(folder / "c", given, CertificationSettings(trials=300), Choices())
        read.append((str(number), read_certificate(folder / "c" / "certificate.json")))
    found = compare_certificates(read)
    assert [any(s.moved for s in p.shifts) for p in found.pairs] == [False, True]
    assert found.exchangeability[0].value_mm == pytest.approx(0.4, abs=0.01)


def corrected(seed: int, left_mm: float, scatter_mm: float = 0.02) -> tuple[Improvement, float, float]:
    """A robot that stands 0.5 mm off before and left_mm after, each in a direction of its own at each pose, measured by an instrument with
    0.01 mm systematic; and the true mean distances."""
    rng = np.random.default_rng([seed, 21])

    def measured(size: float, number: int) -> dict[str, Any]:
        way = rng.normal(size=(5, 3))
        off = size * way / np.linalg.norm(way, axis=1)[:, None]
        return certificate(off + rng.normal(0.0, 0.01, 3), scatter_mm, rng, number, cycles=30, systematic_mm=0.01)

    return improvement(measured(0.5, 0), measured(left_mm, 1), seed=seed), 0.5, left_mm


@pytest.mark.parametrize("left_mm", [0.004, 0.05])
def test_the_interval_of_an_improvement_holds_the_true_one(left_mm: float) -> None:
    """Near the noise and above it; a plain quotient of the measured distances is too small where what is left is near the noise."""
    found = [corrected(seed, left_mm) for seed in range(25)]
    factors = np.array([before / after for _, before, after in found])
    low, high = np.array([f.factor_95 for f, _, _ in found]).T
    assert np.mean((low <= factors) & (factors <= high)) >= 0.9
    assert np.isfinite(high).all() == (left_mm == 0.05)
    if left_mm == 0.05:
        assert (high / low < 2.5).all()


def test_a_robot_that_was_corrected_by_the_instruments_own_error_is_not_called_exact() -> None:
    """It stands off by just what the instrument errs by, which measures nothing then: the true factor is in the interval all the same."""
    inside = []
    for seed in range(25):
        rng = np.random.default_rng([seed, 5])
        off = rng.normal(0.0, 0.02, 3)
        before = certificate(np.tile([0.3, 0.0, 0.0], (5, 1)) + off, 0.01, rng, 0, cycles=30, systematic_mm=0.02)
        after = certificate(np.zeros((5, 3)), 0.01, rng, 1, cycles=30, systematic_mm=0.02)
        low, high = improvement(before, after).factor_95
        inside.append(low <= 0.3 / np.linalg.norm(off) <= high)
    assert np.mean(inside) >= 0.9


def test_what_noise_alone_would_show_is_the_floor() -> None:
    """A robot without any error left shows the floor in the mean, and what identification left is added to it."""
    found = [corrected(seed, 0.0)[0] for seed in range(25)]
    assert np.mean([f.after_mm[0] for f in found]) == pytest.approx(np.mean([f.floor_mm for f in found]), rel=0.1)
    parts = found[0].parts
    assert parts.scatter_mm == pytest.approx(0.02 * np.sqrt(3 / 30), rel=0.2)
    assert parts.instrument_mm == pytest.approx(0.01 * np.sqrt(3), rel=1e-3)
    assert parts.identified_mm is None
    rng = np.random.default_rng(0)
    before, after = (certificate(np.full((5, 3), off), 0.02, rng, i, cycles=30) for i, off in enumerate((0.3, 0.0)))
    less, more = (improvement(before, after, left) for left in (None, dict.fromkeys(POSES, 0.1)))
    assert more.parts.identified_mm == pytest.approx(0.1)
    # the mean length of a vector of three normal coordinates is sqrt(8 / 3 pi) of its root mean square
    assert more.floor_mm == pytest.approx(np.sqrt(8 / (3 * np.pi)) * np.hypot(0.1, less.parts.scatter_mm), rel=0.02)


def test_an_exact_instrument_tells_the_exact_factor() -> None:
    rng = np.random.default_rng(0)
    before, after = (certificate(np.outer(np.arange(1, 6), [0.0, 0.0, size]), 1e-9, rng, i) for i, size in enumerate((0.5, 0.02)))
    found = improvement(before, after)
    assert found.factor == pytest.approx(25.0, rel=1e-6)
    assert found.factor_95 == pytest.approx((25.0, 25.0), rel=1e-5)


def test_the_page_of_a_correction(tmp_path: Path) -> None:
    """Both certificates, their figures with what the instrument tells apart, and what was made of the robot, in both languages."""
    rng = np.random.default_rng(1)
    for i, (name, off) in enumerate((("before", 0.3), ("after", 0.01))):
        content = certificate(np.full((5, 3), off), 0.02, rng, i, cycles=30, random_mm=1e-3)
        content["characteristics"].append({"name": "FV", "pose": "P2-P4", "value": off, "unit": "mm/s", "u95": 0.01, "capable": True})
        (tmp_path / f"{name}.json").write_bytes(canonical(content))
    rows = [{"name": pose, "left": None, "u_identified_mm": 0.03} for pose in POSES]
    (tmp_path / "corrections.json").write_text(json.dumps({"targets": rows}))
    given = ["compare", *(str(tmp_path / f"{name}.json") for name in ("before", "after"))]
    for language, words in (("en", "times nearer to its commanded poses"), ("ru", "ближе к заданным позам")):
        page = tmp_path / f"{language}.html"
        requested = [*given, "--page", str(page), "--corrections", str(tmp_path / "corrections.json"), "--language", language]
        done = ran(*requested)
        assert "improvement:" in done
        assert "identification 0.0300 mm" in done
        text = page.read_text()
        assert words in text
        assert (">мм/с<" if language == "ru" else ">mm/s<") in text
        assert all(f"LM-{i}" in text for i in (0, 1))
    (tmp_path / "corrections.json").write_text("{}")
    done = refused(*given, "--out", tmp_path / "none.json", "--corrections", tmp_path / "corrections.json")
    assert "not written by `lmeasure correct`" in done
    assert f"{tmp_path / 'nowhere.json'}: cannot be read" in refused(*given, "--corrections", tmp_path / "nowhere.json")
    assert not (tmp_path / "none.json").exists()
    both = ["--out", str(tmp_path / "figures.json"), "--page", str(tmp_path / "page.html")]
    assert ran(*given, *both).splitlines()[-2] == f"written: {both[1]}, {both[3]}"
