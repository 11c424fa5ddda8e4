"""The one table of a cable's parameters: in the kernels' order, where the rig and the kernels' rows keep each."""

import numpy as np
import pytest

from lmeasure.core import CalibrationError, RigError
from lmeasure.kernels import BY_ALPHA, BY_ANGLE_ZERO, BY_ATTACHMENT, BY_BASE, BY_BETA, BY_RADIUS, PARAMETERS, guide_direction
from lmeasure.rig import (
    FACTORS,
    FURTHER_KEYS,
    GROUPS,
    PHASED,
    SCALE,
    TABLE,
    Rig,
    azimuth_stretch,
    further_names,
    group_names,
    kernel_values,
    parameter_names,
    parameter_of,
    rig_from_dict,
    solved_parameters,
    tilt_names,
    value_of,
    with_kernel_values,
    with_values,
)
from lmeasure.rig.parameters import EXACT, same_direction, stated_u
from lmeasure.rig.sensor_table import ANYWHERE_DEG
from lmeasure.simulation import cell_rig


def test_the_table_is_in_the_kernels_order() -> None:
    kernels = [
        name.removeprefix("attachment_").replace("guide_alpha_rad", "guide_alpha_deg").replace("beta_rad", "beta_deg")
        for name in PARAMETERS
    ]
    assert [p.key for p in TABLE] == kernels
    assert TABLE[SCALE].key == "scale"
    assert {*GROUPS["run-out"], *GROUPS["eccentricity"]} == PHASED
    assert round(ANYWHERE_DEG, 3) == 103.923  # 360 degrees over the root of 12
    assert [p.group == "attachment" for p in TABLE] == [name.startswith("attachment_") for name in PARAMETERS]


def test_every_parameter_moves_what_a_rig_that_has_the_other_value_has() -> None:
    """Through the rig file and through the kernels' rows alike; each by its own."""
    rig = cell_rig(1)
    cable = rig.cable[0]
    for i, name in enumerate(parameter_names(rig)[0]):
        value = value_of(rig, name)
        assert value is not None
        other = with_values(rig, {name: value + 0.25})
        assert value_of(other, name) == pytest.approx(value + 0.25)
        values = kernel_values(rig.cable_rows((cable,)))
        values[0, i] = (value + 0.25) * FACTORS[i]
        rows = with_kernel_values(rig.cable_rows((cable,)), values)
        assert rows == pytest.approx(other.cable_rows((cable,)), rel=1e-12, abs=1e-12)
        moved = kernel_values(rows)[0] - kernel_values(rig.cable_rows((cable,)))[0]
        assert np.flatnonzero(np.abs(np.nan_to_num(moved)) > 1e-12).tolist() == ([] if TABLE[i].key == "scale" else [i])
    assert np.isnan(kernel_values(rig.cable_rows())[0]).tolist() == [p.key == "scale" for p in TABLE]


def test_values_are_brought_back_to_their_ranges() -> None:
    rig = with_values(cell_rig(1), {"B1.pulley_radius_mm": -12.0, "B1.guide_alpha_deg": 100.0, "B1.guide_beta_deg": 10.0})
    point = rig.point("B1")
    assert (point.pulley_radius_mm, point.guide_alpha_deg, point.guide_beta_deg) == (12.0, 80.0, 190.0)


def test_a_radius_has_no_sign_and_a_zero_has() -> None:
    """Which stand in the same column of the kernels' rows."""
    rig = with_encoders()
    rows = rig.cable_rows((rig.cable[0], rig.observed[len(rig.cable)]))
    values = kernel_values(rows)
    values[:, BY_RADIUS] = [-12.0, -0.3]
    assert kernel_values(with_kernel_values(rows, values))[:, BY_RADIUS].tolist() == [12.0, -0.3]


