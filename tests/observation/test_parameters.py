"""The one table of a cable's parameters: in the kernels' order, where the rig and the kernels' rows keep each."""

import numpy as np
import pytest

from lmeasure.errors import CalibrationError, RigError
from lmeasure.kernels.layout import PARAMETERS
from lmeasure.observation.parameters import (
    FACTORS,
    GROUPS,
    TABLE,
    kernel_values,
    parameter_names,
    solved_parameters,
    stated_u,
    value_of,
    with_kernel_values,
    with_values,
)
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.simulation import cell_rig


def test_the_table_is_in_the_kernels_order() -> None:
    kernels = [
        name.removeprefix("attachment_").replace("guide_alpha_rad", "guide_alpha_deg").replace("beta_rad", "beta_deg")
        for name in PARAMETERS
    ]
    assert [p.key for p in TABLE] == kernels
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


def stating() -> Rig:
    data = cell_rig(1).to_dict()
    data["u_attachment_mm"] = 0.1
    first, second, third = data["observation_point"][:3]
    first |= {"u_position_mm": 2.0, "u_guide_deg": 1.0, "u_pulley_radius_mm": 0.0}
    first["drum"] |= {"u_count_length_mm": 0.00012, "u_tangent_length_mm": 3.0}
    second["drum"] |= {"u_scale": 0.002, "u_count_length_mm": 0.00012}
    data["assumed"] = [f"{third['name']}.position_mm", f"{third['name']}.count_length_mm", "P1"]
    return rig_from_dict(data)


def test_priors_are_what_is_stated_then_what_is_usual() -> None:
    rig = stating()
    width = {p.name: p.prior_u for p in solved_parameters(rig, rig.cable, tuple(GROUPS))}
    assert [width[f"B1.{k}"] for k in ("x_mm", "z_mm", "guide_beta_deg", "tangent_length_mm")] == [2.0, 2.0, 1.0, 3.0]
    assert width["B1.pulley_radius_mm"] == 1e-9  # stated to be exact
    assert width["B1.scale"] == pytest.approx(0.01)
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


def test_what_there_is_not_is_told() -> None:
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
