"""The trajectory: poses over time with their status and uncertainty."""

import json
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lmeasure import core
from lmeasure.core import BoolArray, DataFrame, FloatArray, IntArray, Shown, Status, TextArray, framed
from lmeasure.io import files
from lmeasure.recording import POSITION_COLUMNS
from lmeasure.text import Lines, Message, message, of_file
from lmeasure.trajectory.time.stamps import stamps_of
from lmeasure.trajectory.uncertainty.assumed import NOTHING, Assumed

if TYPE_CHECKING:
    import xarray as xr

UNCERTAINTY_COLUMNS = ("u_x_mm", "u_y_mm", "u_z_mm", "u_rx_rad", "u_ry_rad", "u_rz_rad")
COLUMNS_OF_OURS = (
    "time_s", *POSITION_COLUMNS, *core.QUATERNION_COLUMNS, "residual_mm", "iterations", "status", "cause", "cable",
    "worst_pressure_angle_deg", *UNCERTAINTY_COLUMNS,
)  # fmt: skip
"""Columns of every table of a trajectory that this program wrote."""
SYSTEMATIC_COLUMNS = tuple(name.replace("u_", "u_systematic_", 1) for name in UNCERTAINTY_COLUMNS)
"""The part of those that the whole run has in common."""
NAMES = ", "  # Between the names of cables where a sample is good without several
_PLACES = [3, 4, 5, 0, 1, 2]  # of those columns in (rotation; tool origin)
_DIAGONAL = np.array([7 * place for place in _PLACES])  # in a covariance as one row


@dataclass(frozen=True, repr=False)
class Trajectory(Shown):
    """Poses of the tool over n samples, with status and uncertainty. Values of samples that are not ok are NaN.

    Covariances are of (rotation [rad]; tool origin [mm]) in the base frame, R_true = Exp(delta) R. `covariances` correlates samples.

    Examples
    --------
    >>> trajectory.poses.shape, bool((trajectory.status == 0).all())
    ((58, 7), True)
    """

    time_s: FloatArray
    """(n,) times [s]."""
    poses: FloatArray
    """(n, 7) poses base_from_tool: x, y, z [mm], qx, qy, qz, qw (unit quaternion)."""
    residual_mm: FloatArray
    """(n,) largest absolute length residual [mm]; NaN without redundant cables."""
    iterations: IntArray
    """(n,) iterations of the solver."""
    status: IntArray
    """(n,) `Status` of each sample; 0 is ok."""
    cause: TextArray
    """(n,) cause of a status, a code of `lmeasure.text`."""
    cable: TextArray
    """(n,) cable of a status; of ok samples, the cables not used."""
    worst_pressure_angle_deg: FloatArray
    """(n,) largest pressure angle of the cables [deg]."""
    random: FloatArray
    """(n, 6, 6) covariance of errors that are independent between samples, such as the resolution of the counts."""
    systematic: FloatArray
    """(n, 6, 6) covariance of errors that the run shares, such as calibration, start pose and clocks of passes."""
    covers: str
    """Effects included in the uncertainties, in words."""
    notes: tuple[Message, ...] = ()
    """Notes for the user."""
    chi_squared: FloatArray | None = None
    """(n,) chi-squared of the contradictions between redundant lengths; NaN without redundant cables. None: not computed."""
    assumed: Assumed = NOTHING
    """Effect of assumed typical sizes, and the statements that would help most."""
    absent: tuple[str, ...] = ()
    """Quantities without a stated uncertainty: "position", "rotation"."""
    u95_assumed_mm: FloatArray | None = None
    """(n,) part of the position's U95 that assumed values make [mm]; None: not computed."""

    def about(self) -> dict[str, str]:
        """Return samples, worst angle, uncertainty and its sources."""
        summary = self.overview()
        return {
            "samples": f"{summary.samples}, " + ", ".join(f"{count} {word}" for word, count in summary.statuses.most_common()),
            "worst pressure angle": f"{summary.worst_angle:.1f} deg",
            "largest u": f"{summary.u_position:.4f} mm, {math.degrees(summary.u_rotation):.5f} deg",
            "u covers": self.covers,
        }

    def to_frame(self) -> DataFrame:
        """The columns of a trajectory file."""
        return framed(self.columns())

    def to_xarray(self) -> "xr.Dataset":
        """The columns of a trajectory file over time_s, and the covariances (rotation [rad]; tool origin [mm])."""
        import xarray as xr

        columns = self.columns()
        time_s = columns.pop("time_s")
        whole = {name: (("time_s", "row", "column"), getattr(self, name)) for name in ("random", "systematic")}
        attributes = {"u_covers": self.covers, "notes": "\n".join(map(str, self.notes))}
        return xr.Dataset({name: ("time_s", values) for name, values in columns.items()} | whole, {"time_s": time_s}, attributes)

    @cached_property
    def u(self) -> FloatArray:
        """(n, 6) standard uncertainties in the order of `UNCERTAINTY_COLUMNS`: tool origin [mm], small rotation [rad]."""
        return np.sqrt(_variances(self.random) + _variances(self.systematic))

    def columns(self, angles: str | None = None) -> dict[str, Any]:
        """Columns of a trajectory file; with the angles of a controller's convention, behind the others, when one is named."""
        out: dict[str, Any] = {"time_s": self.time_s}
        out |= dict(zip(POSITION_COLUMNS, self.poses[:, :3].T, strict=True))
        out |= dict(zip(core.QUATERNION_COLUMNS, self.poses[:, 3:].T, strict=True))
        out |= {"residual_mm": self.residual_mm, "iterations": self.iterations, "status": core.words(self.status)}
        out |= {"cause": self.cause, "cable": self.cable, "worst_pressure_angle_deg": self.worst_pressure_angle_deg}
        out |= dict(zip(UNCERTAINTY_COLUMNS, self.u.T, strict=True))
        out |= dict(zip(SYSTEMATIC_COLUMNS, np.sqrt(_variances(self.systematic)).T, strict=True))
        if self.u95_assumed_mm is not None:
            out["u95_assumed_mm"] = self.u95_assumed_mm
        if self.chi_squared is not None:
            out["chi_squared"] = self.chi_squared
        if angles is not None:
            values = np.full((len(self.poses), 3), np.nan)
            known = ~np.isnan(self.poses[:, 3:]).any(axis=1)
            values[known] = core.angles_from_rotation(angles, core.se3.rotation(self.poses[known]))
            out |= dict(zip(core.convention(angles).columns, values.T, strict=True))
        return out

    def summary(self) -> str:
        """Return a few lines: number of samples by status, worst residual and angle, sources in the uncertainties."""
        return self.overview().text()

    def overview(self) -> "Summary":
        """Return its messages."""
        summary = Summary()
        summary.add(self)
        return summary


