"""Counters that step, stand, hang or are mixed up: found where they can be, and sound motions left in peace."""

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from cells import FloatArray, cell, motion, record, with_recorded, words
from scipy.spatial.transform import Rotation
from test_schemes import EIGHT, rig_of

from lmeasure.core import Status
from lmeasure.recording import Run
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.trajectory import align, reconstruct
from lmeasure.trajectory.faults.continuity import Continuity, ContinuityFinder

COUNT_MM = 0.012


def along(points: FloatArray, speed_mm_s: float, rate_hz: float, ramp_s: float = 0.0, rest_s: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """Times and poses of a tool led straight from point to point (k, 3), its speed there at once or by ramps, resting at each."""
    parts = [np.repeat(points[:1], max(round(rest_s * rate_hz), 1), axis=0)]
    for a, b in pairwise(points):
        length = float(np.linalg.norm(b - a))
        whole = length / speed_mm_s + ramp_s
        t = np.arange(1, round(whole * rate_hz) + 1) / rate_hz
        if ramp_s:
            gone = np.where(t < ramp_s, t**2 / 2 / ramp_s, t - ramp_s / 2)
            late = np.maximum(t - (whole - ramp_s), 0.0)
            gone = speed_mm_s * (gone - late**2 / 2 / ramp_s)
        else:
            gone = speed_mm_s * t
        parts += [a + np.minimum(gone, length)[:, None] * (b - a) / length, np.repeat(b[None], round(rest_s * rate_hz), axis=0)]
    places = np.vstack(parts)
    turn = Rotation.from_rotvec(places / 2000.0)
    return np.arange(len(places)) / rate_hz, np.column_stack([places, turn.as_quat()])


WORSE = ("jitter", "rows lost", "vibration", "stick and slip", "an emergency stop", "stale counts", "stale counts of each by itself")
CORNERS = np.array([[0.0, 0, 0], [150, 0, 0], [150, 120, 0], [150, 120, -100], [0, 0, 0], [-120, 40, 60], [0, 0, 0]])


def round_trip(rig: Rig, rate_hz: float = 250.0) -> Run:
    """A run that rests at each corner, and comes back to its start twice."""
    return record(rig, *along(CORNERS, 250.0, rate_hz, 0.1, 0.5))


def continuity_of(run: Run) -> Continuity:
    finder = ContinuityFinder(run.rig)
    finder.add(align(run)._all_lengths)
    return finder.found()


@pytest.mark.parametrize("rate_hz", [100.0, 250.0, 1000.0])
@pytest.mark.parametrize("ramp_s", [0.0, 0.05, 0.2])
@pytest.mark.parametrize("rest_s", [0.0, 0.3])
def test_sound_motions_do_not_step(rate_hz: float, ramp_s: float, rest_s: float) -> None:
    """Corners passed at full speed, from one sample to the next, among them."""
    for speed in (50.0, 250.0, 1000.0):
        found = continuity_of(record(cell(), *along(CORNERS, speed, rate_hz, ramp_s, rest_s)))
        assert (found.breaks, found.away, found.stood, found.clock_s) == ((), (), (), ())


@pytest.mark.parametrize("what", WORSE)
def test_nor_do_sound_motions_of_worse_machines(what: str) -> None:
    rng = np.random.default_rng(7)
    times, poses = along(CORNERS, 250.0, 250.0, 0.1, 0.3)
    if what == "vibration":
        poses[:, :3] += 0.05 * np.sin(2 * np.pi * np.outer(times, [11.0, 9.0, 13.0]))
    if what == "an emergency stop":
        stopped = np.minimum(np.arange(len(poses)), 300)
        poses = poses[stopped]
    run = record(cell(), times, poses)
    counts = run.passes[0]
    if what == "jitter":
        counts = replace(counts, time_s=np.sort(times + rng.uniform(0.0, 0.008, len(times))) + 1e-6 * np.arange(len(times)))
    if what == "rows lost":
        kept = np.sort(rng.permutation(len(times))[: int(0.8 * len(times))])
        counts = replace(counts, time_s=times[kept], recorded=counts.recorded[kept])
    if what == "stick and slip":
        counts = replace(counts, recorded=np.rint(counts.recorded / 8.0) * 8.0)
    if what == "stale counts":
        counts = replace(counts, recorded=counts.recorded[np.arange(len(times)) // 3 * 3])
    if what == "stale counts of each by itself":
        every = [column[np.maximum((np.arange(len(times)) + j) // 3 * 3 - j, 0)] for j, column in enumerate(counts.recorded.T)]
        counts = replace(counts, recorded=np.stack(every, axis=1))
    found = continuity_of(replace(run, passes=(counts,)))
    assert (found.breaks, found.away, found.stood) == ((), (), ())


@pytest.mark.parametrize("counts", [60, 1000, -20_000])
def test_a_step_is_found_where_and_as_large_as_it_is(counts: int) -> None:
    rng = np.random.default_rng(abs(counts))
    for _ in range(5):
        run = round_trip(cell())
        n, j = len(run.passes[0].time_s), int(rng.integers(6))
        i = int(rng.integers(5, n - 5))
        recorded = run.passes[0].recorded.copy()
        recorded[i:, j] += counts
        (found,) = continuity_of(with_recorded(run, recorded)).breaks
        sign = run.rig.observation_point[j].drum.count_sign
        assert (found.cable, found.before_s, found.after_s) == (j, run.passes[0].time_s[i - 1], run.passes[0].time_s[i])
        assert found.by_mm == pytest.approx(sign * counts * COUNT_MM, abs=found.u_mm)
        trajectory = reconstruct(with_recorded(run, recorded))
        assert (trajectory.status[:i] == Status.OK).all()
        ok = trajectory.status[i:] == Status.OK
        assert not ok.any(), "no rest can prove it"
        (determined,) = (
            re.match(r"channel .* jumped by about ([-+]\d+) counts \(within (\d+)\) between", n) for n in map(str, trajectory.notes[:1])
        )
        assert determined is not None, trajectory.notes
        assert abs(int(determined[1]) - counts) <= int(determined[2]) <= max(25, found.u_mm / COUNT_MM + 1)


def test_a_channel_without_counts_hides_no_step_of_another() -> None:
    """Nor is the step taken for the motion's acceleration."""
    run = round_trip(rig_of(EIGHT))
    recorded = run.passes[0].recorded.copy()
    recorded[:, 5] = np.nan
    sound = continuity_of(with_recorded(run, recorded))
    recorded[600:, 1] += 1000.0
    stepped = continuity_of(with_recorded(run, recorded))
    assert [(b.cable, b.before_s) for b in stepped.breaks] == [(1, run.passes[0].time_s[599])]
    assert stepped.acceleration_mm_s2 == sound.acceleration_mm_s2


def test_a_bit_that_flips_once_costs_a_sample() -> None:
    run = round_trip(cell())
    recorded = run.passes[0].recorded.copy()
    recorded[640, 4] = int(recorded[640, 4]) ^ 1024
    trajectory = reconstruct(with_recorded(run, recorded))
    assert np.flatnonzero(trajectory.status != Status.OK).tolist() == [640]
    assert words(trajectory)[640] == "jump"


def test_a_second_jump_minutes_later_proves_nothing_but_a_rest_does() -> None:
    """Today's counter jumped back to where it could be; where it was is told by the rests only."""
    run = round_trip(cell())
    n = len(run.passes[0].time_s)
    for back, proved in ((2000, True), (1500, False)):
        recorded = run.passes[0].recorded.copy()
        recorded[400:, 1] += 2000
        recorded[n // 2 :, 1] -= back
        trajectory = reconstruct(with_recorded(run, recorded))
        lost = trajectory.status == Status.ORIGIN_LOST
        assert lost[400 : n // 2].all()
        assert lost[n // 2 :].all() != proved
        assert lost[n // 2 :].any() != proved
        if proved:
            assert any("it is back: no counts are lost" in note for note in map(str, trajectory.notes))


def test_a_channel_that_stands_while_its_point_moves_is_reported() -> None:
    """From a rest on: no sudden stop shows it."""
    run = round_trip(cell())
    recorded = run.passes[0].recorded.copy()
    recorded[100:, 2] = recorded[100, 2]
    trajectory = reconstruct(with_recorded(run, recorded))
    moving = np.flatnonzero(np.abs(np.diff(run.passes[0].recorded[:, 2])) > 1)
    assert (trajectory.status[moving[0] + 2 :] == Status.ORIGIN_LOST).all()
    recorded[800:, 2] = run.passes[0].recorded[800:, 2]
    again = reconstruct(with_recorded(run, recorded))
    assert (again.status[moving[0] + 2 : 800] == Status.ORIGIN_LOST).all()
    assert (again.status[805:] == Status.OK).all(), "the rests prove it"
    drums = [p.model_copy(update={"drum": p.drum.model_copy(update={"braked": True})}) for p in run.rig.observation_point]
    braked = run.rig.model_copy(update={"observation_point": tuple(drums)})
    assert continuity_of(replace(with_recorded(run, recorded), rig=braked)).stood == ()


@pytest.mark.parametrize("samples", [1, 3, 40])
def test_steps_that_nothing_could_show_are_not_called_seen(samples: int) -> None:
    run = record(cell(), *motion(samples))
    recorded = run.passes[0].recorded.copy()
    if samples > 3:
        recorded[:, 1] = np.nan
        recorded[::4, 4] = np.nan
    (said,) = (note for note in map(str, reconstruct(with_recorded(run, recorded)).notes) if note.startswith("counter jumps"))
    if samples > 3:
        assert re.match(r"counter jumps of \d+ counts .*\. Jumps of ch2, ch5 are not detected: no four consecutive counts$", said)
    else:
        assert said == "counter jumps are not detected, because no channel has four consecutive counts"


@pytest.mark.parametrize("flips", [3, 40])
def test_bits_that_flip_often_are_no_habit(flips: int) -> None:
    """On a straight line at an even speed, which has no acceleration to hold anything against."""
    t = np.arange(4000) / 250.0
    poses = np.zeros((4000, 7))
    poses[:, 0], poses[:, 6] = 60.0 * t, 1.0
    run = record(cell(), t, poses)
    recorded = run.passes[0].recorded.copy()
    at = 50 + 90 * np.arange(flips)
    recorded[at, 3] = recorded[at, 3].astype(int) ^ 1024
    trajectory = reconstruct(with_recorded(run, recorded))
    assert np.flatnonzero(trajectory.status != Status.OK).tolist() == at.tolist()
    assert f"channel ch4 had a short wrong value {flips} times, first after 0.196 s" in map(str, trajectory.notes)


def orthogonal() -> Rig:
    """Three cables to one point, along the axes: a motion along one of them hardly moves the others."""
    data = cell().to_dict()
    far = {"B1": [-1500.0, 150.0, 0.0], "B2": [0.0, -1350.0, 0.0], "B3": [0.0, 150.0, 1500.0]}
    points = [
        dict(p, position_mm=far[p["name"]], guide_alpha_deg=45.0 if p["name"] != "B3" else -30.0) for p in data["observation_point"][:3]
    ]
    return cell(observation_point=points, cable=[{"name": f"c{i}", "channel": f"ch{i}", "from": f"B{i}", "to": "P1"} for i in (1, 2, 3)])


@pytest.mark.parametrize("rate_hz", [10.0, 50.0, 100.0, 250.0])
def test_a_cable_that_moves_alone_by_its_place_is_no_fault(rate_hz: float) -> None:
    t = np.arange(round(10 * rate_hz)) / rate_hz
    poses = np.zeros((len(t), 7))
    poses[:, 0], poses[:, 6] = 150.0 * np.sin(np.pi * t), 1.0
    found = continuity_of(record(orthogonal(), t, poses))
    assert (found.breaks, found.away, found.stood) == ((), (), ())


@pytest.mark.parametrize("what", ["vibrates", "sticks"])
def test_a_cable_that_vibrates_or_sticks_a_little_follows(what: str) -> None:
    t = np.arange(1500) / 250.0
    poses = np.zeros((1500, 7))
    poses[:, 0], poses[:, 6] = 60.0 * t, 1.0
    run = record(cell(), t, poses)
    recorded = run.passes[0].recorded.copy()
    if what == "vibrates":
        recorded[:, 2] += np.rint(5.0 * np.sin(2.0 * np.pi * 25.0 * t))
    else:
        recorded[700:775, 2] -= np.rint(np.linspace(0.0, 12.0, 75))
    assert set(words(reconstruct(with_recorded(run, recorded)))) == {"ok"}


@pytest.mark.parametrize("rate_hz", [20.0, 100.0])
def test_passes_that_are_interpolated_do_not_contradict_each_other(rate_hz: float) -> None:
    data = rig_of(EIGHT).to_dict()
    for i, cable in enumerate(data["cable"]):
        cable["pass"] = 1 + i // 4
    times, poses = motion(240, rate_hz=rate_hz)
    run = record(rig_from_dict(data), times, poses)
    later = times[:-1] + 0.5 / rate_hz
    between = record(run.rig, *motion(480, rate_hz=2 * rate_hz)).passes[1].recorded[1:-1:2][: len(later)]
    shifted = replace(run.passes[1], time_s=np.concatenate([[times[0]], later]), recorded=np.vstack([run.passes[1].recorded[:1], between]))
    trajectory = reconstruct(replace(run, passes=(run.passes[0], shifted)))
    assert set(words(trajectory)[2:-2]) == {"ok"}
