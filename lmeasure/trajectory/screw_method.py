"""Trajectory by the screw method (thesis Rashoyan 2021, 5.6), with the uncertainty of every pose."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmeasure import files
from lmeasure.conventions import QUATERNION_COLUMNS
from lmeasure.errors import GeometryError, TrajectoryError
from lmeasure.kernels import screw
from lmeasure.lengths import cable_covariance, count_variance, lengths_from_counts, span_lengths
from lmeasure.poses import POSITION_COLUMNS
from lmeasure.run import Run

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

UNCERTAINTY_COLUMNS = ("u_x_mm", "u_y_mm", "u_z_mm", "u_rx_rad", "u_ry_rad", "u_rz_rad")

_CAUSES = {
    screw.SINGULAR: "the cables do not determine the pose: their Pluecker matrix is singular here or on the way here",
    screw.NOT_CONVERGED: "no pose was found whose lengths are these counts",
    screw.OTHER_ASSEMBLY: "beyond a singular pose the lengths fit two assemblies: which one cannot be told",
}


@dataclass(frozen=True)
class Trajectory:
    """Poses of the tool over time; what is not `ok` is NaN.

    time_s (n,); poses (n, 7) base_from_tool, mm and unit quaternions x, y, z, w; residual_mm (n,) largest absolute length residual;
    iterations (n,); status (n,) codes of `kernels.screw.STATUS`; cause, cable (n) texts; worst_pressure_angle_deg (n,);
    u_random, u_systematic (n, 6, 6) covariances of (rotation [rad]; tool origin [mm]), base axes, R_true = Exp(delta) R, from the
    resolution of the counts and from the linked calibration (systematic: nearly the same error along the whole run).
    covers: what the standard uncertainties hold, in words.
    """

    time_s: FloatArray
    poses: FloatArray
    residual_mm: FloatArray
    iterations: IntArray
    status: IntArray
    cause: files.TextArray
    cable: files.TextArray
    worst_pressure_angle_deg: FloatArray
    random: FloatArray
    systematic: FloatArray
    covers: str
    notes: tuple[str, ...] = ()

    @property
    def u(self) -> FloatArray:
        """(n, 6) standard uncertainties in the order of `UNCERTAINTY_COLUMNS`: tool origin [mm], small rotation [rad]."""
        both = np.sqrt(np.einsum("nii->ni", self.random + self.systematic))
        return np.asarray(both[:, [3, 4, 5, 0, 1, 2]])

    def columns(self) -> dict[str, Any]:
        """Columns of a trajectory file."""
        out: dict[str, Any] = {"time_s": self.time_s}
        out |= dict(zip(POSITION_COLUMNS, self.poses[:, :3].T, strict=True))
        out |= dict(zip(QUATERNION_COLUMNS, self.poses[:, 3:].T, strict=True))
        out |= {
            "residual_mm": self.residual_mm,
            "iterations": self.iterations,
            "status": np.array(screw.STATUS, dtype=np.object_)[self.status],
            "cause": self.cause,
            "cable": self.cable,
            "worst_pressure_angle_deg": self.worst_pressure_angle_deg,
        }
        return out | dict(zip(UNCERTAINTY_COLUMNS, self.u.T, strict=True))

    def summary(self) -> str:
        """A few lines for a person: how many samples of which status, worst residual and angle, what the uncertainties cover."""
        counts = Counter({screw.STATUS[code]: int(times) for code, times in zip(*np.unique(self.status, return_counts=True), strict=True)})
        lines = [f"{len(self.time_s)} samples: " + ", ".join(f"{n} {name}" for name, n in counts.most_common())]
        if (self.status != screw.OK).any():
            first = int(np.argmax(self.status != screw.OK))
            cable = f", cable {self.cable[first]}" if self.cable[first] else ""
            lines.append(f"first that is not ok: sample {first} at {self.time_s[first]:.6g} s{cable}: {self.cause[first]}")
        if counts["ok"]:
            u = self.u
            position = np.nanmax(np.linalg.norm(u[:, :3], axis=1))
            rotation = np.nanmax(np.linalg.norm(u[:, 3:], axis=1))
            lines.append(
                f"worst pressure angle {np.nanmax(self.worst_pressure_angle_deg):.1f} deg; largest standard uncertainty "
                f"{position:.4f} mm, {np.degrees(rotation):.5f} deg"
            )
        lines += [f"uncertainties: {self.covers}", *(f"note: {n}" for n in self.notes)]
        return "\n".join(lines)


def reconstruct(run: Run) -> Trajectory:
    """The trajectory of a run of six cables, in one pass or several.

    RigError when the rig has not six cables or its attachment points lie on a line; TrajectoryError when the start pose is singular;
    GeometryError when a cable cannot run at the start pose.
    """
    rig = run.rig
    rig.require_pose()
    try:
        span_lengths(rig, run.start[None, :])
    except GeometryError as error:
        raise GeometryError(f"start {error}") from None
    rows = rig.cable_rows()
    lengths = lengths_from_counts(run)
    variance = count_variance(rig)
    u = np.sqrt(variance)
    _, _, _, start_status, _ = screw.track(rows, run.start, np.zeros((1, 6)), np.zeros(1, np.int64), u)
    if start_status[0] != screw.OK:
        raise TrajectoryError(f"start: {_CAUSES[int(start_status[0])]}")
    poses, residual, iterations, status, angle = screw.track(rows, run.start, lengths.change_mm, lengths.flags, u)
    random, systematic = screw.pose_covariances(
        rows,
        run.start,
        poses,
        lengths.counts,
        rig.scales(),
        variance,
        cable_covariance(rig, run.calibration),
    )
    solved = np.array([_CAUSES.get(code, "") for code in range(len(screw.STATUS))], dtype=np.object_)[status]
    cause = np.where(lengths.flags == screw.OK, solved, lengths.cause)
    covers = (
        "counts of half a unit and the linked calibration"
        if run.calibration
        else "the counts' resolution only: the rig links no calibration"
    )
    return Trajectory(
        lengths.time_s,
        poses,
        residual,
        iterations,
        status,
        cause,
        lengths.cable,
        np.degrees(angle),
        random,
        systematic,
        covers,
        lengths.notes,
    )


def write_trajectory(path: Path, trajectory: Trajectory) -> None:
    """Write .parquet or .csv with the columns of the contract, whole or not at all; Parquet keeps `covers` in its metadata."""
    files.write_table(path, trajectory.columns(), {"uncertainty_covers": trajectory.covers})


def read_trajectory(path: Path) -> Trajectory:
    """Read what `write_trajectory` wrote; covariances come back as their diagonals. FileFormatError names the row and column."""
    table = files.read_table(path)
    u = table.matrix(UNCERTAINTY_COLUMNS, gaps=True)[:, [3, 4, 5, 0, 1, 2]]
    return Trajectory(
        table.numbers("time_s"),
        table.matrix((*POSITION_COLUMNS, *QUATERNION_COLUMNS), gaps=True),
        table.numbers("residual_mm", gaps=True),
        table.numbers("iterations").astype(np.int64),
        table.choices("status", screw.STATUS),
        table.labels("cause"),
        table.labels("cable"),
        table.numbers("worst_pressure_angle_deg", gaps=True),
        np.einsum("ni,ij->nij", u**2, np.eye(6)),
        np.zeros((len(u), 6, 6)),
        "as the file says",
    )
