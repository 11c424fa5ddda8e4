"""Agreement of a run's cables, and the choice of cables to omit.

With more cables than unknowns every sample is a test: chi-squared of the contradictions, with common errors of the lengths in the
covariance (`trajectory.faults.redundancy`). An alarm is one that a sound run of so many samples has once in a thousand runs (Bonferroni;
equal roundings in a slow run make it rarer), by the law of rounding (`contradictions`). Alarms of a run are one question: the omission of
which cable explains them all? A set of cables explains alarms if the others agree at all of them together, at 1e-3. It is omitted if no
other set of its size does. If several explain them, or none, the wrong cable is unknown and the samples are inconsistent. One redundant
cable can never identify the faulty one.

The alarm for a growing error comes late, and a constant error hides where the geometry does not show it. So a doubt reaches back to the
last epoch, and on to the first of some, at which every cable in question agrees, with a standard uncertainty that would show its error at
the alarms. If no cable explains the alarms, the whole run is in doubt.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import scipy

from lmeasure.core import BoolArray, FloatArray, IntArray, Status
from lmeasure.rig import Rig
from lmeasure.sensors import Lengths, channel_message, last_travel
from lmeasure.text import Message, message
from lmeasure.trajectory.faults.continuity import EVERY, Doubt, Doubts
from lmeasure.trajectory.faults.redundancy import Epochs, Parities, Redundancy
from lmeasure.trajectory.reconstruction.screw_method import Reconstruction

AGREES = 2.0  # Standard uncertainties within which a cable agrees
SHOWS = (3.0, 30.0)
"""Standard uncertainties, within these bounds, of half a cable's error at the alarms, so that an agreement counts against it."""
AGAIN_S = 0.1
AGAIN = 5  # Samples, and for so long, a cable must agree again
MOSTLY = 0.8  # Part of those samples: one of twenty is beyond two standard uncertainties


def spans(time_s: FloatArray, alarms: IntArray, error: FloatArray, u: FloatArray) -> list[tuple[int, int]]:
    """First and last epochs of the doubts, from the alarms on (k,), about cables with errors and uncertainties (n, q) at times (n,)."""
    n = len(error)
    determined = np.where(np.isfinite(u[alarms]), np.abs(error[alarms]), 0.0)
    size = np.quantile(determined, 0.9, axis=0)
    shows = np.clip(0.5 * (determined / u[alarms]).max(axis=0), *SHOWS)
    agrees: BoolArray = np.all((np.abs(error) <= AGREES * u) & (shows * u <= size), axis=1)
    out: list[tuple[int, int]] = []
    for alarm in alarms.tolist():
        if out and alarm <= out[-1][1]:
            continue
        # several channels may be wrong so that for a while none seems to be
        before = np.flatnonzero(agrees[:alarm])
        first = int(before[-1]) + 1 if len(before) else 0
        again = (int(begin) for begin in np.flatnonzero(agrees[alarm:]) + alarm if _agrees_from(int(begin), time_s, agrees))
        out.append((first, max(next(again, n) - 1, alarm)))
    return out


def _agrees_from(begin: int, time_s: FloatArray, agrees: BoolArray) -> bool:
    """Return whether most epochs agree from there on for the required time and number, or up to the end."""
    end = max(int(np.searchsorted(time_s, time_s[begin] + AGAIN_S)), begin + AGAIN - 1)
    return bool(agrees[begin : end + 1].mean() >= MOSTLY)


MOST = 2048


class RunSamples:
    """Keeps every k-th sample of a run that is given in pieces, k doubling where they become more than twice `MOST`."""

    def __init__(self) -> None:
        self._kept: list[Epochs] = []
        self._every, self._seen = 1, 0

    def add(self, epochs: Epochs, travel: FloatArray) -> None:
        """The next samples, and which way their channels travelled last (n, m)."""
        rows = np.arange(-self._seen % self._every, len(epochs), self._every)
        self._seen += len(epochs)
        self._kept.append(replace(epochs.at(rows), travel=travel[rows]))
        while sum(map(len, self._kept)) > 2 * MOST:
            self._every *= 2
            whole = joined(self._kept)
            self._kept = [whole.at(np.arange(0, len(whole), 2))]

    def epochs(self) -> Epochs | None:
        """Return all that were kept, None where nothing was added."""
        return joined(self._kept) if self._kept else None


