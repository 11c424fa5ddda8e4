"""Errors of the instrument at poses of a run: its random part from the counts, its systematic part from the calibration."""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from lmeasure.core import FloatArray, IntArray, se3, symmetric_root
from lmeasure.recording import Run
from lmeasure.rig import TYPICAL_SIZES
from lmeasure.text import Message, message
from lmeasure.trajectory.faults.rest_evidence import CLOSURE
from lmeasure.trajectory.files.trajectory import Trajectory
from lmeasure.trajectory.reconstruction.runs import covariances
from lmeasure.trajectory.time.passes import Alignment
from lmeasure.trajectory.uncertainty.budget import BY_CALIBRATION, DIMENSIONS, ORIGINS, PHYSICAL, RESTORED, TEMPERATURE
from lmeasure.trajectory.uncertainty.sources import LENGTHS, PHASE, ZERO, standard

SOURCES = {
    PHASE: "source.phase",
    CLOSURE: "source.closure",
    BY_CALIBRATION: "source.calibration",
    DIMENSIONS: "source.dimensions",
    PHYSICAL: "source.effects",
    "start pose": "source.start",
    LENGTHS: "covers.of.lengths",
    ORIGINS: "source.origins",
    RESTORED: "covers.of.restored",
    TEMPERATURE: "source.temperature",
    ZERO: "covers.of.zeros",
    "unknown start": "covers.of.unknown_start",
}
OF_COUNTERS = (PHASE, CLOSURE, ORIGINS, RESTORED)  # Sources with new errors in every run
COUNT = 12.0**-0.5  # Standard uncertainty of a rounded count


class ErrorSource(NamedTuple):
    """A source of errors as a budget names it: its standard uncertainty u in a unit, 1 and empty where its variables have several;
    degrees_of_freedom: of u, None where it is stated."""

    name: Message | str
    u: float = 1.0
    unit: str = ""
    degrees_of_freedom: float | None = None


