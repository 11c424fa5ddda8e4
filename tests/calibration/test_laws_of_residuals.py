"""Residuals of a campaign with everything a rig may have: against strings laid on discs, finite differences, and one unknown at a time."""

from dataclasses import replace

import numpy as np
import oracles
import pytest
from scipy.spatial.transform import Rotation
from test_with_encoders import swivelled

from lmeasure.calibration import Campaign, Model, unknowns_of
from lmeasure.calibration.solve.frame import model_of
from lmeasure.core import FloatArray, se3
from lmeasure.recording import Poses
from lmeasure.rig import GROUPS, Rig, SensorChannel, rig_from_dict
from lmeasure.sensors import counts_from_poses

PARTS = ("run-out", "eccentricity", "offset", "diameter", "backlash", "tilt")
PLAIN = ("position", "guide", "radius", "scale", "tangent", "axial", "attachment", "pitch")
POSES = 6


def with_parts(*, first: bool = False) -> Rig:
    """Encoders on every pulley, levels, and parts that are not as drawn, of every other cable; temperature, stretch and sag."""
    data = swivelled(2, leaning=True).to_dict()
    data["frame_expansion_per_k"] = 1.2e-5
    for i, point in enumerate(data["observation_point"]):
        point["drum"] |= {
            "cable_expansion_per_k": 1.6e-5,
            "cable_stiffness_n": 9000.0,
            "cable_tension_n": 6.0,
            "cable_tension_n_per_m": 0.5,
        }
        point["drum"]["scale"] = 1.0 + 1e-3 * (i + 1)
        point["phase_length_mm"] = 1500.0 + 10.0 * i
        if i % 2 != first:
            point |= {"swivel_offset_mm": 0.4, "swivel_tilt_deg": [0.3, -0.2], "pulley_eccentricity_mm": [0.1, -0.2]}
            point["drum"] |= {"cable_oversize_mm": 0.1, "run_out_mm": [0.05, 0.03], "backlash_counts": 2.0}
    return rig_from_dict(data)


def campaign_of(rig: Rig, *, seed: int = 0, exact: bool = False) -> tuple[Campaign, FloatArray]:
    """Counts at poses, each channel zeroed at one of its own, some not counted; and the poses. exact: without errors."""
    rng = np.random.default_rng(seed)
    rows = np.column_stack([rng.uniform(-250, 250, (POSES, 3)), Rotation.from_rotvec(rng.uniform(-0.3, 0.3, (POSES, 3))).as_quat()])
    observed = rig.observed
    zero = np.arange(len(observed)) % 3
    counts = np.column_stack([counts_from_poses(rig, rows, rows[z], observed)[:, j] for j, z in enumerate(zero)])
    if not exact:
        counts += rng.normal(0.0, 3.0, counts.shape) * (np.arange(POSES)[:, None] != zero)
    for i, j in ((3, 0), (4, 2), (5, len(observed) - 1)):
        counts[i, j] = np.nan
    names = tuple(str(i + 1) for i in range(POSES))
    warm = 20.0 + rng.uniform(0, 6, counts.shape)
    poses = Poses(names, rows, np.full(POSES, 0.05), np.full(POSES, 1e-4))
    return Campaign(rig, poses, observed, counts, zero, temperature_c=None if exact else warm), rows


def numeric(model: Model, theta: FloatArray, step: float = 1e-3) -> FloatArray:
    return np.array([(model.residuals(theta + d) - model.residuals(theta - d)) / (2 * step) for d in step * np.eye(len(theta))]).T


@pytest.mark.parametrize("free", [(), (0, 1, 2), (3, 4, 5), tuple(range(6))])
def test_derivatives_of_all_unknowns_are_those_of_finite_differences(free: tuple[int, ...]) -> None:
    campaign, _ = campaign_of(with_parts())
    model = model_of(campaign, unknowns_of(campaign, (*PLAIN, *PARTS)), free)
    assert {name.rsplit(".", 1)[1] for name in model.parameters.names} >= {key for group in (*PLAIN, *PARTS) for key in GROUPS[group]}
    theta = model.start + 1e-2 * np.random.default_rng(1).normal(size=len(model.start))
    J, expected = model.jacobian(theta), numeric(model, theta)
    assert np.abs(expected).max(axis=0).min() > 0.0
    # expansion and stretch, a ten-thousandth of a length, are no part of the derivatives
    assert (np.abs(J - expected) <= 3e-4 * np.maximum(1.0, np.abs(expected).max(axis=0))).all()


