"""Parts that are not as drawn: their laws against taut strings over discs, their derivatives against differences."""

from dataclasses import replace
from typing import Any

import mpmath
import numpy as np
import pytest

from lmeasure.calibration import Campaign, Model, unknowns_of
from lmeasure.core import CalibrationError, RigError, se3
from lmeasure.kernels import layout
from lmeasure.recording import poses_from_rows
from lmeasure.rig import GROUPS, Rig, rig_from_dict, solved_parameters, value_of, with_values
from lmeasure.sensors import ECCENTRICITY, OFFSET, RUN_OUT, Parts, arms, counts_from_poses, phased
from lmeasure.sensors.imperfect_parts import OVERSIZE, Acted, thicker
from lmeasure.sensors.wrap import Span, spans
from lmeasure.simulation import cell_rig, reference_poses
from lmeasure.simulation.instrument import machine_counts, with_play

POSES = reference_poses()
COUNT_MM = 0.012


def untrue(point: dict[str, Any] | None = None, drum: dict[str, Any] | None = None) -> Rig:
    data = cell_rig(1).to_dict()
    for p in data["observation_point"]:
        p.update(point or {})
        p["drum"].update(drum or {})
    return rig_from_dict(data)


EVERY = untrue(
    {"pulley_eccentricity_mm": [0.08, -0.05], "swivel_offset_mm": 0.3, "swivel_tilt_deg": [0.2, -0.3]},
    {"run_out_mm": [0.05, 0.03], "cable_oversize_mm": 0.05, "backlash_counts": 1.5},
)


@pytest.mark.parametrize(
    ("point", "drum", "least_mm", "left_mm"),
    [
        ({}, {}, 0.0, 1e-9),
        # left out: that the cable leaves the drum aslant, two hundredths of it
        ({}, {"run_out_mm": [0.04, 0.03]}, 0.05, 0.0025),
        ({"phase_length_mm": 1000.0}, {"run_out_mm": [0.04, 0.03]}, 0.05, 0.0025),
        # left out: x^2/R
        ({"pulley_eccentricity_mm": [0.04, 0.03]}, {}, 0.05, 5e-4),
        ({"pulley_eccentricity_mm": [0.04, 0.03], "phase_length_mm": 1500.0}, {}, 0.05, 5e-4),
        ({"swivel_offset_mm": 0.3}, {}, 0.03, 1e-7),
        # left out: R tilt^2
        ({"swivel_tilt_deg": [0.3, -0.2]}, {}, 0.02, 1e-6),
        ({}, {"cable_oversize_mm": 0.05}, 0.5, 1e-7),
    ],
    ids=["as drawn", "run-out", "run-out from a length", "eccentric", "eccentric from a length", "offset", "tilt", "thicker cable"],
)
def test_laws_are_those_of_taut_strings(point: dict[str, Any], drum: dict[str, Any], least_mm: float, left_mm: float) -> None:
    rig = untrue(point, drum)
    found = counts_from_poses(rig, POSES, POSES[0], rig.cable)
    plain = counts_from_poses(cell_rig(1), POSES, POSES[0], rig.cable)
    true = np.column_stack([machine_counts(rig, c, POSES, POSES[0]) for c in rig.cable])
    assert np.abs(true - plain).max() * COUNT_MM >= least_mm
    assert np.abs(found - true).max() * COUNT_MM < left_mm


@pytest.mark.parametrize("counted_from", ["a length", "the zero pose"])
@pytest.mark.parametrize("free", [(), (0, 1, 2, 3, 4, 5)], ids=["poses known", "poses free"])
def test_derivatives_are_those_of_differences(counted_from: str, free: tuple[int, ...]) -> None:
    poses = poses_from_rows(POSES)
    poses = replace(poses, u_position_mm=np.full(len(POSES), 0.02), u_rotation_rad=np.zeros(len(POSES)))
    campaign = Campaign(EVERY, poses, EVERY.cable, counts_from_poses(EVERY, POSES, POSES[0], EVERY.cable), np.zeros(6, np.int64))
    unknowns = unknowns_of(campaign, tuple(GROUPS))
    if counted_from == "a length":
        campaign = replace(campaign, rig=phased(EVERY, unknowns.names, POSES[np.zeros(6, np.int64)], EVERY.cable))
    model = Model(campaign, unknowns, free=free, frame="rig" if free else None)
    theta = model.start
    J, h = model.jacobian(theta), 1e-4
    every = range(model.own) if not free else range(0, len(theta), 7)
    for i in every:
        step = h * (np.arange(len(theta)) == i)
        difference = (model.residuals(theta + step) - model.residuals(theta - step)) / (2.0 * h)
        # left out: how the cable of a count changes with the drum, times the play
        assert np.abs(J[:, i] - difference).max() <= 1e-4 * max(np.abs(J[:, i]).max(), 1e-2), i


def test_play_lags_behind_what_turns_it() -> None:
    rig = untrue(drum={"backlash_counts": 2.0})
    path = np.concatenate([np.linspace(0, 50, 101), np.linspace(50, -50, 201), np.linspace(-50, 0, 101)])
    counts = np.tile(path[:, None], (1, 6))
    shown = with_play(rig, counts, rig.cable, np.random.default_rng(0))
    lag = counts - shown
    # the width of the band is passed between going out and coming back
    np.testing.assert_allclose(lag[90] - lag[250], 4.0)
    np.testing.assert_allclose(lag[90], lag[-1] if lag[-1, 0] == lag[90, 0] else lag[390], atol=1e-9)
    assert np.abs(lag[90]).max() <= 4.0


