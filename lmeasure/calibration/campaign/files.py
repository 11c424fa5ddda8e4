"""Reading a calibration folder: dwells averaged, visits distinguished, wrapped counters undone, channels that do not move refused."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import cast, get_args

import numpy as np

from lmeasure.calibration.campaign.campaign import Campaign, Source
from lmeasure.calibration.campaign.dwells import mean_variance, pooled_scatter
from lmeasure.core import CalibrationError, FileFormatError, FloatArray, GeometryError, IntArray, conventions
from lmeasure.io import Column, files, gathered, no_folder
from lmeasure.recording import read_pose_table, read_poses
from lmeasure.rig import Drum, Input, SensorTable, read_rig
from lmeasure.sensors import ARM_MM, REFERENCE_C, counts_from_poses
from lmeasure.text import joined, message

_REPEATABILITY = ("u_repeatability_mm", "u_repeatability_deg")
MIN_POSES = 2
STILL_MM = 1.0  # larger changes within a dwell mean that the robot moved


def read_campaign(folder: Path, columns: Mapping[str, Column] | None = None) -> Campaign:
    """Read a calibration folder: rig.toml, reference_poses.csv and counts.csv.

    Parameters
    ----------
    folder
        The folder.
    columns
        Names and units of other columns of reference_poses.csv.

    Returns
    -------
    Campaign
        Counts at the poses. Consecutive rows of one pose are averaged; a pose that returns later is another visit.

    Raises
    ------
    FileFormatError, CalibrationError
        If a file is wrong. The message names file, pose and channel.

    Examples
    --------
    >>> lm.read_campaign(Path("campaign")).counts.shape
    (12, 6)
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileFormatError(message("error.is_not_a_calibration", where=folder, hint=no_folder(folder, "reference_poses.csv")))
    rig = read_rig(folder / "rig.toml")
    poses = read_poses(folder / "reference_poses.csv", rig.angles, columns, positions_alone=True)
    named = ["rig.toml", "reference_poses.csv", "counts.csv", *(p.name for p in folder.glob("reference.xml"))]
    inputs = tuple(Input(file=name, sha256=files.sha256(folder / name)) for name in named)
    path = folder / "counts.csv"
    table = files.read_table(path)
    names = table.text("pose")
    if not names:
        raise FileFormatError(message("error.has_no_rows", where=path))
    index = {name: i for i, name in enumerate(poses.names)}
    lost = [(row + 2, name) for row, name in enumerate(names) if name not in index]
    if lost:
        raise gathered(str(path), [message("calibration.pose_not_listed", path=path, line=line, name=repr(name)) for line, name in lost])
    passage = table.numbers("pass") if "pass" in table.columns else np.ones(len(names))
    measured = tuple(c for c in rig.observed if c.passage in set(passage.tolist()))
    if not any(c.is_cable for c in measured):
        raise FileFormatError(message("error.no_cable_of_the", where=path, passage=passage[0]))
    # a drum without a column is an error; encoders are optional
    cables = tuple(c for c in measured if c.is_cable or c.channel in table.columns)
    unread = dict.fromkeys(c.channel for c in measured if c not in cables)
    notes = tuple(message("calibration.encoder_counts_csv_has", channel=channel) for channel in unread)
    pose_of = np.array([index[name] for name in names])
    visit_of = _visits(pose_of, passage)
    stated = read_pose_table(folder / "reference_poses.csv", rig.angles, columns)
    warm = _temperatures(stated, table, pose_of)
    # each pose's first visit in the order of reference_poses.csv, later ones behind
    again = sorted({(v, i) for v, i in zip(visit_of.tolist(), pose_of.tolist(), strict=True) if v})
    place = {(0, i): i for i in range(len(poses))} | {key: len(poses) + n for n, key in enumerate(again)}
    counts, zero = np.full((len(place), len(cables)), np.nan), np.zeros(len(cables), dtype=np.int64)
    counted = np.zeros(counts.shape, dtype=np.int64)
    variance, at_zero, dwelt = np.full(counts.shape, 1.0 / 12.0), np.zeros(len(cables)), False
    temperature = np.full(counts.shape, REFERENCE_C if rig.reference_temperature_c is None else rig.reference_temperature_c)
    for j, c in enumerate(cables):
        recorded = table.numbers(c.channel, gaps=True)
        rows = np.flatnonzero(passage == c.passage)
        drum = rig.counter(c)
        readings = {}
        for i in dict.fromkeys(place[visit_of[row], pose_of[row]] for row in rows.tolist()):
            own = [row for row in rows.tolist() if place[visit_of[row], pose_of[row]] == i and np.isfinite(recorded[row])]
            if own:
                what = f"{path}:{own[0] + 2}: channel {c.channel}"
                if drum.codes is not None and not ((recorded[own] >= 0) & (recorded[own] < drum.codes)).all():
                    raise FileFormatError(message("error.is_no_code_of", where=what, recorded=recorded[own[0]], codes=drum.codes - 1))
                readings[i] = _dwell(recorded[own], drum, what)
                counted[i, j] = own[0]
                if warm is not None:
                    temperature[i, j] = warm[own].mean()
        scatter = pooled_scatter(list(readings.values()))
        for i, values in readings.items():
            counts[i, j] = values.mean() * drum.count_sign / drum.scale
            # noise that the dwells do not show is in every mean all the same
            noise = (drum.u_reading / drum.per_count * drum.scale) ** 2
            variance[i, j] = mean_variance(scatter, len(values)) + max(0.0, noise - scatter) / len(values)
            dwelt = dwelt or len(values) > 1 or noise > 0.0
        zero[j] = place[visit_of[rows[0]], pose_of[rows[0]]]
        if drum.absolute:
            continue
        read = readings.get(int(zero[j]), np.zeros(1))
        if not (drum.zero_exact and not read.any()) or (scatter > 0.0 and len(read) > 1):
            at_zero[j] = variance[zero[j], j]
        if not np.isfinite(counts[zero[j], j]):
            raise FileFormatError(
                message("error.channel_has_no_count", where=path, rows=rows[0] + 2, channel=c.channel, names=names[rows[0]])
            )
    campaign = Campaign(
        rig,
        poses,
        cables,
        counts,
        zero,
        inputs,
        notes,
        temperature_c=None if warm is None else temperature,
        dwell_variance=variance if dwelt else None,
        zero_variance=at_zero if dwelt else None,
        u_visit=_repeatability(stated),
        counted=counted,
        angles=_angles(stated, conventions.convention(rig.angles).columns),
        source=_source(stated),
    )
    return _unwrapped(_checked(_with_visits(campaign, again), path))


