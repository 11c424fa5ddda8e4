"""The fast scan: the same figures as the pivoted kernel, and the same bits however it is cut and whoever does it."""

import os
import signal
import subprocess
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cluster import two_workers
from scipy.spatial.transform import Rotation
from zone_rigs import cell, published

from lmeasure.accuracy import axis, tilts, zone
from lmeasure.accuracy.limits import Body
from lmeasure.accuracy.scan import Plan, run
from lmeasure.accuracy.zone import fewest_directions, make_plan
from lmeasure.core import AccuracyError, LMeasureError
from lmeasure.kernels import ALPHA, ATTACHMENT_XYZ, BASE_XYZ, BETA, RADIUS, guide_direction, layout, wrap_geometry, zone as kernels
from lmeasure.rig import Rig

BODIES = (
    Body(name="column", from_mm=(600, 0, -500), to_mm=(600, 0, 900), radius_mm=80),
    Body(name="flange", frame="tool", from_mm=(0, 0, -40), to_mm=(0, 0, 30), radius_mm=60),
)


def plan_of(rig: Rig, span: float = 400.0, step: float = 100.0, steps: int = 3) -> Plan:
    nodes = axis(-span, span, step)
    positions = np.stack(np.meshgrid(nodes, nodes, nodes, indexing="ij"), axis=-1).reshape(-1, 3)
    start = np.array([0, 0, 0, 0, 0, 0, 1.0])
    return make_plan(rig, None, positions, tilts(0.3, steps), start=start, full=True, near=True, bodies=BODIES)


def scalar(plan: Plan) -> tuple[np.ndarray, np.ndarray]:
    figures, flags = kernels.scan(
        plan.cables, plan.positions, plan.quaternions, plan.variance, plan.weights, plan.scales, plan.factor, plan.start, plan.points,
        plan.pairs, plan.bodies,
    )  # fmt: skip
    return figures, flags


@pytest.mark.parametrize("rig", [cell(0), cell(3), published()], ids=["cell-0", "cell-3", "published"])
def test_lanes_give_the_figures_of_the_pivoted_kernel(rig: Rig) -> None:
    plan = plan_of(rig)
    slow, slow_flags = scalar(plan)
    fast, fast_flags = run(plan)
    np.testing.assert_array_equal(fast_flags, slow_flags)
    for name, a, b in zip(kernels.FIGURES, fast, slow, strict=True):
        # figures grow with the condition of the rows, and so does their rounding; the square of the norm bounds it
        tolerance = 1e-12 + 1e-15 * slow[kernels.NORM2]
        assert (np.abs(a - b) <= tolerance * np.maximum(1.0, np.abs(b))).all(), name


@pytest.mark.parametrize("linked", [False, True], ids=["alone", "linked"])
@pytest.mark.parametrize("rig", [cell(0), published()], ids=["pulleys", "straight"])
def test_few_places_too(rig: Rig, linked: bool) -> None:
    """So few that kernels are seen through without being compiled (NUMBA_DISABLE_JIT=1), by a debugger for instance."""
    random = np.random.default_rng(1)
    plan = replace(plan_of(rig, 150.0, 300.0, 1), quaternions=Rotation.from_rotvec([[0.1, -0.2, 0.15], [-0.2, 0.1, 0.1]]).as_quat())
    if linked:
        plan = replace(plan, factor=0.02 * random.standard_normal((78, 4)), scales=random.uniform(0.5, 2.0, 6))
    slow, slow_flags = scalar(plan)
    fast, fast_flags = run(plan)
    np.testing.assert_array_equal(fast_flags, slow_flags)
    assert (fast != slow).any()
    for name, a, b in zip(kernels.FIGURES, fast, slow, strict=True):
        assert (np.abs(a - b) <= (1e-12 + 1e-15 * slow[kernels.NORM2]) * np.maximum(1.0, np.abs(b))).all(), name


def test_few_places_of_a_rig_as_small_as_a_grain() -> None:
    """All lengths in parts of ten thousand: so are the figures that are lengths, and the others are what they were."""
    plan = replace(plan_of(published(), 150.0, 300.0, 1), quaternions=np.array([[0.1, 0.0, 0.0, 0.995]]))
    small = plan.cables.copy()
    small[:, [*range(3), *range(7, 10)]] *= 1e-4
    start, bodies = plan.start.copy(), plan.bodies.copy()
    start[:3] *= 1e-4
    bodies[:, [layout.BODY_LENGTH, layout.BODY_RADIUS, *range(layout.BODY_START, layout.BODY_START + 3)]] *= 1e-4
    figures, _ = scalar(plan)
    places, points, variance = 1e-4 * plan.positions, 1e-4 * plan.points, 1e-8 * plan.variance
    scaled, _ = scalar(replace(plan, cables=small, positions=places, start=start, bodies=bodies, points=points, variance=variance))
    lengths = [kernels.U95_POSITION, kernels.U95_ATTACHMENT, kernels.SHORTEST, kernels.LONGEST, kernels.CLEARANCE]
    expected = figures.copy()
    expected[lengths] *= 1e-4
    np.testing.assert_allclose(scaled, expected, rtol=1e-9)


