"""The parts of which a zone's map is made, one by one: nodes, orientations, what the figures mean, what they cover, what is scanned."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from zone_rigs import cell, published

from lmeasure.accuracy import Limits, Scan, axis, map_zone, scan_zone, tilts, zone as zones
from lmeasure.accuracy.zone import assumed_in_zone, covers, drum_variance, make_plan, named_figures, sampled
from lmeasure.core import AccuracyError, GeometryError
from lmeasure.kernels import FIGURES
from lmeasure.rig import CalibrationRecord, RecordedParameter, Rig, rig_from_dict

START = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
ONE = Rotation.identity(1)


def changed(rig: Rig, drum: dict[str, Any] | None = None, point: dict[str, Any] | None = None, which: int | None = None) -> Rig:
    data = rig.to_dict()
    for i, one in enumerate(data["observation_point"]):
        if which in (None, i):
            one |= point or {}
            one["drum"] |= drum or {}
    return rig_from_dict(data)


def record(*names: str) -> CalibrationRecord:
    return CalibrationRecord(
        rig="test", parameters=tuple(RecordedParameter(name=n, value=0.0, u=0.1, prior_u=1.0) for n in names),
        covariance=tuple(tuple(float(v) for v in row) for row in 0.01 * np.eye(len(names))), residuals=(), equations=100,
        unknowns=len(names), rank=len(names),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("span", "said"),
    [
        ((-1.1e6, 0.0, 1.0), "-1100000:0:1: lies beyond 1000000"),
        ((0.0, 1.1e6, 1.0), "lies beyond"),
        ((0.0, 1.0, math.inf), "must be finite, with start <= stop and step > 0"),
        ((0.0, 1.0, 0.0), "must be finite"),
        ((1.0, 0.0, 1.0), "must be finite"),
        ((math.nan, 0.0, 1.0), "must be finite"),
        ((0.0, math.nan, 1.0), "must be finite"),
        ((0.0, 1e6, 1e-3), "does not divide the range"),
        ((0.0, 10.0, 3.0), "does not divide the range"),
        ((0.0, 1.0, 1.0 / (1.0 + 2e-6)), "does not divide the range"),
        ((0.0, 0.5, 1.0), "does not divide the range"),
    ],
)
def test_spans_that_cannot_be_say_why(span: tuple[float, float, float], said: str) -> None:
    with pytest.raises(AccuracyError, match=said):
        axis(*span)


def test_spans_that_just_can_be() -> None:
    np.testing.assert_array_equal(axis(-1e6, 1e6, 1e6), [-1e6, 0.0, 1e6])
    # steps that are off by rounding of what was typed
    np.testing.assert_allclose(axis(0.0, 1.0, 1.0 / (1.0 + 0.5e-6)), [0.0, 1.0])
    assert len(axis(0.0, 1000.0, 1.0 + 0.5e-6)) == 1001


def test_tilts_are_every_combination_of_equal_steps() -> None:
    base = Rotation.from_rotvec([0.3, -0.2, 1.0])
    for tilt, steps, values in (
        (0.2, 3, (-0.2, 0.0, 0.2)),
        (0.2, 2, (-0.2, 0.2)),
        (0.2, 1, (0.0,)),
        (0.0, 4, (0.0,)),
        (math.pi, 1, (0.0,)),
    ):
        found, turned = tilts(tilt, steps), tilts(tilt, steps, base)
        assert len(found) == len(turned) == len(values) ** 3
        expected = [Rotation.from_rotvec([a, b, c]) for a in values for b in values for c in values]
        for one, other, wanted in zip(found, turned, expected, strict=True):
            assert (one * wanted.inv()).magnitude() < 1e-12
            assert (other * (wanted * base).inv()).magnitude() < 1e-12
    assert len(tilts(0.1, 46)) == 46**3
    with pytest.raises(AccuracyError, match=r"47 steps of each tilt make 103823 orientations. At most 100000 are tried"):
        tilts(0.1, 47)
    for tilt, steps in ((0.1, 0), (-0.1, 2), (3.2, 2), (math.nan, 2)):
        with pytest.raises(AccuracyError, match="the tilt must lie in"):
            tilts(tilt, steps)


@pytest.mark.parametrize(
    ("nodes", "said"),
    [
        (np.array([0.0, 1.0, 1.0]), "the nodes along y must be finite and rise"),
        (np.array([1.0, 0.0]), "must be finite and rise"),
        (np.array([0.0, np.inf]), "must be finite and rise"),
        (np.zeros(0), "must be finite and rise"),
        (np.zeros((1, 1)), "must be finite and rise"),
        (np.array([0.0, 1.0, 2.1]), "the nodes along y must be equally spaced"),
        (np.array([0.0, 1.0, 2.0 + 4.2e-6]), "must be equally spaced"),
    ],
)
def test_nodes_that_cannot_be_are_named_by_their_axis(nodes: np.ndarray, said: str) -> None:
    with pytest.raises(AccuracyError, match=said):
        map_zone(cell(), None, (np.zeros(1), nodes, np.zeros(1)), ONE)


def test_nodes_that_just_can_be(monkeypatch: pytest.MonkeyPatch) -> None:
    zones._check([np.array([0.0, 1.0, 2.0 + 1.8e-6]), np.array([0.0, 5.0]), np.zeros(1)])
    monkeypatch.setattr(zones, "MAX_NODES", 12)
    zones._check([np.arange(3.0), np.arange(2.0), np.arange(2.0)])
    with pytest.raises(AccuracyError, match=r"the box has 18 nodes. At most 12 are scanned at once"):
        zones._check([np.arange(3.0), np.arange(3.0), np.arange(2.0)])
    assert zones._spacing([np.array([0.0, 1.0, 2.0]), np.array([5.0]), np.array([-3.0, 4.0])], (9.0, 8.0, 7.0)) == (1.0, 8.0, 7.0)
    assert zones._spacing([np.array([1.0]), np.array([5.0]), np.array([-3.0, 4.0])], None) == (0.0, 0.0, 7.0)


@pytest.mark.parametrize("refine", [0.0, 1.0, -0.1, math.nan])
def test_a_relative_change_that_cannot_be(refine: float) -> None:
    with pytest.raises(AccuracyError, match="the relative change at which to stop must lie between 0 and 1"):
        map_zone(cell(), None, (np.zeros(1), np.zeros(1), np.zeros(1)), ONE, scan=Scan(refine=refine))


def test_the_default_start_is_the_boxs_centre_with_the_mean_orientation() -> None:
    x, y, z = np.array([0.0, 40.0, 80.0]), np.array([-30.0, 10.0]), np.array([20.0])
    turns = Rotation.from_rotvec([[0.1, 0.0, 0.0], [0.3, 0.0, 0.0]])
    found = scan_zone(cell(), None, x=x, y=y, z=z, rotations=turns)
    zero = found.attrs["zero_pose_xyz_mm_qxyzw"]
    np.testing.assert_allclose(zero[:3], [40.0, -10.0, 20.0], atol=1e-12)
    assert abs(np.dot(zero[3:], [np.sin(0.1), 0.0, 0.0, np.cos(0.1)])) == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(found["quaternion_xyzw"].values, turns.as_quat())
    assert dict(found.sizes) == {"x": 3, "y": 2, "z": 1, "orientation": 2, "component": 4}
    assert not {"u95_rotation_deg", "clearance_mm"} & set(found.data_vars)
    assert found.attrs["limit_deg"] == 60.0
    # what is asked of rotations is mapped, and so is what is asked of distances
    more = scan_zone(cell(), None, x=x[:1], y=y[:1], z=z, rotations=turns, limits=Limits(70.0, clearance_mm=5.0, u95_rotation_deg=1.0))
    assert {"u95_rotation_deg", "u95_attachment_mm", "clearance_mm"} <= set(more.data_vars)
    assert more.attrs["limit_deg"] == 70.0


def test_figures_by_their_names() -> None:
    """cos of the pressure angle is one over the speed, and the singularity's distance one over the norm."""
    values = dict.fromkeys(FIGURES, 0.0) | {
        "speed2": 4.0, "u95_position": 0.3, "u95_rotation": 0.01, "u95_attachment": 0.4, "shortest": 700.0, "longest": 2000.0, "wrap": 1.5,
        "norm2": 16.0, "clearance": 33.0,
    }  # fmt: skip
    lows, highs = [2.0, -3.0, -1.0, 0.0, -5.0], [3.0, -2.0, 1.0, 2.0, 0.0]
    figures = np.array([np.full(5, values[name]) for name in FIGURES])
    figures[FIGURES.index("determinant_low")], figures[FIGURES.index("determinant_high")] = lows, highs
    figures[FIGURES.index("shortest"), 4] = np.inf
    flags = np.arange(5)
    found = named_figures(figures, flags, full=True, near=True, six=True)
    expected = {
        "worst_pressure_angle_deg": 60.0, "u95_position_mm": 0.3, "u95_rotation_deg": np.degrees(0.01), "u95_attachment_mm": 0.4,
        "longest_cable_mm": 2000.0, "largest_wrap_deg": np.degrees(1.5), "singularity_distance": 0.25, "clearance_mm": 33.0,
    }  # fmt: skip
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], value, rtol=1e-12)
    np.testing.assert_array_equal(found["shortest_cable_mm"], [700.0] * 4 + [np.nan])
    np.testing.assert_array_equal(found["assembly"], [1, -1, 0, 0, 0])
    np.testing.assert_array_equal(found["flags"], flags)
    assert set(found) == {*expected, "shortest_cable_mm", "assembly", "flags"}
    without = {"full": {"u95_rotation_deg", "u95_attachment_mm"}, "near": {"clearance_mm"}, "six": {"assembly"}}
    for name, gone in without.items():
        some = named_figures(figures, flags, **({"full": True, "near": True, "six": True} | {name: False}))
        assert set(found) - set(some) == gone


