"""Clocks of logs that start again, are set, or err in single stamps; SYNC as CiA 301 has it. The logs are written here, line by line."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from lmeasure.acquisition import Imported, import_logs, scan_log
from lmeasure.core import FloatArray
from lmeasure.rig import Rig, read_rig, rig_from_dict

CASES = Path(__file__).parent.parent / "authorities"
STEPS = np.array([10, -14, 30, -28, 50, -42])
"""Counts of each channel per period."""
N, PERIOD_S, DELAY_S = 300, 0.01, 2e-4
BEGIN_S = 1000.0


def rig(timing: str = "sync", bits: int = 32) -> Rig:
    data = read_rig(CASES / "sixteen-bits-one-late-stamp" / "rig.toml").to_dict()
    channels = [{"channel": f"ch{c}", "id": 0x180 + c, "bits": bits} for c in range(1, 7)]
    return rig_from_dict(data | {"can": {"decoder": "raw", "timing": timing, "channel": channels}})


def lines(timing: str = "sync", bits: int = 32, every: tuple[int, ...] = (1,) * 6, byte: bool = False) -> tuple[FloatArray, list[str]]:
    """Stamps and the rest of each line: SYNC, if there is one, and the answers behind it."""
    stamps, rest = [], []
    for k in range(N):
        at = BEGIN_S + PERIOD_S * k
        if timing == "sync":
            stamps.append(at)
            rest.append(f"080#{k % 240 + 1:02X}" if byte else "080#")
        for c in range(6):
            if k % every[c] == 0:
                value = int(STEPS[c]) * k % 2**bits
                stamps.append(at + DELAY_S * (c + 1))
                rest.append(f"{0x181 + c:03X}#{value.to_bytes(bits // 8, 'little').hex().upper()}")
    return np.array(stamps), rest


def imported(folder: Path, stamps: FloatArray, rest: list[str], of: Rig) -> Imported:
    log = folder / "drive.log"
    log.write_text("".join(f"({t:.6f}) can0 {data}\n" for t, data in zip(stamps, rest, strict=True)))
    return import_logs([log], of, None)


def reported(result: Imported) -> dict[str, int]:
    """Faults by kind, but for what gaps may hide."""
    return {kind: n for kind, n in result.logs[0].events.tally.items() if kind != "gap_step"}


def away(by: float, count: int = 1, sample: int = 100) -> Callable[[FloatArray, int], FloatArray]:
    def law(stamps: FloatArray, per: int) -> FloatArray:
        return stamps + by * ((np.arange(len(stamps)) >= sample * per) & (np.arange(len(stamps)) < sample * per + count))

    return law


def started_again(modulus: float) -> Callable[[FloatArray, int], FloatArray]:
    return lambda stamps, per: (stamps - BEGIN_S + modulus - 1.5) % modulus


LAWS: dict[str, tuple[Callable[[FloatArray, int], FloatArray], str]] = {
    "2^32 us": (started_again(2**32 / 1e6), "clock_wrap"),
    "60 s": (started_again(60.0), "clock_wrap"),
    "2^16 ms": (started_again(65.536), "clock_wrap"),
    "1 h": (started_again(3600.0), "clock_wrap"),
    "set back": (away(-47.3, 10**9), "time"),
    "set back by 20 periods": (away(-0.2, 10**9), "time"),
    "set forward": (away(3600.0, 10**9), "time"),
    "set forward by 50 periods": (away(0.5, 10**9), "time"),
    "one stamp ahead": (away(6.2), "stamp"),
    "one stamp behind": (away(-6.2), "stamp"),
    "a sample ahead": (away(6.2, 7), "stamp"),
    "the first stamp is none": (away(-BEGIN_S, 1, 0), "stamp"),
    "the first stamp is ahead": (away(77.0, 1, 0), "stamp"),
}


@pytest.mark.parametrize("timing", ["sync", "free"])
@pytest.mark.parametrize("name", LAWS)
def test_time_goes_on(tmp_path: Path, name: str, timing: str) -> None:
    """Whatever the clock did, samples are a period apart and no count is lost."""
    law, kind = LAWS[name]
    stamps, rest = lines(timing, 16)
    result = imported(tmp_path, law(stamps, len(stamps) // N), rest, rig(timing, 16))
    counts = result.run.passes[0]
    np.testing.assert_allclose(counts.time_s, PERIOD_S * np.arange(N), rtol=0, atol=2e-6)
    np.testing.assert_allclose(counts.of("ch1"), 10.0 * np.arange(N), rtol=0, atol=1e-2)
    # by their own timers, the others are read behind the first channel, and not before its first sample
    assert int(np.isnan(counts.recorded).sum()) == (0 if timing == "sync" else 5)
    assert {k: n for k, n in reported(result).items() if k != "gap"} == {kind: 1}


@pytest.mark.parametrize("timing", ["sync", "free"])
@pytest.mark.parametrize(("first", "second"), [(40, 40), (300, 300), (20, 300)])
def test_blocks_that_a_logger_exchanged_are_put_back(tmp_path: Path, timing: str, first: int, second: int) -> None:
    stamps, rest = lines(timing)
    order = np.arange(len(stamps))
    at = 100 * len(stamps) // N
    order[at : at + first + second] = np.r_[order[at + first : at + first + second], order[at : at + first]]
    result = imported(tmp_path, stamps[order], [rest[i] for i in order], rig(timing))
    counts = result.run.passes[0]
    np.testing.assert_allclose(counts.time_s, PERIOD_S * np.arange(N), rtol=0, atol=2e-6)
    late = 0.0 if timing == "sync" else 4.0
    np.testing.assert_allclose(counts.of("ch5")[1:], 50.0 * np.arange(1, N) - late, rtol=0, atol=0.1)
    assert reported(result)["reordered"] == 1


@pytest.mark.parametrize("timing", ["sync", "free"])
@pytest.mark.parametrize("late_s", [0.015, 0.15, 0.9])
def test_late_stamps_are_no_wraps(tmp_path: Path, timing: str, late_s: float) -> None:
    """Frames that come together when a busy host gets round to them; counters of 16 bits pass half their range in 20 ms at 20 m/s."""
    stamps, rest = lines(timing, 16)
    free = BEGIN_S + 1.0 + late_s
    held = (stamps >= BEGIN_S + 1.0) & (stamps < free)
    stamps[held] = free + 1e-6 * np.arange(held.sum())
    result = imported(tmp_path, np.maximum.accumulate(stamps), rest, rig(timing, 16))
    assert not {"lost_wrap", "jump", "time", "stamp", "pause"} & set(reported(result))
    if timing == "sync":
        np.testing.assert_array_equal(result.run.passes[0].recorded, np.multiply.outer(np.arange(N), STEPS))


def test_a_silent_channel_of_sixteen_bits_goes_on_where_the_others_prove_it(tmp_path: Path) -> None:
    """ch3 is silent for 1.5 s; the other cables move by centimetres at most. Where they move by metres, it is not known."""
    stamps, rest = lines("sync", 16)
    heard = ~(np.array([r.startswith("183#") for r in rest]) & (stamps > BEGIN_S + 1.0) & (stamps < BEGIN_S + 2.5))
    result = imported(tmp_path, stamps[heard], [r for r, h in zip(rest, heard, strict=True) if h], rig("sync", 16))
    counts = result.run.passes[0].of("ch3")
    there = np.isfinite(counts)
    assert 145 <= (~there).sum() <= 155
    np.testing.assert_array_equal(counts[there], 30.0 * np.arange(N)[there])
    assert set(reported(result)) == {"gap"}


def test_a_pause_in_which_counters_may_have_wrapped_is_said(tmp_path: Path) -> None:
    """Two seconds without SYNC while the tool moved."""
    stamps, rest = lines("sync", 16)
    kept = (stamps < BEGIN_S + 0.5) | (stamps > BEGIN_S + 2.495)
    result = imported(tmp_path, stamps[kept], [r for r, k in zip(rest, kept, strict=True) if k], rig("sync", 16))
    assert reported(result) == {"pause": 1, "lost_wrap": 6}
    texts = {e.kind: e.text for e in result.logs[0].events.kept}
    assert texts["pause"] == "no SYNC for 2.01 s"
    assert texts["lost_wrap"].endswith("units are possible: its range is 65536")
    assert np.isnan(result.run.passes[0].recorded[60:]).all()
    # at rest nothing can have happened
    still = [r if r == "080#" else f"{r[:4]}0000" for r in rest]
    result = imported(tmp_path, stamps[kept], [r for r, k in zip(still, kept, strict=True) if k], rig("sync", 16))
    assert reported(result) == {"pause": 1}


@pytest.mark.parametrize("byte", [False, True])
@pytest.mark.parametrize("every", [(1,) * 6, (5,) * 6, (1, 1, 1, 1, 1, 4), (2, 3, 2, 3, 6, 1), (60,) * 6])
def test_every_nth_sync_is_no_gap(tmp_path: Path, every: tuple[int, ...], byte: bool) -> None:
    stamps, rest = lines(every=every, byte=byte)
    result = imported(tmp_path, stamps, rest, rig())
    counts = result.run.passes[0]
    answered = np.arange(0, N, np.lcm.reduce(every))
    np.testing.assert_allclose(counts.time_s, PERIOD_S * answered, rtol=0, atol=2e-6)
    np.testing.assert_array_equal(counts.recorded, np.multiply.outer(answered, STEPS))
    slow = sum(n > 1 for n in every)
    assert reported(result) == ({"unanswered": slow} if slow else {})
    said = {n: f"answers every {n}{ {2: 'nd', 3: 'rd'}.get(n, 'th') } SYNC" for n in every if n > 1}
    assert {e.text for e in result.logs[0].events.kept} == set(said.values())


def test_gaps_of_channels_that_answer_every_fifth_sync(tmp_path: Path) -> None:
    """One frame is lost, one comes behind the next SYNC."""
    stamps, rest = lines(every=(5,) * 6)
    of_two = [i for i, r in enumerate(rest) if r.startswith("182#")]
    late = of_two[30]
    order = [i for i in range(len(rest)) if i not in (of_two[20], late)]
    order.insert(order.index(late + 5) + 1, late)  # its four fellows, and the SYNC
    stamps = np.maximum.accumulate(stamps[order])
    result = imported(tmp_path, stamps, [rest[i] for i in order], rig())
    expected = np.multiply.outer(np.arange(0.0, N, 5.0), STEPS)
    expected[20, 1] = np.nan
    np.testing.assert_array_equal(result.run.passes[0].recorded, expected)
    assert reported(result) == {"unanswered": 6, "gap": 1, "reordered": 1}


@pytest.mark.parametrize(("every", "byte"), [(1, True), (5, False), (5, True), (1, False)])
def test_a_scan_finds_the_sync_and_which_of_them_are_answered(tmp_path: Path, every: int, byte: bool) -> None:
    stamps, rest = lines(every=(every,) * 6, byte=byte)
    waves = np.rint(2e4 * np.sin(0.03 * np.arange(N)))
    k = np.searchsorted(BEGIN_S + PERIOD_S * np.arange(N), stamps + 1e-9) - 1
    rest = [
        r if r[:3] == "080" else f"{r[:4]}{int(waves[i]).to_bytes(4, 'little', signed=True).hex()}" for r, i in zip(rest, k, strict=True)
    ]
    (tmp_path / "drive.log").write_text("".join(f"({t:.6f}) can0 {data}\n" for t, data in zip(stamps, rest, strict=True)))
    scan = scan_log(tmp_path / "drive.log")
    assert scan.table()[2:4] == ['timing = "sync"', "sync_id = 0x80"]
    assert sum("# answers every 5th SYNC" in line for line in scan.table()) == (6 if every == 5 else 0)
    assert sum(line.strip() == "answers every 5th SYNC" for line in scan.lines()) == (6 if every == 5 else 0)


def test_encoders_with_timers_of_their_own_answer_no_sync(tmp_path: Path) -> None:
    """Their delays behind a frame of one byte drift over its whole period."""
    stamps, rest = lines(byte=True)
    own = np.array([r[:3] != "080" for r in rest])
    stamps[own] = BEGIN_S + (stamps[own] - BEGIN_S) * 1.004
    order = np.argsort(stamps, kind="stable")
    (tmp_path / "drive.log").write_text("".join(f"({stamps[i]:.6f}) can0 {rest[i]}\n" for i in order))
    scan = scan_log(tmp_path / "drive.log")
    assert scan.sync is None


def test_the_cases_that_were_reported() -> None:
    late = CASES / "sixteen-bits-one-late-stamp"
    result = import_logs([late / "late.log"], read_rig(late / "rig.toml"), None)
    np.testing.assert_array_equal(result.run.passes[0].of("ch1"), 10.0 * np.arange(40))
    assert reported(result) == {}
    wraps = CASES / "free-clock-wraps"
    result = import_logs([wraps / "gvret.csv"], read_rig(wraps / "rig.toml"), None)
    counts = result.run.passes[0]
    np.testing.assert_allclose(counts.time_s, 0.01 * np.arange(400), rtol=0, atol=1e-6)
    np.testing.assert_array_equal(counts.of("ch1"), 10.0 * np.arange(400))
    assert reported(result) == {"clock_wrap": 1, "gap": 5}
    scan = scan_log(CASES / "scan-sync-with-counter" / "sync.log")
    table = scan.table()
    assert table[2:4] == ['timing = "sync"', "sync_id = 0x80"]
