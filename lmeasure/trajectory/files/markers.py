"""Trajectories of a rigid body from labelled markers, in exports of motion capture: tables of tabs, three columns for each marker.

The body's shape is found from all frames together, its poses by rotating it onto each frame (Kabsch, Acta Cryst. A 34, 1978). The residuals
are the uncertainty of a marker, from which that of the poses follows. Swapped labels are corrected if that explains a frame, a single
outlying marker is omitted, and both are reported. Its origin is the middle of the markers, its axes are those of the instrument in the
first frame that shows all of them.
"""

import re
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.core import BoolArray, FileFormatError, FloatArray, IntArray, se3
from lmeasure.io import text_of
from lmeasure.text import Message, message

LEAST = 3  # Markers of a frame from which a pose follows
ROUNDS = 8
WORSE = 6.0  # Times the usual misfit of a frame from which something is wrong with it
FLAT = 1e-3  # Relative to the largest extent of the visible markers: a smaller width counts as a line
EXACT_MM = 1e-6  # Least uncertainty of a marker: numbers that fit exactly are rounded
_SIZES = {"mm": 1.0, "cm": 10.0, "m": 1e3}


@dataclass(frozen=True)
class Marked:
    """Frames (n) of labelled markers (m): time_s (n,), places (n, m, 3) [mm], NaN where one was not seen, and lines (n,) of the file."""

    names: tuple[str, ...]
    time_s: FloatArray
    places: FloatArray
    lines: tuple[int, ...]


@dataclass(frozen=True)
class Body:
    """poses (n, 7) of the body, NaN where it is hidden, covariance (n, 6, 6) of (rotation [rad]; position [mm]), standard uncertainty of a
    marker's coordinate [mm], and remarks."""

    poses: FloatArray
    covariance: FloatArray
    u_marker_mm: float
    notes: tuple[Message, ...]


def is_of_markers(text: str) -> bool:
    """Return whether the beginning of a file is one of labelled markers."""
    return bool(re.match(r"\ufeff?\s*(NO_OF_FRAMES|PathFileType)\t", text))


def read_markers(path: Path) -> Marked:
    """Read labelled markers: a header of KEY<tab>values up to MARKER_NAMES, or a .trc of PathFileType 4. FileFormatError names the line."""
    lines = text_of(path).splitlines()
    first = lines[0].split("\t")
    return _of_trc(path, lines) if first[0].strip() == "PathFileType" else _of_keys(path, lines)


def body_of(marked: Marked, path: Path) -> Body:
    """Return the rigid body of the markers; FileFormatError if they are too few, or lie on a line."""
    places, names = marked.places.copy(), marked.names
    seen = _seen(places)
    enough = seen.sum(axis=1) >= LEAST
    if not enough.any():
        raise FileFormatError(message("error.no_frame_shows_of", where=path, least=LEAST, names=", ".join(names)))
    whole = np.flatnonzero(seen.sum(axis=1) == seen.sum(axis=1).max())
    shape = _first_shape(path, places[whole[0]] if len(whole) == 1 else places[_usual(places, whole)])
    for _ in range(ROUNDS):
        turns, middles, left = _fitted(places, shape)
        back = np.einsum("nij,nmi->nmj", turns, places - middles[:, None])
        good = enough & (left <= WORSE * max(float(np.nanmedian(left[enough])), EXACT_MM))
        shape = _centred(np.nanmedian(np.where(good[:, None, None], back, np.nan), axis=0), shape)
    usual = max(float(np.nanmedian(left[enough])), EXACT_MM)
    odd = np.flatnonzero(enough & (left > WORSE * usual))
    swaps, strays = _mended(places, shape, odd, WORSE * usual)
    seen = _seen(places)
    turns, middles, left = _fitted(places, shape)

    def said(code: str, frames: list[int], **of: str) -> Message:
        return message(code, frames=len(frames), at_s=float(marked.time_s[frames[0]]), line=marked.lines[frames[0]], **of)

    notes = [said("markers.swapped", frames, one=names[a], other=names[b]) for (a, b), frames in swaps.items()]
    notes += [said("markers.stray", frames, marker=names[k]) for k, frames in strays.items()]
    fits = (seen.sum(axis=1) >= LEAST) & (left <= WORSE * usual)
    wrong = (seen.sum(axis=1) >= LEAST) & ~fits
    if wrong.any():
        notes.append(said("markers.no_body", np.flatnonzero(wrong).tolist()))
    missing = [(name, int((~s).sum())) for name, s in zip(names, _seen(marked.places).T, strict=True) if not s.all()]
    notes += [message("markers.missing", marker=name, frames=count, of=len(places)) for name, count in missing]
    first = int(whole[0])
    shape = shape @ turns[first].T if not np.isnan(turns[first]).any() else shape
    turns, middles, left = _fitted(np.where(fits[:, None, None], places, np.nan), shape)
    u = _scatter(left, seen, fits)
    poses = np.full((len(places), 7), np.nan)
    poses[fits] = se3.pose(middles[fits], Rotation.from_matrix(turns[fits]))
    if np.isnan(u):
        raise FileFormatError(message("error.frames_of_markers_are", where=path, fits=int(fits.sum()), n_names=len(names)))
    notes.append(message("markers.body", markers=len(names), u_mm=u, frames=int(fits.sum()), of=len(places)))
    return Body(poses, _covariances(shape, turns, seen, fits) * u**2, u, tuple(notes))


