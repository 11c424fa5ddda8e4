"""Counters that go on from another origin, where the other channels alone would lose the way."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from test_slips import PATH, TIME_S, faulty, sound
from test_truth import AUTHORITY

from lmeasure.core import Status, se3
from lmeasure.procedures import explained
from lmeasure.recording import Run, read_run
from lmeasure.rig import rig_from_dict
from lmeasure.simulation import cell_rig, simulate_run
from lmeasure.trajectory import align, prepare, reconstruct
from lmeasure.trajectory.reconstruction.live import AnyChannels


def cell(number: int) -> tuple[Run, np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Return the counts of a sound run of eight drums, 4 s at 250 Hz, its times and its poses."""
    rng, time_s = np.random.default_rng([number, 1]), np.arange(0.0, 4.0, 0.004)
    data = cell_rig(int(rng.integers(1, 1000))).to_dict()
    for i, like in ((7, 1), (8, 4)):
        point = dict(data["observation_point"][like - 1])
        at = np.array(point["position_mm"]) * [-1.0, -1.0, 1.0] + rng.uniform(-150.0, 150.0, 3)
        point |= {"name": f"B{i}", "position_mm": at.tolist(), "guide_beta_deg": float(np.degrees(np.arctan2(at[0], at[1])))}
        point["guide_alpha_deg"] = float(np.degrees(np.arctan2(-at[2], np.hypot(at[0], at[1]))))
        data["observation_point"].append(point)
        used = sorted({c["to"] for c in data["cable"]})
        data["cable"].append({"name": f"c{i}", "channel": f"ch{i}", "from": f"B{i}", "to": used[i % len(used)]})
    size, way = np.repeat([0.2, 150.0], 3) * rng.uniform(0.3, 1.0, 6), rng.uniform(0.6, 1.8, (2, 6))
    swing = np.sin(way[0] * time_s[:, None]) + 0.4 * np.sin(3.0 * way[1] * time_s[:, None])
    home = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    poses = se3.displaced(home, size * swing * rng.choice([-1.0, 1.0], 6))
    return simulate_run(rig_from_dict(data), time_s, poses, noise_mm=0.0, rng=rng).run, time_s, poses


def with_fault(run: Run, channel: str, by: np.ndarray[Any, Any]) -> Run:
    counts = run.passes[0]
    recorded = counts.recorded.copy()
    recorded[:, counts.channels.index(channel)] += by
    return replace(run, passes=(replace(counts, recorded=recorded),))


@pytest.mark.parametrize(
    ("number", "channel", "size", "begin", "samples", "unsure"),
    [
        # without c3 the others tell no pose at sample 74, before it slips, and at 199, while it does
        (11, "ch3", 693, 700, 25, 0),
        (11, "ch3", 771, 198, 25, 30),
        # long before it slips they tell none, and continuity sees the slip's begin and end
        (155, "ch3", -3240, 380, 25, 30),
        # without c6 they come to another assembly at sample 870
        (66, "ch6", -4814, 703, 1, 0),
    ],
)
def test_a_counter_goes_on_though_the_others_lose_the_way(
    number: int, channel: str, size: int, begin: int, samples: int, unsure: int
) -> None:
    run, time_s, poses = cell(number)
    ramp = np.clip((np.arange(len(time_s)) - begin + 1) / samples, 0.0, 1.0)
    found = reconstruct(with_fault(run, channel, np.rint(size * ramp)))
    ok = found.status == Status.OK
    assert np.count_nonzero(~ok) <= unsure
    assert ok[begin + unsure :].all()
    restored = [str(note) for note in found.notes if "Restored from the other channels" in str(note)]
    assert len(restored) == 1
    assert f"cable c{channel[2:]} " in restored[0]
    assert float(restored[0].split(" by ")[1].split(" mm")[0]) == pytest.approx(0.012 * size, abs=0.03)
    assert not any("contradict each other" in str(note) for note in found.notes)
    error = np.linalg.norm(found.poses[ok, :3] - poses[ok, :3], axis=1)
    assert (error / np.linalg.norm(found.u[ok, :3], axis=1)).max() < 4.0


@pytest.mark.parametrize(
    ("channel", "begin", "size", "stepped", "determined"),
    [
        # off by so much that no pose is found with it before what is known of its new origin is taken off
        ("ch5", 600, 3000, 3100, "has another origin after 1.322 s, by +37.2 mm (standard uncertainty"),
        # too little to be told from what went before: it is left out to the end
        ("ch3", 900, 40, 70, "has another origin after 1.299 s, which the other channels do not determine. It is not used from there"),
    ],
)
def test_a_counter_that_slips_and_then_steps_is_restored_only_where_its_origin_is_reported(
    channel: str, begin: int, size: int, stepped: int, determined: str
) -> None:
    run = read_run(AUTHORITY / "eight-run")
    counts = run.passes[0]
    recorded, j = counts.recorded.copy(), np.arange(len(counts.time_s))
    ramp = np.where(j < 1300, size * np.clip((j - begin) / (1300 - begin), 0.0, 1.0), stepped)
    recorded[:, counts.channels.index(channel)] += np.rint(ramp).astype(recorded.dtype)
    found = reconstruct(replace(run, passes=(replace(counts, recorded=recorded),)))
    assert (found.status == Status.OK).all()
    (note,) = (str(note) for note in found.notes if "another origin" in str(note))
    assert note.startswith(f"cable c{channel[2:]} {determined}")
    whole = reconstruct(run)
    apart = np.linalg.norm(found.poses[:, :3] - whole.poses[:, :3], axis=1)
    assert (apart / np.linalg.norm(found.u[:, :3], axis=1)).max() < 4.0


def test_a_live_pose_goes_on_with_what_was_restored() -> None:
    run = faulty("ch3", np.rint(3000.0 * np.clip((np.arange(len(TIME_S)) - 600) / 25.0, 0.0, 1.0)))
    counts, n = run.passes[0], 1000
    assert np.abs(np.diff(counts.of("ch3"))).max() < run.rig.point("B3").drum.rate * 0.004
    known = replace(run, passes=(replace(counts, time_s=TIME_S[:n], recorded=counts.recorded[:n]),))
    reconstruction = prepare(align(known))
    # what slipped is no effect that a rig leaves out, and no point that moved
    assert explained(reconstruction) == ()
    way = AnyChannels(reconstruction, TIME_S[:n], counts.recorded[:n])
    assert way.last[0] == Status.OK
    steps = [way.step(t, recorded) for t, recorded in zip(TIME_S[n:], counts.recorded[n:], strict=True)]
    assert {status for status, _, _ in steps} == {Status.OK}
    whole = AnyChannels(prepare(align(sound())))
    expected = [whole.step(t, recorded)[1] for t, recorded in zip(TIME_S, sound().passes[0].recorded, strict=True)]
    # as near to the pose as that of the sound run
    apart = np.array([pose[:3] for _, pose, _ in steps]) - [pose[:3] for pose in expected[n:]]
    assert np.linalg.norm(apart, axis=1).max() < 0.01
    assert np.linalg.norm(np.array([pose[:3] for _, pose, _ in steps]) - PATH[n:, :3], axis=1).max() < 0.02
