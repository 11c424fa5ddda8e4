"""Zones of more than six cables: against a plain statement in NumPy, and the ways that give the same figures."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from zone_oracle import cable_length, length_rows
from zone_rigs import cell, point, rig

from lmeasure.accuracy import REASONS, Limits, Placement, axis, exact_radius_95, guard, place, scan_zone, tilts
from lmeasure.accuracy.limits import Body
from lmeasure.accuracy.placement import Box, Search, Where, Work
from lmeasure.accuracy.scan import Plan, run, scan_positions
from lmeasure.accuracy.zone import assumed_in_zone, make_plan
from lmeasure.core import RigError
from lmeasure.kernels import zone as kernels
from lmeasure.recording import Program
from lmeasure.rig import TYPICAL_SIZES, CalibrationRecord, RecordedParameter, Rig

START = np.array([30.0, -20.0, 10.0, *Rotation.from_rotvec([0.05, -0.1, 0.08]).as_quat()])
KEYS = ("x_mm", "y_mm", "z_mm", "guide_alpha_deg", "guide_beta_deg")


def plain(rig: Rig) -> list[dict[str, np.ndarray]]:
    """The cables by what rig.toml says, without lmeasure's rows."""
    points = {p.name: p for p in rig.observation_point}
    out = []
    for c in rig.cable:
        p = points[c.from_point]
        values = [*p.position_mm, p.guide_alpha_deg, p.guide_beta_deg]
        out.append({"values": np.array(values), "R": np.array(p.pulley_radius_mm), "P": np.array(rig.tool[c.to_point])} | of(values))
    return out


def of(values: list[float] | np.ndarray) -> dict[str, np.ndarray]:
    a, b = np.radians(values[3]), np.radians(values[4])
    return {"B": np.array(values[:3]), "u": np.array([-np.cos(a) * np.sin(b), -np.cos(a) * np.cos(b), np.sin(a)])}


def record(rig: Rig) -> CalibrationRecord:
    """Correlated across points and guides, some known in combination only."""
    random = np.random.default_rng(5)
    names = [f"{p.name}.{key}" for p in rig.observation_point for key in KEYS]
    draws = random.standard_normal((len(names), 7)) * 0.03
    covariance = draws @ draws.T + np.diag(random.uniform(1e-6, 1e-4, len(names)))
    return CalibrationRecord(
        rig=rig.name, parameters=tuple(RecordedParameter(name=n, value=0.0, u=0.1, prior_u=1.0) for n in names),
        covariance=tuple(tuple(float(v) for v in row) for row in 0.5 * (covariance + covariance.T)), residuals=(), equations=100,
        unknowns=len(names), rank=len(names),
    )  # fmt: skip


def statement(rig: Rig, calibration: CalibrationRecord | None, pose: np.ndarray) -> dict[str, float]:
    """The figures of a pose by the definitions, from differences of lengths: generalised least squares and its full covariance."""
    cables, position, turn = plain(rig), pose[:3], Rotation.from_quat(pose[3:]).as_matrix()
    J = length_rows(position, turn, cables)
    # each count is rounded, and counted from somewhere within one
    variance = np.array([2 * p.drum.count_length_mm**2 / 12 for p in rig.observation_point])
    W = np.diag(1.0 / variance)
    G = np.linalg.solve(J.T @ W @ J, J.T @ W)
    covariance = np.diag(variance)
    if calibration is not None:
        begun = START[:3], Rotation.from_quat(START[3:]).as_matrix()
        by = np.zeros((len(cables), 5 * len(cables)))
        for j, cable in enumerate(cables):
            for k in range(5):
                step = 1e-3 * np.eye(5)[k]
                for sign in (1, -1):
                    moved = of(cable["values"] + sign * step)
                    here, there = (
                        cable_length(p + R @ cable["P"], moved["B"], moved["u"], float(cable["R"])) for p, R in ((position, turn), begun)
                    )
                    by[j, 5 * j + k] += sign * (here - there) / 2e-3
        covariance = covariance + by @ np.array(calibration.covariance) @ by.T
    C = G @ covariance @ G.T
    arms = np.array([turn @ cable["P"] for cable in cables])
    speeds = np.linalg.norm(G[3:].T + np.cross(G[:3].T, arms), axis=1)
    at_arms = [np.hstack([-cross_matrix(arm), np.eye(3)]) for arm in arms]
    scaled = J / np.r_[np.full(3, np.linalg.norm(arms, axis=1).max()), np.ones(3)]
    return {
        "worst_pressure_angle_deg": np.degrees(np.arccos(1.0 / max(1.0, speeds.max()))),
        "u95_position_mm": exact_radius_95(np.linalg.eigvalsh(C[3:, 3:])),
        "u95_rotation_deg": np.degrees(exact_radius_95(np.linalg.eigvalsh(C[:3, :3]))),
        "u95_attachment_mm": max(exact_radius_95(np.linalg.eigvalsh(A @ C @ A.T)) for A in at_arms),
        "singularity_distance": 1.0 / np.linalg.norm(np.linalg.pinv(scaled)),
    }


