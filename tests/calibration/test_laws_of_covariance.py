"""What residuals of a campaign err by, pair by pair, from what each of the two has in common with the other."""

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_laws_of_residuals import POSES, campaign_of
from test_with_encoders import swivelled

from lmeasure.calibration import Campaign, Model, unknowns_of
from lmeasure.calibration.solve.frame import model_of
from lmeasure.calibration.solve.residuals import parameters_of
from lmeasure.calibration.solve.unknowns import rig_with
from lmeasure.core import FloatArray
from lmeasure.rig import rig_from_dict
from lmeasure.sensors import ARM_MM

COUNT_MM, TICK_MM = 0.012, 2.0 * np.pi / 131072 * ARM_MM
REFERENCE = np.array([0, 1, 2, 3, 1, 2])
"""The last two poses are later visits of earlier ones."""


def measured(**changes: Any) -> Campaign:
    """Six cables and six absolute encoders, in two passes; every channel is counted from one of three zero poses."""
    data = swivelled(2).to_dict()
    for number, point in enumerate(data["observation_point"]):
        point["drum"] |= {"count_length_mm": COUNT_MM, "scale": 1.0 + 0.1 * number, "zero_exact": number == 5}
    campaign, _ = campaign_of(rig_from_dict(data))
    # whole counts, which are zero where they were zeroed
    counts = campaign.counts.copy()
    scales = campaign.rig.scales(campaign.cables)
    counts[:, :6] = np.rint(counts * scales)[:, :6] / scales[:6]
    zero = campaign.zero
    counts[zero[:6], np.arange(6)] = 0.0
    return replace(campaign, temperature_c=None, counts=counts, **changes)


def model_with(campaign: Campaign) -> Model:
    return Model(campaign, unknowns_of(campaign, ("position",)))


def pairs(model: Model, law: Any) -> FloatArray:
    """(e, e) of a law of two residuals, each a pose and a channel."""
    each = list(zip(model.pose_index.tolist(), model.cable_index.tolist(), strict=True))
    return np.array([law(*one, *other) for one, other in product(each, each)]).reshape(len(each), len(each))


def count_mm(campaign: Campaign, j: int) -> float:
    """A recorded count."""
    return COUNT_MM / campaign.rig.scales(campaign.cables)[j] if j < 6 else TICK_MM


@pytest.mark.parametrize("dwelt", [False, True])
def test_counts_err_each_on_its_own_and_by_where_their_channel_was_zeroed(dwelt: bool) -> None:
    """Rounding is uniform within a count, and so is the phase of a zero that is not exact; the mean of a dwell has its own variance."""
    campaign = measured()
    if dwelt:
        rng = np.random.default_rng(3)
        of_zeros = np.r_[np.linspace(0.1, 0.2, 6), [0.0] * 6]
        campaign = replace(campaign, dwell_variance=rng.uniform(0.01, 0.1, (POSES, 12)), zero_variance=of_zeros)
    model = model_with(campaign)
    own = np.full((POSES, 12), 1.0 / 12.0) if campaign.dwell_variance is None else campaign.dwell_variance
    zero = np.r_[np.full(5, 1.0 / 12.0), np.zeros(7)] if campaign.zero_variance is None else campaign.zero_variance

    def law(i: int, j: int, k: int, m: int) -> float:
        if j != m:
            return 0.0
        return float(count_mm(campaign, j) ** 2 * (zero[j] + (own[i, j] if i == k else 0.0)))

    np.testing.assert_allclose(model.reading_covariance(), pairs(model, law), rtol=1e-9, atol=1e-18)
    whole, shared = model.uniform()
    cables = model.cable_index < 6
    own_mm2 = own * [count_mm(campaign, j) ** 2 for j in range(12)]
    np.testing.assert_allclose(whole[cables], own_mm2[model.pose_index[cables], model.cable_index[cables]])
    np.testing.assert_array_equal(whole[~cables], 0.0)
    assert shared.shape == (len(cables), 6 if dwelt else 5)


