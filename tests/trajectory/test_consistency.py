"""Which channel of several is found wrong, from when to when, and what is said of it: by hand, of channels that read one number.

Each of m channels reads the same x: the best x is the mean weighed by 1/u^2, chi-squared the weighed sum of squares about it, and the
error of one alone its reading less the mean of the others.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2
from test_truth import AUTHORITY

from lmeasure.core import BoolArray, FloatArray, Status
from lmeasure.rig import read_rig
from lmeasure.sensors.stated_errors import BAND
from lmeasure.text import Message, message
from lmeasure.trajectory import Epochs, collect_epochs
from lmeasure.trajectory.faults import consistency
from lmeasure.trajectory.faults.consistency import Consistency, EpochFinder, RunSamples, consistent
from lmeasure.trajectory.faults.continuity import EVERY, NONE, Doubt, Doubts
from lmeasure.trajectory.faults.redundancy import ChanceOfContradiction, Parities

U = 0.01
"""Standard uncertainty of a reading [mm]."""
N = 400
TIME = np.arange(N) / 100.0


class Readings:
    """Channels that read the same number, as `Redundancy` tells of them. u (m,); law: of the chance of contradictions, the normal one by
    default; scripted: chi-squared of all together and of each, by the channels that are used."""

    def __init__(self, u: Sequence[float], *, unknowns: int = 1) -> None:
        self.free, self.u = np.arange(unknowns), np.array(u)
        self.requested: list[tuple[bool, ...]] = []
        self.at: list[int] = []
        self.law: Callable[[FloatArray, int], FloatArray] = lambda q, freedom: np.asarray(chi2.logsf(q, freedom))
        self.scripted: dict[tuple[int, ...], tuple[float, float]] = {}

    def solve(self, change_mm: FloatArray) -> FloatArray:
        used = np.isfinite(change_mm)
        weights = np.where(used, 1.0 / self.u**2, 0.0)
        poses = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (len(change_mm), 1))
        with np.errstate(invalid="ignore"):
            poses[:, 0] = (weights * np.where(used, change_mm, 0.0)).sum(axis=1) / weights.sum(axis=1)
        poses[np.isnan(poses[:, 0])] = np.nan
        return poses

    def parities(self, epochs: Epochs, poses: FloatArray, used: BoolArray | None = None) -> Parities:
        used = np.isfinite(epochs.change_mm) if used is None else used
        used = used & np.isfinite(poses[:, :1])
        weight = np.zeros((*used.shape, used.shape[1]))
        for i, mine in enumerate(used):
            p = np.where(mine, 1.0 / self.u**2, 0.0)
            weight[i] = np.diag(p) - np.outer(p, p) / max(p.sum(), 1e-300) if mine.sum() > len(self.free) else 0.0
        residual = np.where(used, epochs.gone_on_mm - poses[:, :1], 0.0)
        return Parities(residual, used, weight, np.maximum(used.sum(axis=1) - len(self.free), 0))

    def chance(self, epochs: Epochs, poses: FloatArray, used: BoolArray) -> ChanceOfContradiction:
        assert len(epochs) == len(poses)
        self.requested.append(tuple(used.tolist()))
        self.at.append(len(epochs))
        q = np.linspace(0.0, 200.0, 20001)
        return ChanceOfContradiction(q, self.law(q, int(used.sum()) - len(self.free)))

    def jointly(self, epochs: Epochs, poses: FloatArray, used: BoolArray) -> tuple[float, FloatArray, int]:
        found = self.parities(epochs, poses, used).chi_squared
        freedom = int(used[0].sum()) - len(self.free)
        determined = self.scripted.get(tuple(np.flatnonzero(used[0]).tolist()))
        return (float(found.sum()), found, freedom) if determined is None else (determined[0], np.full(len(epochs), determined[1]), freedom)


def epochs_of(errors: FloatArray) -> Epochs:
    change = 50.0 * np.sin(TIME[: len(errors), None]) + errors
    return Epochs(TIME[: len(errors)], change, change.copy(), change / 0.012, np.zeros_like(change), np.full_like(change, U**2), None, None)


def with_errors(*wrong: tuple[int, int, int, float], channels: int = 4, n: int = N) -> Epochs:
    """Channel, first epoch, the one behind the last and the error [mm] of each."""
    errors = np.zeros((n, channels))
    for j, begin, end, by in wrong:
        errors[begin:end, j] += by
    return epochs_of(errors)


RIG = read_rig(AUTHORITY / "swivel-run" / "rig.toml")
"""Six cables, then encoders."""


def judged(
    epochs: Epochs, readings: Readings | None = None, *, before: Doubts = NONE, samples: int = N, observed: Any = RIG.observed
) -> Doubts:
    readings = readings or Readings([U] * epochs.change_mm.shape[1])
    rig: Any = SimpleNamespace(observed=observed)
    one: Any = readings
    return Consistency(rig, one, readings.solve, epochs, samples=samples).judged(before)


def spans_of(found: Doubts) -> list[tuple[int, float, float, str]]:
    assert all(d.status == Status.INCONSISTENT for d in found.every)
    return [(d.cable, d.after_s, d.until_s, d.said.code) for d in found.every]


def alarm_at(chi_squared: float, at: Sequence[int] = (200,), channels: int = 4) -> Epochs:
    """One channel errs so much at these epochs that chi-squared is that: of m readings it is (m - 1)/m (e/u)^2."""
    errors = np.zeros((N, channels))
    errors[list(at), 2] = U * np.sqrt(chi_squared * channels / (channels - 1))
    return epochs_of(errors)


def test_sound_channels_are_in_no_doubt() -> None:
    before = Doubts((Doubt(1, 0.5, 0.6, Status.GAP, message("contradiction")),), (message("rig.uncalibrated"),))
    found = judged(with_errors(), before=before)
    assert (found.every, found.notes) == (before.every, before.notes)


def test_one_that_errs_is_left_out_as_long_as_it_does_and_by_how_much() -> None:
    epochs = with_errors((2, 100, 200, 0.2), (2, 140, 141, -0.45))
    found = judged(epochs)
    assert spans_of(found) == [(2, 0.99, 1.99, "cable.left_out")]
    # at most, whatever its sign; of four the mean of the three others
    assert found.every[0].said.values == pytest.approx({"mm": -0.25, "u_mm": U * np.sqrt(4.0 / 3.0)})
    assert str(found.every[0].said).startswith("differs from the other cables by up to -0.25 mm (standard uncertainty")
    assert [n.code for n in found.notes] == ["cables.left_out"]
    name = RIG.cable[2].name
    assert str(found.notes[0]).startswith(
        f"from 0.99 s to 1.99 s: cable {name} differs from the other cables by up to -0.25 mm (standard uncertainty"
    )
    # not used any more, what it showed is kept
    assert np.isnan(epochs.change_mm[100:200, 2]).all()
    assert np.isfinite(np.delete(epochs.change_mm, 2, axis=1)).all()
    assert np.isfinite(epochs.change_mm[np.r_[:100, 200:N], 2]).all()
    assert np.isfinite(epochs.gone_on_mm).all()


def test_errors_at_the_beginning_and_at_the_end_have_no_bounds() -> None:
    found = judged(with_errors((1, 0, 60, 0.2)))
    assert spans_of(found) == [(1, -np.inf, 0.59, "cable.left_out")]
    assert str(found.notes[0]).startswith("from the beginning to 0.59 s: ")
    found = judged(with_errors((1, 300, N, 0.2)))
    assert spans_of(found) == [(1, 2.99, np.inf, "cable.left_out")]
    assert str(found.notes[0]).startswith("from 2.99 s to the end: ")
    # one epoch before the end, and one behind the beginning
    assert spans_of(judged(with_errors((1, 1, 60, 0.2)))) == [(1, 0.0, 0.59, "cable.left_out")]
    assert spans_of(judged(with_errors((1, 300, N - 1, 0.2))))[0][1:3] == (2.99, 3.98)
    assert spans_of(judged(with_errors((1, 300, 380, 0.2))))[0][1:3] == (2.99, 3.79)


@pytest.mark.parametrize("samples", [N, 10 * N, 0])
def test_an_alarm_is_one_that_a_sound_run_has_once_in_a_thousand(samples: int) -> None:
    limit = chi2.isf(1e-3 / max(samples, 1), 3)
    assert not judged(alarm_at(limit * 0.999), samples=samples).every
    assert judged(alarm_at(limit * 1.001), samples=samples).every


def test_the_law_of_rounding_is_worked_out_where_the_normal_law_hardly_allows_what_is_seen() -> None:
    """Once for all channels that are used together, from the first epoch that uses them."""
    for chance, requested in ((0.051, 0), (0.049, 1)):
        readings = Readings([U] * 4)
        judged(alarm_at(chi2.isf(chance, 3)), readings)
        assert len(readings.requested) == requested
    readings = Readings([U] * 4)
    # with a law that ends early, what the normal law would let pass is an alarm
    readings.law = lambda q, freedom: np.asarray(-4.0 * q)
    assert judged(alarm_at(chi2.isf(0.049, 3)), readings).every
    readings = Readings([U] * 4)
    epochs = with_errors((2, 100, 130, 0.2), (2, 200, 230, 0.2))
    epochs.change_mm[:50, 3] = np.nan
    judged(epochs, readings)
    assert readings.requested.count((True,) * 4) == 1
    assert readings.at[readings.requested.index((True,) * 4)] == N - 50


def test_what_is_used_by_fewer_channels_has_fewer_degrees_of_freedom() -> None:
    epochs = with_errors((2, 100, 130, U * np.sqrt(1.5 * 1.001 * chi2.isf(1e-3 / N, 2))))
    epochs.change_mm[50:250, 3] = np.nan
    # of three readings two degrees, so that this is just an alarm, and is said of the channels that are there
    assert spans_of(judged(epochs)) == [(2, 0.99, 1.29, "cable.left_out")]
    epochs = with_errors((2, 100, 130, 0.2))
    epochs.change_mm[90:250, [0, 3]] = np.nan
    # of two nobody knows which
    found = judged(epochs)
    assert [(d[0], d[3]) for d in spans_of(found)] == [(EVERY, "contradiction.among")]
    names = [RIG.cable[j].name for j in (1, 2)]
    assert found.every[0].said.values == {"cables": " or ".join(names)}
    assert str(found.notes[0]).endswith(f": the cables contradict each other. One of {names[0]} or {names[1]} is wrong")
    epochs = with_errors((2, 100, 130, 0.2))
    epochs.change_mm[90:250, [0, 1, 3]] = np.nan
    assert not judged(epochs).every


def test_two_at_once_are_both_left_out_each_by_what_the_rest_tells() -> None:
    found = judged(with_errors((1, 100, 200, 0.2), (3, 100, 200, -0.3), channels=5))
    assert spans_of(found) == [(1, 0.99, 1.99, "cable.left_out"), (3, 0.99, 1.99, "cable.left_out")]
    for doubt, by in zip(found.every, (0.2, -0.3), strict=True):
        assert doubt.said.values == pytest.approx({"mm": by, "u_mm": U * np.sqrt(4.0 / 3.0)})
    assert [n.code for n in found.notes] == ["cables.left_out"] * 2
    assert [n.values["cable"] for n in found.notes] == [RIG.cable[1].name, RIG.cable[3].name]


def test_two_pairs_that_agree_among_themselves_tell_of_none_which_is_wrong() -> None:
    epochs = with_errors((0, 100, 200, 0.2), (1, 100, 200, 0.2))
    found = judged(epochs)
    assert spans_of(found) == [(EVERY, 0.99, 1.99, "contradiction")]
    assert str(found.notes[0]) == "from 0.99 s to 1.99 s: the cables contradict each other. The wrong one cannot be determined"
    # settled, and not left out
    assert np.isfinite(epochs.change_mm).all()


def test_all_that_contradict_each_other_are_explained_by_none_for_the_whole_run() -> None:
    found = judged(with_errors((0, 100, 200, 0.2), (1, 100, 200, 0.5), (2, 100, 200, -0.4)))
    assert spans_of(found) == [(EVERY, -np.inf, np.inf, "contradiction.none")]
    assert str(found.notes[0]) == "from the beginning to the end: the cables contradict each other, and no single cable explains it"


@pytest.mark.parametrize("length", [1, 20])
@pytest.mark.parametrize(("gap", "codes"), [(128, ["contradiction.none"]), (129, ["cable.left_out"] * 3)])
def test_where_none_explains_all_alarms_they_are_explained_one_cluster_after_the_other(gap: int, codes: list[str], length: int) -> None:
    """Those that more than a second without an alarm lies between; of three readings two that err at different times are one too many."""
    begins = [50 + k * (length - 1 + gap) for k in range(3)]
    wrong = with_errors(*((j, b, b + length, 0.2) for j, b in zip((1, 2, 0), begins, strict=True)), channels=3)
    times = np.arange(N) / 128.0  # whose differences are exact
    found = judged(replace(wrong, time_s=times))
    assert [d[3] for d in spans_of(found)] == codes
    if len(codes) == 3:
        expected = [(j, times[b - 1], times[b + length - 1]) for j, b in zip((1, 2, 0), begins, strict=True)]
        assert [d[:3] for d in spans_of(found)] == expected


def test_two_that_err_at_different_times_are_each_left_out_at_their_own() -> None:
    found = judged(with_errors((1, 100, 120, 0.2), (2, 130, 150, 0.3), channels=5))
    assert spans_of(found) == [(1, 0.99, 1.19, "cable.left_out"), (2, 1.29, 1.49, "cable.left_out")]
    # and where both err, both
    found = judged(with_errors((1, 100, 120, 0.2), (2, 110, 150, 0.3), channels=5))
    assert spans_of(found) == [(1, 0.99, 1.19, "cable.left_out"), (2, 1.09, 1.49, "cable.left_out")]


def scripted(chances: dict[int, float], *, alone: bool = False, rounded: dict[int, float] | None = None) -> Doubts:
    """Of an alarm of three channels, where the chance of what is left without one is that: twice the smaller of all epochs together
    and of the worst of them; rounded: the same by the law of rounding."""
    readings = Readings([U] * 3)
    left = {j: float(chi2.isf(chances.get(j, 1e-9) / 2.0, 1)) for j in range(3)}
    for j, chi in left.items():
        readings.scripted[tuple(k for k in range(3) if k != j)] = (0.0, chi) if alone else (chi, 0.0)
    if rounded is not None:
        order = sorted(rounded, key=lambda j: left[j])
        determined = [left[j] for j in order], [np.log(rounded[j] / 2.0) for j in order]
        readings.law = lambda q, freedom: np.asarray(chi2.logsf(q, freedom) if freedom == 2 else np.interp(q, *determined))
    return judged(alarm_at(30.0, channels=3), readings)


def explained(found: Doubts) -> list[int]:
    """Channels that the first doubt is about."""
    first = found.every[0]
    if first.cable != EVERY:
        return [first.cable]
    names = [o.name for o in RIG.observed]
    return [names.index(n) for n in first.said.values["cables"].split(" or ")] if "cables" in first.said.values else []


@pytest.mark.parametrize("alone", [False, True])
def test_an_explanation_is_one_that_is_not_refuted(alone: bool) -> None:
    """At 1e-3 where it is one of several, at 1e-6 where no other stands."""
    assert explained(scripted({1: 0.5, 2: 0.9e-3}, alone=alone)) == [1]
    assert explained(scripted({1: 0.5, 2: 1.1e-3}, alone=alone)) == [1, 2]
    assert explained(scripted({1: 1.1e-6}, alone=alone)) == [1]
    assert explained(scripted({1: 1.2e-6, 2: 1.1e-6}, alone=alone)) == [1, 2]
    assert explained(scripted({1: 1.1e-6, 2: 0.9e-6}, alone=alone)) == [1]
    assert scripted({1: 0.9e-6}, alone=alone).every[0].said.code in ("contradiction.none",)


def test_of_several_that_stand_the_law_of_rounding_decides() -> None:
    """It is above the normal law nowhere, and takes longer: where only one stands it is not asked."""
    assert explained(scripted({1: 0.5, 2: 0.1}, alone=True, rounded={1: 0.5, 2: 1e-4})) == [1]
    assert explained(scripted({1: 0.5, 2: 0.1}, alone=True, rounded={1: 1e-4, 2: 1e-4})) == [1, 2]
    assert explained(scripted({1: 0.5}, alone=True, rounded={1: 1e-8})) == [1]


def test_the_worst_of_many_epochs_is_one_of_as_many() -> None:
    """Bonferroni: at n epochs the smallest of n chances is as small n times as often; and all together have as many degrees of freedom."""
    n = 12
    for chance, found in ((1.1e-3, [1, 2]), (0.9e-3, [1])):
        for of_all in (False, True):
            readings = Readings([U] * 3)
            chi = float(chi2.isf(chance / 2.0, n)) if of_all else float(chi2.isf(chance / 2.0 / n, 1))
            readings.scripted = {(0, 2): (0.0, 0.0), (0, 1): (chi, 0.0) if of_all else (0.0, chi), (1, 2): (1e6, 1e6)}
            assert explained(judged(alarm_at(30.0, at=range(200, 200 + n), channels=3), readings)) == found


def test_forty_alarms_judge_the_strongest_and_some_spread_over_the_run() -> None:
    chosen: list[FloatArray] = []

    class Noted(Readings):
        def jointly(self, epochs: Epochs, poses: FloatArray, used: BoolArray) -> tuple[float, FloatArray, int]:
            chosen.append(epochs.time_s)
            return super().jointly(epochs, poses, used)

    epochs = with_errors((2, 40, 361, 0.2), (2, 301, 316, 0.1), (2, 50, 55, 0.1))
    judged(epochs, Noted([U] * 4))
    expected = set(range(301, 316)) | set(range(50, 55)) | set(np.linspace(40, 360, 20).round().astype(int).tolist())
    assert set(np.round(chosen[0] * 100.0).astype(int).tolist()) == expected


def test_explanations_are_judged_where_the_most_channels_are_used() -> None:
    """Others cannot be compared; those of which a channel was missing come after."""
    epochs = with_errors((2, 100, 200, 0.2))
    epochs.change_mm[100:150, 0] = np.nan
    found = judged(epochs)
    assert spans_of(found) == [(2, 0.99, 1.99, "cable.left_out")]


def test_where_the_others_lose_the_way_a_channel_is_left_out_from_the_alarms_on() -> None:
    """Without the first channel in the first half second the others tell nothing of the whole run."""

    class Led(Readings):
        def solve(self, change_mm: FloatArray) -> FloatArray:
            poses, used = super().solve(change_mm), np.isfinite(change_mm)
            poses[:, 1] = used.all(axis=1)
            return poses if used[:50, 0].all() else np.full_like(poses, np.nan)

        def jointly(self, epochs: Epochs, poses: FloatArray, used: BoolArray) -> tuple[float, FloatArray, int]:
            together, each, freedom = super().jointly(epochs, poses, used)
            return together + 1e3 * float(poses[:, 1].sum()), each, freedom

    found = judged(with_errors((0, 100, 150, 0.2)), Led([U] * 4))
    assert spans_of(found) == [(0, 0.99, 1.49, "cable.left_out")]
    assert found.every[0].said.values["mm"] == pytest.approx(0.2)


def test_a_run_is_followed_from_its_beginning_to_its_alarms(monkeypatch: pytest.MonkeyPatch) -> None:
    """Epoch by epoch, or by so many of them, evenly spread."""

    def seen(most: int) -> list[list[int]]:
        monkeypatch.setattr(consistency, "ON_THE_WAY", most)
        out = []

        class Noted(Readings):
            def solve(self, change_mm: FloatArray) -> FloatArray:
                out.append(np.round(100.0 * np.arcsin(np.nanmin(change_mm, axis=1) / 50.0)).astype(int).tolist())
                return super().solve(change_mm)

        errors = np.zeros((150, 4))
        errors[101, 2] = 0.2
        judged(epochs_of(errors), Noted([U] * 4))
        return out[1:6:4]

    assert seen(2000) == [list(range(102)), list(range(102))]
    assert seen(102)[0] == list(range(102))
    assert seen(5)[0] == [0, 25, 50, 76, 101]


@pytest.mark.parametrize("lost", [[0], [0, 1, 2, 3]])
def test_without_a_way_an_explanation_is_tested_where_the_best_one_leads_or_all_together(lost: list[int]) -> None:
    """Poses tell in their second coordinate without which channel they are; what is left without the first agrees nowhere else."""

    class Led(Readings):
        def solve(self, change_mm: FloatArray) -> FloatArray:
            poses, used = super().solve(change_mm), np.isfinite(change_mm)
            poses[:, 1] = np.where(used.all(axis=1), 0.0, 1.0 + np.argmin(used, axis=1))
            if not used.all() and int(np.argmin(used.all(axis=0))) in lost:
                poses[:] = np.nan
            return poses

        def jointly(self, epochs: Epochs, poses: FloatArray, used: BoolArray) -> tuple[float, FloatArray, int]:
            _, each, freedom = super().jointly(epochs, poses, used)
            chances: dict[tuple[int, ...], float] = {
                (1, 2, 3): 0.5 if (poses[:, 1] == (0.0 if len(lost) > 1 else 3.0)).all() else 1e-30,
                (0, 1, 3): 1e-8,
            }
            chance = chances.get(tuple(np.flatnonzero(used[0]).tolist()), 1e-9)
            return float(chi2.isf(chance / 2.0, freedom * len(each))), np.zeros(len(each)), freedom

    assert explained(judged(alarm_at(40.0), Led([U] * 4))) == [0]


def test_an_encoder_errs_in_degrees() -> None:
    encoder = next(o for o in RIG.observed[6:])
    observed = (*RIG.cable[:2], encoder, RIG.cable[3])
    found = judged(with_errors((2, 100, 200, 0.2)), observed=observed)
    assert found.every[0].said.code == "encoder.left_out"
    u = U * np.sqrt(4.0 / 3.0)
    assert found.every[0].said.values == pytest.approx({"deg": np.degrees(0.2), "u_deg": np.degrees(u)})
    (note,) = found.notes
    assert note.code == "channel.left_out"
    assert note.values["said"] == found.every[0].said
    assert note.values["what"].values == {"name": encoder.name}
    assert str(note).startswith("from 0.99 s to 1.99 s: ")


def test_one_that_nothing_controls_is_left_out_without_a_size() -> None:
    class Blind(Readings):
        def parities(self, epochs: Epochs, poses: FloatArray, used: BoolArray | None = None) -> Parities:
            found = super().parities(epochs, poses, used)
            # of sizes alone, which are asked for with what is used
            return (
                found
                if used is None or used.shape != (N, 4)
                else SimpleNamespace(  # type: ignore[return-value]
                    errors=(np.zeros((N, 4)), np.full((N, 4), np.inf)), chi_squared=found.chi_squared, freedom=found.freedom
                )
            )

    found = judged(with_errors((2, 100, 200, 0.2)), Blind([U] * 4))
    assert spans_of(found) == [(2, -np.inf, np.inf, "cable.left_out.unknown")]
    assert [n.code for n in found.notes] == ["cables.left_out.unknown"]


def test_doubts_are_in_order_of_time_and_of_channels() -> None:
    before = Doubts(
        (Doubt(3, 3.5, 3.6, Status.GAP, message("contradiction")), Doubt(0, 0.99, 1.0, Status.JUMP, message("contradiction.none")))
    )
    found = judged(with_errors((2, 100, 120, 0.2), (2, 250, 270, 0.2)), before=before)
    assert [(d.cable, d.after_s) for d in found.every] == [(0, 0.99), (2, 0.99), (2, 2.49), (3, 3.5)]
    # what was in doubt before is said already
    assert [n.values["begin"].values["s"] for n in found.notes] == [0.99, 2.49]


def lost_origin(by_mm: float, u: Sequence[float] = (U,) * 4, *, settled: bool = False) -> tuple[Doubts, Epochs, Doubts]:
    """Of a channel that went on by so much off, from 2 s on."""
    epochs = with_errors((1, 201, N, by_mm))
    epochs.change_mm[201:, 1] = np.nan
    if settled:
        epochs.gone_on_mm[201:, 1] = np.nan
    said = message("rig.uncalibrated")
    doubt = Doubt(1, 2.0, np.inf, Status.ORIGIN_LOST, said)
    determined = message("channels.contradict", what=said, begin=1, end=2, said="x")
    before = Doubts((doubt,), (said, message("passes.not_repeated"), determined))
    return judged(epochs, Readings(u), before=before), epochs, before


def test_an_origin_that_the_others_show_to_be_right_is_used_again() -> None:
    found, epochs, before = lost_origin(0.01)
    assert found.every == ()
    said = before.every[0].said
    assert [n.code for n in found.notes] == ["passes.not_repeated", "origin.shown"]
    assert found.notes[1].values == {"what": said}
    np.testing.assert_array_equal(epochs.change_mm[201:, 1], epochs.gone_on_mm[201:, 1])
    # of four equal readings the uncertainty of one against the others is 2/sqrt(3) times its own: half of five of them, no more
    most = 2.5 * U * np.sqrt(4.0 / 3.0)
    assert not lost_origin(0.999 * most)[0].every
    found, epochs, before = lost_origin(1.001 * most)
    assert (found.every, found.notes) == (before.every, before.notes)
    assert np.isnan(epochs.change_mm[201:, 1]).all()
    assert not lost_origin(-0.999 * most)[0].every
    assert lost_origin(-1.001 * most)[0].every


def test_an_origin_that_hardly_anything_shows_is_not_proved() -> None:
    """Up to 0.05 mm."""
    one = 0.05 / np.sqrt(4.0 / 3.0)
    assert not lost_origin(0.0, [0.999 * one] * 4)[0].every
    assert lost_origin(0.0, [1.001 * one] * 4)[0].every
    assert lost_origin(0.0, settled=True)[0].every


def test_an_origin_is_proved_only_by_a_channel_that_agrees_everywhere() -> None:
    """Five standard uncertainties anywhere, half of that where it is known best."""

    def found(factor: float) -> tuple[Doubt, ...]:
        epochs = with_errors((1, 300, 301, factor * U * np.sqrt(4.0 / 3.0)))
        epochs.change_mm[201:, 1] = np.nan
        doubt = Doubt(1, 2.0, np.inf, Status.ORIGIN_LOST, message("rig.uncalibrated"))
        return judged(epochs, before=Doubts((doubt,)), samples=1).every

    assert not found(4.999)
    assert [d.status for d in found(5.001)] == [Status.ORIGIN_LOST]


@pytest.mark.parametrize(("cable", "status"), [(1, Status.JUMP), (EVERY, Status.ORIGIN_LOST)])
def test_nothing_but_the_lost_origin_of_one_channel_is_proved(cable: int, status: Status) -> None:
    epochs = with_errors()
    epochs.change_mm[201:, 1] = np.nan
    before = Doubts((Doubt(cable, 2.0, np.inf, status, message("rig.uncalibrated")),))
    assert judged(epochs, before=before).every == before.every
    # one that is about no epoch, neither
    later = Doubts((Doubt(1, 90.0, np.inf, Status.ORIGIN_LOST, message("rig.uncalibrated")),))
    assert judged(epochs, before=later).every == later.every


def test_an_origin_says_nothing_where_everything_is_in_doubt() -> None:
    """Of two pairs that differ nobody knows which are right, so that neither proves the fifth."""
    epochs = with_errors((0, 150, N, 0.2), (2, 150, N, 0.2), channels=5)
    epochs.change_mm[100:, 1] = np.nan
    before = Doubts((Doubt(1, 2.5, np.inf, Status.ORIGIN_LOST, message("rig.uncalibrated")),))
    found = judged(epochs, before=before)
    assert [(d.cable, d.status) for d in found.every] == [(EVERY, Status.INCONSISTENT), (1, Status.ORIGIN_LOST)]


def test_an_origin_is_proved_by_the_last_epoch_before_everything_is_in_doubt() -> None:
    epochs = with_errors((2, 100, 130, 0.2))
    epochs.change_mm[90:250, [0, 3]] = np.nan
    before = Doubts((Doubt(0, 0.985, 0.99, Status.ORIGIN_LOST, message("rig.uncalibrated")),))
    assert spans_of(judged(epochs, before=before)) == [(EVERY, 0.99, 1.29, "contradiction.among")]


def test_so_many_faults_that_what_is_left_is_nobodys(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(consistency, "ROUNDS", 1)
    wrong = [(j, b, b + 20, 0.2) for j, b in ((1, 20), (2, 180))]
    found = judged(with_errors(*wrong, channels=3))
    assert spans_of(found) == [(EVERY, -np.inf, np.inf, "contradiction.none"), (1, 0.19, 0.39, "cable.left_out")]
    monkeypatch.setattr(consistency, "ROUNDS", 2)
    assert [d[0] for d in spans_of(judged(with_errors(*wrong, channels=3)))] == [1, 2]


def test_of_a_long_run_the_epochs_are_kept_that_contradict_themselves_most(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(consistency, "MOST_EPOCHS", 10)
    errors = np.zeros((N, 4))
    errors[[3, 4, 11, 18], 2] = 0.2, 0.3, 0.2, 0.1
    readings: Any = Readings([U] * 4)
    every = epochs_of(errors)
    poses = readings.solve(every.change_mm)
    chi = np.where(errors.any(axis=1), 1e3, 0.0)
    chi[14] = np.nan  # no pose by the counts: whatever contradicts it is not known, and it stays

    def kept(sizes: Sequence[int]) -> tuple[list[int], int]:
        finder, begun = EpochFinder(readings), 0
        for size in sizes:
            part = slice(begun, begun + size)
            finder.add(every.at(part), poses[part], chi[part])
            begun += size
        return np.round(finder.epochs().time_s * 100.0).astype(int).tolist(), finder.samples

    assert kept([20]) == (list(range(20)), 20)
    assert kept([12, 8]) == (list(range(20)), 20)
    assert kept([12, 9]) == ([0, 3, 4, 6, 8, 11, 12, 14, 16, 18, 20], 21)
    assert kept([12, 10]) == ([0, 3, 4, 6, 8, 11, 12, 14, 16, 18, 20], 22)
    assert kept([5, 5, 5, 5, 1, 9, 9])[1] == 39


def test_only_what_is_suspect_is_worked_out() -> None:
    """By the normal law at 1e-4, and at one degree of freedom at least; where there is no pose nothing is."""
    readings, requested = Readings([U] * 4), []

    def parities(epochs: Epochs, poses: FloatArray, used: BoolArray | None = None) -> Parities:
        requested.extend(np.round(epochs.time_s * 100.0).astype(int).tolist())
        return Readings.parities(readings, epochs, poses, used)

    readings.parities = parities  # type: ignore[method-assign]
    every = epochs_of(np.zeros((12, 4)))
    every.change_mm[6:9, 3], every.change_mm[9:, 1:] = np.nan, np.nan
    poses = readings.solve(every.change_mm)
    poses[5] = np.nan
    limit = [float(chi2.isf(1e-4, f)) for f in (3, 2, 1)]
    chi = np.concatenate(
        [[0.0, 0.999 * limit[0], 1.001 * limit[0], np.nan, 1.3 * limit[0], 1e9]] + [np.r_[0.0, 0.999, 1.001] * q for q in limit[1:]]
    )
    one: Any = readings
    EpochFinder(one).add(every, poses, chi)
    assert requested == [2, 3, 4, 8, 11]


def reconstruction(readings: Readings | None, epochs: Epochs, **budget: Any) -> Any:
    """As much of one as is asked, in two pieces."""
    if readings is not None:
        readings.epochs = lambda lengths, travel: epochs.at(lengths.rows)  # type: ignore[attr-defined]
    parts = slice(0, 150), slice(150, len(epochs))

    def examine(pieces: Any) -> Any:
        assert pieces == "pieces"
        for rows in parts:
            at = epochs.at(rows)
            poses = Readings([U] * 4).solve(at.change_mm)
            yield SimpleNamespace(rows=rows, counts=at.counts), poses, np.full(len(at), 1e3), None

    return SimpleNamespace(
        redundancy=readings, examine=examine,
        budget=SimpleNamespace(scales=np.ones(4), calibrated=True, one_motion=False, rig=RIG, **budget),
        poses_of=None if readings is None else readings.solve,
    )  # fmt: skip


def test_epochs_are_collected_piece_by_piece_and_some_are_kept_once() -> None:
    epochs = with_errors((2, 100, 200, 0.2))
    whole = reconstruction(Readings([U] * 4), epochs)
    pieces: Any = "pieces"
    spread = RunSamples()
    assert spread.epochs() is None
    found, samples = collect_epochs(whole, pieces, spread)
    assert samples == N
    np.testing.assert_array_equal(found.time_s, TIME)
    kept = spread.epochs()
    assert kept is not None
    assert kept.travel is not None
    np.testing.assert_array_equal(kept.time_s, TIME)
    # sin rises up to 1.57 s, then falls: which way they travelled last, kept from piece to piece
    assert (kept.travel[[20, 149, 152]] == 1.0).all()
    assert (kept.travel[[250, 399]] == -1.0).all()


def test_a_way_back_of_less_than_some_recorded_counts_is_none() -> None:
    epochs = with_errors()
    back = BAND / 2.0 * np.array([0.8, 1.2, 0.8, 1.2])  # of which a recorded one is half a true one
    epochs.counts[:] = np.where(np.arange(N)[:, None] < 100, 0.0, np.where(np.arange(N)[:, None] < 200, 50.0, 50.0 - back))
    whole = reconstruction(Readings([U] * 4), epochs)
    whole.budget.scales = np.full(4, 2.0)
    pieces: Any = "pieces"
    spread = RunSamples()
    collect_epochs(whole, pieces, spread)
    kept = spread.epochs()
    assert kept is not None
    assert kept.travel is not None
    np.testing.assert_array_equal(kept.travel[[50, 150, 250]], [[0.0] * 4, [1.0] * 4, [1.0, -1.0, 1.0, -1.0]])


def said(epochs: Epochs, *, calibrated: bool = True, one_motion: bool = False, before: Doubts = NONE, readings: bool = True) -> Doubts:
    one = reconstruction(Readings([U] * 4) if readings else None, epochs)
    one.budget.calibrated, one.budget.one_motion = calibrated, one_motion
    pieces: Any = "pieces"
    return consistent(one, pieces, before)


def codes(notes: tuple[Message, ...]) -> list[str]:
    return [n.code for n in notes]


def test_what_is_said_beside_contradictions() -> None:
    """That nobody calibrated where none is named, that passes differ where they are taken for one motion; of a sound run nothing."""
    left_out, contradict, sound = with_errors((2, 100, 200, 0.2)), with_errors((0, 100, 200, 0.2), (1, 100, 200, 0.2)), with_errors()

    def fresh(epochs: Epochs) -> Epochs:
        return epochs.at(slice(None))

    assert codes(said(fresh(left_out)).notes) == codes(said(fresh(left_out), calibrated=False).notes) == ["cables.left_out"]
    assert codes(said(fresh(contradict)).notes) == ["cables.contradict"]
    assert codes(said(fresh(contradict), calibrated=False).notes) == ["cables.contradict", "rig.uncalibrated"]
    assert codes(said(fresh(left_out), one_motion=True).notes) == ["cables.left_out", "passes.not_repeated"]
    both = said(fresh(contradict), calibrated=False, one_motion=True)
    assert codes(both.notes) == ["cables.contradict", "rig.uncalibrated", "passes.not_repeated"]
    before = Doubts(notes=(message("origin.shown", what="x"),))
    assert said(fresh(sound), calibrated=False, one_motion=True, before=before) is before
    assert said(fresh(left_out), before=before, readings=False) is before
