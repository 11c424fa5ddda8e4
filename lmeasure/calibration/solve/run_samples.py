"""A motion as a campaign: samples of a run spread over its region, at poses that are only roughly known."""

from pathlib import Path

import numpy as np

from lmeasure.calibration.campaign.campaign import Campaign
from lmeasure.core import CalibrationError, FloatArray, IntArray, se3
from lmeasure.io import files
from lmeasure.kernels import follow_least_squares, span_lengths
from lmeasure.recording import Poses, Run, StatedStart, read_run
from lmeasure.rig import CABLES_FOR_A_POSE, Input, Rig
from lmeasure.sensors import Lengths, count_variance, lengths_from_counts
from lmeasure.text import message

SAMPLES = 40
FOLLOWED = 4000
"""Most samples at which the tool is followed along the run."""
SIZE_MM = 300.0
"""Lever arm that makes a turn comparable with a shift where samples are spread."""


def is_run(folder: Path) -> bool:
    """Return whether a folder contains a run, and no campaign."""
    return (folder / "run.toml").is_file() and not (folder / "reference_poses.csv").is_file()


def read_motion(
    folder: Path, rig: Path | None = None, start: StatedStart | None = None, *, samples: int = SAMPLES, named: tuple[str, ...] = ()
) -> tuple[Campaign, Run]:
    """Return the campaign of a run folder, with its rig or another one; see `campaign_of`. Raises the errors of `read_run`."""
    run = read_run(folder, rig, start)
    sources = [folder / "run.toml", *(Path(c.source) for c in run.passes)]
    inputs = tuple(Input(file=path.name, sha256=files.sha256(path)) for path in sources if path.is_file())
    return campaign_of(run, samples, inputs, named), run


def campaign_of(run: Run, samples: int = SAMPLES, inputs: tuple[Input, ...] = (), named: tuple[str, ...] = ()) -> Campaign:
    """Samples of a run, as far from each other as can be, with the start pose before them, where the counters were zeroed. Poses are those
    that the run's rig makes of the counts: where estimation begins, and nothing that is trusted. named: "start", or times [s] whose
    samples are taken too, under these names.

    CalibrationError where the run has no start to begin with, several passes, or too few samples that can be read.
    """
    rig = run.rig
    if run.start is None:
        raise CalibrationError(message("error.its_start_is_unknown", where=run.passes[0].source))
    if rig.passes > 1:
        raise CalibrationError(message("error.has_passes_a_motion", where=run.passes[0].source, passes=rig.passes))
    lengths = lengths_from_counts(run)
    whole = np.flatnonzero(np.isfinite(lengths.change_mm).all(axis=1))
    if len(whole) < 2:
        raise CalibrationError(message("error.has_no_samples_at", where=run.passes[0].source))
    poses, rows = _followed(rig, lengths, whole, run.start)
    own = {name: _at(name, lengths.time_s[rows], run.passes[0].source) for name in named if name != "start"}
    chosen = np.unique(np.r_[spread(poses, samples), list(own.values())].astype(np.intp))
    called = {place: name for name, place in own.items()}
    counts = np.vstack([np.zeros(len(rig.observed)), lengths.counts[rows[chosen]]])
    absolute = np.array([rig.counter(o).absolute for o in rig.observed])
    counts[0, absolute] = np.nan
    names = ("start", *(called.get(int(i), f"{lengths.time_s[rows[i]]:.3f} s") for i in chosen))
    stated = Poses(names, np.vstack([run.start, poses[chosen]]), np.zeros(len(names)), np.zeros(len(names)))
    return Campaign(rig, stated, rig.observed, counts, np.zeros(len(rig.observed), np.int64), inputs, free_of_play=True)


def _at(name: str, time_s: FloatArray, source: str) -> int:
    """The sample nearest to a time that is a name."""
    try:
        requested = float(name)
    except ValueError:
        raise CalibrationError(message("error.distance_is_neither_start", name=name, source=source)) from None
    if not time_s[0] <= requested <= time_s[-1]:
        raise CalibrationError(message("error.distance_s_lies_outside", name=name, source=source, time_s=time_s[0], time_s2=time_s[-1]))
    return int(np.argmin(np.abs(time_s - requested)))


def _followed(rig: Rig, lengths: Lengths, whole: IntArray, start: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return (k, 7) poses of samples by the rig, and the samples' indices. Cables alone are used if they determine a pose: zeros of
    encoders may be anywhere."""
    rows = whole[np.unique(np.linspace(0, len(whole) - 1, FOLLOWED).astype(np.intp))]
    channels = rig.cable if len(rig.cable) >= CABLES_FOR_A_POSE else rig.observed
    of, m = rig.cable_rows(channels), len(channels)
    begun = np.where([rig.counter(o).absolute for o in channels], 0.0, span_lengths(of, start[None])[0])
    state, changes = np.concatenate([start, np.zeros(m + 1)]), np.ascontiguousarray(lengths.change_mm[rows][:, :m])
    state[len(start) : -1] = span_lengths(of, start[None])[0] - begun
    flags, u = np.zeros(len(rows), np.int64), np.sqrt(count_variance(rig, channels))
    poses = follow_least_squares(of, start, begun, state, changes, flags, u, np.arange(6))[0]
    ok = np.isfinite(poses[:, 0])
    if ok.sum() < 2:
        raise CalibrationError(message("error.the_rig_makes_no"))
    return poses[ok], rows[ok]


def spread(poses: FloatArray, samples: int) -> IntArray:
    """Return as many of (k, 7) poses as requested, each the farthest from those before it, in order of time."""
    here = np.column_stack([poses[:, :3], SIZE_MM * se3.displacement(poses, poses[0])[:, :3]])
    chosen, away = [0], np.linalg.norm(here - here[0], axis=1)
    while len(chosen) < min(samples, len(here)):
        chosen.append(int(np.argmax(away)))
        if not away[chosen[-1]] > 0.0:
            break
        away = np.minimum(away, np.linalg.norm(here - here[chosen[-1]], axis=1))
    return np.unique(np.array(chosen, dtype=np.intp))