def test_visits_of_a_pose_share_its_error_and_cables_of_a_pass_the_robots() -> None:
    """By the residuals' derivatives by the poses, of the zero poses too."""
    rng = np.random.default_rng(5)
    u_visit = rng.uniform(1e-4, 1e-3, (POSES, 6)) * [1, 1, 1, 100, 100, 100]
    campaign = measured(reference=REFERENCE, u_visit=u_visit)
    # at each pose two cables and their encoders are read after the others
    data = campaign.rig.to_dict()
    for number in (1, 3):
        data["cable"][number]["pass"] = 2
    rig = rig_from_dict(data)
    assert [o.channel for o in rig.observed] == [o.channel for o in campaign.cables]
    model = model_with(replace(campaign, rig=rig, cables=rig.observed))
    second = model.campaign.cables
    passage = [c.passage for c in second]
    assert set(passage) == {1, 2}
    theta = model.start
    J = model.pose_jacobian(theta)
    spread = np.repeat([1e-4, 0.05], 3) ** 2
    counts = model.reading_covariance()
    expected = counts.copy()
    for e, f in product(range(len(J)), repeat=2):
        for a, b in product(range(POSES), repeat=2):
            if REFERENCE[a] == REFERENCE[b]:
                expected[e, f] += float((J[e, a] * spread) @ J[f, b])
        if passage[model.cable_index[e]] == passage[model.cable_index[f]]:
            expected[e, f] += sum(float((J[e, a] * u_visit[a] ** 2) @ J[f, a]) for a in range(POSES))
    np.testing.assert_allclose(model.measurement_covariance(theta), expected, rtol=1e-9, atol=1e-15)


def test_lengths_err_on_their_own_at_every_pose_and_where_they_were_zeroed() -> None:
    """Absolute encoders count from no zero pose."""
    model = model_with(measured(reference=REFERENCE))
    noise = model.noise
    u, taken = np.linspace(0.01, 0.12, 12), np.array([0.0, 0.04, 0.0, 0.09, 0.5, 0.7])
    plain = model.covariance(model.start)

    def of_lengths(i: int, j: int, k: int, m: int) -> float:
        return float(u[j] ** 2 * ((i == k) + (j < 6))) if j == m else 0.0

    wide = model.with_noise(noise.with_lengths(u))
    np.testing.assert_allclose(wide.covariance(model.start) - plain, pairs(model, of_lengths), rtol=1e-7, atol=1e-12)
    assert wide is not model
    assert model.noise is noise
    zero = model.campaign.zero

    def taken_back(i: int, j: int, k: int, m: int) -> float:
        """Each end of a residual is the length of a reference pose, whose variance a loss has raised."""
        if j != m:
            return 0.0
        ends = [{REFERENCE[i]: 1.0}, {REFERENCE[k]: 1.0}]
        for end in ends:
            if j < 6:
                end[REFERENCE[zero[j]]] = end.get(REFERENCE[zero[j]], 0.0) - 1.0
        return float(sum(ends[0].get(r, 0.0) * ends[1].get(r, 0.0) * taken[r] for r in range(POSES)))

    robust = model.with_noise(replace(noise, robust_variance_mm2=taken))
    np.testing.assert_allclose(robust.covariance(model.start) - plain, pairs(model, taken_back), rtol=1e-7, atol=1e-12)
    np.testing.assert_array_equal(robust.taken_back, taken[model.pose_index])
    assert model.taken_back is None