def test_values_are_read_and_written_by_their_names() -> None:
    rig = with_values(cell_rig(1), {"B2.run_out_sin_mm": 0.03, "B3.swivel_tilt_alpha_deg": 0.1, "B1.backlash_counts": 1.0})
    assert rig.point("B2").drum.run_out_mm == (0.0, 0.03)
    assert value_of(rig, "B2.run_out_cos_mm") == 0.0
    assert value_of(rig, "B2.run_out_sin_mm") == 0.03
    assert value_of(rig, "B1.pulley_eccentricity_cos_mm") == 0.0
    np.testing.assert_array_equal(rig.cable_rows()[1], cell_rig(1).cable_rows()[1])
    assert rig.cable_rows()[2][14] == pytest.approx(np.radians(rig.point("B3").guide_alpha_deg + 0.1))


def test_groups_may_be_of_one_point() -> None:
    rig = cell_rig(1)
    assert [p.name for p in solved_parameters(rig, rig.cable, ("run-out:B3",))] == ["B3.run_out_cos_mm", "B3.run_out_sin_mm"]
    with pytest.raises(CalibrationError, match="'B9' is no observation_point"):
        solved_parameters(rig, rig.cable, ("run-out:B9",))


@pytest.mark.parametrize(
    ("point", "drum", "said"),
    [
        ({"pulley_eccentricity_mm": [15.0, 9.0]}, {}, "no pulley turns so"),
        ({}, {"run_out_mm": [9.0, 0.0]}, "no drum is so"),
        ({}, {"cable_oversize_mm": -9.0}, "no drum is so"),
        ({"swivel_offset_mm": 30.0}, {}, "no pulley turns so"),
    ],
)
def test_slips_of_the_pen_are_refused(point: dict[str, Any], drum: dict[str, Any], said: str) -> None:
    with pytest.raises(RigError, match=said):
        untrue(point, drum)


def test_a_turn_of_a_thicker_cable() -> None:
    """A helix: of a drum on which a turn holds so much cable, wound by half the difference farther out; to the last digits where it is
    a thousandth of a micrometre."""
    for turn, pitch, over in ((72.0, 0.0, 0.2), (72.0, 10.0, 0.2), (120.0, -40.0, -0.3), (500.0, 1.5, 1e-6)):
        with mpmath.workdps(40):
            r = mpmath.sqrt(mpmath.mpf(turn) ** 2 - mpmath.mpf(pitch) ** 2) / (2 * mpmath.pi)

            def longer(by: mpmath.mpf, r: mpmath.mpf = r, turn: float = turn, pitch: float = pitch) -> mpmath.mpf:
                return mpmath.sqrt((2 * mpmath.pi * (r + by / 2)) ** 2 + mpmath.mpf(pitch) ** 2) - turn

            expected = float(longer(mpmath.mpf(over))), float(mpmath.diff(longer, mpmath.mpf(over)))
        assert [float(v) for v in thicker(turn, pitch, over)] == pytest.approx(expected, rel=1e-13)


def test_phases_are_stated_about_the_cable_that_is_out_where_counters_are_zeroed() -> None:
    """In whole millimetres, of what is asked for and turns; what a rig states itself is kept."""
    stated = {"B2": 700.0}
    data = cell_rig(1).to_dict()
    for point in data["observation_point"]:
        if point["name"] in stated:
            point["phase_length_mm"] = stated[point["name"]]
    rig, zero = rig_from_dict(data), POSES[np.arange(6)]
    assert phased(rig, (), zero, rig.cable) is rig
    assert phased(rig, ("B1.x_mm", "B2.run_out_cos_mm"), zero, rig.cable) is rig
    found = phased(rig, ("B1.run_out_cos_mm", "B2.run_out_sin_mm", "B3.pulley_eccentricity_cos_mm", "B4.scale"), zero, rig.cable)
    for i, c in enumerate(rig.cable):
        at = rig.cable_rows()[i]
        out = float(np.linalg.norm(se3.apply(zero[i], at[7:10]) - at[:3]))
        expected = stated.get(c.from_point, round(out) if c.from_point in ("B1", "B3") else None)
        assert found.point(c.from_point).phase_length_mm == expected


def test_what_is_taken_as_exact_adds_what_the_parts_of_a_rig_that_states_it_do() -> None:
    """Of six cables, one straight, whose pulley and swivel axis are none."""
    rows, random = cell_rig(1).cable_rows(), np.random.default_rng(4)
    rows[2, layout.RADIUS] = 0.0
    poses, counts = POSES[:4], random.uniform(-4e4, 4e4, (4, 6))
    zero = np.repeat(POSES[:1], 6, axis=0), np.zeros(6)
    expected = Parts(np.zeros((6, 7)), np.full(6, np.nan), np.ones(6)).gradient(rows, zero, poses, counts, since=False)
    every = spans(rows, poses, arms(rows, poses))
    for j in range(6):
        at = Acted(rows[j], se3.matrices(poses), counts[:, j], Span(*(values[:, j] for values in every)))
        for kind, columns in ((RUN_OUT, slice(0, 2)), (ECCENTRICITY, slice(2, 4)), (OFFSET, [4]), (OVERSIZE, [5])):
            if rows[j, layout.RADIUS] > 0.0 or kind in (RUN_OUT, OVERSIZE):
                assert kind.adds is not None
                np.testing.assert_allclose(kind.adds(at), expected[:, j, columns], rtol=1e-9, atol=1e-12, err_msg=kind.text)