def stating() -> Rig:
    data = cell_rig(1).to_dict()
    data["u_attachment_mm"] = 0.1
    first, second, third = data["observation_point"][:3]
    first |= {"u_position_mm": 2.0, "u_guide_deg": 1.0, "u_pulley_radius_mm": 0.0}
    first["drum"] |= {"u_count_length_mm": 0.00012, "u_tangent_length_mm": 3.0}
    first["drum"]["scale"] = 0.5
    second["drum"] |= {"u_scale": 0.002, "u_count_length_mm": 0.00012}
    data["assumed"] = [f"{third['name']}.position_mm", f"{third['name']}.count_length_mm", "P1"]
    return rig_from_dict(data)


def test_priors_are_what_is_stated_then_what_is_usual() -> None:
    rig = stating()
    width = {p.name: p.prior_u for p in solved_parameters(rig, rig.cable, tuple(GROUPS))}
    assert [width[f"B1.{k}"] for k in ("x_mm", "z_mm", "guide_beta_deg", "tangent_length_mm")] == [2.0, 2.0, 1.0, 3.0]
    assert width["B1.pulley_radius_mm"] == 1e-9  # stated to be exact
    assert width["B1.scale"] == pytest.approx(0.01 * 0.5)
    assert width["B2.scale"] == 0.002
    assert [width[f"B2.{k}"] for k in ("y_mm", "guide_alpha_deg", "groove_pitch_mm", "axial_offset_mm")] == [30.0, 5.0, 0.05, 5.0]
    assert [width[f"B3.{k}"] for k in ("x_mm", "y_mm", "z_mm", "scale", "guide_beta_deg")] == [300.0, 300.0, 300.0, 0.3, 5.0]
    assert width["tool.P1.x_mm"] == 0.1
    assert {p.unit for p in solved_parameters(rig, rig.cable, ("scale",)) if p.name.endswith("scale")} == {""}
    # what nobody measured is solved for though nobody asks
    extra = {p.name for p in solved_parameters(rig, rig.cable, ("guide",))} - {
        f"B{i}.guide_{a}_deg" for i in range(1, 7) for a in ("alpha", "beta")
    }
    assert extra == {"B3.x_mm", "B3.y_mm", "B3.z_mm", "B3.scale", *(f"tool.P1.{a}_mm" for a in "xyz")}


def test_what_there_is_not_is_reported() -> None:
    rig = cell_rig(1)
    with pytest.raises(
        CalibrationError, match=r"^--solve: 'angle' is not one of position, guide, radius, .*pitch, run-out, eccentricity, .*tilt$"
    ):
        solved_parameters(rig, rig.cable, ("angle",))
    with pytest.raises(CalibrationError, match="nothing is left to solve for"):
        solved_parameters(rig, rig.cable, ())
    with pytest.raises(RigError, match="there is no observation point B9 in"):
        value_of(rig, "B9.count_length_mm")
    with pytest.raises(RigError, match=r"there is no point Q in \[tool\] of"):
        value_of(rig, "tool.Q.x_mm")
    assert value_of(rig, "ball.radius_mm") is None
    assert value_of(rig, "tool.P1.mass_kg") is None
    assert value_of(rig, "B1.name") is None
    assert value_of(rig, "B1.count_length_mm") == rig.point("B1").drum.count_length_mm
    assert stated_u(rig, "B1.scale") is None


def with_encoders() -> Rig:
    """Swivels whose zeros are known, exact, and unknown, one that is not absolute, and an inclination."""
    common = {"counts_per_revolution": 4096}
    swivels = [{"point": f"B{i}", "channel": f"sw{i}", **common} for i in (1, 2, 3, 4)]
    swivels[0] |= {"zero_deg": 10.0, "u_zero_deg": 0.002}
    swivels[1] |= {"zero_deg": 20.0}
    swivels[3] |= {"absolute": False}
    return rig_from_dict(cell_rig(1).to_dict() | {"swivel": swivels, "inclination": [{"channel": "level", "axis": [1, 0, 0], **common}]})


