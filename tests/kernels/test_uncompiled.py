"""Kernels computed without a compiler: the same bits, and nothing changed by a call that takes too long."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from zone_rigs import cell, published

from lmeasure.accuracy import axis, tilts
from lmeasure.accuracy.limits import Body
from lmeasure.accuracy.scan import run
from lmeasure.accuracy.zone import make_plan
from lmeasure.kernels import cable, compiled_at_once, counter, search, uncompiled, zone, zone_lanes
from lmeasure.kernels.decorators import StrictKernel
from lmeasure.rig import Rig

BODIES = (
    Body(name="column", from_mm=(600, 0, -500), to_mm=(600, 0, 900), radius_mm=80),
    Body(name="flange", frame="tool", from_mm=(0, 0, -40), to_mm=(0, 0, 30), radius_mm=60),
)


def agree(kernel: Any, *arguments: Any) -> None:
    """Both ways give the same bits, and the same changes of their arguments."""
    own, theirs = ([a.copy() if isinstance(a, np.ndarray) else a for a in arguments] for _ in range(2))
    without, compiled = uncompiled.call(kernel, tuple(own), math.inf), kernel.dispatcher(*theirs)
    both = zip(*((x if isinstance(x, tuple) else (x,)) for x in (without, compiled)), strict=True)
    for a, b in [*both, *((a, b) for a, b in zip(own, theirs, strict=True) if isinstance(a, np.ndarray))]:
        np.testing.assert_array_equal(a, b, err_msg=kernel.__name__)


@pytest.mark.parametrize("rig", [cell(0), published()], ids=["pulleys", "straight"])
def test_cables_have_the_same_bits(rig: Rig) -> None:
    random = np.random.default_rng(0)
    rows, turns = rig.cable_rows(), random.normal(size=(40, 4))
    poses = np.concatenate([random.uniform(-400.0, 400.0, (40, 3)), turns / np.linalg.norm(turns, axis=1)[:, None]], axis=1)
    poses[3] = np.nan
    counts = random.uniform(-5e4, 5e4, (40, 6))
    for kernel in (cable.span_lengths, cable.span_rows_of, cable.wrap_geometry):
        agree(kernel, rows, poses)
    agree(cable.changes_from_counts, rows, counts)
    agree(cable.counts_from_changes, rows, 0.01 * counts)
    agree(cable.length_gradients, rows, poses, counts, random.uniform(0.5, 2.0, 6))


def test_counters_and_searches_have_the_same_bits() -> None:
    random = np.random.default_rng(1)
    time_s, recorded = np.arange(300) * 1e-3, np.cumsum(random.integers(-30, 30, 300)).astype(float)
    recorded[::17], recorded[100], recorded[200:] = np.nan, 9e3, recorded[200:] + 500.0
    agree(counter.resume_counting, recorded, time_s, 4e4, 65536.0, np.zeros(counter.STATE), 1e-3)
    candidates = np.concatenate([random.uniform(-900.0, 900.0, (2048, 3)), random.uniform(-3.0, 3.0, (2048, 2))], axis=1)
    points, changes = random.uniform(-300.0, 300.0, (9, 3)), random.uniform(-200.0, 200.0, 9)
    agree(search.best_of, candidates, 4, 20.0, points, changes, np.arange(9) == 0)


@pytest.mark.parametrize("linked", [False, True], ids=["alone", "linked"])
def test_zones_have_the_same_bits(linked: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[tuple[Any, ...]] = []

    def noted(*arguments: Any) -> Any:
        seen.append(arguments)
        return zone_lanes.scan_lanes.dispatcher(*arguments)

    monkeypatch.setattr("lmeasure.kernels.scan_lanes", noted)
    nodes, random = axis(-600.0, 600.0, 150.0), np.random.default_rng(2)
    positions = np.stack(np.meshgrid(nodes, nodes, nodes, indexing="ij"), axis=-1).reshape(-1, 3)
    plan = make_plan(cell(0), None, positions, tilts(0.3, 2), start=np.eye(7)[6], full=True, near=True, bodies=BODIES)
    if linked:
        plan = replace(plan, factor=0.02 * random.standard_normal((78, 4)), scales=random.uniform(0.5, 2.0, 6))
    run(plan)
    agree(zone_lanes.scan_lanes, *seen[0])
    p = replace(plan, positions=positions[::100])
    agree(zone.scan, p.cables, p.positions, p.quaternions, p.variance, p.weights, p.scales, p.factor, p.start, p.points, p.pairs, p.bodies)


def test_a_call_that_takes_too_long_changes_nothing() -> None:
    state, recorded = np.zeros(counter.STATE), np.arange(1000.0)
    with pytest.raises(uncompiled.TooLongError):
        uncompiled.call(counter.resume_counting, (recorded, recorded, 4e4, 0.0, state, 1e-3), -math.inf)
    assert not state.any()


def _half(value: float) -> float:
    return 0.5 * value


def test_every_call_is_compiled_where_that_is_wanted() -> None:
    half = StrictKernel(_half, kept=False)
    with compiled_at_once():
        assert half(3.0) == 1.5
    assert "_half" not in uncompiled.used
    assert len(half.dispatcher.signatures) == 1
    assert StrictKernel(_half, kept=False)(3.0) == 1.5
    assert "_half" in uncompiled.used
