"""Two calibrations of one rig: their changes, and a test against their uncertainties.

The difference of two independent campaigns has the covariance C_old + C_new. A direction that either campaign left to the prior, or nearly,
gives no evidence and is not tested. Coordinates of B alone mislead: together they may move far without changing a length, so every point is
judged by all its values jointly, and every cable by the lengths it predicts.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy

from lmeasure.calibration.solve.prediction import workspace
from lmeasure.calibration.solve.solve import Calibration
from lmeasure.core import CalibrationError, FloatArray
from lmeasure.kernels import changes_from_counts, counts_from_changes, span_lengths
from lmeasure.rig import PLACE, Cable, CalibrationRecord, Rig, parameter_names, read_calibration_record, read_rig, value_of
from lmeasure.sensors import channel_names, further_solved, length_gradients_since, parts_of
from lmeasure.text import Lines, composed, message

SIGNIFICANT = 0.01
"""Probability of chance, over all points or all cables together, under which something has moved."""


SILENT = 0.5
"""A direction is left to the prior when the counts narrowed its variance by less than this part of it."""


@dataclass(frozen=True)
class Earlier:
    """An earlier calibration: its rig, its record, and where they were read."""

    rig: Rig
    record: CalibrationRecord
    source: str


@dataclass(frozen=True)
class ValueShift:
    """One value before and now, in the unit of its name; u is the standard uncertainty of the difference."""

    name: str
    old: float
    new: float
    u: float

    @property
    def change(self) -> float:
        """New minus old; angles the short way round."""
        return math.remainder(self.new - self.old, 360.0) if self.name.endswith("_deg") else self.new - self.old


@dataclass(frozen=True)
class PointShift:
    """An observation or attachment point: distance its position moved [mm] and the joint test of all its values.

    chi_squared of the difference in `freedom` directions that both campaigns determine, out of `values`; probability of as much by chance,
    None without such a direction.
    """

    point: str
    distance_mm: float
    chi_squared: float
    freedom: int
    values: int
    probability: float | None
    moved: bool


@dataclass(frozen=True)
class LengthShift:
    """Change of the lengths that one cable predicts for the same counts, over the workspace: rms and largest [mm], the standard uncertainty
    where it is largest in units of that, and the probability of as much anywhere by chance (Scheffe's simultaneous bound)."""

    cable: str
    rms_mm: float
    worst_mm: float
    u_mm: float
    probability: float
    moved: bool


@dataclass(frozen=True)
class Comparison:
    """Changes between two calibrations; together: the joint test of all values; lengths: of cables, if the new campaign is available;
    notes: values without a comparison."""

    source: str
    together: PointShift
    points: tuple[PointShift, ...]
    lengths: tuple[LengthShift, ...]
    values: tuple[ValueShift, ...]
    notes: tuple[str, ...]

    @property
    def moved(self) -> bool:
        return self.together.moved or any(p.moved for p in self.points) or any(c.moved for c in self.lengths)


def read_earlier(path: Path) -> Earlier:
    """An earlier calibration: its output folder, or its calibration.json with the rig.toml beside it; FileFormatError names the file."""
    path = Path(path)
    record = path / "calibration.json" if path.is_dir() else path
    return Earlier(read_rig(record.parent / "rig.toml"), read_calibration_record(record), str(path))


def compare(old: Earlier, new: Calibration, seed: int = 0) -> Comparison:
    """Judge the new calibration against the old one over the new campaign's workspace; CalibrationError as `compare_records`."""
    found = compare_records(old, Earlier(new.rig, new.record, message("calibration.the_new_one")))
    lengths, dropped = _lengths(old, new, seed)
    notes = [message("calibration.cable_not_runs_between", name=name, source=old.source) for name in dropped]
    return replace(found, lengths=lengths, notes=(*found.notes, *notes))


def compare_records(old: Earlier, new: Earlier) -> Comparison:
    """Judge points and values by the records of both calibrations alone; CalibrationError when they share no point, or lie in frames of
    their own."""
    _check_frames(old, new.record)
    names = list(dict.fromkeys(p.name for record in (old.record, new.record) for p in record.parameters))
    common = [n for n in names if _known(old.rig, n) and _known(new.rig, n)]
    if not common:
        raise CalibrationError(message("error.its_points_and_those", where=old.source, name=new.rig.name))
    notes = _notes(old, new, names, common)
    width = np.array([_width(old.record, new.record, n) for n in common])
    covariances = _covariance(old.record, common), _covariance(new.record, common)
    values = tuple(
        ValueShift(n, value_of(old.rig, n) or 0.0, value_of(new.rig, n) or 0.0, float(u))
        for n, u in zip(common, np.sqrt(np.diag(covariances[0] + covariances[1])), strict=True)
    )
    z = np.array([v.change for v in values]) / width
    scaled = covariances[0] / np.outer(width, width), covariances[1] / np.outer(width, width)
    owners = list(dict.fromkeys(n.rsplit(".", 1)[0] for n in common))
    points = []
    for owner in owners:
        own = np.array([i for i, n in enumerate(common) if n.rsplit(".", 1)[0] == owner])
        place = [values[i].change for i in own if common[i].rsplit(".", 1)[1] in PLACE]
        points.append(
            _tested(
                owner.removeprefix("tool."),
                z[own],
                (scaled[0][np.ix_(own, own)], scaled[1][np.ix_(own, own)]),
                math.hypot(*place),
                len(owners),
            )
        )
    together = _tested("all", z, scaled, max((p.distance_mm for p in points), default=0.0), 1)
    return Comparison(old.source, together, tuple(points), (), values, tuple(notes))


def _tested(name: str, z: FloatArray, covariances: tuple[FloatArray, FloatArray], distance: float, tests: int) -> PointShift:
    """Chi-squared of a difference z in prior widths, between two with covariances (p, p) in the same units.

    Tested are the directions orthogonal to all that either leaves to its prior.
    """
    silent = [vectors[:, values >= SILENT] for values, vectors in map(np.linalg.eigh, covariances)]
    left, size, _ = np.linalg.svd(np.hstack(silent))
    determined = left[:, int((size > 1e-6).sum()) :]
    d = determined.T @ z
    chi2 = float(d @ np.linalg.solve(determined.T @ (covariances[0] + covariances[1]) @ determined, d)) if determined.shape[1] else 0.0
    freedom = determined.shape[1]
    probability = float(scipy.stats.chi2.sf(chi2, freedom)) if freedom else None
    moved = probability is not None and probability * tests < SIGNIFICANT
    return PointShift(name, distance, chi2, freedom, len(z), probability, moved)


def _lengths(old: Earlier, new: Calibration, seed: int) -> tuple[tuple[LengthShift, ...], list[str]]:
    campaign = new.campaign
    earlier = {(c.from_point, c.to_point, c.passage) for c in old.rig.cable}
    cables = tuple(c for c in campaign.drums if (c.from_point, c.to_point, c.passage) in earlier)
    dropped = [c.name for c in campaign.drums if c not in cables]
    if not cables:
        return (), dropped
    rows = np.vstack([campaign.poses.rows[campaign.zero[0]], workspace(campaign, seed)])
    rig, before = (of.rig.zeroed_at(rows[0]) for of in (new, old))
    counts = counts_from_changes(rig.cable_rows(cables), _changes(rig, rows, cables))
    raw = counts * rig.scales(cables)
    # modelled minus measured lengths of the same counts by both calibrations
    shift = _misread(rig, rows, raw, cables) - _misread(before, rows, raw, cables)
    variance = _variance(rig, new.record, rows, raw, cables) + _variance(before, old.record, rows, raw, cables)
    out = []
    solved = {p.name for record in (old.record, new.record) for p in record.parameters}
    for j, (c, own) in enumerate(zip(cables, parameter_names(new.rig, cables), strict=True)):
        d, u = shift[1:, j], np.sqrt(variance[1:, j])
        good = np.isfinite(d) & (u > 0.0)
        if not good.any():
            dropped.append(c.name)
            continue
        d, u = d[good], u[good]
        worst = int(np.argmax(np.abs(d)))
        probability = float(scipy.stats.chi2.sf(float(np.max((d / u) ** 2)), max(len(solved & set(own)), 1)))
        moved = probability * len(cables) < SIGNIFICANT
        out.append(LengthShift(c.name, float(np.sqrt(np.mean(d**2))), float(d[worst]), float(u[worst]), probability, moved))
    return tuple(out), dropped


def _changes(rig: Rig, rows: FloatArray, cables: tuple[Cable, ...]) -> FloatArray:
    """(n, m) changes of the lengths since the first pose [mm]."""
    lengths = span_lengths(rig.cable_rows(cables), np.ascontiguousarray(rows))
    return np.asarray(lengths - lengths[0])


def _misread(rig: Rig, rows: FloatArray, raw: FloatArray, cables: tuple[Cable, ...]) -> FloatArray:
    """(n, m) modelled minus measured changes [mm] for recorded counts raw (n, m), signs undone."""
    counts = raw / rig.scales(cables)
    out = _changes(rig, rows, cables) - changes_from_counts(rig.cable_rows(cables), counts)
    parts = parts_of(rig, cables)
    if parts is None:
        return np.asarray(out)
    zero = np.tile(rows[0], (len(cables), 1)), np.zeros(len(cables))
    return np.asarray(out + parts.excess(rig.cable_rows(cables), zero, rows, counts))


def _variance(rig: Rig, record: CalibrationRecord, rows: FloatArray, raw: FloatArray, cables: tuple[Cable, ...]) -> FloatArray:
    """(n, m) variance [mm^2] of `_misread` from the record's covariance."""
    wide = further_solved(record)
    g = length_gradients_since(rig, cables, rows[0], rows, counts=raw / rig.scales(cables), wide=wide)
    covariance, width = record.cable_covariance(channel_names(rig, cables, wide=wide)), g.shape[2]
    blocks = np.array([covariance[j * width : (j + 1) * width, j * width : (j + 1) * width] for j in range(len(cables))])
    return np.asarray(np.maximum(np.einsum("nma,mab,nmb->nm", g, blocks, g), 0.0))


def _covariance(record: CalibrationRecord, names: list[str]) -> FloatArray:
    """(p, p) covariance of the named values; a value that was not solved is taken as exact."""
    place = {p.name: i for i, p in enumerate(record.parameters)}
    select = np.zeros((len(names), len(place)))
    for row, name in enumerate(names):
        if name in place:
            select[row, place[name]] = 1.0
    return np.asarray(select @ record.covariance_matrix() @ select.T)


def _width(old: CalibrationRecord, new: CalibrationRecord, name: str) -> float:
    """The narrower of the priors that the two calibrations had."""
    return min(p.prior_u for record in (old, new) for p in record.parameters if p.name == name)


def _known(rig: Rig, name: str) -> bool:
    owner = name.rpartition(".")[0]
    if owner in {sensor.channel for sensor in rig.sensors}:
        return True
    return owner.removeprefix("tool.") in (rig.tool if owner.startswith("tool.") else {p.name for p in rig.observation_point})


def _check_frames(old: Earlier, new: CalibrationRecord) -> None:
    """A rig that was found with its poses lies in a frame that its nominal rig, or its poses, chose (decision 12)."""
    own = [r for r in (old.record, new) if r.settings.get("self_calibration")]
    nominal = [{i.sha256 for i in r.inputs if i.file == "rig.toml"} for r in (old.record, new)]
    same = len(own) == 2 and all(r.settings.get("frame") == "rig" for r in own) and nominal[0] == nominal[1] != set()
    if own and not same:
        raise CalibrationError(message("error.a_self_calibration_has", where=old.source))


def _notes(old: Earlier, new: Earlier, names: list[str], common: list[str]) -> list[str]:
    out: list[str] = []
    shared = {i.sha256 for i in old.record.inputs if i.file == "counts.csv"} & {i.sha256 for i in new.record.inputs}
    if shared:
        out.append(message("calibration.same_counts"))
    missing = sorted({n.rsplit(".", 1)[0].removeprefix("tool.") for n in set(names) - set(common)})
    if missing:
        out.append(message("calibration.one_two_only", names=tuple(missing)))
    solved = [{p.name for p in record.parameters} for record in (old.record, new.record)]
    one_sided = sorted({n.rsplit(".", 1)[1] for n in common if (n in solved[0]) != (n in solved[1])})
    if one_sided:
        out.append(message("calibration.solved_one_two_only", names=tuple(one_sided)))
    return out


def comparison_summary(comparison: Comparison) -> str:
    """The comparison as a table for a person."""
    verdict = message("calibration.something_moved" if comparison.moved else "calibration.nothing_moved")
    lines: list[str] = [message("calibration.compared_probability_chance_under", source=comparison.source, verdict=verdict, p=SIGNIFICANT)]
    lines += [message("line.note", text=note) for note in comparison.notes]
    head = "{point:10s} {shift:>12s} {chi:>12s} {freedom:>8s} {chance:>10s}"
    columns = {name: message(f"calibration.compared.{name}") for name in ("point", "shift", "chi", "freedom", "chance")}
    moved, lines = message("calibration.compared.moved"), [*lines, composed(head, **columns)]
    for name, p in (*((p.point, p) for p in comparison.points), (message("calibration.all_points"), comparison.together)):
        values = {"mm": p.distance_mm, "chi": p.chi_squared, "freedom": p.freedom, "values": p.values, "chance": chance(p.probability)}
        lines.append(message(f"calibration.compared.row{'_moved' * p.moved}", name=name, moved=moved, **values))
    if comparison.lengths:
        columns = {name: message(f"calibration.compared.{name}") for name in ("cable", "rms", "worst", "u", "chance")}
        lines.append(composed("{cable:10s} {rms:>12s} {worst:>12s} {u:>8s} {chance:>10s}", **columns))
    for c in comparison.lengths:
        row = "{name:10s} {rms:12.4f} {worst:12.4f} {u:8.4f} {chance:>10s}" + ("  {moved}" if c.moved else "")
        lines.append(composed(row, name=c.cable, rms=c.rms_mm, worst=c.worst_mm, u=c.u_mm, chance=chance(c.probability), moved=moved))
    return Lines(lines)


def chance(probability: float | None) -> str:
    """A probability in few digits; a dash where nothing could be tested."""
    return "-" if probability is None else f"{probability:.2g}" if probability >= 1e-9 else "< 1e-9"