def test_an_encoder_sees_its_points_place_and_guide_its_cables_end_and_its_own_zero() -> None:
    rig = with_encoders()
    swivel, level = rig.observed[len(rig.cable)], rig.observed[-1]
    names = parameter_names(rig, (rig.cable[0], swivel, level))
    own = {BY_BASE: "x_mm", BY_BASE + 1: "y_mm", BY_BASE + 2: "z_mm", BY_ALPHA: "guide_alpha_deg", BY_BETA: "guide_beta_deg"}
    expected = {i: f"B1.{key}" for i, key in own.items()} | {BY_ANGLE_ZERO: "sw1.zero_deg"}
    expected |= {BY_ATTACHMENT + i: f"tool.{rig.cable[0].to_point}.{a}_mm" for i, a in enumerate("xyz")}
    assert names[1] == [expected.get(i, "") for i in range(len(TABLE))]
    assert names[2] == ["level.zero_deg" if i == BY_ANGLE_ZERO else "" for i in range(len(TABLE))]
    assert all(names[0][i] == name for i, name in expected.items() if i != BY_ANGLE_ZERO)
    assert tilt_names(swivel) == ("B1.swivel_tilt_alpha_deg", "B1.swivel_tilt_beta_deg")
    assert tilt_names(level) == ()
    further = further_names(rig, (rig.cable[0], swivel))
    assert {name.removeprefix("B1.") for name in further[0]} == FURTHER_KEYS
    assert set(further[1]) == {""}


def test_zeros_are_solved_for_but_where_they_are_exact_or_mean_nothing() -> None:
    rig = with_encoders()
    found = {p.name: p for p in solved_parameters(rig, rig.observed, ("position",)) if p.name.endswith("zero_deg")}
    assert {name: (p.value, p.prior_u, p.unit) for name, p in found.items()} == {
        "sw1.zero_deg": (10.0, 0.002, "deg"),
        "sw3.zero_deg": (0.0, ANYWHERE_DEG, "deg"),
        "level.zero_deg": (0.0, ANYWHERE_DEG, "deg"),
    }
    assert parameter_of(rig, "sw2.zero_deg").prior_u == EXACT
    assert [value_of(rig, f"sw{i}.zero_deg") for i in (1, 2, 3)] == [10.0, 20.0, None]
    assert stated_u(rig, "sw1.zero_deg") == 0.002
    with pytest.raises(RigError, match="there is no encoder sw9 in"):
        value_of(rig, "sw9.zero_deg")
    moved = with_values(rig, {"sw2.zero_deg": 200.0, "level.zero_deg": 30.0})
    assert [value_of(moved, name) for name in ("sw1.zero_deg", "sw2.zero_deg", "level.zero_deg")] == [10.0, -160.0, 30.0]


def test_a_group_of_one_point_alone() -> None:
    rig = cell_rig(1)

    def names(*solve: str) -> list[str]:
        return [p.name for p in solved_parameters(rig, rig.cable, solve)]

    assert names("run-out:B3") == ["B3.run_out_cos_mm", "B3.run_out_sin_mm"]
    assert names("axial:B2", "radius:B1") == ["B1.pulley_radius_mm", "B2.axial_offset_mm"]
    assert len(names("attachment")) == 9
    assert group_names(rig.cable, "axial") == tuple(f"B{i}.axial_offset_mm" for i in range(1, 7))
    for requested in ("axial:B9", "attachment:B1", "attachment:P1"):
        group, _, owner = requested.partition(":")
        with pytest.raises(CalibrationError, match=f"^--solve: {group}:{owner}: '{owner}' is no observation_point "):
            names(requested)
    # a point without a pulley has none that could be off its axis
    straight = with_values(rig, {"B2.pulley_radius_mm": 0.0})
    for group, each in (("eccentricity", 2), ("offset", 1), ("run-out", 2)):
        found = [p.name for p in solved_parameters(straight, straight.cable, (group,))]
        owners = [f"B{i}" for i in range(1, 7) if i != 2 or group == "run-out"]
        assert [name.partition(".")[0] for name in found] == [owner for owner in owners for _ in range(each)]