def cross_matrix(a: np.ndarray) -> np.ndarray:
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


@pytest.mark.parametrize("linked", [False, True], ids=["alone", "linked"])
@pytest.mark.parametrize("cables", [6, 7, 8])
def test_figures_are_those_of_generalised_least_squares(cables: int, linked: bool) -> None:
    rig, random = cell(0, cables), np.random.default_rng(cables)
    calibration = record(rig) if linked else None
    for _ in range(3):
        pose = np.r_[random.uniform(-250, 250, 3), Rotation.from_rotvec(random.uniform(-0.3, 0.3, 3)).as_quat()]
        turn = Rotation.from_quat(pose[None, 3:])
        zone = scan_zone(rig, calibration, x=pose[:1], y=pose[1:2], z=pose[2:3], rotations=turn, start=START, full=True)
        for name, expected in statement(rig, calibration, pose).items():
            assert zone[name].item() == pytest.approx(expected, rel=6e-5), name


def plan_of(rig: Rig, linked: bool, step: float = 150.0) -> Plan:
    nodes = axis(-300, 300, step)
    positions = np.stack(np.meshgrid(nodes, nodes, nodes, indexing="ij"), axis=-1).reshape(-1, 3)
    bodies = (Body(name="column", from_mm=(600, 0, -500), to_mm=(600, 0, 900), radius_mm=80),)
    plan = make_plan(rig, None, positions, tilts(0.3, 2), start=START, full=True, near=True, bodies=bodies)
    if not linked:
        return plan
    random, m = np.random.default_rng(7), len(plan.cables)
    return replace(plan, factor=0.02 * random.standard_normal((13 * m, 9)), scales=random.uniform(0.5, 2.0, m))


@pytest.mark.parametrize("linked", [False, True], ids=["alone", "linked"])
@pytest.mark.parametrize("alike", [False, True], ids=["weighted", "alike"])
@pytest.mark.parametrize("cables", [7, 9])
def test_lanes_give_the_figures_of_the_scalar_kernel(cables: int, alike: bool, linked: bool) -> None:
    plan = plan_of(cell(1, cables), linked)
    if alike:
        plan = replace(plan, weights=np.ones(cables))
    assert (plan.weights.min() < 1.0) != alike
    fast = lanes_are_the_scalar_kernel(plan)
    # in any parts the same
    parts = run(replace(plan, nodes_per_chunk=32), workers=2)
    np.testing.assert_array_equal(parts[0], fast)


@pytest.mark.parametrize("linked", [False, True], ids=["alone", "linked"])
def test_few_places_too(linked: bool) -> None:
    """So few that kernels are seen through without being compiled (NUMBA_DISABLE_JIT=1)."""
    plan = plan_of(cell(1, 7), linked, step=600.0)
    lanes_are_the_scalar_kernel(replace(plan, quaternions=plan.quaternions[[0, -1]]))
    # none of them weighs as much as a whole cable
    if not linked:
        lanes_are_the_scalar_kernel(replace(plan, quaternions=plan.quaternions[[0]], weights=np.linspace(0.3, 0.9, 7)))