def test_poses_that_were_unknown_are_as_uncertain_as_their_unknowns() -> None:
    """Each component by its own variance, where rotations are free beside what the file states of the positions."""
    campaign = measured(reference=None)
    for free in ((0, 1, 2), tuple(range(6))):
        model = model_of(campaign, unknowns_of(campaign, ("position",)), free, "rig" if len(free) == 6 else None)
        theta = model.start
        n = len(theta)
        variance = np.linspace(1.0, 2.0, n) ** 2
        found = model.found_poses(theta, np.diag(variance))
        own = variance[model.own :].reshape(POSES, len(free))
        expected = np.zeros((POSES, 6))
        expected[:, free] = own * np.where(np.array(free) < 3, np.radians(1.0), 1.0) ** 2
        if len(free) == 3:
            expected[:, 3:] += 0.05**2
        assert found.covariance is not None
        np.testing.assert_allclose(found.covariance, [np.diag(v) for v in expected], rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(found.u_rotation_rad, np.sqrt(expected[:, :3].mean(axis=1)))
        np.testing.assert_allclose(found.u_position_mm, np.sqrt(expected[:, 3:].mean(axis=1)))
        np.testing.assert_allclose(found.rows, campaign.poses.rows, atol=1e-12)
    alone = model_with(campaign)
    assert alone.found_poses(alone.start, np.eye(len(alone.start))) is campaign.poses


@pytest.mark.parametrize("play", ["uncertain", "known", "sought"])
def test_play_errs_for_each_reading_and_once_for_all_of_a_cable_where_it_was_zeroed(play: str) -> None:
    """Which way a cable was pulled where it rests nobody recorded; play that is known, or sought, takes part in the zero alone, of angles
    in both. An encoder of which none is stated has none."""
    data = swivelled(2).to_dict()
    for number, point in enumerate(data["observation_point"]):
        point["drum"] |= {"count_length_mm": COUNT_MM, "scale": 1.0 + 0.1 * number, "backlash_counts": 4.0}
        if play != "known":
            point["drum"]["u_backlash_counts"] = 1.0 + number
    data["swivel"] = [s | ({"backlash_deg": 0.02} if i else {}) for i, s in enumerate(data["swivel"])]
    campaign, _ = campaign_of(rig_from_dict(data))
    campaign = replace(campaign, temperature_c=None)
    model = Model(campaign, parameters_of(campaign.rig, campaign.drums, ("backlash",))) if play == "sought" else model_with(campaign)
    count = COUNT_MM / (1.0 + 0.1 * np.arange(6))
    u, known, none = count * (1.0 + np.arange(6)), count * 4.0, np.zeros(6)
    own, begun = {"uncertain": (u, np.hypot(u, known)), "known": (none, known), "sought": (none, u)}[play]
    arc = np.r_[0.0, np.full(5, np.radians(0.01) * ARM_MM)]

    def law(i: int, j: int, k: int, m: int) -> float:
        if j != m:
            return 0.0
        if j >= 6:
            return float(arc[j - 6] ** 2) if i == k else 0.0
        return float(begun[j] ** 2 + (own[j] ** 2 if i == k else 0.0))

    found = model.unsolved_covariance(model.start)
    assert found is not None
    np.testing.assert_allclose(found, pairs(model, law), rtol=1e-9, atol=1e-18)


def test_nothing_else_is_uncertain_unless_it_is_stated() -> None:
    """Neither play nor dimensions nor temperature: what is left is what counts and poses err by."""
    model = model_with(measured())
    assert model.unsolved_covariance(model.start) is None
    assert model.effect_covariance(model.start) is None
    np.testing.assert_array_equal(model.covariance(model.start), model.measurement_covariance(model.start))


def test_dimensions_err_alike_in_all_equations() -> None:
    """Of points on the tool, against the residuals of rigs that have them elsewhere; there is no play."""
    rig = swivelled(2).model_copy(update={"u_attachment_mm": 0.02})
    campaign, _ = campaign_of(rig, exact=True)
    unknowns = unknowns_of(campaign, ("position",))
    model = Model(campaign, unknowns)
    columns = []
    for point, axis in product(rig.tool, range(3)):
        ends = []
        for sign in (1.0, -1.0):
            tool = {name: tuple(np.array(at) + sign * 0.02 * (name == point) * np.eye(3)[axis]) for name, at in rig.tool.items()}
            ends.append(Model(replace(campaign, rig=rig.model_copy(update={"tool": tool})), unknowns).residuals(model.start))
        columns.append((ends[0] - ends[1]) / 2.0)
    expected = np.array(columns).T @ np.array(columns)
    found = model.covariance(model.start) - model.measurement_covariance(model.start)
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-8)


