"""What a weave is made of, against its definition written out: strokes and crossings, what may be the farthest in truth, its figures."""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from synthetic_paths import FloatArray
from synthetic_trajectories import UNIT

from lmeasure.core import CertificationError
from lmeasure.iso9283.clauses import weaving
from lmeasure.iso9283.clauses.weaving import Weave, WeavePart, WeaveTest, _before_crossings, weaves
from lmeasure.iso9283.figure import Subject
from lmeasure.iso9283.paths import Crossings, Cycle, Line
from lmeasure.recording import CommandedPath
from lmeasure.trajectory import PoseErrors, kept_over
from lmeasure.trajectory.time.stamps import sound

START, ALONG = np.array([20.0, -10.0, 5.0]), np.array([2.0, 3.0, 6.0]) / 7.0
ACROSS, ASIDE = np.array([3.0, -6.0, 2.0]) / 7.0, np.array([6.0, 2.0, -3.0]) / 7.0
LENGTH = 140.0
PATH: dict[str, Any] = {"name": "w", "kind": "linear", "start_mm": tuple(START), "end_mm": tuple(START + LENGTH * ALONG)}
PATH |= {"weave_stroke_mm": 8.0, "weave_distance_mm": 20.0}


def crossed(*cycles: Cycle) -> Crossings:
    """Of a line in space, of which cycles alone are asked."""
    none: Any = None
    names = ["way_mm", "commanded", "tangent", "attained", "time_s", "pace_mm_s", "samples", "weights", "step", "scatter"]
    line = Line(CommandedPath.model_validate(PATH))
    return Crossings(**dict.fromkeys(names, none), line=line, cycles=cycles, angle_deg=0.0)


def cycle_of(way: FloatArray, sway: FloatArray, aside: FloatArray | float = 0.0) -> Cycle:
    """Along the line at ways (n,), off by sway (n,) and a little aside, at uneven times."""
    place = START + np.outer(way, ALONG) + np.outer(sway, ACROSS) + np.outer(np.broadcast_to(aside, len(way)), ASIDE)
    time_s = 3.0 + way / 50.0 + 0.001 * np.sin(way)
    return Cycle(np.arange(500, 500 + len(way)), time_s, np.column_stack([place, np.tile(UNIT, (len(way), 1))]), way)