def test_few_places_that_cables_hardly_wrap_around_to() -> None:
    """Guides that lead to within 0.3 rad of the tool: less is wrapped than one radian, and that is told."""
    plan = replace(plan_of(cell(0), 150.0, 300.0, 1), quaternions=np.array([[0.0, 0.0, 0.0, 1.0]]))
    cables, turn = plan.cables.copy(), Rotation.from_rotvec([0.2, -0.1, 0.15])
    way = plan.positions.mean(axis=0) - cables[:, BASE_XYZ]
    cables[:, layout.GUIDE_XYZ] = turn.apply(way / np.linalg.norm(way, axis=1)[:, None])
    poses = np.column_stack([plan.positions, np.tile(plan.quaternions, (len(plan.positions), 1))])
    wrapped = wrap_geometry(cables, poses)[3].max(axis=1)
    assert wrapped.max() < 1.0
    np.testing.assert_allclose(kernels.around(cables, poses, plan.pairs, plan.bodies)[:, 0], wrapped, rtol=1e-12)
    figures, _ = scalar(replace(plan, cables=cables))
    np.testing.assert_allclose(figures[kernels.WRAP], wrapped, rtol=1e-12)


def test_few_places_beside_a_single_body_keep_their_distance_from_it() -> None:
    plan = replace(plan_of(cell(0), 150.0, 300.0, 1), quaternions=np.array([[0.0, 0.0, 0.0, 1.0]]))
    plan = replace(plan, pairs=plan.pairs[:0], bodies=plan.bodies[:1])
    poses = np.column_stack([plan.positions, np.tile(plan.quaternions, (len(plan.positions), 1))])
    distance = scalar(plan)[0][kernels.CLEARANCE]
    assert np.isfinite(distance).all()
    np.testing.assert_array_equal(distance, kernels.around(plan.cables, poses, plan.pairs, plan.bodies)[:, 1])
    np.testing.assert_allclose(run(plan)[0][kernels.CLEARANCE], distance, rtol=1e-9)


def test_few_places_of_a_single_point_have_its_uncertainty() -> None:
    """And that of the rotation; without a point neither."""
    plan = replace(plan_of(cell(0), 150.0, 300.0, 1), quaternions=np.array([[0.0, 0.0, 0.0, 1.0]]))
    requested, every = [kernels.U95_ROTATION, kernels.U95_ATTACHMENT], [scalar(replace(plan, points=plan.points[:n]))[0] for n in (0, 1, 3)]
    assert not every[0][requested].any()
    assert not run(replace(plan, points=plan.points[:0]))[0][requested].any()
    np.testing.assert_array_equal(every[1][kernels.U95_ROTATION], every[2][kernels.U95_ROTATION])
    assert (every[1][kernels.U95_ATTACHMENT] > every[1][kernels.U95_POSITION]).any()
    assert (every[1][kernels.U95_ATTACHMENT] <= every[2][kernels.U95_ATTACHMENT]).all()
    np.testing.assert_allclose(run(replace(plan, points=plan.points[:1]))[0][requested], every[1][requested], rtol=1e-9)


def test_few_places_where_nothing_holds() -> None:
    """One cable twice holds no pose anywhere."""
    plan = plan_of(cell(0), 150.0, 300.0, 1)
    twice = plan.cables.copy()
    twice[3] = twice[2]
    _, flags = scalar(replace(plan, cables=twice))
    assert (flags == kernels.SINGULAR).all()


