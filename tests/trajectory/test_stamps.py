"""Time stamps that jitter: evenly taken samples get even times, stamps in error carry it, sound ones stay as they are."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cells import cell
from in_process import ran

from lmeasure.core import FloatArray, Status
from lmeasure.kernels import JUMPED
from lmeasure.recording import Counts, Run, read_run, unwrap, write_run
from lmeasure.sensors import counts_from_poses, recorded_from_counts
from lmeasure.trajectory import motion_of, read_trajectory, reconstruct
from lmeasure.trajectory.time.stamps import clock, judge_stamps, numbers

Law = Callable[[np.random.Generator, FloatArray], FloatArray]

TRUTH = Path(__file__).parents[1] / "authorities" / "truth"
PERIOD_S, SPEED, RAMP_S = 0.005, 250.0, 0.25
NOISE_MM = 0.0046
LAST_S = 8.0
LEVEL = slice(200, 1300)
"""Samples, of 1600, at SPEED."""


def way(t: FloatArray) -> FloatArray:
    """(n,) way [mm] at times (n,): rest until 0.5 s, at SPEED until 7.25 s, ramps of RAMP_S, rest."""
    s, end = np.clip(t - 0.5, 0.0, LAST_S - 1.0), LAST_S - 1.0
    ramp = 0.5 * SPEED / RAMP_S
    out = np.where(s < RAMP_S, ramp * s**2, SPEED * (s - 0.5 * RAMP_S))
    return np.where(s > end - RAMP_S, SPEED * (end - RAMP_S) - ramp * (end - s) ** 2, out)


def on_line(t: FloatArray) -> FloatArray:
    """(n, 3) places on a line in space."""
    return way(t)[:, None] * np.array([0.6, 0.0, 0.8])


def measured(rng: np.random.Generator, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Places with their noise, and its standard uncertainties."""
    return on_line(t) + rng.normal(0.0, NOISE_MM, (len(t), 3)), np.full(len(t), NOISE_MM)


def instants(n: int, rate_hz: float = 1.0 / PERIOD_S) -> FloatArray:
    """(n,) even times [s]."""
    return np.asarray(np.arange(n) / rate_hz, dtype=np.float64)


def in_order(stamps: FloatArray) -> FloatArray:
    steps = 5e-5 * np.arange(len(stamps))
    return np.asarray(np.maximum.accumulate(stamps - steps) + steps)


def pauses(rng: np.random.Generator, t: FloatArray) -> FloatArray:
    """A host that is away for 20 to 50 ms at a time."""
    free, begin = np.zeros(len(t)), np.flatnonzero(rng.random(len(t)) < 0.01)
    free[begin] = t[begin] + rng.uniform(0.02, 0.05, len(begin))
    return in_order(np.maximum(t, np.maximum.accumulate(free)) + rng.exponential(2e-4, len(t)))


EVEN_LAWS: dict[str, Law] = {
    "uniform": lambda rng, t: in_order(t + rng.uniform(0.0, 0.01, len(t))),
    "overtaking": lambda rng, t: np.sort(t + rng.uniform(0.0, 0.01, len(t))),
    "exponential": lambda rng, t: in_order(t + rng.exponential(0.003, len(t))),
    "both sides": lambda rng, t: in_order(t + rng.normal(0.0, 0.003, len(t))),
    "pauses": pauses,
    "tenth of a period": lambda rng, t: t + rng.uniform(0.0, 5e-4, len(t)),
}


@pytest.mark.parametrize("name", EVEN_LAWS)
def test_late_stamps_of_even_samples_give_even_times(name: str) -> None:
    t = instants(1600)
    of_rate = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        places, u = measured(rng, t)
        stamps = EVEN_LAWS[name](rng, t)
        found = judge_stamps(stamps, places, u)
        assert found.kind == "even"
        assert np.ptp(np.diff(found.time_s)) < 1e-9
        # where windows of time fall stays as it was recorded
        assert np.mean(found.time_s - stamps) == pytest.approx(0.0, abs=1e-9)
        of_rate.append((np.diff(found.time_s).mean() / PERIOD_S - 1.0) / found.u_rate)
        assert found.u_rate < 1e-4
        assert found.u_time_s * SPEED < 2.0 * NOISE_MM
    # 16 if the stated uncertainty is right, and hardly above 30
    assert 0.5 < np.sum(np.square(of_rate)) < 30.0