def by_definition(cycle: Cycle, stroke_mm: float) -> dict[str, Any]:
    """All of `Weave`, in the direction in which the variance is largest, walking from sample to sample."""
    kept = [i for i, w in enumerate(cycle.way_mm) if 0.0 < w < LENGTH]
    place = cycle.poses[kept, :3]
    off = (place - START) @ (np.eye(3) - np.outer(ALONG, ALONG))
    direction = np.linalg.eigh(np.cov(off.T))[1][:, 2]
    y = off @ direction
    middle = y - (y.max() + y.min()) / 2.0
    least = 0.1 * max(y.max() - y.min(), stroke_mm)
    before, last_far, last_change = [], 0.0, 0
    for i, value in enumerate(middle):
        if i and np.sign(middle[i - 1]) != np.sign(value):
            last_change = i - 1
        if abs(value) >= least:
            if last_far * value < 0.0:
                before.append(last_change)
            last_far = value
    strokes = [range(a + 1, b + 1) for a, b in pairwise(before)]
    tops = [max(s, key=lambda i: abs(middle[i])) for s in strokes]
    width = min(max(min(len(s) for s in strokes) // 6, 1), 7)
    seen = max(width, 3)
    rows = np.array(
        [[min(max(t + k, 0), len(y) - 1) for k in range(-seen, seen + 1)] for t in [*tops, int(np.argmax(y)), int(np.argmin(y))]]
    )
    edges = np.array([[before[0], before[0] + 1], [before[-1], before[-1] + 1]])
    at = np.array(kept)
    return {
        "direction": direction, "samples": cycle.samples[at[rows]], "positions": place[rows], "y": y[rows], "width": width,
        "side": np.r_[np.sign(middle[tops]), 1.0, -1.0], "edges": cycle.samples[at[edges]], "edge_positions": place[edges],
        "edge_y": y[edges], "edge_s": cycle.time_s[at[edges]],
    }  # fmt: skip


NOISE = np.random.default_rng(6).normal(size=2000)


def swaying(step_mm: float, *, begin: float = -12.0, end: float = 150.0, noise: float = 0.0) -> Cycle:
    """About a middle of 0.7 mm, strokes of nearly 8 mm."""
    way = np.arange(begin, end, step_mm)
    sway = 0.7 + 4.0 * np.sin(2.0 * np.pi * way / 19.3) + 0.3 * np.cos(way / 30.0) + noise * NOISE[: len(way)]
    return cycle_of(way, sway, 0.2 * np.sin(way / 9.0))


CYCLES = {
    "coarse": swaying(2.1),
    "of three samples about a place": swaying(0.45),
    "fine": swaying(0.15),
    "noisy": swaying(0.5, noise=0.12),
    "with samples at both ends of the path": swaying(0.5),
    "that begins and ends far": swaying(0.5, begin=4.5, end=121.0),
    # about the middle it goes to and fro, less far than is a stroke
    "that trembles": swaying(0.15, noise=0.2),
    **{f"of {n} samples a stroke": swaying(9.65 / n) for n in (16, 17, 18, 19, 41, 42, 43)},
    # its short way out and back is no stroke of eight millimetres
    "that hesitates": cycle_of(
        np.arange(1.0, 100.0), np.interp(np.arange(1.0, 100.0), [0, 20, 40, 44, 48, 70, 100], [1.2, -1.1, 0.1, 0.45, 0.3, 1.3, -1.4])
    ),
}


@pytest.mark.parametrize("stroke_mm", [1.0, 8.0])
@pytest.mark.parametrize("name", CYCLES)
def test_strokes_lie_between_crossings_of_the_middle(name: str, stroke_mm: float) -> None:
    (found,), expected = weaves(crossed(CYCLES[name]), stroke_mm), by_definition(CYCLES[name], stroke_mm)
    turned = 1.0 if found.direction @ expected["direction"] > 0.0 else -1.0
    for key in ("direction", "y", "edge_y"):
        expected[key] = turned * expected[key]
    if turned < 0.0:
        # of all: the farthest to the one side, then to the other
        order = [*range(len(expected["y"]) - 2), -1, -2]
        expected |= {key: expected[key][order] for key in ("samples", "positions", "y")}
        expected["side"] = np.r_[-expected["side"][:-2], 1.0, -1.0]
    for key, value in expected.items():
        np.testing.assert_allclose(getattr(found, key), value, atol=1e-9, err_msg=key)
    assert found.strokes == len(expected["y"]) - 2


def test_widths_of_strokes_are_a_sixth_of_their_samples_and_seven_at_most() -> None:
    widths = [weaves(crossed(CYCLES[name]), 8.0)[0].width for name in ("coarse", "of three samples about a place", "fine")]
    assert widths == [1, 3, 7]


@pytest.mark.parametrize(("turns", "strokes"), [(0, 0), (1, 0), (2, 1), (3, 2)])
def test_a_path_needs_two_strokes(turns: int, strokes: int) -> None:
    way = np.arange(1.0, 130.0)
    sway = 4.0 * np.cos(np.pi * np.minimum(way / 30.0, turns + 0.001))
    if strokes >= 2:
        (found,) = weaves(crossed(cycle_of(way, sway)), 8.0)
        assert found.strokes == strokes
        return
    with pytest.raises(CertificationError, match=rf"^path w, cycle 2: has {strokes} strokes across the path. At least 2 are needed$"):
        weaves(crossed(CYCLES["fine"], cycle_of(way, sway)), 8.0)


def test_a_crossing_is_the_last_change_of_side_between_excursions() -> None:
    y = np.array([0.5, -0.5, 1.0, 0.2, -0.9, 0.3, -0.2, -1.0, -3.0, 0.0, 2.0, 0.99, -0.99, 1.5])
    np.testing.assert_array_equal(_before_crossings(y, 1.0), [5, 9])
    np.testing.assert_array_equal(_before_crossings(-y, 1.0), [5, 9])
    np.testing.assert_array_equal(_before_crossings(y, 1.0 + 1e-9), [9])


def weave(rows: FloatArray, width: int, seed: int) -> Weave:
    """Rows y (q, k) of places that are not what the direction says, with crossings of the middle at uneven times."""
    rng = np.random.default_rng(seed)
    q, k = rows.shape
    side = np.r_[np.where(np.arange(q - 2) % 2, -1.0, 1.0), 1.0, -1.0]
    return Weave(
        direction=ACROSS, samples=rng.integers(1000, size=(q, k)), positions=rng.normal(size=(q, k, 3)), y=rows, width=width, side=side,
        edges=rng.integers(1000, size=(2, 2)), edge_positions=rng.normal(size=(2, 2, 3)),
        edge_y=np.array([[-0.7, 1.2], [1.1, -1.9]]), edge_s=np.array([[2.0, 2.25], [7.5, 7.6]]),
    )  # fmt: skip


def rows_of(strokes: int, half: int, seed: int) -> FloatArray:
    """Tops of strokes, one side and the other, and of all; noisy."""
    rng = np.random.default_rng(seed)
    i = np.arange(-half, half + 1.0)
    side = np.r_[np.where(np.arange(strokes) % 2, -1.0, 1.0), 1.0, -1.0]
    return side[:, None] * (
        4.0 - 0.03 * (i - rng.uniform(-1.0, 1.0, (strokes + 2, 1))) ** 2 + 0.05 * rng.normal(size=(strokes + 2, len(i)))
    )


STEEP = rows_of(3, 3, 1) + np.r_[0.6, 0.6, -0.6, -0.6, 0.6][:, None] * np.arange(-3.0, 4.0)
"""What lies farther off than it may be is farther still, on one side or the other."""
WEAVES = (weave(STEEP, 2, 1), weave(rows_of(5, 3, 2), 3, 2), weave(rows_of(4, 7, 3), 7, 3))


def laws(n: int, *, rounded: bool) -> PoseErrors:
    rng = np.random.default_rng(3)
    return PoseErrors.of(rng.normal(size=(n, 6, 6)) * 0.004, rng.normal(size=(n, 6, 2)) * 0.002, rounded=rounded)


@pytest.mark.parametrize("reduced", [False, True])
def test_the_farthest_is_what_a_curve_through_samples_reaches_about_the_middle_one(reduced: bool) -> None:
    """Through those measured, or, where they are three and more on either side, through the parabolas that fit them."""
    sizes = [w.y.size + 4 for w in WEAVES]
    errors = np.random.default_rng(9).normal(size=(2, sum(sizes), 6)) * 0.02
    far, times = WeavePart(WEAVES, laws(sum(sizes), rounded=False)).state(errors, reduced)
    for n, w in enumerate(WEAVES):
        off = errors[:, sum(sizes[:n]) : sum(sizes[: n + 1]), 3:] @ ACROSS
        for draw in (0, 1):
            tops = []
            for row, side, moved in zip(w.y, w.side, off[draw, : w.y.size].reshape(w.y.shape), strict=True):
                i = np.arange(len(row)) - len(row) // 2
                smooth = np.polyval(np.polyfit(i, row, 2), i) if reduced and w.width >= 3 else row
                fine = CubicSpline(i, smooth + moved)(np.arange(-16 * w.width, 16 * w.width + 1) / 16.0)
                tops.append(fine.max() if side > 0.0 else fine.min())
            np.testing.assert_allclose(far[n][draw], tops, atol=1e-12)
            level = (max(tops) + min(tops)) / 2.0
            edge = w.edge_y + off[draw, w.y.size :].reshape(2, 2)
            when = [np.interp(level, np.sort(e), s[np.argsort(e)]) for e, s in zip(edge, w.edge_s, strict=True)]
            np.testing.assert_allclose(times[n][draw], when, atol=1e-12)


def test_what_rounding_keeps_is_common_to_a_row() -> None:
    n = sum(w.y.size + 4 for w in WEAVES)
    exact, rounded = laws(n, rounded=False), laws(n, rounded=True)
    assert WeavePart.of(WEAVES, exact).errors is exact
    near = tuple(replace(w, positions=0.002 * w.positions, edge_positions=0.0004 * w.edge_positions) for w in WEAVES)
    part, at = WeavePart.of(near, rounded), 0
    np.testing.assert_array_equal(part.positions, np.concatenate([x.reshape(-1, 3) for w in near for x in (w.positions, w.edge_positions)]))
    shares = []
    for number, row in enumerate(row for w in near for x in (w.positions, w.edge_positions) for row in x):
        step = max(np.linalg.norm(b - a) for a, b in pairwise(row))
        here = np.arange(at, at + len(row))
        kept = kept_over(rounded[here], np.full(len(row), step))[:, None, None]
        np.testing.assert_allclose(part.errors.own[here], np.sqrt(1.0 - kept) * rounded.own[here])
        np.testing.assert_allclose(part.errors.local[here], np.sqrt(kept) * rounded.own[here])
        assert set(part.errors.place[here]) == {number}
        shares += kept.ravel().tolist()
        at += len(row)
    assert at == n
    assert min(shares) < 0.3 < 0.6 < max(shares)


def test_a_weave_states_its_stroke_and_its_frequency() -> None:
    """WS by the mean stroke of each cycle, WF by the weaves from the first crossing to the last; WF knows no more than the instants."""
    path = CommandedPath.model_validate(PATH | {"speed_mm_s": 50.0, "windows_s": [(0.0, 2.0), (5.0, 10.0), (12.0, 16.0)]})
    stamps = replace(sound(np.arange(9.0)), u_time_s=0.003, u_rate=4e-4)
    test = WeaveTest(subject=Subject("path", "w"), path=path, cycles=WEAVES, stamps=stamps)
    samples = np.concatenate([x.ravel() for w in WEAVES for x in (w.samples, w.edges)])
    np.testing.assert_array_equal(test.samples(), samples)
    ((key, part),) = test.parts(lambda at: laws(len(at), rounded=False)).items()
    assert key == Subject("weave", "w")
    far, times = part.state(np.zeros((len(part.errors), 6)), False)
    ws, wf = test.figures()
    assert [(*f.key, f.clause, f.unit, f.cycles, f.needs) for f in (ws, wf)] == [
        (name, None, "w", None, "11", "%", 3, (Subject("path", "w"),)) for name in ("WS", "WF")
    ]
    strokes = [np.mean([abs(b - a) for a, b in pairwise(f[:-2])]) for f in far]
    assert float(ws.of({key: (far, times)})) == pytest.approx(100.0 * (np.mean(strokes) / 8.0 - 1.0))
    # two strokes are one weave; 50 mm/s by 20 mm are 2.5 of them a second
    rates = [0.5 * n / (t[1] - t[0]) for n, t in zip((3, 5, 4), times, strict=True)]
    value = float(wf.of({key: (far, times)}))
    assert value == pytest.approx(100.0 * (np.mean(rates) / 2.5 - 1.0))
    assert ws.instants is None
    assert wf.instants is not None
    # each end of three cycles of 2, 5 and 4 s errs by 3 ms, and all by a rate
    of_ends = 0.003 * np.sqrt(2.0 * (1.0 / 4.0 + 1.0 / 25.0 + 1.0 / 16.0)) / 3.0
    assert wf.instants(value).u == pytest.approx((100.0 + value) * np.hypot(of_ends, 4e-4))
    assert wf.instants(value).bias == 0.0
    without = WeaveTest(subject=Subject("path", "w"), path=path.model_copy(update={"speed_mm_s": None}), cycles=WEAVES, stamps=stamps)
    assert [f.key.name for f in without.figures()] == ["WS"]


def test_paths_with_a_weave_that_were_run_are_tested() -> None:
    plain = {k: v for k, v in PATH.items() if not k.startswith("weave")}
    paths = [CommandedPath.model_validate(p) for p in (plain | {"name": "p"}, PATH, PATH | {"name": "not run"})]
    ways = {name: crossed(CYCLES["coarse"], CYCLES["fine"]) for name in ("p", "w")}
    attained: Any = SimpleNamespace(program=SimpleNamespace(path=paths), paths=ways, stamps=sound(np.arange(3.0)))
    (found,) = weaving.tests(attained)
    assert (found.subject, found.path, found.stamps) == (Subject("path", "w"), paths[1], attained.stamps)
    assert [c.width for c in found.cycles] == [1, 7]