def test_a_place_that_a_cable_cannot_run_to() -> None:
    """Its point lies within its pulley there, and elsewhere it runs."""
    plan = plan_of(cell(0), 150.0, 300.0, 1)
    inside = plan.cables.copy()
    turn = Rotation.from_quat(plan.quaternions[0])
    point = plan.positions[1] + turn.apply(inside[2, ATTACHMENT_XYZ])
    u = np.array(guide_direction(inside[2, ALPHA], inside[2, BETA]))
    away = np.cross(u, [0.3, -0.5, 0.8])
    inside[2, BASE_XYZ] = point - inside[2, RADIUS] * away / np.linalg.norm(away)
    slow, flags = scalar(replace(plan, cables=inside))
    assert flags[1] == kernels.CANNOT_RUN
    assert (np.delete(flags, 1) & kernels.CANNOT_RUN == 0).all()
    np.testing.assert_array_equal(slow[[kernels.SPEED2, kernels.NORM2, kernels.U95_POSITION, kernels.U95_ROTATION], 1], np.inf)
    np.testing.assert_array_equal(run(replace(plan, cables=inside))[1], flags)


@pytest.mark.parametrize("rows", [range(13), range(5), (5,), (6, 12), (7, 8), (9, 10, 11)], ids=str)
@pytest.mark.parametrize("rig", [cell(0), published()], ids=["pulleys", "straight"])
def test_lanes_give_the_part_of_a_calibration_by_every_parameter(rig: Rig, rows: Sequence[int]) -> None:
    random = np.random.default_rng(7)
    factor = np.zeros((6, 13, 4))
    factor[:, rows] = 0.02 * random.standard_normal((6, len(rows), 4))
    start = np.array([40.0, -30.0, 20.0, *Rotation.from_rotvec([0.1, 0.2, -0.1]).as_quat()])
    plan = replace(plan_of(rig, 300.0, 150.0), factor=factor.reshape(78, 4), start=start, scales=random.uniform(0.5, 2.0, 6))
    slow, slow_flags = scalar(plan)
    fast, fast_flags = run(plan)
    np.testing.assert_array_equal(fast_flags, slow_flags)
    for name, a, b in zip(kernels.FIGURES, fast, slow, strict=True):
        assert (np.abs(a - b) <= (1e-12 + 1e-15 * slow[kernels.NORM2]) * np.maximum(1.0, np.abs(b))).all(), name
    # the lanes did it, and it is more than the counts alone
    assert (fast[kernels.U95_POSITION] != slow[kernels.U95_POSITION]).any()
    assert (fast[kernels.U95_POSITION] > run(replace(plan, factor=np.zeros((78, 0))))[0][kernels.U95_POSITION]).all()
    parts = run(replace(plan, nodes_per_chunk=32), workers=2)
    np.testing.assert_array_equal(parts[0], fast)


@pytest.mark.parametrize("negligible", [1e-14, 1e-4])
@pytest.mark.parametrize("few", [False, True], ids=["many", "few"])
def test_directions_that_are_left_out_never_make_u95_smaller(monkeypatch: pytest.MonkeyPatch, negligible: float, few: bool) -> None:
    monkeypatch.setattr(zone, "NEGLIGIBLE", negligible)
    plan, random = plan_of(cell(0), 300.0, 150.0), np.random.default_rng(3)
    spread = np.sqrt(plan.variance[0]) * 10.0 ** random.uniform(-10.0, 0.0, (6, 13, 30))
    factor = spread * random.standard_normal((6, 13, 30))
    factor[:, 5:9] *= 1e-12
    plan = replace(plan, factor=factor.reshape(78, 30), positions=plan.positions[:2] if few else plan.positions)
    fewer = fewest_directions(plan)
    ranks = np.linalg.matrix_rank(fewer.factor.reshape(6, 13, 30), tol=1e-12 * np.abs(factor).max())
    assert (ranks < 13).all()
    dense, fast = run(plan)[0], run(fewer)[0]
    m, between = 6, 4.0
    most = np.sqrt(between * m * negligible)
    for figure in (kernels.U95_POSITION, kernels.U95_ROTATION, kernels.U95_ATTACHMENT):
        # the radius of a covariance is a polynomial's, to 5e-5 of it, and rises with the covariance but for that
        grown = fast[figure] / dense[figure] - 1.0
        assert (grown > -1e-11).all()
        assert (grown <= 0.5 * (most + most**2) + 1e-11).all()
    np.testing.assert_array_equal(
        np.delete(fast, [kernels.U95_POSITION, kernels.U95_ROTATION, kernels.U95_ATTACHMENT], axis=0),
        np.delete(dense, [kernels.U95_POSITION, kernels.U95_ROTATION, kernels.U95_ATTACHMENT], axis=0),
    )


def test_without_uncertain_parameters_nothing_is_left_out() -> None:
    plan = plan_of(cell(0), 300.0, 150.0)
    assert fewest_directions(plan) is plan