@pytest.mark.parametrize("least", [1e-5, 1e-7, 1e-9, 1e-13])
def test_few_places_of_which_coarse_cables_must_tell_what_fine_ones_do_not(least: float) -> None:
    """Seven cables, two of which weigh next to nothing: the fine ones leave a motion to them, whose normal equations are not sound."""
    plan = plan_of(cell(1, 7), False, step=600.0)
    plan = replace(plan, quaternions=plan.quaternions[[0]], weights=np.array([1.0, 1.0, 1.0, 1.0, 1.0, least, least]))
    slow, slow_flags = kernels.scan(
        plan.cables, plan.positions, plan.quaternions, plan.variance, plan.weights, plan.scales, plan.factor, plan.start, plan.points,
        plan.pairs, plan.bodies,
    )  # fmt: skip
    fast, fast_flags = run(plan)
    np.testing.assert_array_equal(fast_flags, slow_flags)
    for name, a, b in zip(kernels.FIGURES, fast, slow, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-9, err_msg=name)


def lanes_are_the_scalar_kernel(plan: Plan) -> np.ndarray:
    slow, slow_flags = kernels.scan(
        plan.cables, plan.positions, plan.quaternions, plan.variance, plan.weights, plan.scales, plan.factor, plan.start, plan.points,
        plan.pairs, plan.bodies,
    )  # fmt: skip
    fast, fast_flags = run(plan)
    np.testing.assert_array_equal(fast_flags, slow_flags)
    for name, a, b in zip(kernels.FIGURES, fast, slow, strict=True):
        if name.startswith("determinant"):
            np.testing.assert_array_equal(a, b)
            continue
        # normal equations: their rounding grows with the square of the condition
        assert (np.abs(a - b) <= (1e-12 + 1e-14 * slow[kernels.NORM2]) * np.maximum(1.0, np.abs(b))).all(), name
    assert (fast[kernels.U95_POSITION] != slow[kernels.U95_POSITION]).any()
    return fast


def test_cables_that_count_coarsely_add_nothing() -> None:
    data = cell(0, 8).to_dict()
    for p in data["observation_point"][6:]:
        p["drum"]["count_length_mm"] = 5000.0
    nodes = axis(-100, 100, 100)
    coarse = scan_zone(Rig.model_validate(data, by_alias=True), None, x=nodes, y=nodes, z=nodes, rotations=tilts(0.2, 2))
    six = scan_zone(cell(0), None, x=nodes, y=nodes, z=nodes, rotations=tilts(0.2, 2))
    eight = scan_zone(cell(0, 8), None, x=nodes, y=nodes, z=nodes, rotations=tilts(0.2, 2))
    # where six are nearly blind whatever sees adds something
    seen = six["u95_position_mm"].values < 1.0
    assert seen.sum() > 20
    for name in ("worst_pressure_angle_deg", "u95_position_mm"):
        np.testing.assert_allclose(coarse[name].values[seen], six[name].values[seen], rtol=1e-5)
        assert (eight[name].values < six[name].values).all(), name
    # how far a singular pose is does not depend on how finely a cable counts
    np.testing.assert_allclose(coarse["singularity_distance"].values, eight["singularity_distance"].values, rtol=1e-9)


def test_more_than_six_cables_have_no_assembly_to_keep() -> None:
    nodes, turns = axis(-300, 300, 100), tilts(0.3, 2)
    free = scan_zone(cell(0, 8), None, x=nodes, y=nodes, z=nodes, rotations=turns, limits=Limits(50.0))
    kept = scan_zone(cell(0, 8), None, x=nodes, y=nodes, z=nodes, rotations=turns, limits=Limits(50.0, one_assembly=True), refine=0.1)
    assert "assembly" not in free
    assert 0 < free.attrs["nodes_in_zone"] < 343
    np.testing.assert_array_equal(kept["in_zone"].values, free["in_zone"].values)
    assert kept.attrs["assemblies_in_zone"] == 1
    assert kept.attrs["refined_volume_mm3"] > 0.0


