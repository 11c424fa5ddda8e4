"""Channels that slip in runs of six drums and six swivels: what is told of them, and poses that are as good as is stated."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from test_truth import AUTHORITY

from lmeasure.core import FloatArray, Status, se3
from lmeasure.recording import Run, read_run
from lmeasure.rig import rig_from_dict
from lmeasure.simulation import simulate_run
from lmeasure.trajectory import Trajectory, covariances, reconstruct

TIME_S = np.arange(0.0, 6.0, 0.004)
WAY = np.array([0.2, -0.15, 0.25, 150.0, 120.0, -100.0])
PATH = se3.displaced(
    np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
    np.where([True, False, True, True, False, True], np.sin(0.9 * TIME_S)[:, None], np.sin(1.7 * TIME_S)[:, None]) * WAY,
)


@cache
def sound() -> Run:
    rig = read_run(AUTHORITY / "swivel-run").rig
    return simulate_run(rig, TIME_S, PATH, noise_mm=0.0, rng=np.random.default_rng(1)).run


@cache
def of_sound() -> Trajectory:
    return reconstruct(sound())


def faulty(channel: str, by: FloatArray | float, run: Run | None = None) -> Run:
    run = run or sound()
    counts = run.passes[0]
    recorded, j = counts.recorded.copy(), counts.channels.index(channel)
    recorded[:, j] += by
    if channel.startswith("sw"):
        recorded[:, j] %= 131072
    return replace(run, passes=(replace(counts, recorded=recorded),))


def stated_errors(found: Trajectory) -> FloatArray:
    """(k,) errors of the places that are `ok`, in standard uncertainties."""
    ok = found.status == 0
    return np.asarray(np.linalg.norm(found.poses[ok, :3] - PATH[ok, :3], axis=1) / np.linalg.norm(found.u[ok, :3], axis=1))


def behind(sample: int) -> FloatArray:
    return (np.arange(len(TIME_S)) >= sample).astype(float)


@pytest.mark.parametrize(("by", "known"), [(500.0, True), (20.0, False)])
def test_a_drum_that_slips_goes_on_from_a_restored_origin(by: float, known: bool) -> None:
    run = faulty("ch3", by * behind(700))
    found = reconstruct(run if known else replace(run, start=None))
    assert (found.status == 0).all()
    assert stated_errors(found).max() < 3.5
    notes = [str(note) for note in found.notes if "Restored from the other channels" in str(note)]
    assert len(notes) == 1
    assert notes[0].startswith("cable c3 ")
    size = float(notes[0].split(" by ")[1].split(" mm")[0])
    # a count is 0.012 mm of cable at the drum, and less of the free one, which no length for all places makes up for
    assert size == pytest.approx(by * 0.012, abs=0.01)
    last = str(found.cause[-1])
    assert last.startswith("restored")
    assert found.cable[-1] == "c3"
    # as good as before at the end, where the restored channel is used
    assert found.u[-1, 0] < 1.3 * of_sound().u[-1, 0]
    law = covariances(found, run if known else replace(run, start=None))
    np.testing.assert_allclose(law.random, found.random, rtol=1e-6, atol=1e-15)


def test_a_swivel_that_slips_on_its_shaft_or_sticks_is_left_out() -> None:
    found = reconstruct(faulty("sw4", 60.0 * behind(700)))
    assert (found.status == 0).all()
    assert set(found.cable[:650]) == {""}
    assert set(found.cable[720:]) == {"sw4"}
    assert stated_errors(found).max() < 3.5
    codes = sound().passes[0].of("sw2")
    stuck = np.where((np.arange(len(codes)) >= 500) & (np.arange(len(codes)) < 900), codes[500] - codes, 0.0)
    found = reconstruct(faulty("sw2", stuck))
    assert (found.status == 0).all()
    assert set(found.cable[520:890]) == {"sw2"}
    assert set(found.cable[950:]) == {""}
    assert stated_errors(found).max() < 3.5


@pytest.mark.parametrize("kind", ["stands", "hangs"])
def test_a_drum_that_stands_or_hangs_for_a_while_did_not_slip(kind: str) -> None:
    """It shows no length meanwhile, and is what it was afterwards: nobody else slipped either."""
    counts, j = sound().passes[0].of("ch6"), np.arange(len(TIME_S))
    during = (j >= 500) & (j < 780)
    by = (
        np.where(during, counts[500] - counts, 0.0)
        if kind == "stands"
        else np.where(during, np.rint(4000 * np.sin(np.pi * (j - 500) / 280)), 0)
    )
    found = reconstruct(faulty("ch6", by))
    assert (found.status == 0).all()
    assert set(found.cable) == {"", "c6"}
    assert set(found.cable[520:770]) == {"c6"}
    assert set(found.cable[:480]) == set(found.cable[900:]) == {""}
    assert not any("slipped" in str(note) or "went on" in str(note) for note in found.notes)
    assert stated_errors(found).max() < 3.5


@pytest.mark.parametrize(("channel", "codes"), [("sw3", 9000.0)])
def test_a_code_that_jumps_is_named_where_the_start_is_unknown(channel: str, codes: float) -> None:
    """It contradicts every assembly alike; what was before it tells which one it is."""
    found = reconstruct(replace(faulty(channel, codes * behind(900)), start=None))
    assert (found.status == 0).all()
    assert set(found.cable) == {"", channel}
    assert set(found.cable[910:]) == {channel}
    assert stated_errors(found).max() < 3.5


def test_a_sound_run_says_nothing() -> None:
    for found in (of_sound(), reconstruct(replace(sound(), start=None))):
        assert set(found.cable) == {""}
        assert stated_errors(found).max() < 3.0


def test_a_zero_that_nobody_knows_and_incremental_swivels() -> None:
    data = sound().rig.to_dict()
    unknown = [{k: v for k, v in s.items() if i or not k.endswith("zero_deg")} for i, s in enumerate(data["swivel"])]
    found = reconstruct(replace(sound(), rig=rig_from_dict(data | {"swivel": unknown})))
    assert (found.status == 0).all()
    assert stated_errors(found).max() < 3.5
    keys = {"absolute": False, "count_sign": -1, "counter_bits": 16}
    counting = [{k: v for k, v in s.items() if not k.endswith("zero_deg")} | keys for s in data["swivel"]]
    rig = rig_from_dict(data | {"swivel": counting})
    found = reconstruct(simulate_run(rig, TIME_S, PATH, noise_mm=0.0, rng=np.random.default_rng(2)).run)
    assert (found.status == 0).all()
    assert stated_errors(found).max() < 3.5


def test_drums_alone_are_not_searched_for_slips(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a calibration has wrong is alike in all samples, and passed for slips of sound cables (`benchmarks/faults.py --alarms`)."""

    def searched(*_: object) -> None:
        raise AssertionError("searched")

    monkeypatch.setattr("lmeasure.trajectory.origin.origins.slip", searched)
    found = reconstruct(read_run(AUTHORITY / "eight-run"))
    assert (found.status == Status.OK).all()