def test_places_without_a_sound_first_block_are_left_to_the_pivoted_kernel() -> None:
    plan = plan_of(cell(0), steps=1)
    cables = plan.cables.copy()
    # without tilts the spans of cables 1 and 3 are parallel everywhere, so a block that holds both has no inverse
    cables[2, 0:7] = cables[0, 0:7]
    cables[2, 0:3] += cables[2, 7:10] - cables[0, 7:10]
    parallel = replace(plan, cables=cables, order=np.array([0, 2, 1, 3, 4, 5]))
    slow, _ = scalar(parallel)
    fast, _ = run(parallel)
    assert np.isfinite(slow).all()
    np.testing.assert_array_equal(fast, slow)


def test_same_bits_in_any_chunks_with_any_threads() -> None:
    plan = plan_of(cell(0))
    whole = run(plan, workers=1)
    for nodes in (32, 160, 32_000):
        for workers in (1, 3):
            parts = run(replace(plan, nodes_per_chunk=nodes), workers=workers)
            np.testing.assert_array_equal(parts[0], whole[0])
            np.testing.assert_array_equal(parts[1], whole[1])


def test_killed_scan_goes_on_where_it_stopped(tmp_path: Path) -> None:
    plan = replace(plan_of(cell(0)), nodes_per_chunk=32)
    whole = run(plan)

    class KilledError(Exception):
        pass

    def stop(done: int, of: int) -> None:
        assert of == plan.chunks
        if done == 5:
            raise KilledError

    with pytest.raises(KilledError):
        run(plan, stop, checkpoint=tmp_path, workers=1)
    assert len(list(tmp_path.glob("chunk-*.npz"))) == 5
    counted: list[int] = []
    again = run(plan, lambda done, of: counted.append(done), checkpoint=tmp_path, workers=1)
    assert counted == list(range(6, plan.chunks + 1))
    np.testing.assert_array_equal(again[0], whole[0])
    with pytest.raises(AccuracyError, match="another scan"):
        run(plan_of(cell(1)), checkpoint=tmp_path)


def test_clearance_is_the_distance_of_the_free_spans() -> None:
    """A rig of straight cables, whose spans are the lines from B to P; distances by dense sampling of both."""
    rig = published()
    at, turn = np.array([100.0, -300.0, 200.0]), Rotation.from_rotvec([[0.1, -0.2, 0.3]])
    plan = make_plan(rig, None, at[None, :], turn, start=np.r_[at, 0, 0, 0, 1], near=True, bodies=BODIES)
    rows = plan.cables
    points = at + turn[0].apply(rows[:, 7:10])
    s = np.linspace(0, 1, 1500)
    lines = [p + s[:, None] * (b - p) for p, b in zip(points, rows[:, 0:3], strict=True)]
    least = np.inf
    for i, j in plan.pairs:
        least = min(least, float(np.sqrt(((lines[i][:, None] - lines[j][None]) ** 2).sum(axis=-1)).min()))
    for body in BODIES:
        ends = np.array([body.from_mm, body.to_mm], dtype=float)
        if body.frame == "tool":
            ends = at + turn[0].apply(ends)
        piece = ends[0] + s[::10, None] * (ends[1] - ends[0])
        for line in lines:
            least = min(least, float(np.sqrt(((line[:, None] - piece[None]) ** 2).sum(axis=-1)).min()) - body.radius_mm)
    figures, _ = run(plan)
    assert figures[kernels.CLEARANCE, 0] == pytest.approx(least, abs=0.2)
    assert len(plan.pairs) == 3 * 4 - 3


def test_two_worker_processes_give_the_same_bits_though_one_is_killed() -> None:
    with two_workers() as cluster:
        _same_bits(cluster.address, cluster.workers)


def _same_bits(address: str, workers: "list[subprocess.Popen[str]]") -> None:
    plan = replace(plan_of(cell(0)), nodes_per_chunk=64)
    whole = run(plan)
    killed: list[int] = []

    def kill_one(done: int, of: int) -> None:
        assert of > 4
        if done == 2:
            os.kill(workers[0].pid, signal.SIGKILL)
            workers[0].wait()
            killed.append(done)

    far = run(plan, kill_one, scheduler=address)
    assert killed == [2]
    assert workers[1].poll() is None
    np.testing.assert_array_equal(far[0], whole[0])
    np.testing.assert_array_equal(far[1], whole[1])


def test_scheduler_that_does_not_answer_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lmeasure.io.cluster.ANSWER_S", 1.0)
    with pytest.raises(LMeasureError, match="no dask scheduler answers"):
        run(plan_of(cell(0)), scheduler="tcp://127.0.0.1:9")