def test_what_is_covered_is_said() -> None:
    exact, phased = changed(cell(), {"zero_exact": True}), changed(cell(), {"zero_exact": False})
    none = " only (the rig has no linked calibration)"
    assert covers(exact, None) == f"counts of +-1/2{none}"
    assert covers(phased, None) == f"counts of +-1/2, the sub-count offset at zeroing (the same size){none}"
    some = changed(phased, {"zero_exact": True}, which=2)
    mixed = "counts of +-1/2, the sub-count offset at zeroing of counters without an exact zero (the same size)"
    assert covers(some, None) == f"{mixed}{none}"
    linked, since = record("B1.x_mm"), ", all for changes of length since zeroing at the start pose"
    assert covers(exact, linked) == f"counts of +-1/2 and the linked calibration's covariance{since}"
    stated = changed(exact, {"u_run_out_mm": 0.02})
    text = covers(stated, None)
    assert text.startswith("counts of +-1/2 and the uncertainty of")
    assert text.endswith(f"{since}. The rig has no linked calibration")
    both = covers(stated, linked)
    assert both == text.removesuffix(f"{since}. The rig has no linked calibration") + f" and the linked calibration's covariance{since}"
    for u_deg, how in ((0.01, ""), (0.1, ", to first order")):
        swivel = {"point": "B1", "channel": "sw1", "counts_per_revolution": 4096, "zero_deg": 1.0, "u_zero_deg": u_deg}
        rig = rig_from_dict(exact.to_dict() | {"swivel": [swivel]})
        assert covers(rig, None) == f"counts of +-1/2, the zeros of encoders{how}{none}"