def joined(pieces: list[Epochs]) -> Epochs:
    """One behind the other."""
    every = {name: [vars(piece)[name] for piece in pieces] for name in vars(pieces[0])}
    whole: dict[str, Any] = {name: None if values[0] is None else np.concatenate(values) for name, values in every.items()}
    return Epochs(**whole)


SIGNIFICANCE = 1e-3  # Of a run: that a sound one gives an alarm, and that an explanation which is right is refuted
HARDLY = 1e-6
"""Probability of the only remaining explanation below which it is refuted: the tails of a calibration's law are not known well."""
JUDGED = 40  # Alarms that test explanations, the strongest among them
APART_S = 1.0  # Without an alarm, between alarms that are explained one by one where nothing explains them all
WORTH = 0.05  # Chance, by the normal law, of the largest contradiction of some channels from which the law of their rounding is worked out
PROVES = 5.0
"""Standard uncertainties within which a cable's error must be everywhere, and within half of them where it is known best, to be none."""
BACK_MM = 0.05  # Standard uncertainty of an error up to which redundant cables prove an origin
MOST_EPOCHS = 2**17  # Kept of a run: of a longer one, of several neighbours the one that contradicts itself most
SUSPECT = 1e-4
"""Chance, by an upper bound of chi-squared and the normal law, from which a sample's contradictions are worked out to be compared."""
ON_THE_WAY = 2000  # Epochs for the path of a run to its alarms
ROUNDS = 40
IN_TIME = {
    "cable.left_out": "cables.left_out",
    "cable.left_out.unknown": "cables.left_out.unknown",
    "contradiction": "cables.contradict",
    "contradiction.none": "cables.contradict.none",
    "contradiction.among": "cables.contradict.among",
}
"""Cause of a sample, and of the whole time with such samples."""

Solve = Callable[[FloatArray], FloatArray]
"""(n, 7) poses of a run from its start by changes (n, m) of the cables, NaN for one that is not used."""


