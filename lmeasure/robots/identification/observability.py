"""Observability of a robot's parameters, in numbers and words."""

from dataclasses import dataclass

import numpy as np

from lmeasure.core import BoolArray
from lmeasure.estimation import by_few
from lmeasure.robots.identification.problem import Fit
from lmeasure.robots.identification.unknowns import R
from lmeasure.text import Message, message

DETERMINED = 0.3
"""Of its prior's: standard uncertainty up to which a parameter counts as determined by the measurements."""
SILENT = 1.0
"""Information of the measurements, in that of the prior, below which a direction is held by nominal values."""
MENTIONED = 0.05
"""Of the largest: part of a direction that is mentioned."""
PLACED = 0.05
"""Of a millimetre or degree, by which a frame must move with a direction to be named as what makes up for it."""


@dataclass(frozen=True)
class Silent:
    """A combination of parameters that the measurements leave free: changes by name, in the units of the names, for one prior standard
    uncertainty of the first."""

    direction: dict[str, float]
    said: Message

    @property
    def text(self) -> str:
        """Return the message, whose text is English."""
        return self.said


def determined_parameters(fit: Fit[R]) -> BoolArray:
    """(p,) whether the measurements determine an unknown by itself."""
    return np.asarray(np.sqrt(np.diag(fit.covariance)) < DETERMINED * fit.problem.width)


def silent_directions(fit: Fit[R]) -> list[Silent]:
    """Combinations that leave every measured value as it is, each with as few parameters as can be; those of few first."""
    unknowns, width = fit.problem.unknowns, fit.problem.width
    free, names = len(unknowns.freed), unknowns.names
    white = fit.information * np.outer(width, width)
    own, cross, frames = white[:free, :free], white[:free, free:], white[free:, free:]
    # what the instrument errs by in all rows is no frame: it is known by its own size
    shared = np.arange(free, len(names)) >= unknowns.asked
    frames = frames + np.diag(shared.astype(np.float64))
    size = np.sqrt(np.maximum(np.diag(frames), 1e-300))
    follow = -np.linalg.pinv(frames / np.outer(size, size), rcond=1e-12, hermitian=True) @ (cross / size).T / size[:, None]
    values, vectors = np.linalg.eigh(own + cross @ follow)
    basis = vectors[:, values < SILENT].T
    if len(basis) == 0:
        return []
    out = []
    for row, pivot in zip(*by_few(basis), strict=True):
        strong = [i for i in np.argsort(-np.abs(row), kind="stable") if abs(row[i]) > MENTIONED * np.abs(row).max()]
        change = row * width[:free]
        moved = (follow @ row) * width[free:]
        with_it = sorted({names[free + i].split(".")[0] for i in np.flatnonzero((np.abs(moved) > PLACED) & ~shared)})
        parts = tuple(message("identify.moved", name=names[i], by=float(change[i])) for i in sorted(strong, key=lambda i: (i != pivot, i)))
        if with_it:
            frames_said = tuple(_plain(name) for name in with_it)
            why = message("identify.silent.frames" if len(frames_said) > 1 else "identify.silent.frame", frames=frames_said)
        else:
            why = message("identify.silent.alone" if len(strong) == 1 else "identify.silent.together")
        out.append(Silent({names[i]: float(change[i]) for i in strong}, message("identify.silent", moves=parts, why=why)))
    return sorted(out, key=lambda s: len(s.direction))


def unknown_frames(fit: Fit[R]) -> list[Silent]:
    """Frames that the measurements do not tell wholly, and orientations that were not measured at all."""
    unknowns = fit.problem.unknowns
    free, sigma = len(unknowns.freed), np.sqrt(np.diag(fit.covariance))
    loose = [i for i in range(free, unknowns.asked) if sigma[i] > DETERMINED * fit.problem.width[i]]
    out = [Silent({unknowns.names[i]: float(sigma[i])}, message("identify.untold", name=unknowns.names[i])) for i in loose]
    if not unknowns.based:
        out.append(Silent({}, message("identify.untold.base")))
    if not unknowns.turned.any():
        out.append(Silent({}, message("identify.untold.turn")))
    return out


def _plain(owner: str) -> Message:
    """Return what a frame is called."""
    if owner in ("base", "tool", "instrument"):
        return message(f"identify.frame.{owner}")
    kind, _, name = owner.partition("_")
    return message(f"identify.frame.{kind}", name=name)