def _seen(places: FloatArray) -> BoolArray:
    """(n, m) which markers a frame shows."""
    return np.asarray(~np.isnan(places).any(axis=2))


def _fitted(places: FloatArray, shape: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (n, 3, 3) rotations and (n, 3) places of the shape's origin that bring the shape (m, 3) onto the visible markers, and (n,)
    root mean square of the residuals per degree of freedom; NaN for a frame with too few."""
    seen = _seen(places) & ~np.isnan(shape).any(axis=1)
    count = seen.sum(axis=1)
    good = count >= LEAST
    weight = seen / np.maximum(count, 1)[:, None]
    there, body = np.where(seen[:, :, None], places, 0.0), np.where(np.isnan(shape), 0.0, shape)
    centre, own = np.einsum("nm,nmi->ni", weight, there), weight @ body
    moment = np.einsum("nm,nmi,nmj->nij", weight, there - centre[:, None], body[None] - own[:, None])
    u, _, vt = np.linalg.svd(moment)
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    turns = u @ vt
    middles = centre - np.einsum("nij,nj->ni", turns, own)
    off = np.where(seen[:, :, None], there - middles[:, None] - np.einsum("nij,mj->nmi", turns, body), 0.0)
    left = np.sqrt((off**2).sum(axis=(1, 2)) / np.maximum(3 * count - 6, 1))
    for out in (turns, middles, left):
        out[~good] = np.nan
    return turns, middles, left


def _usual(places: FloatArray, frames: IntArray) -> int:
    """The frame whose distances between markers are nearest to the median ones: its labels are right if those of most are."""
    some = frames[np.unique(np.linspace(0, len(frames) - 1, min(len(frames), 500)).astype(int))]
    apart = np.linalg.norm(places[some, :, None] - places[some, None], axis=3)
    with np.errstate(invalid="ignore"):
        off = np.nansum(np.abs(apart - np.median(apart, axis=0)), axis=(1, 2))
    return int(some[int(np.argmin(off))])


def _first_shape(path: Path, places: FloatArray) -> FloatArray:
    """Return the (m, 3) shape about the middle of the visible markers; FileFormatError if these lie on a line."""
    shape = places - np.nanmean(places, axis=0)
    size = np.linalg.svd(shape[~np.isnan(shape).any(axis=1)], compute_uv=False)
    if size[1] < FLAT * size[0]:
        raise FileFormatError(message("error.its_markers_stand_in", where=path))
    return shape


def _centred(shape: FloatArray, before: FloatArray) -> FloatArray:
    """Return the shape about its middle; markers that no frame shows stay the same."""
    known = np.where(np.isnan(shape), before, shape)
    return np.asarray(known - np.nanmean(known, axis=0))


def _mended(
    places: FloatArray, shape: FloatArray, odd: IntArray, limit: float
) -> tuple[dict[tuple[int, int], list[int]], dict[int, list[int]]]:
    """Correct in places (n, m, 3) the frames `odd`: two swapped labels, or an outlying marker, which is removed. Return the frames of
    each."""
    swaps: dict[tuple[int, int], list[int]] = {}
    strays: dict[int, list[int]] = {}
    for i in odd.tolist():
        there = np.flatnonzero(~np.isnan(places[i]).any(axis=1))
        pairs = list(combinations(there.tolist(), 2))
        tried = np.repeat(places[i][None], len(pairs), axis=0)
        for row, (a, b) in enumerate(pairs):
            tried[row, [a, b]] = tried[row, [b, a]]
        left = _fitted(tried, shape)[2]
        best = int(np.argmin(left))
        if left[best] <= limit:
            places[i] = tried[best]
            swaps.setdefault(pairs[best], []).append(i)
            continue
        if len(there) <= LEAST:
            continue
        tried = np.repeat(places[i][None], len(there), axis=0)
        tried[np.arange(len(there)), there] = np.nan
        left = _fitted(tried, shape)[2]
        best = int(np.argmin(left))
        if left[best] <= limit:
            places[i] = tried[best]
            strays.setdefault(int(there[best]), []).append(i)
    return swaps, strays


def _scatter(left: FloatArray, seen: BoolArray, fits: BoolArray) -> float:
    """Return the standard uncertainty of a marker's coordinate [mm] from the residuals, corrected for the shape's freedom; NaN without
    any."""
    freedom = (3 * seen.sum(axis=1) - 6)[fits]
    spare = float(freedom.sum() - (3 * int(seen[fits].any(axis=0).sum()) - 6))
    return max(float(np.sqrt((left[fits] ** 2 * freedom).sum() / spare)), EXACT_MM) if spare > 0 else float("nan")


def _covariances(shape: FloatArray, turns: FloatArray, seen: BoolArray, fits: BoolArray) -> FloatArray:
    """Return the (n, 6, 6) covariance of (rotation; position) by markers of unit uncertainty: the inverse of the sum of their
    information."""
    out = np.zeros((len(turns), 6, 6))
    arms = np.einsum("nij,mj->nmi", turns[fits], shape)
    moves = se3.at_points(arms.reshape(-1, 3))[:, 3:].reshape(*arms.shape[:2], 3, 6)
    moves = np.where(seen[fits][:, :, None, None], moves, 0.0)
    out[fits] = np.linalg.inv(np.einsum("nmik,nmil->nkl", moves, moves))
    return out


def _of_keys(path: Path, lines: list[str]) -> Marked:
    keys: dict[str, list[str]] = {}
    number = 0
    for line in lines:
        cells = [cell.strip() for cell in line.split("\t")]
        number += 1
        if not re.fullmatch(r"[A-Z][A-Z0-9_]*", cells[0]):
            break
        keys[cells[0]] = [cell for cell in cells[1:] if cell]
    names = tuple(keys.get("MARKER_NAMES", ()))
    if not names:
        raise FileFormatError(message("error.has_no_marker_names", where=path))
    if "3D" not in keys.get("DATA_INCLUDED", ["3D"]):
        raise FileFormatError(message("error.data_included_is_export", where=path, keys=" ".join(keys["DATA_INCLUDED"])))
    timed = lines[number - 1].split("\t")[0].strip().lower() == "frame" if number <= len(lines) else False
    rate = _number(path, keys.get("FREQUENCY", ["0"])[0], "FREQUENCY")
    if not timed and rate <= 0.0:
        raise FileFormatError(message("error.has_neither_columns_frame", where=path))
    return _rows(path, lines, number + timed, names, 2 if timed else 0, rate, 1.0)


def _of_trc(path: Path, lines: list[str]) -> Marked:
    if len(lines) < 6:
        raise FileFormatError(message("error.is_cut_off_within", where=path))
    head = dict(zip(lines[1].split("\t"), lines[2].split("\t"), strict=False))
    unit = head.get("Units", "").strip()
    if unit not in _SIZES:
        raise FileFormatError(message("error.line_3_units_is", where=path, unit=unit, sizes=", ".join(_SIZES)))
    names = tuple(cell.strip() for cell in lines[3].split("\t")[2:] if cell.strip())
    return _rows(path, lines, 6, names, 2, 0.0, _SIZES[unit])


def _rows(path: Path, lines: list[str], first: int, names: tuple[str, ...], before: int, rate: float, size: float) -> Marked:
    """Rows from line `first` on, `before` columns of frame and time before those of the markers."""
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise FileFormatError(message("error.marker_stands_twice", where=path, twice=twice[0]))
    wide, time_s, places, numbers = before + 3 * len(names), [], [], []
    for number, line in enumerate(lines[first - 1 :], first):
        if not line.strip():
            continue
        cells = [cell.strip() for cell in line.rstrip("\r\n").split("\t")]
        cells += [""] * (wide - len(cells))
        if any(cells[wide:]):
            has = {"n_cells": len(cells), "n_names": len(names), "wide": wide}
            raise FileFormatError(message("error.line_has_cells_markers", where=path, number=number, **has))
        values = [_number(path, cell, f"line {number}") for cell in cells[:wide]]
        time_s.append(values[1] if before else (number - first) / rate)
        places.append(values[before:])
        numbers.append(number)
    if not places:
        raise FileFormatError(message("error.has_no_rows", where=path))
    there = np.array(places).reshape(len(places), len(names), 3)
    there[(there == 0.0).all(axis=2)] = np.nan
    there[np.isnan(there).any(axis=2)] = np.nan
    return Marked(names, np.array(time_s), size * there, tuple(numbers))


def _number(path: Path, cell: str, where: str) -> float:
    if cell.lower() in ("", "nan", "null", "-"):
        return float("nan")
    try:
        value = float(cell.replace(",", "."))
    except ValueError:
        value = float("inf")
    if not np.isfinite(value):
        raise FileFormatError(message("error.is_no_number_3", where=path, where2=where, cell=cell))
    return value