def _visits(poses: IntArray, passage: FloatArray) -> IntArray:
    """(r,) number of the visit, from 0, of its pose (r,) that each row of counts belongs to; passes are visits of their own motion."""
    visit = np.zeros(len(poses), dtype=np.int64)
    for p in np.unique(passage):
        rows = np.flatnonzero(passage == p)
        seen: dict[int, int] = {}
        for before, row in zip([-1, *rows[:-1].tolist()], rows.tolist(), strict=True):
            i = int(poses[row])
            if before < 0 or int(poses[before]) != i:
                seen[i] = seen.get(i, -1) + 1
            visit[row] = seen[i]
    return visit


def _temperatures(stated: files.Table, counts: files.Table, pose_of: IntArray) -> FloatArray | None:
    """(r,) temperature at which each row of counts was read: its own, or that stated for its reference pose; None where neither is."""
    name = "temperature_c"
    of_poses = _column(stated, name)
    if name not in counts.columns:
        return None if of_poses is None else of_poses[pose_of]
    if of_poses is not None:
        raise FileFormatError(message("error.has_and_so_has", where=counts.path, name=name, name2=stated.path.name))
    values = counts.numbers(name)
    conventions.check_temperature(values, f"{counts.path}: column {name!r}")
    return values


def _dwell(recorded: FloatArray, drum: Drum | SensorTable, what: str) -> FloatArray:
    """Return the readings of one dwell with wraps undone; FileFormatError if the robot cannot have been at rest."""
    change = recorded - recorded[0]
    full = drum.codes if drum.codes is not None else None if drum.counter_bits is None else 2.0**drum.counter_bits
    if full is not None:
        change = change - full * np.rint(change / full)
    at_mm = 1.0 if drum.is_length else ARM_MM
    moved = float(change.max() - change.min()) * drum.per_count / drum.scale * at_mm
    if moved > STILL_MM:
        raise FileFormatError(message("error.moves_mm_between_readings", where=what, moved=moved, still_mm=STILL_MM))
    return np.asarray(recorded[0] + change)