def test_what_is_not_given_is_nothing_and_comes_back_when_it_is() -> None:
    rig = cell_rig(1)
    keys = [key for group in ("run-out", "eccentricity", "offset", "diameter", "backlash", "tilt") for key in GROUPS[group]]
    given = {f"B2.{key}": 0.01 * (i + 1) for i, key in enumerate(keys)}
    assert [value_of(rig, name) for name in given] == [0.0] * len(keys)
    assert {name: value_of(with_values(rig, given), name) for name in given} == given
    assert value_of(rig, "B1.u_position_mm") is None
    # of two that stand together the other one stays nothing
    for one, other in (GROUPS["run-out"], GROUPS["run-out"][::-1]):
        assert value_of(with_values(rig, {f"B2.{one}": 0.02}), f"B2.{other}") == 0.0


def test_angles_of_one_direction() -> None:
    """Whatever is written of a guide, the way it points is the same; within the ranges nothing is rewritten."""
    rng, rig = np.random.default_rng(4), cell_rig(1)

    def way(alpha: float, beta: float) -> list[float]:
        return list(guide_direction(np.radians(alpha), np.radians(beta)))

    for alpha, beta in rng.uniform(-400.0, 400.0, (20, 2)):
        point = with_values(rig, {"B1.guide_alpha_deg": alpha, "B1.guide_beta_deg": beta}).point("B1")
        assert abs(point.guide_alpha_deg) <= 90.0
        assert abs(point.guide_beta_deg) <= 360.0
        assert way(point.guide_alpha_deg, point.guide_beta_deg) == pytest.approx(way(alpha, beta), abs=1e-12)
        (a, other_a), (b, other_b) = same_direction("guide_alpha_deg", alpha), same_direction("guide_beta_deg", beta)
        assert (a, b) == (alpha, beta)
        assert way(other_a, other_b) == pytest.approx(way(alpha, beta), abs=1e-12)
    for beta, kept in ((360.0, 360.0), (-360.0, -360.0), (360.5, 0.5), (-400.0, -40.0), (500.0, 140.0)):
        assert with_values(rig, {"B1.guide_alpha_deg": 20.0, "B1.guide_beta_deg": beta}).point("B1").guide_beta_deg == kept
    for alpha, angles in ((90.0, (90.0, 10.0)), (-90.0, (-90.0, 10.0)), (-100.0, (-80.0, 190.0))):
        point = with_values(rig, {"B1.guide_alpha_deg": alpha, "B1.guide_beta_deg": 10.0}).point("B1")
        assert (point.guide_alpha_deg, point.guide_beta_deg) == angles


def test_the_azimuth_of_a_steep_guide_is_worse_known() -> None:
    assert [azimuth_stretch(a) for a in (0.0, 59.0, -59.0)] == [1.0] * 3
    assert azimuth_stretch(80.0) == azimuth_stretch(-80.0) == pytest.approx(0.5 / np.cos(np.radians(80.0)))
    assert azimuth_stretch(90.0) == pytest.approx(0.5e9)

    def prior(alpha: float, key: str, **stated: float) -> float:
        data = cell_rig(1).to_dict()
        data["observation_point"][0] |= {"guide_alpha_deg": alpha, **stated}
        return parameter_of(rig_from_dict(data), f"B1.{key}").prior_u

    assert prior(80.0, "guide_beta_deg") == pytest.approx(2.5 / np.cos(np.radians(80.0)))
    assert prior(80.0, "guide_alpha_deg") == 5.0
    assert prior(90.0, "guide_beta_deg") == 104.0  # anywhere
    assert prior(80.0, "guide_beta_deg", u_guide_deg=1.0) == pytest.approx(0.5 / np.cos(np.radians(80.0)))
    assert prior(80.0, "guide_beta_deg", u_guide_deg=0.0) == EXACT