WARM = {
    "cable_expansion_per_k": 1.6e-5, "u_cable_expansion_per_k": 2e-6, "cable_stiffness_n": 9000.0, "u_cable_stiffness_n": 90.0,
    "cable_tension_n": 6.0, "cable_tension_n_per_m": 0.5, "u_cable_tension_n": 0.3, "cable_mass_kg_per_m": 4e-3,
    "u_cable_mass_kg_per_m": 1e-4, "guide_length_mm": 300.0,
}  # fmt: skip


@pytest.mark.parametrize("friction_n", [0.0, 0.2])
@pytest.mark.parametrize("u_temperature_k", [0.0, 0.5])
def test_what_temperature_stretch_and_friction_err_by(friction_n: float, u_temperature_k: float) -> None:
    """Properties err alike everywhere, against residuals of rigs that have others; the temperature of a pose for all its cables, against
    residuals of campaigns in which it was warmer there; friction of a cable at every stop anew, by as much of its free length as the
    tension stretches it. Where a counter was zeroed all its residuals have what erred there; encoders have none of it."""
    data = swivelled(2).to_dict()
    data |= {"frame_expansion_per_k": 1.2e-5, "u_frame_expansion_per_k": 1e-6, "u_temperature_k": u_temperature_k}
    for point in data["observation_point"]:
        point["drum"] |= WARM | {"u_cable_tension_change_n": friction_n}
        point["pulley_radius_mm"] = 0.0
    rig = rig_from_dict(data)
    campaign, rows = campaign_of(rig)
    unknowns = unknowns_of(campaign, ("position",))
    model = Model(campaign, unknowns)

    def residuals(changed: Campaign) -> FloatArray:
        return Model(changed, unknowns).residuals(model.start)

    def with_value(number: int | None, key: str, sign: float) -> Campaign:
        other = rig.to_dict()
        holder = other if number is None else other["observation_point"][number]["drum"]
        holder[key] += sign * holder[f"u_{key}"]
        return replace(campaign, rig=rig_from_dict(other))

    def warmer(pose: int, k: float) -> Campaign:
        assert campaign.temperature_c is not None
        return replace(campaign, temperature_c=campaign.temperature_c + k * (np.arange(POSES) == pose)[:, None])

    uncertain = [(None, "frame_expansion_per_k"), *product(range(6), [key.removeprefix("u_") for key in WARM if key[:2] == "u_"])]
    columns = [(residuals(with_value(*one, 1.0)) - residuals(with_value(*one, -1.0))) / 2.0 for one in uncertain]
    if u_temperature_k:
        columns += [(residuals(warmer(i, u_temperature_k)) - residuals(warmer(i, -u_temperature_k))) / 2.0 for i in range(POSES)]
    expected = np.array(columns).T @ np.array(columns)
    free = np.zeros((POSES, 12))
    for j, cable in enumerate(rig.cable):
        point = rig.point(cable.from_point)
        tied = rows[:, :3] + Rotation.from_quat(rows[:, 3:]).apply(rig.tool[cable.to_point])
        drum = point.drum
        free[:, j] = np.linalg.norm(tied - point.position_mm, axis=1) + np.hypot(drum.tangent_length_mm, drum.axial_offset_mm) + 300.0
    stretched = free * friction_n / 9000.0

    def by_friction(i: int, j: int, k: int, m: int) -> float:
        return float((stretched[i, j] ** 2 if i == k else 0.0) + stretched[campaign.zero[j], j] ** 2) if j == m else 0.0

    expected += pairs(model, by_friction)
    size = np.sqrt(np.diag(expected))
    cables = model.cable_index < 6
    assert (size[cables] > 1e-4).all()
    np.testing.assert_array_equal(size[~cables], 0.0)
    found = model.effect_covariance(model.start)
    assert found is not None
    np.testing.assert_allclose(found, expected, rtol=5e-3, atol=1e-6)
    whole = model.covariance(model.start)
    np.testing.assert_allclose(whole - model.measurement_covariance(model.start), found, atol=1e-9)