def test_places_all_over_a_scan_are_sampled_with_orientations_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zones, "SAMPLED", 4)
    turns = Rotation.from_rotvec([[0.1, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.3]])
    for count, step in ((3, 1), (4, 1), (5, 2), (8, 2), (9, 3), (13, 4)):
        places = np.arange(3.0 * count).reshape(-1, 3)
        found = sampled(places, turns)
        np.testing.assert_array_equal(found[:, :3], places[::step])
        np.testing.assert_array_equal(found[:, 3:], turns.as_quat()[np.arange(len(found)) % 3])
        assert len(found) <= 4


def test_cables_that_could_touch_are_those_that_share_no_point_nor_pass() -> None:
    places = np.zeros((1, 3))
    for rig in (cell(), published()):
        plan = make_plan(rig, None, places, ONE, start=START, near=True)
        expected = [
            (i, j)
            for i in range(6)
            for j in range(i + 1, 6)
            if not {rig.cable[i].from_point, rig.cable[i].to_point} & {rig.cable[j].from_point, rig.cable[j].to_point}
        ]
        assert plan.pairs.tolist() == [list(pair) for pair in expected]
        assert len(make_plan(rig, None, places, ONE, start=START).pairs) == 0
    data = cell().to_dict()
    for number, cable in enumerate(data["cable"]):
        cable["pass"] = 1 + number % 2
    twice = rig_from_dict(data)
    pairs = make_plan(twice, None, places, ONE, start=START, near=True).pairs
    assert len(pairs)
    assert all(twice.cable[i].passage == twice.cable[j].passage for i, j in pairs)
    used = make_plan(cell(), None, places, ONE, start=START, full=True).points
    np.testing.assert_array_equal(used, [cell().tool[name] for name in sorted({c.to_point for c in cell().cable})])
    assert make_plan(cell(), None, places, ONE, start=START).points.shape == (0, 3)


