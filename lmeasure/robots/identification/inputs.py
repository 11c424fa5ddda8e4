"""Inputs of `lmeasure identify`: a table of joint values and places, or places of one instrument and joint values of their own.

The places may be a run of cables, the trajectory of any instrument, of which the rests are taken, or points by name.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from lmeasure.core import RobotError
from lmeasure.io import Column, ForeignTable
from lmeasure.recording import read_run
from lmeasure.robots.identification.measurements import Measurements, Noted, noted
from lmeasure.robots.identification.read_measurements import read_commanded, read_measurements, with_joints
from lmeasure.robots.identification.trajectory_rests import matched, rests_of
from lmeasure.robots.model import RobotModel
from lmeasure.text import message
from lmeasure.trajectory import ErrorModel, ErrorsOfRun, Stated, Trajectory, align, kind_of, read_trajectory, reconstruct


@dataclass(frozen=True)
class Given:
    """The measurements and what is to be said of how they were come by."""

    rows: Measurements
    notes: tuple[Noted, ...] = ()


def given(path: Path, joints: Path | None, robot: RobotModel, stated: Stated) -> Given:
    """Read measurements, of which `stated` says columns and uncertainties; joints: where the joint values stand, None: beside the places.

    A run's rests have the errors of its counts by themselves and those of its calibration, start and zeroing in common. RobotError or
    FileFormatError says what cannot be read, or does not belong together.
    """
    columns = dict(stated.columns or {})
    tabular = not path.is_dir() and kind_of(path) in ("table", "parquet")
    if joints is None:
        if path.is_dir() and not (path / "run.toml").is_file():
            raise RobotError(message("error.is_a_folder_and", where=path))
        if not tabular:
            kind = "run folder" if path.is_dir() else "trajectory"
            raise RobotError(message("error.is_a_joints_file", where=path, kind=kind))
        return Given(_with(read_measurements(path, robot, columns), stated))
    commanded = read_commanded(joints, robot, columns)
    if tabular and ForeignTable(path, columns, part=True).find("time", "s") is None:
        rows, notes = with_joints(read_measurements(path, robot, columns, points_alone=True), commanded)
        return Given(_with(rows, stated), tuple(notes))
    trajectory, model, said = _trajectory(path, columns)
    found = rests_of(trajectory, model)
    rows, notes = matched(found, commanded, robot)
    determined = noted("rests", "rested", rests=len(found), used=len(rows))
    return Given(_with(rows, stated), (determined, *said, *notes))


def _trajectory(path: Path, columns: Mapping[str, Column]) -> tuple[Trajectory, ErrorModel | None, list[Noted]]:
    """A trajectory, its errors where a run tells them, and what it says of itself."""
    if path.is_dir():
        aligned = align(read_run(path))
        trajectory = reconstruct(aligned, covariances=False)
        notes = [Noted("run", note) for note in trajectory.notes]
        return trajectory, ErrorsOfRun(aligned), notes + [Noted("assumed", line) for line in trajectory.assumed.lines]
    trajectory = read_trajectory(path, Stated(columns or None, of_others=True))
    notes = [Noted("markers" if kind_of(path) == "markers" else "trajectory", note) for note in trajectory.notes]
    if trajectory.systematic.any():
        notes.append(noted("systematic", "even", file=path.name))
    return trajectory, None, notes


def _with(rows: Measurements, stated: Stated) -> Measurements:
    return rows.with_uncertainty(stated.u_position_mm, stated.u_rotation_rad)
