"""Encoders of angles as channels of a rig file: what is read, refused, simulated and decoded."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from reference.channel import Observation, predictions, rows, values
from reference.rig_channels import cable_lengths, rig_inclination, swivel_angle

from lmeasure.core import RigError, Status, se3
from lmeasure.kernels import BY_ALPHA, BY_ANGLE_ZERO, BY_ATTACHMENT, BY_BASE, length_gradients, span_lengths, span_rows_of
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.sensors import lengths_from_counts, span_rows
from lmeasure.simulation import cell_rig, simulate_run

HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
TIME_S = np.linspace(0.0, 1.0, 400)
PATH = se3.displaced(HOME, np.sin(np.pi * TIME_S)[:, None] * [0.1, -0.2, 0.15, 120.0, 80.0, -60.0])


def rig_with(*swivels: dict[str, Any], leaning: tuple[dict[str, Any], ...] = ()) -> Rig:
    return rig_from_dict(cell_rig(3).to_dict() | {"swivel": list(swivels), "inclination": list(leaning)})


def sw(number: int, **keys: Any) -> dict[str, Any]:
    return {"point": f"B{number}", "channel": f"sw{number}", "counts_per_revolution": 131072} | keys


LEVEL: dict[str, Any] = {"channel": "level", "axis": [1.0, 0.2, 0.0], "counts_per_revolution": 3600000, "zero_deg": 0.5}


def test_compiled_channels_are_the_reference() -> None:
    rig = rig_with(sw(1, zero_deg=12.5), sw(4, zero_deg=-170.0, count_sign=-1), leaning=(LEVEL,))
    own: list[Observation] = [
        swivel_angle(rig, "sw1", "B1", rig.cable[0].to_point, counts_per_revolution=131072, zero_deg=12.5),
        swivel_angle(rig, "sw4", "B4", rig.cable[3].to_point, counts_per_revolution=131072, zero_deg=-170.0),
        rig_inclination("level", (1.0, 0.2, 0.0), counts_per_revolution=3600000, zero_deg=0.5),
    ]
    channels = rig.cable_rows(rig.observed)[6:]
    assert span_lengths(channels, PATH) == pytest.approx(predictions(own, PATH), abs=1e-14)
    assert span_rows_of(channels, PATH) == pytest.approx(rows(own, PATH), abs=1e-14)
    for ours, theirs in zip(span_rows(channels, PATH), (span_lengths(channels, PATH), span_rows_of(channels, PATH)), strict=True):
        assert ours == pytest.approx(theirs, abs=1e-14)
    found = length_gradients(channels, PATH, np.zeros((len(PATH), 3)), np.ones(3))
    for j, o in enumerate(own[:2]):
        # per mm and degree there, per mm and radian here
        wanted = o.gradient(PATH, values(o)) / np.array([1, 1, 1, np.pi / 180, np.pi / 180, 1, 1, 1, np.pi / 180])
        columns = [*range(BY_BASE, BY_BASE + 3), BY_ALPHA, BY_ALPHA + 1, *range(BY_ATTACHMENT, BY_ATTACHMENT + 3), BY_ANGLE_ZERO]
        assert found[:, j, columns] == pytest.approx(wanted, abs=1e-13)


def test_eccentricity_is_in_reading_and_row() -> None:
    off = {"eccentricity_deg": 2.0, "eccentricity_phase_deg": 40.0}
    plain, channels = ((rig := rig_with(sw(1, zero_deg=0.0) | keys)).cable_rows(rig.observed)[6:] for keys in ({}, off))
    angle = span_lengths(plain, PATH)
    assert span_lengths(channels, PATH) == pytest.approx(angle + np.radians(2.0) * np.sin(angle - np.radians(40.0)), abs=1e-14)
    step = 1e-6 * np.eye(6)
    numeric = [span_lengths(channels, se3.displaced(PATH, s)) - span_lengths(channels, se3.displaced(PATH, -s)) for s in step]
    assert span_rows_of(channels, PATH)[:, 0] == pytest.approx(np.concatenate(numeric, axis=1) / 2e-6, abs=1e-8)
    for ours, theirs in zip(span_rows(channels, PATH), (span_lengths(channels, PATH), span_rows_of(channels, PATH)), strict=True):
        assert ours == pytest.approx(theirs, abs=1e-14)


@pytest.mark.parametrize(
    "keys",
    [
        {"zero_deg": 12.5},
        {"zero_deg": -100.0, "count_sign": -1},
        {"absolute": False, "zero_exact": True},
        {"absolute": False, "zero_exact": True, "counter_bits": 13, "count_sign": -1},
        {"zero_deg": 3.0, "backlash_deg": 0.05},
    ],
)
def test_counts_come_back_as_angles(keys: dict[str, Any]) -> None:
    rig = rig_with(sw(1, **keys), leaning=(LEVEL,))
    run = simulate_run(rig, TIME_S, PATH, noise_mm=0.0, rng=np.random.default_rng(1)).run
    codes = run.passes[0].of("sw1")
    assert "zero_deg" not in keys or (codes.min() >= 0 and codes.max() < 131072)
    found = lengths_from_counts(run)
    assert found.cables[6:] == ("sw1", "level")
    expected = span_lengths(rig.cable_rows(rig.observed), PATH)[:, 6:] - (
        span_lengths(rig.cable_rows(rig.observed), HOME[None])[:, 6:] if "absolute" in keys else 0.0
    ) * np.array([1.0, 0.0])
    off = found.change_mm[:, 6:] - expected
    off[:, 0] -= 2 * np.pi * np.round(off[:, 0] / (2 * np.pi))
    # on the way, where it is known which way the swivel turned, to half a count
    going = slice(20, -1)
    assert np.abs(off[going] / rig.cable_rows(rig.observed)[6:, 13]).max() <= 0.5 + 1e-6


def test_codes_across_their_end_and_behind_a_gap() -> None:
    """However long nothing was seen, an absolute encoder is sure where it is."""
    rig = rig_with(sw(1, zero_deg=0.0))
    about = float(np.degrees(span_lengths(rig.cable_rows(rig.observed)[6:], HOME[None])[0, 0]))
    rig = rig_with(sw(1, zero_deg=(about + 180.0) % 360.0 - 180.0))
    run = simulate_run(rig, TIME_S, PATH, noise_mm=0.0, rng=np.random.default_rng(1)).run
    recorded = run.passes[0].recorded.copy()
    assert np.ptp(recorded[:, 6]) > 100000
    recorded[100:300, 6] = np.nan
    found = lengths_from_counts(replace(run, passes=(replace(run.passes[0], recorded=recorded),)))
    assert np.abs(np.diff(found.change_mm[:100, 6])).max() < 0.1
    assert (found.flags[100:300] == Status.GAP).all()
    assert (found.flags[300:] == Status.OK).all()
    recorded[350, 6] = 131072
    found = lengths_from_counts(replace(run, passes=(replace(run.passes[0], recorded=recorded),)))
    assert found.flags[350] == Status.JUMP
    assert "131072 codes" in str(found.cause[350])


@pytest.mark.parametrize(
    ("swivel", "text"),
    [
        (sw(1, point="B9"), "'B9' is no observation_point"),
        (sw(1, channel="ch1"), "'ch1' is the channel of something else as well"),
        (sw(1, channel="time_s"), "'time_s' is the name of another column"),
        (sw(1, cable="c2"), "'c2' is no cable from B1"),
        (sw(1, absolute=False, zero_deg=1.0), "zero_deg: is of absolute sensors"),
        (sw(1, counter_bits=16), "counter_bits: is of incremental sensors"),
        (sw(1, u_zero_deg=1.0), "u_zero_deg: is the uncertainty of zero_deg, which is missing"),
        (sw(1, zero=1.0), "unknown key 'zero'"),
    ],
)
def test_what_is_refused(swivel: dict[str, Any], text: str) -> None:
    with pytest.raises(RigError, match=text.replace("(", r"\(")):
        rig_with(swivel)


def test_several_cables_of_a_point_must_be_told() -> None:
    data = cell_rig(3).to_dict()
    data["cable"].append({"name": "c7", "channel": "ch7", "from": "B1", "to": "P2", "pass": 1})
    with pytest.raises(RigError, match="state in cable which of the cables from B1 turns sw1"):
        rig_from_dict(data | {"swivel": [sw(1)]})
    rig = rig_from_dict(data | {"swivel": [sw(1, cable="c7")]})
    assert rig.observed[-1].to_point == "P2"
    assert rig.to_dict() == rig_from_dict(rig.to_dict()).to_dict()


def test_what_is_known_of_channels_where_nobody_states_it() -> None:
    """A count's end is anywhere within it, an angle anywhere on the circle; axes are taken as exact."""
    rig = rig_with()

    def zero_of(channel: Observation) -> float:
        return next(q.prior_u for q in channel.parameters if ".zero_" in q.name)

    c = rig.cable[0]
    drum = rig.point(c.from_point).drum
    count = drum.count_length_mm / drum.scale
    assert zero_of(cable_lengths(rig, HOME)[0]) == pytest.approx(count / 12.0**0.5)
    assert zero_of(cable_lengths(rig)[0]) == 10_000.0
    exact = [p.model_copy(update={"drum": p.drum.model_copy(update={"zero_exact": True})}) for p in rig.observation_point]
    sharp = rig.model_copy(update={"observation_point": tuple(exact)})
    assert [zero_of(o) for o in cable_lengths(sharp, HOME)] == [0.0] * len(rig.cable)
    for stated, u in ((None, 360.0 / 12.0**0.5), (0.25, 0.25)):
        assert zero_of(swivel_angle(rig, "sw", "B1", c.to_point, counts_per_revolution=4096, u_zero_deg=stated)) == pytest.approx(u)
        level = rig_inclination("level", (1.0, 0.2, 0.0), counts_per_revolution=4096, u_zero_deg=stated)
        assert zero_of(level) == pytest.approx(u)
    assert [(q.value, q.prior_u) for q in level.parameters] == [
        (1.0, 0.0), (0.2, 0.0), (0.0, 0.0), (0.0, 0.0), (0.0, 0.0), (1.0, 0.0), (0.0, 0.25),
    ]  # fmt: skip
    assert level.variance == pytest.approx((2.0 * np.pi / 4096) ** 2 / 12.0)