def test_lost_samples_leave_holes_of_whole_periods() -> None:
    t = instants(1600)
    for seed in range(8):
        rng = np.random.default_rng(seed)
        kept = rng.random(len(t)) > 0.02
        stamps, number = in_order(t + rng.uniform(0.0, 0.01, len(t)))[kept], np.flatnonzero(kept)
        places, u = measured(rng, t[kept])
        found = judge_stamps(stamps, places, u)
        assert found.kind == "even"
        moving = (number > 120) & (number < 1480)
        np.testing.assert_allclose(np.diff(found.time_s[moving]) / PERIOD_S, np.diff(number[moving]), atol=1e-3)


def walked(rng: np.random.Generator, n: int, by_s: float) -> FloatArray:
    """(n,) random walk [s] of steps by_s."""
    return np.asarray(np.cumsum(rng.normal(0.0, by_s, n)))


def with_one_lost_of_50(rng: np.random.Generator, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    kept = rng.random(len(t)) > 0.02
    return t[kept], in_order(t + rng.uniform(0.0, 0.01, len(t)))[kept]


def with_long_pauses(rng: np.random.Generator, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    free, begin = np.zeros(len(t)), np.flatnonzero(rng.random(len(t)) < 0.002)
    free[begin] = t[begin] + rng.uniform(0.005, 0.3, len(begin))
    return t, in_order(np.maximum(t, np.maximum.accumulate(free)) + rng.exponential(2e-4, len(t)))


def by_itself(rng: np.random.Generator, t: FloatArray, walk_s: float, change: float) -> tuple[FloatArray, FloatArray]:
    """A device that strays itself, or has another rate from the middle on; stamps are late by up to 1 ms."""
    true = in_order(np.where(t > t[-1] / 2.0, t + change * (t - t[-1] / 2.0), t) + walked(rng, len(t), walk_s))
    return true, in_order(true + rng.uniform(0.0, 1e-3, len(t)))


STRAYING: dict[str, tuple[str, Callable[[np.random.Generator, FloatArray], tuple[FloatArray, FloatArray]]]] = {
    "intervals of 5 +- 4 ms add up": ("even", lambda rng, t: (t, np.cumsum(rng.normal(0.005, 0.004, len(t)).clip(5e-5)))),
    "intervals of 5 +- 0.3 ms add up": ("even", lambda rng, t: (t, in_order(t + walked(rng, len(t), 3e-4)))),
    "and stamps are late besides": ("even", lambda rng, t: (t, in_order(t + walked(rng, len(t), 1e-3) + rng.uniform(0.0, 3e-3, len(t))))),
    "one of 50 is lost": ("even", with_one_lost_of_50),
    "pauses of up to 300 ms": ("even", with_long_pauses),
    "a device that strays": ("uneven", lambda rng, t: by_itself(rng, t, 1e-4, 0.0)),
    "another rate from the middle on": ("uneven", lambda rng, t: by_itself(rng, t, 0.0, 0.01)),
}


@pytest.mark.parametrize("name", STRAYING)
def test_durations_of_moves_between_rests_lie_within_their_uncertainty(name: str) -> None:
    """Six moves of 2.25 s between rests of 0.5 s. Whether the host strays or the device, the motion shows within a few samples."""
    kind, law = STRAYING[name]
    lasts, rest, moves = 2.25, 0.5, 6
    kinds: list[str] = []
    inside: list[bool] = []
    for seed in range(10):
        rng = np.random.default_rng([11, seed])
        true, stamps = law(rng, instants(round((moves * (lasts + rest) + rest) / PERIOD_S)))
        turn, phase = np.divmod(true - rest, lasts + rest)
        since = np.clip(phase, 0.0, lasts)
        ramp = 0.5 * SPEED / RAMP_S * np.minimum(np.minimum(since, lasts - since), RAMP_S) ** 2
        level = SPEED * (since - 0.5 * RAMP_S)
        x = np.where(since < RAMP_S, ramp, np.where(since > lasts - RAMP_S, SPEED * (lasts - RAMP_S) - ramp, level))
        x = np.where(turn % 2 == 0, x, SPEED * (lasts - RAMP_S) - x)
        places = x[:, None] * np.array([0.6, 0.0, 0.8]) + rng.normal(0.0, NOISE_MM, (len(true), 3))
        found = judge_stamps(stamps, places, np.full(len(true), NOISE_MM))
        kinds.append(found.kind)
        edges = rest + (lasts + rest) * np.arange(moves)[:, None] + [0.3, lasts - 0.3]
        durations = np.diff(np.interp(edges, true, found.time_s), axis=1)[:, 0] - (lasts - 0.6)
        common = durations.mean()
        u_single = np.sqrt(2.0) * found.u_time_s
        inside.append(abs(common) <= 1.96 * np.hypot(u_single / np.sqrt(moves), found.u_rate * lasts) + 1e-4)
        inside.append(np.sqrt(np.mean((durations - common) ** 2)) <= 1.5 * u_single + 1e-4)
    assert kinds.count(kind) >= 9
    assert sum(inside) >= 19


def test_a_hole_while_the_tool_rests_is_told_by_the_stamps_alone() -> None:
    t = np.delete(instants(1600), slice(1530, 1533))
    rng = np.random.default_rng(3)
    stamps = in_order(t + rng.uniform(0.0, 0.01, len(t)))
    found = numbers(stamps, measured(rng, t)[0], NOISE_MM)
    assert found.number[-1] == 1599
    # at the transition it is not where, but how many that can be told
    assert np.array_equal(found.number[:1500], np.arange(1500))
    even = clock(stamps, found)
    assert even is not None
    assert even.period_s == pytest.approx(PERIOD_S, rel=2e-4)


def test_samples_that_a_host_asked_for_keep_their_stamps() -> None:
    rng = np.random.default_rng(5)
    true = np.cumsum(rng.uniform(2e-4, 0.01, 1500))
    places, u = measured(rng, true)
    requested = judge_stamps(true, places, u)
    assert requested.kind == "sound"
    assert requested.time_s is true
    late = np.sort(true + rng.uniform(0.0, 0.001, len(true)))
    found = judge_stamps(late, places, u)
    assert found.kind == "uneven"
    assert found.time_s is late
    assert found.u_time_s == pytest.approx(0.001 / np.sqrt(12.0), rel=0.25)
    assert "with errors of 0.2" in str(found.note) or "with errors of 0.3" in str(found.note)


def test_jumps_of_the_place_tell_nothing_of_time() -> None:
    """Parts of a motion that follow each other at once, as in a record that was cut: each jump is far faster than all else."""
    rng = np.random.default_rng(6)
    true = np.cumsum(rng.uniform(2e-4, 0.01, 1500))
    places, u = measured(rng, true)
    places += 320.0 * (np.arange(1500) // 300 % 2)[:, None]
    assert judge_stamps(true, places, u).kind == "sound"
    found = judge_stamps(np.sort(true + rng.uniform(0.0, 0.001, len(true))), places, u)
    assert found.u_time_s == pytest.approx(0.001 / np.sqrt(12.0), rel=0.25)


@pytest.mark.parametrize(("rate_hz", "off_s"), [(1000.0, 0.0), (1000.0, 2e-6), (200.0, 2e-6), (200.0, 1e-6)])
def test_sound_stamps_stay_as_they_are(rate_hz: float, off_s: float) -> None:
    for seed in range(5):
        rng = np.random.default_rng(seed)
        t = instants(round(LAST_S * rate_hz), rate_hz)
        stamps = t + rng.uniform(-off_s, off_s, len(t))
        found = judge_stamps(stamps, *measured(rng, t))
        assert found.kind == "sound"
        assert found.time_s is stamps
        assert found.note is None


def test_what_no_motion_tells_stays() -> None:
    rng = np.random.default_rng(0)
    t = instants(1600)
    stamps = in_order(t + rng.uniform(0.0, 0.01, len(t)))
    assert judge_stamps(stamps, rng.normal(0.0, NOISE_MM, (len(t), 3)), np.full(len(t), NOISE_MM)).kind == "sound"
    assert judge_stamps(stamps[:20], on_line(t[:20]), np.full(20, NOISE_MM)).kind == "sound"
    assert judge_stamps(stamps, np.full((len(t), 3), np.nan), np.full(len(t), np.nan)).kind == "sound"


def test_without_stated_noise_it_is_that_across_the_motion() -> None:
    rng = np.random.default_rng(1)
    t = instants(1600)
    places, _ = measured(rng, t)
    for off_s, kind in ((3e-6, "sound"), (1e-3, "even")):
        stamps = t + rng.uniform(0.0, off_s, len(t))
        assert judge_stamps(stamps, places, np.zeros(len(t))).kind == kind


RECORD: FloatArray = np.asarray(np.arange(1200) * 0.01, dtype=np.float64)
"""Even times of 12 s at 100 Hz."""


def swung(t: FloatArray) -> FloatArray:
    """(n, 3) places on a smooth curve that is never at rest for long."""
    return np.column_stack([200.0 * np.sin(0.7 * t), 50.0 * np.cos(1.1 * t), 20.0 * np.sin(0.4 * t)])


def later(t: FloatArray, at: int, by_s: float) -> FloatArray:
    return np.asarray(t + by_s * (np.arange(len(t)) >= at))


HOLES = {
    f"a hole of {periods:g} periods": later(RECORD, 500, 0.01 * (periods - 1.0)) for periods in (1.5, 2.0, 3.3, 11.0, 50.0, 200.5, 1000.0)
} | {
    "three holes": later(later(later(RECORD, 300, 0.1), 600, 0.033), 900, 12.0),
    "a hole near the end": later(RECORD, 1190, 0.5),
    "gaps of 12 s": np.concatenate([np.arange(300) * 0.01 + 15.0 * k for k in range(4)]),
    "single samples missing": np.delete(RECORD, [200, 201, 700, 1100]),
    "no hole": RECORD,
    "another rate": np.concatenate([RECORD[:600], RECORD[600] + 0.0125 * np.arange(600)]),
    "half the rate": np.concatenate([RECORD[:600], RECORD[600] + 0.02 * np.arange(600)]),
    "a clock that drifts": RECORD + 3e-5 * RECORD**2,
}


@pytest.mark.parametrize("jitter_s", [0.0, 2e-4, 1e-3])
@pytest.mark.parametrize("name", HOLES)
def test_no_hole_is_spread_over_the_record(name: str, jitter_s: float) -> None:
    """Times are right within what is stated, speeds too, and gaps are named."""
    rng, t = np.random.default_rng(7), HOLES[name]
    stamps = t + rng.uniform(-jitter_s, jitter_s, len(t))
    places = swung(t) + rng.normal(0.0, NOISE_MM, (len(t), 3))
    found = judge_stamps(stamps, places, np.full(len(t), NOISE_MM))
    if jitter_s == 0.0:
        assert found.kind == "sound"
    assert np.abs(found.time_s - stamps).max() < 4.0 * jitter_s + 1e-9
    off = found.time_s - t
    u = max(found.u_time_s, jitter_s / np.sqrt(3.0) if found.kind == "sound" else 0.0)
    assert np.abs(off - np.median(off)).max() <= 4.0 * u + 4.0 * found.u_rate * np.ptp(t) + 1e-9
    apart = np.flatnonzero(np.diff(t) > 0.0255)
    if name != "half the rate":
        assert (found.gap is None) == (len(apart) == 0)
    if found.gap is not None:
        assert found.gap.values["gaps"] == len(apart)
        assert found.gap.values["longest_s"] == pytest.approx(np.diff(t).max(), abs=2.0 * jitter_s + 1e-9)
        assert found.stretch is not None
        np.testing.assert_array_equal(np.flatnonzero(np.diff(found.stretch)), apart)


def test_no_fit_crosses_a_gap(tmp_path: Path) -> None:
    """Beside a gap in which the tool turned round, speeds are those of its own side, at any width of the window."""
    t = np.concatenate([np.arange(0.0, 2.0, 0.008), np.arange(2.2, 4.0, 0.008)])
    x = np.where(t < 2.1, 100.0 * t, 500.0 - 100.0 * t)
    rows = "".join(f"{a!r},{b!r},0,0\n" for a, b in zip(t.tolist(), x.tolist(), strict=True))
    (tmp_path / "t.csv").write_text("time_s,x_mm,y_mm,z_mm\n" + rows)
    for width in (None, 0.3):
        motion = motion_of(read_trajectory(tmp_path / "t.csv"), width)
        there = ~np.isnan(motion.velocity[:, 3])
        assert there.mean() > 0.95
        np.testing.assert_allclose(motion.velocity[there, 3], np.where(t < 2.1, 100.0, -100.0)[there], atol=1e-6)
    assert "1 gap in the samples, the longest 0.2" in ran("motion", tmp_path / "t.csv", "--out", tmp_path / "m.csv")


def run_with(stamps: FloatArray, t: FloatArray) -> Run:
    """Whole counts of a cell, taken at true times and stamped."""
    rig, places = cell(), on_line(t) / 6.0 - [80.0, 0.0, 100.0]
    poses = np.column_stack([places, np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1))])
    counts = recorded_from_counts(rig, counts_from_poses(rig, poses, poses[0]))
    return Run(rig, poses[0], (Counts(stamps, tuple(c.channel for c in rig.cable), counts),), unstated="exact")


def test_speeds_hold_what_they_say(tmp_path: Path) -> None:
    t = instants(1600)
    inside, largest = [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        trajectory = reconstruct(run_with(in_order(t + rng.uniform(0.0, 0.01, len(t))), t))
        assert "time stamps are irregular" in trajectory.summary()
        motion = motion_of(trajectory)
        error = motion.speed_mm_s[LEVEL] - SPEED / 6.0
        inside.append(np.mean(np.abs(error) <= 1.96 * motion.u_speed_mm_s[LEVEL]))
        assert np.abs(error).max() < 1.0
        value, u95 = motion.largest_speed()
        largest.append(abs(value - SPEED / 6.0) <= u95)
    assert 0.9 < np.mean(inside) < 0.99
    assert sum(largest) >= 5


def test_the_commands_say_it(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    t = instants(1600)
    write_run(tmp_path / "run", run_with(in_order(t + rng.uniform(0.0, 0.01, len(t))), t))
    out, motion = tmp_path / "t.csv", tmp_path / "m.csv"
    assert "time stamps are irregular" in ran("reconstruct", tmp_path / "run", "--out", out)
    recorded = read_trajectory(out).time_s
    assert "the motion fits samples at even times, every 5.00" in ran("motion", out, "--out", motion).replace("4.99", "5.00")
    header, *rows = motion.read_text().splitlines()
    table = {
        name: np.array(column) for name, column in zip(header.split(","), zip(*(r.split(",") for r in rows), strict=True), strict=True)
    }
    np.testing.assert_array_equal(table["stamp_s"].astype(float), recorded)
    assert np.ptp(np.diff(table["time_s"].astype(float))) < 1e-9


def test_a_busy_hosts_stamps_are_no_jump() -> None:
    # 20 samples, 1.25 mm each, stamped within a millisecond behind a pause
    t = instants(200)
    counts = np.rint(1.25 / 0.012 * np.arange(200))
    stamps = t.copy()
    stamps[100:120] = t[120] - 1e-3 + 5e-5 * np.arange(20)
    found = unwrap(counts, stamps, max_rate=20000.0 / 0.012, bits=32)
    np.testing.assert_array_equal(found.counts, counts)
    # what nothing can have gone in the usual time is one still
    counts[150:] += 100_000
    assert unwrap(counts, stamps, max_rate=20000.0 / 0.012, bits=32).what[150] == JUMPED


@pytest.mark.parametrize("seed", [86])
def test_a_cable_that_turns_back_under_stamps_that_come_late_follows_the_tool(seed: int) -> None:
    """A host is held up four times, and late by up to one and a half intervals thirty times: what that hides of cables that go
    it does not hide of one that turns, which alone seemed to accelerate."""
    given = read_run(TRUTH / "swivel-run")
    recorded = given.passes[0].recorded[::5]
    draw = np.random.default_rng(seed)
    stamps = np.arange(len(recorded)) * 0.005
    for _ in range(4):
        begins, for_s = draw.uniform(0.0, stamps[-1]), draw.choice([0.02, 0.05, 0.1, 0.3])
        held = (stamps >= begins) & (stamps < begins + for_s)
        stamps[held] = begins + for_s + 7e-5 * np.arange(held.sum())
    stamps = np.sort(stamps)
    stamps[draw.choice(len(stamps), 30, replace=False)] += draw.uniform(0.0, 0.0074, 30)
    stamps = np.maximum.accumulate(stamps) + 7e-5 * np.arange(len(stamps))
    found = reconstruct(replace(given, passes=(replace(given.passes[0], time_s=stamps, recorded=recorded),)))
    assert not [str(note) for note in found.notes if "does not follow" in str(note)]
    assert (found.status == Status.OK).all()
    assert set(found.cable) == {""}