@pytest.mark.parametrize(("group", "first"), [*((group, False) for group in (*PLAIN, *PARTS)), ("guide", True), ("tilt", True)])
def test_a_group_of_unknowns_solved_alone_changes_what_it_changes_among_others(group: str, first: bool) -> None:
    """Whichever unknown is the first, and whether its cable has parts that are not as drawn or others have."""
    campaign, _ = campaign_of(with_parts(first=first))
    every = Model(campaign, unknowns_of(campaign, (*PLAIN, *PARTS)))
    alone = Model(campaign, unknowns_of(campaign, (group,)))
    place = [every.parameters.names.index(name) for name in alone.parameters.names]
    at = alone.start + 1e-2 * np.random.default_rng(2).normal(size=len(alone.start))
    among = every.start.copy()
    among[place] = at
    np.testing.assert_allclose(alone.residuals(at), every.residuals(among), atol=1e-9)
    np.testing.assert_allclose(alone.jacobian(at), every.jacobian(among)[:, place], rtol=1e-9, atol=1e-9)


def test_derivatives_by_poses_are_those_of_finite_differences() -> None:
    campaign, rows = campaign_of(with_parts())
    unknowns = unknowns_of(campaign, ("position",))
    model = Model(campaign, unknowns)
    J, step = model.pose_jacobian(model.start), 1e-4
    for i in range(POSES):
        for c in range(6):
            ends = []
            for sign in (1.0, -1.0):
                there = np.zeros((POSES, 6))
                there[i, c] = sign * step
                moved = replace(campaign, poses=replace(campaign.poses, rows=se3.displaced(rows, there)))
                ends.append(Model(moved, unknowns).residuals(model.start))
            np.testing.assert_allclose(J[:, i, c], (ends[0] - ends[1]) / (2 * step), rtol=3e-4, atol=3e-4)


def test_zeros_of_encoders_are_begun_where_their_readings_put_them() -> None:
    """Wherever on the circle they stood before, and all else is left as it is; of readings that differ by their mean."""
    campaign, _ = campaign_of(swivelled(3), exact=True)
    model = Model(campaign, unknowns_of(campaign, ("position",)))
    mine = [n.endswith(".zero_deg") for n in model.parameters.names]
    assert sum(mine) == 6
    away = model.start.copy()
    away[mine] += [100.0, -179.0, 250.0, 0.0, 90.0, -45.0]
    begun = model.zeros_begun(away)
    np.testing.assert_allclose(begun, model.start, atol=1e-9)
    counts = campaign.counts.copy()
    last = len(campaign.cables) - 1
    there = np.flatnonzero(np.isfinite(counts[:, last]))
    counts[there[0], last] += 20.0
    off = Model(replace(campaign, counts=counts), unknowns_of(campaign, ("position",)))
    observed = campaign.cables[last]
    assert isinstance(observed, SensorChannel)
    per_count = 360.0 / observed.table.counts_per_revolution
    moved = np.where(np.array(off.parameters.names) == f"{campaign.cables[last].channel}.zero_deg", 20.0 * per_count / len(there), 0.0)
    assert moved.any()
    np.testing.assert_allclose(np.abs(off.zeros_begun(away) - model.start), moved, atol=1e-7)


@pytest.mark.parametrize("shift", [0.0, 0.3])
def test_residuals_are_what_strings_on_discs_do_not_close_by(shift: float) -> None:
    """[F(P_i) - D(k_i)] - [F(P_0) - D(k_0)] of every cable and pose, each cable with a zero pose of its own."""
    data = swivelled(3).to_dict()
    del data["swivel"]
    for i, point in enumerate(data["observation_point"]):
        point["drum"]["scale"] = 1.0 + 1e-3 * (i + 1)
    rig = rig_from_dict(data)
    campaign, rows = campaign_of(rig, exact=True)
    model = Model(campaign, unknowns_of(campaign, ("position", "scale")))
    theta = model.start + shift * np.where([n.endswith("scale") for n in model.parameters.names], 1e-3, 1.0)
    found = model.residuals(theta)
    expected = []
    for i, j in zip(model.pose_index.tolist(), model.cable_index.tolist(), strict=True):
        cable, point = rig.cable[j], rig.point(rig.cable[j].from_point)
        drum, zero = point.drum, int(campaign.zero[j])
        one = oracles.Cable(
            base=(point.position_mm[0] + shift, point.position_mm[1] + shift, point.position_mm[2] + shift),
            alpha=np.radians(point.guide_alpha_deg), beta=np.radians(point.guide_beta_deg), radius=point.pulley_radius_mm,
            attachment=rig.tool[cable.to_point], tangent=drum.tangent_length_mm, axial=drum.axial_offset_mm, pitch=drum.groove_pitch_mm,
            counts_per_revolution=drum.counts_per_revolution, count_length=drum.count_length_mm, scale=drum.scale + shift * 1e-3,
        )  # fmt: skip
        ends = (oracles.misclosure(one, rows[k], campaign.counts[k, j] * drum.scale) for k in (i, zero))
        here, begun = ends
        expected.append(float(here - begun))
    np.testing.assert_allclose(found, expected, atol=1e-8)
    assert (np.abs(found).max() < 1e-8) == (shift == 0.0)