@dataclass(frozen=True)
class PoseErrors:
    """Errors (rotation [rad]; tool origin [mm]), base axes, R_true = Exp(delta) R, of n poses of one part of the program.

    The error is own u + local z + shared s: own (n, 6, q) with u (q,) new at every pose, local (n, 6, l) with z (l,) drawn once for each
    place of this part, shared (n, 6, K) with s (K,) drawn once for the run. place (n,): indices of the places, from 0. All variables are
    independent and of unit variance; rounded: u and z are rounding errors, uniform, else they are normal. s is normal except where uniform
    (K,) is True. counted (K,): whether s are errors of the counters, drawn anew in every run, as u and z are, while the others are those of
    the instrument. Both are False throughout by default. sources (K,): the source of each of s, see `named`. joint: the errors are those of
    a curve, and places are its clusters: request all instants of a part at once.
    """

    own: FloatArray
    local: FloatArray
    place: IntArray
    shared: FloatArray
    rounded: bool = False
    uniform: tuple[bool, ...] = ()
    counted: tuple[bool, ...] = ()
    sources: tuple[ErrorSource, ...] = ()
    joint: bool = False

    @classmethod
    def of(cls, own: FloatArray, shared: FloatArray, **kinds: Any) -> "PoseErrors":
        """Errors that poses at one place have no more in common than others; kinds: further attributes by their names."""
        return cls(own, np.zeros((len(own), 6, 0)), np.zeros(len(own), dtype=np.int64), shared, **kinds)

    def named(self) -> tuple[ErrorSource, ErrorSource, tuple[ErrorSource, ...]]:
        """The sources of own, of local and of each column of shared."""
        size, kind = (COUNT, "count") if self.rounded else (1.0, "")
        own, local = (f"source.{name}" for name in (("counts", "counts_of_place") if self.rounded else ("random", "systematic")))
        unnamed = (ErrorSource(message("source.shared")),) * (self.shared.shape[2] - len(self.sources))
        if self.joint:
            return *(ErrorSource(message("source.curve")),) * 2, (*self.sources, *unnamed)
        return ErrorSource(message(own), size, kind), ErrorSource(message(local), size, kind), (*self.sources, *unnamed)

    def with_shared(self, column: FloatArray, source: ErrorSource, *, uniform: bool = False) -> "PoseErrors":
        """The same with one more error (n, 6) that all poses of the run have in common."""
        missing = (False,) * (self.shared.shape[2] - len(self.uniform))
        shared = np.concatenate([self.shared, column[:, :, None]], axis=2)
        return replace(self, shared=shared, uniform=(*self.uniform, *missing, uniform), sources=(*self.named()[2], source))

    def __len__(self) -> int:
        return len(self.own)

    @property
    def random(self) -> FloatArray:
        """Return the (n, 6, 6) covariance of the part that is independent of other poses."""
        return np.asarray(self.own @ np.swapaxes(self.own, 1, 2))

    @property
    def covariance(self) -> FloatArray:
        """(n, 6, 6) of the whole error of each pose."""
        common = np.concatenate([self.local, self.shared], axis=2)
        return np.asarray(self.random + common @ np.swapaxes(common, 1, 2))

    def covariance_of(self, weights: FloatArray) -> FloatArray:
        """Return (k, 6, 6) covariances of k weighted sums of the n errors, weights (k, n): of the mean over a window, of a difference, of a
        fit's part of them. Correlations between poses are defined only here."""
        common = np.einsum("kn,nil->kil", weights, self.factors)
        return np.asarray(np.einsum("kn,nij->kij", weights**2, self.random) + common @ np.swapaxes(common, 1, 2))

    def alone(self) -> "PoseErrors":
        """The same, each pose for itself: of poses that are far from each other in time."""
        each = np.concatenate([self.own, self.local], axis=2)
        own = symmetric_root(each @ np.swapaxes(each, 1, 2))
        return replace(self, own=own, local=own[:, :, :0], place=np.zeros(len(own), dtype=np.int64))

    def moved(self, matrices: FloatArray) -> "PoseErrors":
        """The errors of T delta, T (n, 6, 6)."""
        return replace(self, own=matrices @ self.own, local=matrices @ self.local, shared=matrices @ self.shared)

    def __getitem__(self, index: IntArray) -> "PoseErrors":
        return replace(self, own=self.own[index], local=self.local[index], place=self.place[index], shared=self.shared[index])

    def drawn(self, rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
        """Draws of u or z, of any shape."""
        return standard(rng, shape, self.rounded)

    def drawn_common(self, rng: np.random.Generator, trials: int) -> FloatArray:
        """(trials, K) draws of s."""
        common = rng.standard_normal((trials, self.shared.shape[2]))
        uniform = np.flatnonzero(self.uniform)
        common[:, uniform] = standard(rng, (trials, len(uniform)), True)
        return common

    @property
    def factors(self) -> FloatArray:
        """(n, 6, L) factors of all that poses have in common, with a variable of unit variance (L,) for each column."""
        if not self.local.any():
            return self.shared
        n, places = len(self), int(self.place.max()) + 1
        of_places = np.zeros((n, 6, places, self.local.shape[2]))
        of_places[np.arange(n), :, self.place] = self.local
        return np.concatenate([of_places.reshape(n, 6, -1), self.shared], axis=2)

    def drawn_factors(self, rng: np.random.Generator, trials: int) -> FloatArray:
        """(trials, L) draws of the variables of `factors`."""
        of_places = self.factors.shape[2] - self.shared.shape[2]
        return np.hstack([self.drawn(rng, (trials, of_places)), self.drawn_common(rng, trials)])


class ErrorModel(Protocol):
    """Source of errors of poses.

    A model states correlation between samples by their common errors: columns of `PoseErrors.shared`, drawn once for the run, or of
    `local`, drawn once for a place. Any covariance (6 n, 6 n), such as that of errors that fade in time or of a smoother, can be stated:
    the columns of its root are `shared`. `PoseErrors.covariance_of` gives that of a mean or another weighted sum.
    """

    def at(self, trajectory: Trajectory, samples: IntArray) -> tuple[PoseErrors, Message | str]:
        """Return errors of the tool origin at samples (n,) of the trajectory, and their sources, in words."""
        ...


class ErrorsOfRun:
    """Errors by the counts, the linked calibration and the run's other statements: those of `lmeasure.trajectory.covariances`. constraint,
    repeatability_mm: those of the trajectory's reconstruction."""

    def __init__(self, run: Run | Alignment, constraint: str | None = None, repeatability_mm: float = 0.0) -> None:
        self._run, self._constraint, self._repeatability_mm = run, constraint, repeatability_mm

    def at(self, trajectory: Trajectory, samples: IntArray) -> tuple[PoseErrors, Message | str]:
        """See `ErrorModel`; TrajectoryError when the trajectory is not of this run."""
        found = covariances(trajectory, self._run, samples, constraint=self._constraint, repeatability_mm=self._repeatability_mm)
        own, shared = np.nan_to_num(found.own), np.nan_to_num(found.factors)
        each = tuple(self._source(*s) for s in zip(found.sources, found.assumed or ("",) * len(found.sources), strict=True))
        counted = tuple(s in OF_COUNTERS for s in found.sources)
        errors = PoseErrors.of(own, shared, rounded=True, uniform=found.uniform, counted=counted, sources=each)
        sources = message("source.counts"), *(name_of_source(name) for name in dict.fromkeys(found.sources))
        return errors, message("covers.run" if "calibration" in found.sources else "covers.run.uncalibrated", sources=sources)

    def _source(self, name: str, assumed: str) -> ErrorSource:
        """`source_of`, with the degrees of freedom of a calibration."""
        record = (self._run.run if isinstance(self._run, Alignment) else self._run).calibration
        if not assumed and name == BY_CALIBRATION and record is not None and record.equations > record.rank:
            return ErrorSource(name_of_source(name), degrees_of_freedom=float(record.equations - record.rank))
        return source_of(name, assumed)


def source_of(name: str, assumed: str) -> ErrorSource:
    """Return the source of a variable; assumed: its typical size, empty for stated or calibrated ones."""
    if assumed:
        size = TYPICAL_SIZES[assumed]
        return ErrorSource(message("source.assumed", what=size.what), *size.in_unit)
    return ErrorSource(name_of_source(name), COUNT, "count") if name == PHASE else ErrorSource(name_of_source(name))


def name_of_source(name: str) -> Message | str:
    """Return the name of a source of errors."""
    return message(SOURCES[name]) if name in SOURCES else name


class ErrorsOfFile:
    """Errors by the standard uncertainties of a trajectory file alone, without correlations between poses.

    together: the poses of a part, a pose's cycles or a path's crossings, share the whole error, else only the file's systematic one.
    Neither is always worse, so a figure takes the larger of both.
    """

    def __init__(self, together: bool) -> None:
        self.together = together

    def at(self, trajectory: Trajectory, samples: IntArray) -> tuple[PoseErrors, Message | str]:
        """See `ErrorModel`."""
        n = len(samples)
        random, systematic = (np.nan_to_num(c[samples]) for c in (trajectory.random, trajectory.systematic))
        shared = np.zeros((n, 6, 0))
        own = shared if self.together else symmetric_root(random)
        local = symmetric_root(random + systematic if self.together else systematic)
        return PoseErrors(own, local, np.zeros(n, dtype=np.int64), shared), message("covers.file")


def at_tool_point(poses: FloatArray, offset_mm: FloatArray) -> FloatArray:
    """(n, 6, 6) matrices that take the error of the tool origin to that of a point offset_mm (3,) in the tool frame, at (n, 7) poses."""
    return se3.at_points(se3.rotation(poses).apply(offset_mm))