def _with_visits(campaign: Campaign, again: list[tuple[int, int]]) -> Campaign:
    """The campaign with a pose for every visit: later visits repeat the pose that they return to, and share its error."""
    if not again:
        return campaign
    order = np.array([*range(len(campaign.poses)), *(i for _, i in again)], dtype=np.int64)
    poses = campaign.poses
    names = (*poses.names, *(f"{poses.names[i]} (visit {v + 1})" for v, i in again))
    own = campaign.u_visit
    every = replace(poses.of(order), names=names)
    note: str = message("calibration.later_visit_s_pose", n=len(again))
    if own is None:
        note = joined((note, message("calibration.no_repeatability")))
    return replace(
        campaign,
        poses=every,
        reference=order,
        u_visit=None if own is None else own[order],
        angles=None if campaign.angles is None else campaign.angles[order],
        notes=(*campaign.notes, note),
    )


def _angles(table: files.Table, columns: tuple[str, ...]) -> FloatArray | None:
    """(n, 3) the angles as the table has them, or None without them."""
    return np.column_stack([table.numbers(name) for name in columns]) if set(columns) <= set(table.columns) else None


def _source(table: files.Table) -> Source:
    """Return the source of the reference poses from the column `reference`; FileFormatError for several or unknown ones."""
    given = dict.fromkeys(table.text("reference")) if "reference" in table.columns else {"unknown": None}
    if len(given) != 1 or not set(given) <= set(get_args(Source)):
        raise FileFormatError(
            message(
                "error.column_reference_has_write", where=table.path, given=", ".join(map(repr, given)), options=", ".join(get_args(Source))
            )
        )
    return cast(Source, next(iter(given)))


def _column(table: files.Table, name: str) -> FloatArray | None:
    """(n,) a column of the reference poses, or None without it."""
    if name not in table.columns:
        return None
    values = table.numbers(name)
    if name == "temperature_c":
        conventions.check_temperature(values, f"{table.path}: column {name!r}")
    elif (values < 0).any():
        raise FileFormatError(message("error.column_a_standard_uncertainty", where=table.path, name=name))
    return values


def further_columns(folder: Path, new: int) -> dict[str, FloatArray]:
    """Return a folder's statements on the reference poses beside their covariances, extended by `new` poses. The robot comes to new poses
    no better than to any other; their temperatures are unknown (NaN)."""
    stated, out = files.read_table(Path(folder) / "reference_poses.csv"), {}
    for name in (*_REPEATABILITY, "temperature_c"):
        values = _column(stated, name)
        if values is not None:
            out[name] = np.concatenate([values, np.full(new, np.nan if name == "temperature_c" else values.max())])
    return out


def _repeatability(stated: files.Table) -> FloatArray | None:
    """(n, 6) standard deviations (rotation [rad]; position [mm]) with which the robot comes to a pose, or None where none is stated."""
    place, turn = (_column(stated, name) for name in _REPEATABILITY)
    if place is None and turn is None:
        return None
    n = len(place if place is not None else turn if turn is not None else ())
    parts = [np.zeros(n) if turn is None else np.radians(turn), np.zeros(n) if place is None else place]
    return np.repeat(np.column_stack(parts), 3, axis=1)