@pytest.mark.parametrize(("by", "samples"), [(8, 1), (500, 400)])
def test_a_drum_that_slips_little_by_little_is_left_out_meanwhile_and_goes_on(by: int, samples: int) -> None:
    """Seen at once or only by the other channels: before the slip and behind it the drum is used, and the poses are as good as stated."""
    slipping = np.rint(by * np.clip((np.arange(len(TIME_S)) - 699) / samples, 0.0, 1.0))
    found = reconstruct(faulty("ch3", slipping))
    assert (found.status == 0).all()
    assert stated_errors(found).max() < 3.5
    assert set(found.cable[:600]) == {""}
    left_out = np.array([str(cause).startswith("without it") for cause in found.cause])
    assert left_out[700 : 700 + samples].sum() >= samples - 1
    assert not left_out[700 + samples + 150 :].any()
    (note,) = (str(note) for note in found.notes if "Restored from the other channels" in str(note))
    determined = re.search(r"by \+([\d.]+) mm \(standard uncertainty ([\d.e-]+) mm\)", note)
    assert determined is not None
    assert abs(float(determined[1]) - 0.01196 * by) < 4.0 * float(determined[2]) + 0.0005 * by


def test_a_drum_that_slips_to_the_end_is_left_out_from_the_beginning_of_it() -> None:
    slipping = np.rint(200.0 * np.clip((np.arange(len(TIME_S)) - 699) / 790.0, 0.0, 1.0))
    found = reconstruct(faulty("ch3", slipping))
    assert set(found.cable[705:]) == {"c3"}
    assert set(found.cable[:650]) == {""}
    assert stated_errors(found).max() < 3.5
    assert any(re.match(r"from 2\.7\d* s to the end: cable c3 differs from the other cables", str(note)) for note in found.notes)
