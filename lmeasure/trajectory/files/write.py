"""Files of a trajectory: tables, poses alone, messages of ROS 2."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from lmeasure.core import FileFormatError
from lmeasure.io import files
from lmeasure.text import message, stated_causes, table
from lmeasure.trajectory.files.ros import mcap_writer
from lmeasure.trajectory.files.trajectory import Trajectory


@contextmanager
def trajectory_writer(path: Path, covers: str, angles: str | None = None) -> Iterator[Callable[[Trajectory], None]]:
    """Write a trajectory in pieces, whole or not at all: .parquet or .csv with the columns of the contract, and the angles of a convention
    if given; .tum with the poses alone (time and x y z qx qy qz qw in seconds and metres, known ones only); .mcap with ROS 2 messages of
    poses and covariances (`ros.mcap_writer`). Parquet keeps `covers` and the ids of causes in its metadata, .csv these in a column
    `cause_message`."""
    if Path(path).suffix.lower() == ".mcap":
        with mcap_writer(path, covers) as write_messages:
            yield write_messages
        return
    if Path(path).suffix.lower() == ".tum":
        with files.whole(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as out:

            def write_lines(piece: Trajectory) -> None:
                known = ~np.isnan(piece.poses).any(axis=1)
                rows = np.column_stack([piece.time_s, piece.poses[:, :3] / 1000.0, piece.poses[:, 3:]])[known]
                out.writelines(" ".join(map(repr, row)) + "\n" for row in rows.tolist())

            yield write_lines
        return
    if Path(path).suffix.lower() not in {".csv", ".parquet"}:
        raise FileFormatError(message("error.the_name_must_end_in", where=path))
    causes: set[str] = set()
    in_text = Path(path).suffix.lower() == ".csv"  # CSV keeps columns only
    with files.table_writer(path, lambda: {"uncertainty_covers": covers, "messages": json.dumps(table([covers, *causes]))}) as write:

        def write_rows(piece: Trajectory) -> None:
            causes.update(piece.cause.tolist())
            columns = list(piece.columns(angles).items())
            if in_text:
                columns.insert(len(columns) - 3 * (angles is not None), ("cause_message", stated_causes(piece.cause)))
            write(dict(columns))

        yield write_rows


def write_trajectory(path: Path, trajectory: Trajectory, angles: str | None = None) -> None:
    """Write a trajectory as .csv or .parquet, complete or not at all.

    Parameters
    ----------
    path
        File to write.
    trajectory
        Trajectory to write.
    angles
        Convention of additional angle columns.

    Examples
    --------
    >>> lm.write_trajectory(Path("trajectory.parquet"), trajectory)
    """
    with trajectory_writer(path, trajectory.covers, angles) as write:
        write(trajectory)