def test_where_eight_cables_do_not_determine_the_pose_they_say_so() -> None:
    """Straight cables that all point at the base's origin see no turn about it."""
    ways = [
        (1, 0.2, 0.1), (-0.3, 1, 0.2), (0.1, -0.4, 1), (-1, 0.3, -0.5), (0.5, -1, 0.4), (0.6, 0.5, -1), (-0.7, -0.6, 0.8),
        (0.9, 0.8, 0.7),
    ]  # fmt: skip
    points = [point(f"B{i}", 1200 * np.array(way)) for i, way in enumerate(ways)]
    tool = {f"P{i}": 100 * np.array(way) for i, way in enumerate(ways)}
    star = rig(points, tool, [(f"B{i}", f"P{i}") for i in range(8)])
    for turn, flag in (((0.0, 0.0, 0.0), kernels.SINGULAR), ((0.3, 0.2, -0.25), 0)):
        rotation = Rotation.from_rotvec([turn])
        zone = scan_zone(star, None, x=np.zeros(1), y=np.zeros(1), z=np.zeros(1), rotations=rotation)
        assert zone["flags"].item() == flag
        assert (zone["u95_position_mm"].item() == np.inf) == bool(flag)
        assert (zone["worst_pressure_angle_deg"].item() == 90.0) == bool(flag)
    # nor where a cable cannot run, inside a pulley
    base, guide = np.array(cell(0, 8).point("B7").position_mm), plain(cell(0, 8))[6]
    side = np.cross(guide["u"], [0.0, 0.0, 1.0])
    at = base + 15.0 * side / np.linalg.norm(side) - guide["P"]
    zone = scan_zone(cell(0, 8), None, x=at[:1], y=at[1:2], z=at[2:], rotations=Rotation.identity(1))
    assert zone["flags"].item() == kernels.CANNOT_RUN
    assert REASONS[0] == "cable_cannot_run"
    assert zone["rejected_because"].item() & 1


def test_five_cables_are_still_refused() -> None:
    rig = cell(0, 8)
    with pytest.raises(RigError, match=r"has 5 cables. A pose is reconstructed from at least 6"):
        scan_zone(
            rig.model_copy(update={"cable": rig.cable[3:]}), None, x=np.zeros(1), y=np.zeros(1), z=np.zeros(1),
            rotations=Rotation.identity(1),
        )  # fmt: skip


def test_a_program_is_held_against_the_zone_of_eight_cables() -> None:
    rig, nodes = cell(0, 8), axis(-300, 300, 100)
    calibration = record(rig)
    zone = scan_zone(rig, calibration, x=nodes, y=nodes, z=nodes, rotations=tilts(0.1, 2), start=START)
    turn = Rotation.from_rotvec([0.1, 0.05, -0.2])
    stated = {"name": "P1", "position_mm": [120.0, -80.0, 60.0], "quaternion_xyzw": turn.as_quat().tolist()}
    program = Program.model_validate({"schema": "lmeasure.program/1", "pose": [stated]})
    (part,) = guard(rig, calibration, zone, program, rotation=Rotation.identity())
    expected = statement(rig, calibration, np.r_[stated["position_mm"], stated["quaternion_xyzw"]])
    assert part.angle_deg[0] == pytest.approx(expected["worst_pressure_angle_deg"], rel=1e-5)
    assert part.u95_mm[0] == pytest.approx(expected["u95_position_mm"], rel=6e-5)


def test_points_of_eight_cables_are_placed() -> None:
    rig = cell(0, 8)
    box = [(np.array(rig.point(name).position_mm) + side).tolist() for name in ("B7",) for side in (-400.0, 400.0)]
    wanted = Placement(
        objective="u95",
        task=Work(low_mm=(-150, -150, -150), high_mm=(150, 150, 150), nodes=2, tilt_rad=0.2, tilt_steps=2),
        mount=(Where(points=("B7",), low_mm=box[0], high_mm=box[1]),),
        keep_out=(Box(low_mm=(-5000, -5000, -5000), high_mm=(-3000, -3000, -3000)),),
    )
    placed = place(rig, wanted, generations=3)
    assert placed.after["u95_position_mm"] < 0.999 * placed.before["u95_position_mm"]
    # what the search sees is what a scan says of the rig it ends with
    plan = Search(placed.rig, wanted).plan
    assert scan_positions(plan, plan.positions)[0][kernels.U95_POSITION].max() == pytest.approx(placed.after["u95_position_mm"], rel=1e-9)


def test_assumed_sizes_add_less_to_more_cables() -> None:
    positions, turns = np.array([[100.0, 50.0, -20.0], [-80.0, 30.0, 40.0]]), Rotation.identity(1)
    rigs = [cell(0, m).model_copy(update={"unstated": "typical"}) for m in (6, 8)]
    six, eight = (assumed_in_zone(rig, None, positions, turns, start=START) for rig in rigs)
    assert {one.key for one in six.every} == {one.key for one in eight.every} == set(list(TYPICAL_SIZES)[:8]) - {"u_backlash_counts"}
    assert 0.0 < eight.part_mm < six.part_mm