class Consistency:
    """Judge of a run by its epochs, which it changes: faulty ones are not used any more. samples: of the whole run."""

    def __init__(self, rig: Rig, redundancy: Redundancy, solve: Solve, epochs: Epochs, *, samples: int) -> None:
        self._rig, self._redundancy, self._solve = rig, redundancy, solve
        self._epochs, self._samples = epochs, max(samples, 1)
        self._settled = np.zeros(len(epochs), np.bool_)
        self._limits: dict[bytes, float] = {}

    def judged(self, before: Doubts) -> Doubts:
        """Return the doubts about the run: before, and those from comparing its cables."""
        every = list(before.every)
        for number in range(ROUNDS + 1):
            poses = self._solve(self._epochs.change_mm)
            parities = self._redundancy.parities(self._epochs, poses)
            alarms = self._alarms(parities, poses)
            if not len(alarms):
                break
            # after this many faults, remaining contradictions belong to no single channel
            every += self._doubts(alarms, parities) if number < ROUNDS else self._inconsistent((), alarms, parities)
        notes = list(before.notes)
        every, proved = self._proved(every)
        # notes on an origin that is right, alone or with its consequences
        notes = [note for note in notes if not {note, note.values.get("what")} & proved.keys()] + list(proved.values())
        new = [d for d in every if all(d is not old for old in before.every)]
        every.sort(key=lambda d: (d.after_s, d.cable))
        return replace(before, every=tuple(every), notes=(*notes, *_notes(self._rig, new)))

    def _alarms(self, parities: Parities, poses: FloatArray) -> IntArray:
        """Epochs, at poses (n, 7), that contradict themselves and are not settled."""
        chi, open_ = parities.chi_squared, (parities.freedom > 0) & ~self._settled
        wrong = np.zeros(len(chi), np.bool_)
        for used in np.unique(parities.used[open_], axis=0):
            mine = open_ & (parities.used == used).all(axis=1)
            if scipy.stats.chi2.sf(chi[mine].max(), used.sum() - len(self._redundancy.free)) < WORTH:
                wrong[mine] = chi[mine] > self._limit(used, np.flatnonzero(mine), poses)
        return np.asarray(np.flatnonzero(wrong))

    def _limit(self, used: BoolArray, epochs: IntArray, poses: FloatArray) -> float:
        """Return the limit of chi-squared of these channels, at these epochs or any of them before."""
        key = used.tobytes()
        if key not in self._limits:
            self._limits[key] = self._redundancy.chance(self._epochs.at(epochs), poses[epochs], used).limit(SIGNIFICANCE / self._samples)
        return self._limits[key]

    def _doubts(self, alarms: IntArray, parities: Parities) -> list[Doubt]:
        """Return doubts from alarms: one explanation for all of them, else for the first of them."""
        cables, certain = self._explained(alarms, parities)
        gaps = np.flatnonzero(np.diff(self._epochs.time_s[alarms]) > APART_S)
        if not cables and len(gaps):
            alarms = alarms[: gaps[0] + 1]
            cables, certain = self._explained(alarms, parities)
        return self._left_out(cables, alarms) if certain else self._inconsistent(cables, alarms, parities)

    def _explained(self, alarms: IntArray, parities: Parities) -> tuple[tuple[int, ...], bool]:
        """Cables that explain alarms, each by itself or as the set that is left out, and whether no other set does."""
        chi = parities.chi_squared[alarms]
        strongest = alarms[np.argsort(-chi, kind="stable")[: JUDGED // 2]]
        spread = alarms[np.unique(np.linspace(0, len(alarms) - 1, JUDGED // 2).round().astype(np.intp))]
        chosen = np.union1d(strongest, spread)
        # cables that all of them use, or explanations could not be distinguished at all
        used: BoolArray = np.isfinite(self._epochs.change_mm)
        most = chosen[np.argmax(used[chosen].sum(axis=1))]
        chosen = chosen[np.all(used[chosen] == used[most], axis=1)]
        usable = np.flatnonzero(used[most])
        spare = len(usable) - len(self._redundancy.free)
        for size in range(1, spare):
            sets = list(combinations(usable.tolist(), size))
            chances = self._chances(sets, chosen)
            for level in (SIGNIFICANCE, HARDLY):
                standing = [cables for cables, chance in zip(sets, chances, strict=True) if chance >= level]
                if len(standing) == 1:
                    return standing[0], True
                if standing:
                    return tuple(sorted({j for cables in standing for j in cables})), False
        return tuple(usable.tolist()) if spare == 1 else (), False

    def _chances(self, sets: list[tuple[int, ...]], chosen: IntArray) -> list[float]:
        """Return, for each set of cables, the chance that the others contradict each other as much as they do at the chosen epochs."""
        poses = []
        for cables in ((), *sets):
            way, every = self._followed(cables, chosen, int(chosen.min()))
            poses.append(every[np.searchsorted(way, chosen)])
        epochs = self._epochs.at(chosen)
        chances = [self._chance(epochs, cables, at) for cables, at in zip(sets, poses[1:], strict=True)]
        # without some cable a run may end at a singular pose; its residuals are then tested to first order at the poses that explain most
        best = poses[1 + int(np.argmax(chances))]
        known = np.where(np.isfinite(best), best, poses[0])
        filled = [np.where(np.isfinite(at), at, known) for at in poses[1:]]
        chances = [
            chance if np.isfinite(at).all() else self._chance(epochs, cables, full)
            for cables, at, full, chance in zip(sets, poses[1:], filled, chances, strict=True)
        ]
        standing = [k for k, chance in enumerate(chances) if chance >= HARDLY]
        if len(standing) > 1:
            for k in standing:
                chances[k] = self._chance(epochs, sets[k], filled[k], rounded=True)
        return chances

    def _chance(self, epochs: Epochs, cables: tuple[int, ...], poses: FloatArray, *, rounded: bool = False) -> float:
        """Return the chance of contradictions as large without these cables, at poses (n, 7), by all epochs together and by the worst
        alone (Bonferroni), by
        the normal law or, rounded, by that of rounding, which is never above it but takes longer; -1 where no pose is known."""
        known = np.isfinite(poses[:, 0])
        if not known.any():
            return -1.0
        epochs, poses = epochs.at(known), poses[known]
        used = np.isfinite(epochs.change_mm)
        used[:, list(cables)] = False
        together, alone, freedom = self._redundancy.jointly(epochs, poses, used)
        n = len(poses)
        worst = scipy.stats.chi2.sf(alone.max(), freedom)
        if rounded:
            worst = min(worst, self._redundancy.chance(epochs, poses, used[0]).above(alone.max()))
        return float(2.0 * min(scipy.stats.chi2.sf(together, freedom * n), worst * n))

    def _followed(self, cables: tuple[int, ...], wanted: IntArray, since: int) -> tuple[IntArray, FloatArray]:
        """Return epochs up to the wanted ones, these among them, and their poses (k, 7) without these cables. If the others determine no
        pose somewhere, they are omitted only from the epoch `since` on, up to which nothing contradicts them."""
        last = int(wanted.max())
        way = np.union1d(np.unique(np.linspace(0, last, min(last + 1, ON_THE_WAY)).round().astype(np.intp)), wanted)
        changes = self._epochs.change_mm[way].copy()
        poses = self._solve(_without(changes, cables))
        lost = np.isnan(poses[:, 0])
        if cables and lost.any():
            poses[lost] = self._solve(_without(changes, cables, way >= since))[lost]
        return way, poses

    def _left_out(self, cables: tuple[int, ...], alarms: IntArray) -> list[Doubt]:
        _, poses = self._followed(cables, np.arange(len(self._epochs)), int(alarms[0]))
        errors, alike = [], []
        for cable in cables:
            used = np.isfinite(self._epochs.change_mm)
            used[:, [j for j in cables if j != cable]] = False
            parities = self._redundancy.parities(self._epochs, poses, used)
            errors.append([values[:, cable].copy() for values in parities.errors])
            alike.append(scipy.stats.chi2.sf(parities.chi_squared[alarms], parities.freedom[alarms]) >= SIGNIFICANCE)
        # cables with faults at different times: each is excluded at alarms that the others do not explain
        among, out = np.array(alike).all(axis=0), []
        for cable, (error, u), agrees in zip(cables, errors, alike, strict=True):
            own = alarms[among | ~agrees]
            out += self._left_out_by_itself(cable, own if len(own) else alarms, error, u)
        return out

    def _left_out_by_itself(self, cable: int, alarms: IntArray, error: FloatArray, u: FloatArray) -> list[Doubt]:
        """Doubts about a cable from its alarms on, by its errors and their standard uncertainties (n,)."""
        out = []
        for first, last in spans(self._epochs.time_s, alarms, error[:, None], u[:, None]):
            after, until = self._between(first, last)
            within = (self._epochs.time_s > after) & (self._epochs.time_s <= until)
            determined = np.flatnonzero(within & np.isfinite(u))
            said = message("cable.left_out.unknown")
            if len(determined):
                most = determined[np.argmax(np.abs(error[determined]))]
                said = message("cable.left_out", mm=float(error[most]), u_mm=float(u[most]))
                if not self._rig.observed[cable].is_length:
                    deg, u_deg = np.degrees([error[most], u[most]]).tolist()
                    said = message("encoder.left_out", deg=deg, u_deg=u_deg)
            out.append(Doubt(cable, after, until, Status.INCONSISTENT, said))
            self._epochs.change_mm[within, cable] = np.nan
        return out

    def _inconsistent(self, cables: tuple[int, ...], alarms: IntArray, parities: Parities) -> list[Doubt]:
        names = [self._rig.observed[j].name for j in cables]
        m = self._epochs.change_mm.shape[1]
        among = {"cables": " or ".join(names)} if 0 < len(names) < m else {}
        said = message(f"contradiction{'.among' if among else '' if names else '.none'}", **among)
        error, u = parities.errors
        chosen = list(cables) or list(range(m))
        found = spans(self._epochs.time_s, alarms, error[:, chosen], u[:, chosen]) if cables else [(0, len(error) - 1)]
        out = []
        for first, last in found:
            after, until = self._between(first, last)
            out.append(Doubt(EVERY, after, until, Status.INCONSISTENT, said))
            self._settled |= (self._epochs.time_s > after) & (self._epochs.time_s <= until)
        return out

    def _between(self, first: int, last: int) -> tuple[float, float]:
        """Times behind the epoch before the first and up to the last, or to the end."""
        time_s = self._epochs.time_s
        return float(time_s[first - 1]) if first > 0 else -np.inf, float(time_s[last]) if last < len(time_s) - 1 else np.inf

    def _proved(self, every: list[Doubt]) -> tuple[list[Doubt], dict[Message, Message]]:
        """Return the doubts without lost origins that the other cables prove right, and the messages in their place."""
        determined: dict[Message, Message] = {}
        for doubt in [d for d in every if d.status == Status.ORIGIN_LOST and d.cable != EVERY]:
            mine = np.flatnonzero(doubt.mask(self._epochs.time_s) & ~self._settled)
            if not len(mine):
                continue
            poses = self._solve(self._epochs.change_mm)[mine]
            epochs = self._epochs.at(mine)
            used = np.isfinite(epochs.change_mm)
            used[:, doubt.cable] = np.isfinite(epochs.gone_on_mm[:, doubt.cable])
            error, u = (v[:, doubt.cable] for v in self._redundancy.parities(epochs, poses, used).errors)
            best = int(np.argmin(u))
            agrees = np.all(np.abs(error) <= PROVES * u) and abs(error[best]) <= 0.5 * PROVES * u[best]
            if u[best] <= BACK_MM and agrees:
                every.remove(doubt)
                determined[doubt.said] = message("origin.shown", what=doubt.said)
                mask = doubt.mask(self._epochs.time_s)
                self._epochs.change_mm[mask, doubt.cable] = self._epochs.gone_on_mm[mask, doubt.cable]
        return every, determined


def _without(changes: FloatArray, cables: tuple[int, ...], where: BoolArray | None = None) -> FloatArray:
    """Changes (n, m) without these cables, everywhere or where (n,) is true."""
    out = changes.copy()
    out[np.ix_(np.ones(len(out), np.bool_) if where is None else where, np.array(cables, dtype=np.intp))] = np.nan
    return out


def _notes(rig: Rig, every: list[Doubt]) -> list[Message]:
    """Return the messages about inconsistencies in a summary."""
    notes = []
    for doubt in sorted((d for d in every if d.status == Status.INCONSISTENT), key=lambda d: d.after_s):
        begin = message("time.beginning") if np.isinf(doubt.after_s) else message("time.at", s=doubt.after_s)
        end = message("time.end") if np.isinf(doubt.until_s) else message("time.at", s=doubt.until_s)
        when = {"begin": begin, "end": end}
        if doubt.cable == EVERY:
            notes.append(message(IN_TIME[doubt.said.code], **when, **doubt.said.values))
        elif (observed := rig.observed[doubt.cable]).is_cable:
            notes.append(message(IN_TIME[doubt.said.code], **when, cable=observed.name, **doubt.said.values))
        else:
            notes.append(message("channel.left_out", **when, what=channel_message(observed), said=doubt.said))
    return notes


class EpochFinder:
    """Collects the epochs of a run that is given in pieces."""

    def __init__(self, redundancy: Redundancy) -> None:
        self._redundancy = redundancy
        self._pieces: list[Epochs] = []
        self._scores: list[FloatArray] = []
        self.samples = 0

    def add(self, epochs: Epochs, poses: FloatArray, chi_squared: FloatArray) -> None:
        """The next samples: their poses (n, 7) and an upper bound (n,) of their chi-squared."""
        self.samples += len(epochs)
        freedom = np.maximum(np.isfinite(epochs.change_mm).sum(axis=1) - len(self._redundancy.free), 1)
        with np.errstate(invalid="ignore"):
            suspect = ~(scipy.stats.chi2.sf(chi_squared, freedom) >= SUSPECT) & np.isfinite(poses[:, 0])
        score = np.where(np.isfinite(chi_squared), 0.0, np.inf)
        rows = np.flatnonzero(suspect)
        if len(rows):
            score[rows] = self._redundancy.parities(epochs.at(rows), poses[rows]).chi_squared
        self._pieces.append(epochs)
        self._scores.append(score)
        if sum(len(piece) for piece in self._pieces) > 2 * MOST_EPOCHS:
            self._thin()

    def epochs(self) -> Epochs:
        """All of them, thinned where they are many."""
        if len(self._pieces) > 1:
            self._join()
        return self._pieces[0]

    def _join(self) -> None:
        self._pieces, self._scores = [joined(self._pieces)], [np.concatenate(self._scores)]

    def _thin(self) -> None:
        """Remove of every two neighbours the one with more contradiction; one without a neighbour stays."""
        self._join()
        score = self._scores[0]
        even = np.arange(0, len(score) - 1, 2)
        kept = np.concatenate([even + (score[even + 1] > score[even]), np.arange(len(score))[2 * len(even) :]])
        self._pieces, self._scores = [self._pieces[0].at(kept)], [score[kept]]


def collect_epochs(reconstruction: Reconstruction, pieces: Iterable[Lengths], samples: RunSamples | None = None) -> tuple[Epochs, int]:
    """Return the epochs of a run whose channels are redundant, and how many samples it has; samples: takes some of them, evenly."""
    redundancy, budget = reconstruction.redundancy, reconstruction.budget
    assert redundancy is not None
    finder, travelled = EpochFinder(redundancy), np.zeros((len(budget.scales), 2))
    for lengths, poses, chi_squared, travel in reconstruction.examine(pieces):
        epochs = redundancy.epochs(lengths, travel)
        finder.add(epochs, poses, chi_squared)
        if samples is not None:
            samples.add(epochs, last_travel(lengths.counts, 1.0 / budget.scales, travelled))
    return finder.epochs(), finder.samples


def consistent(reconstruction: Reconstruction, pieces: Iterable[Lengths], before: Doubts, samples: RunSamples | None = None) -> Doubts:
    """Return the doubts about a run, given its lengths piece by piece with the doubts so far; samples: as in `collect_epochs`."""
    redundancy, budget = reconstruction.redundancy, reconstruction.budget
    if redundancy is None:
        return before
    epochs, number = collect_epochs(reconstruction, pieces, samples)
    found = Consistency(budget.rig, redundancy, reconstruction.poses_of, epochs, samples=number).judged(before)
    if found.every == before.every and found.notes == before.notes:
        return before
    notes = found.notes
    contradicted = [doubt for doubt in found.every if doubt.status == Status.INCONSISTENT]
    if not budget.calibrated and any(doubt.cable == EVERY for doubt in contradicted):
        notes = (*notes, message("rig.uncalibrated"))
    if contradicted and budget.one_motion:
        notes = (*notes, message("passes.not_repeated"))
    return replace(found, notes=notes)