def test_visits_err_at_poses_that_are_exact_too() -> None:
    """How a robot comes back is another thing than how well its poses are known."""
    rng = np.random.default_rng(6)
    u_visit = rng.uniform(1e-4, 1e-3, (POSES, 6)) * [1, 1, 1, 100, 100, 100]
    campaign = measured(u_visit=u_visit)
    model = model_with(replace(campaign, poses=campaign.poses.with_uncertainty(0.0, 0.0)))
    off = (model.pose_jacobian(model.start) * u_visit).reshape(model.equations, -1)
    found = model.measurement_covariance(model.start) - model.reading_covariance()
    np.testing.assert_allclose(found, off @ off.T, rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("absent", [(), ("position",), ("position", "rotation")])
@pytest.mark.parametrize("free", [(0, 1, 2), tuple(range(6))])
def test_found_poses_err_by_what_was_stated_or_taken_in_its_place(absent: tuple[str, ...], free: tuple[int, ...]) -> None:
    """What the residuals have widened is no part of a file that states its positions, nor of positions that were unknown themselves."""
    campaign = measured()
    poses = replace(campaign.poses, absent=absent, u_position_mm=np.full(POSES, 0.0 if absent else 0.05))
    model = model_of(replace(campaign, poses=poses), unknowns_of(campaign, ("position",)), free, "rig" if len(free) == 6 else None)
    model = model.with_noise(model.noise.widened(0.3, 0.0))
    n = len(model.start)
    found = model.found_poses(model.start, np.zeros((n, n)))
    place = 0.0 if len(free) == 6 else np.hypot(0.1, 0.3) if absent else 0.05
    np.testing.assert_allclose(found.u_position_mm, place, rtol=1e-9)
    np.testing.assert_allclose(found.u_rotation_rad, 0.0, atol=1e-15)


@pytest.mark.parametrize("u_deg", [0.02, 1000.0])
def test_zeros_that_were_found_are_in_the_rig_with_what_they_err_by(u_deg: float) -> None:
    """Once around the circle at most; those that nobody sought stay as they were, and without uncertainties so do theirs."""
    data = swivelled(2, leaning=True).to_dict()
    data["swivel"][1]["u_zero_deg"] = 0.0
    data["inclination"][1]["u_zero_deg"] = 0.0
    rig = rig_from_dict(data)
    campaign, _ = campaign_of(rig)
    unknowns = unknowns_of(campaign, ("position",))
    zeros = [n for n in unknowns.names if n.endswith(".zero_deg")]
    assert len(zeros) == 6
    theta = unknowns.nominal + 0.25
    u = np.array([u_deg * (1.0 + 0.1 * i) for i in range(len(theta))])
    found = rig_with(campaign, unknowns, theta, "record.json", u=u)
    assert found.calibration == "record.json"
    alike = rig_with(campaign, unknowns, theta, "record.json")
    for before, after, plain in zip(
        (*rig.swivel, *rig.inclination), (*found.swivel, *found.inclination), (*alike.swivel, *alike.inclination), strict=True
    ):
        name = f"{before.channel}.zero_deg"
        sought = name in zeros
        assert before.zero_deg is not None
        assert after.zero_deg == plain.zero_deg == pytest.approx(before.zero_deg + (0.25 if sought else 0.0))
        assert after.u_zero_deg == (min(u[unknowns.names.index(name)], 360.0) if sought else before.u_zero_deg)
        assert plain.u_zero_deg == before.u_zero_deg
    # what is written is read again
    assert rig_from_dict(found.to_dict()) == found