def test_what_a_plan_refuses() -> None:
    places = np.zeros((1, 3))
    for turns in (Rotation.identity(), Rotation.identity(0)):
        with pytest.raises(AccuracyError, match="a list of at least one rotation"):
            make_plan(cell(), None, places, turns, start=START)
    rig, linked = cell(), record("B1.x_mm")
    inside = np.r_[np.array(rig.observation_point[0].position_mm) - rig.tool[rig.cable[0].to_point], START[3:]]
    normal = np.cross(rig.cable_rows()[0][3:6], [0.0, 0.0, 1.0])
    inside[:3] += rig.observation_point[0].pulley_radius_mm * normal / np.linalg.norm(normal)
    with pytest.raises(GeometryError, match="the calibration's part needs the pose at which the counters are zeroed: "):
        make_plan(rig, linked, places, ONE, start=inside)
    # without one it is not needed
    assert make_plan(rig, None, places, ONE, start=inside).factor.shape[1] == 0


def test_lengths_are_weighed_by_their_deviations() -> None:
    """One drum twice as coarse has half the weight, and four times the variance."""
    rig = changed(cell(), {"count_length_mm": 0.025}, which=1)
    plan = make_plan(rig, None, np.zeros((1, 3)), ONE, start=START)
    np.testing.assert_allclose(plan.weights, [1.0, 0.5, 1.0, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(plan.variance / plan.variance[0], [1.0, 4.0, 1.0, 1.0, 1.0, 1.0])
    np.testing.assert_array_equal(plan.scales, np.ones(6))
    assert plan.channels is None


def test_play_that_is_known_counts_once_where_the_counter_was_zeroed() -> None:
    rig = changed(cell(), {"backlash_counts": 3.0, "scale": 1.5}, which=4)
    places = np.array([[100.0, 50.0, -20.0], [30.0, -60.0, 10.0]])
    found = drum_variance(rig, None, places, ONE, start=START)
    np.testing.assert_allclose(found, np.where(np.arange(6) == 4, (3.0 * 0.0125 / 1.5) ** 2, 0.0), rtol=1e-12)
    # beside what is not, which counts twice
    both = drum_variance(changed(rig, {"u_backlash_counts": 2.0}, which=0), None, places, ONE, start=START)
    np.testing.assert_allclose(both[[0, 4]], [2.0 * (2.0 * 0.0125) ** 2, (3.0 * 0.0125 / 1.5) ** 2], rtol=1e-12)
    # where no cable runs at any place, drums that run out are not known to
    out = changed(cell(), {"u_run_out_mm": 0.02})
    nowhere = np.array([rig.observation_point[0].position_mm]) - rig.tool[rig.cable[0].to_point]
    normal = np.cross(rig.cable_rows()[0][3:6], [0.0, 0.0, 1.0])
    nowhere += rig.observation_point[0].pulley_radius_mm * normal / np.linalg.norm(normal)
    np.testing.assert_array_equal(drum_variance(out, None, nowhere, ONE, start=START), np.zeros(6))
    # those where it runs count alone
    one, mixed = (drum_variance(out, None, p, ONE, start=START) for p in (places, np.vstack([places, nowhere])))
    np.testing.assert_allclose(mixed, one, rtol=1e-12)
    assert (one > 0.0).all()
    assumed = out.model_copy(update={"unstated": "typical"})
    assert not assumed_in_zone(assumed, None, nowhere, ONE, start=START).every
    assert not assumed_in_zone(assumed, None, places, ONE, start=np.r_[nowhere[0], START[3:]]).every


def test_the_settings_one_by_one_are_those_of_a_scan(monkeypatch: pytest.MonkeyPatch) -> None:
    requested: list[tuple[Any, ...]] = []
    monkeypatch.setattr(zones, "map_zone", lambda *given, **more: requested.append((*given, more)))
    nodes: dict[str, Any] = {"x": np.zeros(1), "y": np.ones(1), "z": np.full(1, 2.0)}
    scan_zone(cell(), None, **nodes, rotations=ONE)
    assert requested[-1][4] == {"scan": Scan(), "progress": None}
    assert [float(a[0]) for a in requested[-1][2]] == [0.0, 1.0, 2.0]
    scan_zone(
        cell(), None, **nodes, rotations=ONE, limit_deg=75.0, length_limits=(100.0, 200.0), full=True, start=START, workers=2, refine=0.1
    )
    assert requested[-1][4]["scan"] == replace(Scan(limits=Limits(75.0, (100.0, 200.0))), full=True, start=START, workers=2, refine=0.1)
    assert Scan() == Scan(limits=Limits(60.0, None), full=False, bodies=(), reliability=False)


def test_what_is_refined_is_the_part_of_the_box_that_keeps_its_limits() -> None:
    """Against the share of places in the middles of 8^3 parts of the box."""
    nodes, middles = np.linspace(-120.0, 120.0, 4), np.arange(-105.0, 106.0, 30.0)
    fine = scan_zone(cell(), None, x=middles, y=middles, z=middles, rotations=ONE)
    longest = float(np.quantile(fine["longest_cable_mm"].values, 0.3))
    zone = scan_zone(cell(), None, x=nodes, y=nodes, z=nodes, rotations=ONE, limit_deg=89.0, length_limits=(0.0, longest), refine=0.02)
    held = (fine["longest_cable_mm"].values <= longest) & (fine["worst_pressure_angle_deg"].values <= 89.0)
    assert 0.1 < held.mean() <= 0.31
    assert zone.attrs["refined_volume_mm3"] == pytest.approx(held.mean() * 240.0**3, rel=0.05)


def test_each_node_of_a_box_is_mapped_as_it_is_alone() -> None:
    x, y, z = np.array([-80.0, 40.0]), np.array([-60.0, 0.0, 60.0]), np.array([10.0, 90.0])
    whole = scan_zone(cell(), None, x=x, y=y, z=z, rotations=ONE, start=START)
    for i, j, k in ((0, 0, 1), (0, 2, 0), (1, 0, 0), (1, 1, 1)):
        alone = scan_zone(cell(), None, x=x[i : i + 1], y=y[j : j + 1], z=z[k : k + 1], rotations=ONE, start=START)
        for name in ("worst_pressure_angle_deg", "u95_position_mm", "longest_cable_mm"):
            assert whole[name].values[i, j, k] == pytest.approx(alone[name].item(), rel=1e-9)
