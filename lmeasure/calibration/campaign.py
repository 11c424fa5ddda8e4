"""A calibration campaign: a nominal rig, reference poses of the robot, and what the counters showed there."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lmeasure import conventions, files
from lmeasure.calibration_record import Input
from lmeasure.errors import CalibrationError, FileFormatError, GeometryError
from lmeasure.lengths import counts_from_poses
from lmeasure.poses import Poses, read_poses
from lmeasure.rig import Cable, Rig, read_rig

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

MIN_POSES = 2


@dataclass(frozen=True)
class Campaign:
    """Counts at reference poses.

    poses (n); cables (m) that were measured; counts (n, m) true counts k decoded with the nominal sign and scale, NaN where a pose was
    not counted; zero (m,) index of the pose at which each cable's counter was zeroed.
    """

    rig: Rig
    poses: Poses
    cables: tuple[Cable, ...]
    counts: FloatArray
    zero: NDArray[np.int64]
    inputs: tuple[Input, ...] = ()
    notes: tuple[str, ...] = ()
    temperature_c: FloatArray | None = None
    """(n,) temperature at each pose; None where it was not recorded: then it is the rig's reference."""

    @property
    def used(self) -> BoolArray:
        """(n, m) True where a count gives an equation: counted, and not the cable's own zero pose."""
        mask = np.isfinite(self.counts)
        mask[self.zero, np.arange(len(self.cables))] = False
        return mask


def read_campaign(folder: Path) -> Campaign:
    """Read rig.toml (nominal), reference_poses.csv and counts.csv; FileFormatError or CalibrationError names file, pose and channel."""
    folder = Path(folder)
    if not folder.is_dir():
        raise FileFormatError(f"{folder}: is not a calibration folder")
    rig = read_rig(folder / "rig.toml")
    poses = read_poses(folder / "reference_poses.csv", rig.angles)
    inputs = tuple(Input(file=name, sha256=files.sha256(folder / name)) for name in ("rig.toml", "reference_poses.csv", "counts.csv"))
    path = folder / "counts.csv"
    table = files.read_table(path)
    names = table.text("pose")
    if not names:
        raise FileFormatError(f"{path}: has no rows")
    index = {name: i for i, name in enumerate(poses.names)}
    for row, name in enumerate(names):
        if name not in index:
            raise FileFormatError(f"{path}: line {row + 2}: pose {name!r} is not in reference_poses.csv")
    passage = table.numbers("pass") if "pass" in table.columns else np.ones(len(names))
    cables = tuple(c for c in rig.cable if c.passage in set(passage.tolist()))
    if not cables:
        raise FileFormatError(f"{path}: no cable of the rig belongs to pass {passage[0]:g}")
    counts = np.full((len(poses), len(cables)), np.nan)
    zero = np.zeros(len(cables), dtype=np.int64)
    for j, c in enumerate(cables):
        recorded = table.numbers(c.channel, gaps=True)
        rows = np.flatnonzero(passage == c.passage)
        drum = rig.point(c.from_point).drum
        for row in rows.tolist():
            i = index[names[row]]
            if np.isfinite(counts[i, j]):
                raise FileFormatError(f"{path}: line {row + 2}: pose {names[row]!r} is counted twice by channel {c.channel}")
            counts[i, j] = recorded[row] * drum.count_sign / drum.scale
        zero[j] = index[names[rows[0]]]
        if not np.isfinite(counts[zero[j], j]):
            raise FileFormatError(f"{path}: line {rows[0] + 2}: channel {c.channel} has no count at its zero pose {names[rows[0]]!r}")
    campaign = Campaign(rig, poses, cables, counts, zero, inputs, temperature_c=_temperatures(folder / "reference_poses.csv"))
    return _unwrapped(_checked(campaign, path))


def _temperatures(path: Path) -> FloatArray | None:
    """(n,) temperatures of the reference poses, or None without their column."""
    table = files.read_table(path)
    if "temperature_c" not in table.columns:
        return None
    values = table.numbers("temperature_c")
    conventions.check_temperature(values, f"{path}: column 'temperature_c'")
    return values


def _checked(campaign: Campaign, path: Path) -> Campaign:
    for j, c in enumerate(campaign.cables):
        counted = int(np.isfinite(campaign.counts[:, j]).sum())
        if counted < MIN_POSES:
            raise CalibrationError(f"{path}: channel {c.channel} is counted at {counted} pose(s); {MIN_POSES} are the least")
        if not campaign.counts[:, j][campaign.used[:, j]].any():
            raise CalibrationError(f"{path}: channel {c.channel} does not move: all its counts are zero")
    return campaign


def _unwrapped(campaign: Campaign) -> Campaign:
    """Counters that wrap between poses: the number of turns of the register that comes nearest to the nominal rig's prediction."""
    counts = campaign.counts.copy()
    notes = []
    for j, c in enumerate(campaign.cables):
        drum = campaign.rig.point(c.from_point).drum
        if drum.counter_bits is None or drum.counter_bits > 32:
            continue
        full = 2.0**drum.counter_bits / drum.scale
        if not np.nanmax(np.abs(counts[:, j])) > full / 4:
            continue
        try:
            warm = campaign.temperature_c
            begun = None if warm is None else float(warm[campaign.zero[j]])
            at_zero = campaign.poses.rows[campaign.zero[j]]
            predicted = counts_from_poses(campaign.rig, campaign.poses.rows, at_zero, (c,), warm, begun)[:, 0]
        except GeometryError:
            continue
        turns = np.rint((predicted + counts[campaign.zero[j], j] - counts[:, j]) / full)
        turns[campaign.zero[j]] = 0
        if np.nansum(np.abs(turns)) > 0:
            notes.append(f"channel {c.channel}: {drum.counter_bits}-bit counter unwrapped between poses by the nominal rig's prediction")
            counts[:, j] += turns * full
    return replace(campaign, counts=counts, notes=(*campaign.notes, *notes))