class Summary:
    """Return the notes on a trajectory that comes in pieces; first: number of its first sample in the run."""

    def __init__(self, first: int = 0) -> None:
        self.first, self.samples = first, 0
        self.statuses: Counter[str] = Counter()
        self.first_bad = ""
        self.worst_angle = self.u_position = self.u_rotation = 0.0
        self.covers = ""
        self.notes: list[Message] = []
        self.apart_s: tuple[float, float] | None = None
        """Least and largest interval of stamps where those jitter."""
        self.assumed = NOTHING

    def add(self, piece: Trajectory) -> None:
        """Take the next piece into account."""
        codes, times = np.unique(piece.status, return_counts=True)
        self.statuses.update({core.WORDS[code]: int(n) for code, n in zip(codes, times, strict=True)})
        if not self.first_bad and (piece.status != Status.OK).any():
            i = int(np.argmax(piece.status != Status.OK))
            code, cable = f"trajectory_line.at{'_cable' if piece.cable[i] else ''}", str(piece.cable[i])
            self.first_bad = message(code, i=self.first + self.samples + i, time=float(piece.time_s[i]), cable=cable, cause=piece.cause[i])
        self.samples += len(piece.time_s)
        # fmax ignores unmeasured samples
        self.worst_angle = float(np.fmax.reduce(piece.worst_pressure_angle_deg, initial=self.worst_angle))
        self.u_position = float(np.fmax.reduce(np.linalg.norm(piece.u[:, :3], axis=1), initial=self.u_position))
        self.u_rotation = float(np.fmax.reduce(np.linalg.norm(piece.u[:, 3:], axis=1), initial=self.u_rotation))
        self.covers = piece.covers
        self.notes += [note for note in piece.notes if note not in self.notes]
        if stamps_of(piece).kind != "sound":
            intervals = np.diff(piece.time_s)
            least, largest = self.apart_s or (np.inf, 0.0)
            self.apart_s = min(least, float(intervals.min())), max(largest, float(intervals.max()))
        self.assumed = self.assumed.joined(piece.assumed)

    def join(self, other: "Summary") -> None:
        """Take the part that follows into account."""
        self.samples += other.samples
        self.statuses.update(other.statuses)
        self.first_bad = self.first_bad or other.first_bad
        self.worst_angle = max(self.worst_angle, other.worst_angle)
        self.u_position, self.u_rotation = max(self.u_position, other.u_position), max(self.u_rotation, other.u_rotation)
        self.covers = other.covers
        self.notes += [note for note in other.notes if note not in self.notes]
        both = [span for span in (self.apart_s, other.apart_s) if span is not None]
        self.apart_s = (min(low for low, _ in both), max(high for _, high in both)) if both else None
        self.assumed = self.assumed.joined(other.assumed)

    def figures(self) -> dict[str, float]:
        """Numbers by name."""
        found = {"samples": float(self.samples), "with_a_pose": float(self.statuses["ok"])}
        if self.statuses["ok"]:
            found |= {"worst_pressure_angle_deg": self.worst_angle, "largest_u_position_mm": self.u_position}
            found |= {"largest_u_rotation_deg": math.degrees(self.u_rotation)} if self.u_rotation else {}
        return found | self.assumed.figures()

    def text(self) -> str:
        """The lines."""
        statuses = tuple(message(f"trajectory_line.status.{name}", n=n) for name, n in self.statuses.most_common())
        lines: list[str] = [message("trajectory_line.samples", samples=self.samples, statuses=statuses)]
        if self.first_bad:
            lines.append(message("trajectory_line.first", what=self.first_bad))
        if self.statuses["ok"]:
            degrees = float(np.degrees(self.u_rotation))
            rotation = message("trajectory_line.rotation", deg=degrees) if degrees else message("trajectory.orientation_not_measured")
            lines.append(message("trajectory.worst_pressure_angle_deg", angle=self.worst_angle, u=self.u_position, rotation=rotation))
        lines.append(message("trajectory.uncertainties", covers=self.covers))
        lines += self.assumed.lines
        lines += [message("line.note", text=note) for note in self.notes]
        if self.apart_s is not None:
            least, largest = (1e3 * interval for interval in self.apart_s)
            lines.append(message("line.note", text=message("trajectory_line.jitter", least=least, largest=largest)))
        return Lines(lines)