STILL_PART = 0.1
"""Part of the way between poses: a cable that the nominal rig changes by less may not have changed at all."""


def _checked(campaign: Campaign, path: Path) -> Campaign:
    notes = []
    for j, c in enumerate(campaign.cables):
        counted = int(np.isfinite(campaign.counts[:, j]).sum())
        if counted < MIN_POSES:
            raise CalibrationError(
                message("error.channel_is_counted_at", where=path, channel=c.channel, counted=counted, min_poses=MIN_POSES)
            )
        if not c.is_cable:
            _check_turning(campaign, j, f"{path}: channel {c.channel}")
            continue
        if campaign.counts[:, j][campaign.used[:, j]].any():
            continue
        drum = campaign.rig.point(c.from_point).drum
        try:
            change = float(np.nanmax(np.abs(_predicted(campaign, j)))) * drum.count_length_mm / drum.scale
        except GeometryError:
            change = np.inf
        way = float(np.linalg.norm(campaign.poses.rows[:, :3] - campaign.poses.rows[campaign.zero[j], :3], axis=1).max())
        if not drum.braked and change > STILL_PART * way:
            raise CalibrationError(message("error.channel_does_not_move", where=path, channel=c.channel, change=change))
        notes.append(message("calibration.channel_all_counts_zero", channel=c.channel))
    return replace(campaign, notes=(*campaign.notes, *notes)) if notes else campaign


LEAST_TURN = math.radians(1.0)


def _check_turning(campaign: Campaign, j: int, what: str) -> None:
    """CalibrationError where an encoder shows one count alone, and should turn by the nominal rig."""
    if np.nanmax(campaign.counts[:, j]) > np.nanmin(campaign.counts[:, j]):
        return
    try:
        turn = (
            float(np.ptp(_predicted(campaign, j)[np.isfinite(campaign.counts[:, j])])) * campaign.rig.counter(campaign.cables[j]).per_count
        )
    except GeometryError:
        return
    if turn > LEAST_TURN:
        raise CalibrationError(
            message("error.does_not_move_all", what=what, nanmax=np.nanmax(campaign.counts[:, j]), turn=math.degrees(turn))
        )


def _predicted(campaign: Campaign, j: int) -> FloatArray:
    """(n,) counts of the j-th cable at the reference poses by the nominal rig; GeometryError where it cannot run there."""
    warm = campaign.temperature_c
    own = None if warm is None else warm[:, j]
    begun = None if own is None else float(own[campaign.zero[j]])
    at_zero = campaign.poses.rows[campaign.zero[j]]
    return counts_from_poses(
        campaign.rig, campaign.poses.rows, at_zero, (campaign.cables[j],), temperature_c=own, zero_temperature_c=begun
    )[:, 0]


def _unwrapped(campaign: Campaign) -> Campaign:
    """Counters that wrap between poses: the number of turns of the register that comes nearest to the nominal rig's prediction."""
    counts = campaign.counts.copy()
    notes = []
    for j, c in enumerate(campaign.cables):
        drum = campaign.rig.counter(c)
        if drum.counter_bits is None or drum.counter_bits > 32:
            continue
        full = 2.0**drum.counter_bits / drum.scale
        if not np.nanmax(np.abs(counts[:, j])) > full / 4:
            continue
        try:
            predicted = _predicted(campaign, j)
        except GeometryError:
            continue
        turns = np.rint((predicted + counts[campaign.zero[j], j] - counts[:, j]) / full)
        turns[campaign.zero[j]] = 0
        if np.nansum(np.abs(turns)) > 0:
            notes.append(message("calibration.channel_bit_counter_unwrapped", channel=c.channel, bits=drum.counter_bits))
            counts[:, j] += turns * full
    return replace(campaign, counts=counts, notes=(*campaign.notes, *notes))