@pytest.mark.parametrize("encoders", [True, False])
def test_an_attachment_that_is_off_moves_lengths_and_angles(encoders: bool) -> None:
    """By one standard uncertainty along each axis of the tool, of every cable and encoder that looks at it."""
    rig = swivelled(2).model_copy(update={"u_attachment_mm": 0.02})
    campaign, _ = campaign_of(rig, exact=True)
    if not encoders:
        drums = len(rig.cable)
        campaign = replace(campaign, cables=campaign.cables[:drums], counts=campaign.counts[:, :drums], zero=campaign.zero[:drums])
    unknowns = unknowns_of(campaign, ("position",))
    model = Model(campaign, unknowns)
    found = model.unsolved_shifts(model.start)
    names = [name for v in model.unsolved.variables for name in v.names]
    assert len(names) == found.shape[1] == 3 * len({c.to_point for c in rig.cable})
    turned = np.array([not c.is_cable for c in campaign.cables])[model.cable_index]
    assert turned.any() == encoders
    for name, column in zip(names, found.T, strict=True):
        ends = []
        for sign in (1.0, -1.0):
            owner, key = name.removeprefix("tool.").split(".")
            tool = {point: list(at) for point, at in rig.tool.items()}
            tool[owner]["xyz".index(key.split("_")[-2])] += sign * 0.02
            moved = replace(campaign, rig=rig.model_copy(update={"tool": {point: tuple(at) for point, at in tool.items()}}))
            ends.append(Model(moved, unknowns).residuals(model.start))
        np.testing.assert_allclose(column, (ends[0] - ends[1]) / 2.0, rtol=1e-4, atol=1e-7)
        assert (np.abs(column[turned]) > 1e-4).any() == encoders


FREE = [(), (0, 1, 2), (3, 4, 5), tuple(range(6))]


@pytest.mark.parametrize("free", FREE)
@pytest.mark.parametrize("by_axes", [False, True])
def test_what_is_unknown_of_poses_takes_no_part_of_what_is_stated(free: tuple[int, ...], by_axes: bool) -> None:
    """Nor how it varies from visit to visit; where positions are unknown every visit has a pose of its own. What does not turn with an
    unknown rotation stays as it is stated."""
    rng = np.random.default_rng(4)
    campaign, _ = campaign_of(swivelled(2))
    u_visit, root = rng.uniform(1e-4, 1e-3, (POSES, 6)), 1e-2 * rng.normal(size=(POSES, 6, 6))
    covariance = root @ np.swapaxes(root, 1, 2) if by_axes else None
    poses = replace(campaign.poses, covariance=covariance, u_position_mm=np.linspace(0.02, 0.1, POSES))
    reference = np.array([0, 1, 2, 3, 3, 1])
    campaign = replace(campaign, poses=poses, u_visit=u_visit, reference=reference)
    unknowns = unknowns_of(campaign, ("position",))
    model = Model(campaign, unknowns, free=free)
    noise, turns, places = model.noise, 0 in free or 3 in free, 3 in free
    np.testing.assert_array_equal(noise.u_position_mm, 0.0 if places else poses.u_position_mm)
    np.testing.assert_array_equal(noise.u_rotation_rad, 0.0 if turns else poses.u_rotation_rad)
    kept = np.repeat([not turns, not places], 3)
    if covariance is None or places:
        assert noise.covariance is None
    else:
        np.testing.assert_array_equal(noise.covariance, covariance * np.outer(kept, kept))
    if places:
        assert model.campaign.u_visit is None
        assert model.campaign.reference is None
    else:
        np.testing.assert_array_equal(model.campaign.u_visit, u_visit * kept)
        np.testing.assert_array_equal(model.campaign.reference, reference)
    # a tool that only turns anew at every visit, and is turned anyhow
    turned = replace(campaign, u_visit=u_visit * np.repeat([1.0, 0.0], 3))
    assert (Model(turned, unknowns, free=free).campaign.u_visit is None) == turns
    # an assumed size of what is unknown takes no part either
    silent = replace(campaign, poses=replace(poses, absent=("position", "rotation")))
    expected = () if places else ("position",) if turns else ("position", "rotation")
    assert Model(silent, unknowns, free=free).noise.absent == expected
    assert Model(campaign, unknowns, noise.times(2.0), free=free).noise.u_position_mm == pytest.approx(2.0 * noise.u_position_mm)