def read_own(path: Path) -> Trajectory:
    """Read the output of `written.write_trajectory`; covariances come back as their diagonals. FileFormatError names the row and column."""
    table = files.read_table(path)
    u = table.matrix(UNCERTAINTY_COLUMNS, gaps=True)
    # a trajectory of another program may lack the two parts
    common = table.matrix(SYSTEMATIC_COLUMNS, gaps=True) if SYSTEMATIC_COLUMNS[0] in table.columns else np.zeros_like(u)
    poses = table.matrix((*POSITION_COLUMNS, *core.QUATERNION_COLUMNS), gaps=True)
    far = np.abs(poses[:, :3]) > core.MAX_LENGTH_MM
    _refuse(path, POSITION_COLUMNS, poses[:, :3], far, message("trajectory_file.beyond", mm=core.MAX_LENGTH_MM))
    for columns, values in ((UNCERTAINTY_COLUMNS, u), (SYSTEMATIC_COLUMNS, common)):
        _refuse(path, columns, values, values < 0.0, message("trajectory_file.no_u"))
    known = json.loads(table.kept("messages") or "[]")
    if "cause_message" in table.columns:
        known += map(_loaded, set(table.labels("cause_message").tolist()) - {""})
    solved = table.numbers("time_s"), poses, table.numbers("residual_mm", gaps=True), table.numbers("iterations").astype(np.int64)
    of_samples = table.choices("status", core.WORDS), of_file(table.labels("cause"), known), table.labels("cable")
    angle, covariances = table.numbers("worst_pressure_angle_deg", gaps=True), (np.maximum(u**2 - common**2, 0.0), common**2)
    random, systematic = map(diagonal, covariances)
    names = ("chi_squared", "u95_assumed_mm")
    more: dict[str, Any] = {name: table.numbers(name, gaps=True) for name in names if name in table.columns}
    return Trajectory(*solved, *of_samples, angle, random, systematic, message("covers.file_"), **more)


def _loaded(cell: str) -> dict[str, Any]:
    """Return the id and values of a cause that a cell has; empty where it has something else."""
    try:
        found = json.loads(cell)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def _refuse(path: Path, columns: Sequence[str], values: FloatArray, bad: BoolArray, why: str) -> None:
    """FileFormatError names the first value that is bad."""
    if bad.any():
        row, column = (int(i) for i in np.argwhere(bad)[0])
        value = {"columns": columns[column], "values": values[row, column]}
        raise core.FileFormatError(message("error.row_2", where=path, row=row, **value, why=why))


def _variances(covariance: FloatArray) -> FloatArray:
    """(n, 6) variances in the order of `UNCERTAINTY_COLUMNS`."""
    return np.take(covariance.reshape(-1, 36), _DIAGONAL, axis=1)


def diagonal(variances: FloatArray) -> FloatArray:
    """(n, 6, 6) covariances with (n, 6) variances in the order of `UNCERTAINTY_COLUMNS`."""
    return np.asarray(variances[:, _PLACES, None] * np.eye(6))
