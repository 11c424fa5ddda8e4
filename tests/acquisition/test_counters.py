"""A counter to which nothing happens is passed by compiled code: the same counts, state and events as looking at every step."""

from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from lmeasure.acquisition import Event
from lmeasure.acquisition.counters import counters
from lmeasure.acquisition.counters.counters import CounterState
from lmeasure.acquisition.counters.decoders import ALL_BITS, CounterField
from lmeasure.acquisition.counters.events import EventLog
from lmeasure.kernels import rests

STEPS = st.one_of(st.integers(-60, 60), st.sampled_from([190, -210, 2000, -2000, 40_000, -40_000, None]))


def follow(
    values: list[int], cuts: list[int], bits: int, later: bool, pauses: list[int]
) -> tuple[list[float], dict[str, object], list[Event]]:
    """Counts, state and events of a counter fed in pieces."""
    field = CounterField("ch1", 0x181, ALL_BITS, False, 0, bits, "little", False, 2**bits, start=values[0] // 2, scale=0.3)
    counter = CounterState(field, max_rate=200_000.0, wraps_later=later)
    events, out = EventLog(), np.empty(0)
    value = np.array(values, np.int64) % 2**bits
    time_s = np.cumsum(np.array(pauses)) * 1e-3
    for a, b in zip([0, *cuts], [*cuts, len(values)], strict=True):
        rows = np.arange(a, b)
        out = np.concatenate([out, counter.shown(counter.advance(value[a:b], time_s[a:b], rows, events))])
    return out.tolist(), {k: repr(v) for k, v in asdict(counter).items()}, events.kept


@settings(deadline=None, max_examples=150, derandomize=True)
@given(st.data())
def test_nothing_is_passed_that_looking_would_have_found(data: st.DataObject) -> None:
    values = [data.draw(st.integers(0, 70_000))]
    for step in data.draw(st.lists(STEPS, min_size=1, max_size=12)):
        values.append(0 if step is None else values[-1] + step)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(values)), max_size=4)))
    pauses = data.draw(st.lists(st.sampled_from([1, 2, 300]), min_size=len(values), max_size=len(values)))
    bits, later = data.draw(st.sampled_from([16, 17, 32])), data.draw(st.booleans())
    quick = follow(values, cuts, bits, later, pauses)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(counters, "runs_on", lambda *_: False)
        looked_at = follow(values, cuts, bits, later, pauses)
    np.testing.assert_array_equal(quick[0], looked_at[0])
    assert quick[1:] == looked_at[1:]


@settings(deadline=None, max_examples=200, derandomize=True)
@given(st.lists(st.sampled_from([0.0, 1.0, float("nan")]), max_size=30))
def test_rests_are_the_stretches_that_keep_their_count(column: list[float]) -> None:
    recorded, time_s = np.array(column), np.arange(len(column)) / 10.0
    present = [i for i, x in enumerate(column) if x == x]
    stretches: list[list[int]] = []
    for i in present:
        if stretches and column[stretches[-1][-1]] == column[i]:
            stretches[-1].append(i)
        else:
            stretches.append([i])
    want = [[s[0], s[-1]] for s in stretches if time_s[s[-1]] - time_s[s[0]] >= 0.3]
    assert rests(time_s, recorded, 0.3).tolist() == want


def test_an_absolute_code_of_zero_is_no_beginning_anew() -> None:
    """Behind a pause, or in a hurry, an encoder may come upon its code 0 from anywhere; a code just below a turn is none that it has."""
    field = CounterField("sw1", 0x187, ALL_BITS, False, 0, 32, "little", False, 4096)
    counter, events = CounterState(field, max_rate=40_960.0, wraps_later=True, codes=True), EventLog()
    values, time_s = np.array([1000, 1001, 0, 3000, 2999]), np.array([0.0, 0.01, 5.0, 9.0, 9.01])
    shown = counter.shown(counter.advance(values, time_s, np.arange(5), events))
    np.testing.assert_array_equal(shown, values)
    assert "reset" not in events.tally
    np.testing.assert_array_equal(counter.shown(np.array([-1e-17, 4095.5, 4096.25])), [0.0, 4095.5, 0.25])