@pytest.mark.parametrize("free", FREE[1:])
def test_poses_that_were_counted_have_unknowns_and_others_have_none(free: tuple[int, ...]) -> None:
    campaign, rows = campaign_of(swivelled(2))
    counts = campaign.counts.copy()
    # pose 1 is the zero of some channels
    counts[3] = np.nan
    campaign = replace(campaign, counts=counts, poses=replace(campaign.poses, names=tuple("abcdef")))
    model = Model(campaign, unknowns_of(campaign, ("position",)), free=free)
    keys = ("rx_deg", "ry_deg", "rz_deg", "x_mm", "y_mm", "z_mm")
    assert model.names[model.own :] == tuple(f"pose {pose}.{keys[c]}" for pose in "abcef" for c in free)
    assert model.nuisance is not None
    assert model.nuisance.shared.tolist() == [0, 1, 2]
    assert [("a", "b", "c", "e", "f")[k] for k in model.nuisance.of] == [campaign.poses.names[i] for i in model.pose_index]
    assert "pose e: its recorded cables do not determine all its unknowns" in model.undetermined_block(3)
    theta = model.start.copy()
    theta[model.own :] = np.linspace(0.5, 2.0, len(theta) - model.own)
    moved = model.poses(theta)
    np.testing.assert_array_equal(moved[3], rows[3])
    own = np.zeros((POSES, 6))
    own[np.ix_([0, 1, 2, 4, 5], free)] = theta[model.own :].reshape(5, -1)
    turn = Rotation.from_rotvec(np.radians(own[:, :3])) * Rotation.from_quat(rows[:, 3:])
    np.testing.assert_allclose(moved[:, :3], rows[:, :3] + own[:, 3:], atol=1e-12)
    assert (turn.inv() * Rotation.from_quat(moved[:, 3:])).magnitude().max() < 1e-9
    arms = model.arms
    if 0 in free:
        np.testing.assert_array_equal(arms, np.zeros((POSES, 3)))
    else:
        np.testing.assert_allclose(arms, Rotation.from_quat(rows[:, 3:]).apply(campaign.rig.tool[campaign.rig.cable[0].to_point]))


def test_exact_counts_leave_nothing() -> None:
    """Of a machine with parts that are not as drawn, in its cold; free of the play that its readings have."""
    data = with_parts().to_dict()
    for point in data["observation_point"]:
        point["drum"].pop("backlash_counts", None)
    campaign, _ = campaign_of(rig_from_dict(data), exact=True)
    for unknowns in (("position",), ("position", "guide", "tilt", *PARTS[:4])):
        model = Model(campaign, unknowns_of(campaign, unknowns))
        np.testing.assert_allclose(model.residuals(model.start), 0.0, atol=1e-6)


def test_without_a_thermometer_it_is_as_warm_as_the_rig_was_measured() -> None:
    data = with_parts().to_dict()
    data["reference_temperature_c"] = 25.0
    campaign, _ = campaign_of(rig_from_dict(data))
    unknowns = unknowns_of(campaign, ("position",))
    at_reference = replace(campaign, temperature_c=np.full(campaign.counts.shape, 25.0))
    found = Model(replace(campaign, temperature_c=None), unknowns).residuals(unknowns.nominal)
    np.testing.assert_allclose(found, Model(at_reference, unknowns).residuals(unknowns.nominal), atol=1e-12)
    assert np.abs(found - Model(campaign, unknowns).residuals(unknowns.nominal)).max() > 1e-3


def test_what_nobody_has_is_solved_for_from_nothing() -> None:
    """Parts of a machine that are as drawn: derivatives at nothing are those of finite differences too."""
    data = swivelled(2).to_dict()
    for i, point in enumerate(data["observation_point"]):
        point["phase_length_mm"] = 1500.0 + 10.0 * i
    campaign, _ = campaign_of(rig_from_dict(data))
    model = Model(campaign, unknowns_of(campaign, ("tilt", "run-out", "eccentricity", "offset", "diameter")))
    J, expected = model.jacobian(model.start), numeric(model, model.start)
    assert np.abs(expected).max(axis=0).min() > 0.0
    assert (np.abs(J - expected) <= 3e-4 * np.maximum(1.0, np.abs(expected).max(axis=0))).all()


def test_axes_that_lean_carry_parts_that_are_far_off_along() -> None:
    """Pulleys of which nobody would say that they are as drawn: derivatives by both tilts are those of finite differences."""
    data = swivelled(2).to_dict()
    for i, point in enumerate(data["observation_point"]):
        point |= {"swivel_offset_mm": 2.0, "pulley_eccentricity_mm": [1.0, -0.7], "phase_length_mm": 1500.0 + 10.0 * i}
        point["swivel_tilt_deg"] = [0.3, -0.2]
    campaign, _ = campaign_of(rig_from_dict(data))
    model = Model(replace(campaign, temperature_c=None), unknowns_of(campaign, ("tilt",)))
    J, expected = model.jacobian(model.start), numeric(model, model.start)
    assert np.abs(expected).max(axis=0).min() > 0.0
    np.testing.assert_allclose(J, expected, atol=1e-4)


def test_angles_are_the_shortest_way_around() -> None:
    """Zeros of encoders that are off by more than a turn leave what they are off by less whole turns."""
    campaign, _ = campaign_of(swivelled(3), exact=True)
    model = Model(campaign, unknowns_of(campaign, ("position",)))
    off = np.array([100.0, -170.0, 250.0, 500.0, -720.0, 190.0])
    mine = [n.endswith(".zero_deg") for n in model.parameters.names]
    theta = model.start.copy()
    theta[mine] += off
    per_deg = np.radians(1.0) * campaign.mm_per_unit[6]
    left = np.abs(model.residuals(theta)[model.cable_index >= 6] / per_deg)
    expected = np.abs(off - 360.0 * np.round(off / 360.0))
    np.testing.assert_allclose(left, expected[model.cable_index[model.cable_index >= 6] - 6], atol=1e-6)


@pytest.mark.parametrize("parts", [False, True])
@pytest.mark.parametrize("small", [False, True])
def test_a_radius_has_no_sign(parts: bool, small: bool) -> None:
    """On the way to an optimum it may become less than nothing: as long as it is more, and derivatives turn around."""
    campaign, _ = campaign_of(with_parts() if parts else swivelled(2))
    model = Model(campaign, unknowns_of(campaign, ("position", "radius")))
    radii = np.array([n.endswith("pulley_radius_mm") for n in model.parameters.names])
    assert radii.sum() == 6
    theta = np.where(radii & small, 0.7, model.start)
    other = np.where(radii, -theta, theta)
    np.testing.assert_allclose(model.residuals(other), model.residuals(theta), atol=1e-12)
    J = model.jacobian(theta)
    np.testing.assert_allclose(model.jacobian(other), np.where(radii, -1.0, 1.0) * J, atol=1e-12)
    expected = numeric(model, theta)[:, radii]
    assert np.abs(expected).max() > 0.1
    # a small pulley that is off its axis turns by many times a step of differences
    if not (parts and small):
        np.testing.assert_allclose(J[:, radii], expected, atol=1e-3)


@pytest.mark.parametrize("parts", [False, True])
def test_where_a_cable_cannot_run_nothing_leads_away(parts: bool) -> None:
    """A point within the pulley: its residuals are beyond all others, and no derivative is a number that is none."""
    campaign, _ = campaign_of(with_parts() if parts else swivelled(2))
    model = model_of(campaign, unknowns_of(campaign, ("position", "radius")), tuple(range(6)))
    theta = model.start.copy()
    theta[model.parameters.names.index("B2.pulley_radius_mm")] = 1e4
    r, J = model.residuals(theta), model.jacobian(theta)
    stuck = model.cable_index == 1
    assert (r[stuck] >= 1e5).all()
    assert np.isfinite(J).all()
    np.testing.assert_array_equal(J[stuck], 0.0)
    others = ~stuck & (model.cable_index < 6)
    np.testing.assert_allclose(r[others], model.residuals(model.start)[others], atol=1e-9)
