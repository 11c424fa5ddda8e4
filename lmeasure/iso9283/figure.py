"""Figures: the certified results of a program's parts, as functions of the parts' states.

Errors of single crossings scatter from plane to plane; a robot's deviations extend over several. Among cosines along the path the errors of
crossings have the same power at every frequency, systematic ones the lowest alone, and a robot's power falls with frequency. The observed
power minus that of errors is therefore averaged, by isotonic regression, to a falling power (Barlow et al., Statistical Inference under
Order Restrictions, 1972), and every wave made as large as that: the estimate of an unknown spectrum under known noise.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
import scipy
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, IntArray, conventions
from lmeasure.iso9283 import formulas as iso
from lmeasure.iso9283.characteristic import CharacteristicKey
from lmeasure.text import Message, message

ANGLES = ("a", "b", "c")
AXES = ("x", "y", "z")


class Subject(NamedTuple):
    """Part of a program that a test, its states or an exclusion are of: a pose, a path, a corner of it by number."""

    kind: Literal["pose", "path", "corner", "weave", "distance", "compliance", "settling", "posing", "stabilisation"]
    name: str
    number: int = 0

    @property
    def said(self) -> Message:
        """Return it in words: pose P1."""
        return message(f"subject.{self.kind}", name=self.name)


States = Mapping[Subject, Any]
Function = Callable[[States], FloatArray]


class OfInstants(NamedTuple):
    """Contribution of the samples' uncertain instants to a result: an independent standard uncertainty, and a bias of known sign."""

    u: float
    bias: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A characteristic without a value yet: function of the states of subjects. needs: possible exclusions; vector: the figure whose
    verdict a component takes; instants: the effect of errors of the samples' times, by its value, if its states do not contain it; between:
    possible error between samples; extreme: it is the largest or the least of a path, which errors increase."""

    key: CharacteristicKey
    clause: str
    unit: str
    cycles: int
    of: Function
    needs: tuple[Subject, ...]
    vector: str | None = None
    angles: str | None = None
    extension: bool = False
    instants: Callable[[float], OfInstants] | None = None
    between: float = 0.0
    extreme: bool = False


@dataclass(frozen=True, kw_only=True)
class Maker:
    """Common properties of the results of one part, see `Figure`; pose, path and part as in their keys."""

    cycles: int
    needs: tuple[Subject, ...]
    pose: str | None = None
    path: str | None = None
    part: str | None = None
    angles: str | None = None

    def one(self, name: str, clause: str, unit: str, of: Function, **more: Any) -> Figure:
        """A figure."""
        key = CharacteristicKey(name, self.pose, self.path, self.part)
        return Figure(key=key, clause=clause, unit=unit, cycles=self.cycles, of=of, needs=self.needs, **more)

    def components(self, stem: str, clause: str, of: Function, axes: Sequence[str] = AXES, **more: Any) -> list[Figure]:
        """Figures of the components of (..., 3): of lengths along axes, or of angles."""
        given = {"unit": "deg", "angles": self.angles} if axes is ANGLES else {"unit": "mm"}
        whole = _Whole(of)
        return [self.one(f"{stem}_{a}", clause, of=component(whole, i), **given, **more) for i, a in enumerate(axes)]

    def rotation(self, name: str, clause: str, of: Function) -> Figure:
        """A figure of the rotation as a whole, which the standard does not have."""
        return self.one(name, clause, "deg", of, extension=True)


class _Whole:
    """Compute a figure of several components once for all of them."""

    def __init__(self, of: Function) -> None:
        self._of, self._states, self._value = of, None, np.empty(0)

    def __call__(self, states: Any) -> FloatArray:
        if states is not self._states:
            self._states, self._value = states, self._of(states)
        return self._value


def component(of: Function, *index: int) -> Function:
    """One component of a figure that has several."""
    at: Any = (..., *index)
    return lambda states: of(states)[at]


PLAIN = "fanuc-wpr"
"""Turns about the fixed X, Y and Z: the standard's a, b, c, where a controller's own angles are singular."""
SINGULAR_DEG_PER_DEG = 10.0
"""Rate from which angles are near a singular orientation and mean nothing: a turn of one degree moves an angle by as many degrees."""


def angles_deg(name: str, rotation: Rotation) -> FloatArray:
    """Angles of a convention, always in degrees."""
    values = conventions.angles_from_rotation(name, rotation)
    return np.degrees(values) if conventions.convention(name).columns[0].endswith("_rad") else values


def angle_rates(name: str, rotation: Rotation) -> FloatArray:
    """(n, 3, 3) derivatives of a convention's angles [deg] by a small rotation [rad] in base axes, at n rotations."""
    step = 1e-6
    columns = []
    for axis in np.eye(3):
        there, back = (angles_deg(name, Rotation.from_rotvec(sign * step * axis) * rotation) for sign in (1.0, -1.0))
        columns.append(iso.wrapped(there - back) / (2.0 * step))
    return np.stack(columns, axis=-1)


def singular(name: str, rotation: Rotation) -> bool:
    """Return whether the angles mean nothing at one of the rotations."""
    rates = np.radians(angle_rates(name, rotation))
    return bool(np.linalg.norm(rates, axis=(-2, -1)).max() > SINGULAR_DEG_PER_DEG)


def convention_at(angles: str, rotation: Rotation, part: object, *, stated: bool) -> tuple[str | None, tuple[Message, ...]]:
    """Return a convention whose angles are meaningful at these rotations, None without one, and remarks. stated: a chosen convention is not
    replaced."""
    if not singular(angles, rotation):
        return angles, ()
    if stated or singular(PLAIN, rotation):
        return None, (message("angles.none", part=part, angles=angles),)
    return PLAIN, (message("angles.other", part=part, angles=angles, instead=PLAIN),)


KNOWN = 1e-9
"""Waves whose errors have less than as much of the largest power are exact: directions that a plane does not have."""


def cosines(stretch: IntArray) -> FloatArray:
    """Return (q, q) orthonormal rows by rising frequency: cosines along each stretch of a path between corners, where deviations may jump;
    stretch (q,): index of each place's stretch."""
    sizes = np.unique(stretch, return_counts=True)[1]
    rows = scipy.linalg.block_diag(*(scipy.fft.dct(np.eye(k), axis=0, norm="ortho") for k in sizes))
    frequency = np.concatenate([np.arange(k) / k for k in sizes])
    return np.asarray(rows[np.argsort(frequency, kind="stable")])


def reduced(waves: FloatArray, added: FloatArray, freedom: int, doubt: float) -> FloatArray:
    """Return waves (q, r, c) by rising frequency, of r cycles with that many degrees of freedom, reduced to their power without that of
    errors (q, c).

    A power of k degrees of freedom has the standard uncertainty sqrt((2 E^2 + 4 E S) / k), E of the errors, S without them. It is taken
    smaller by doubt times that: the less the robot deviates in truth, the more errors enlarge its figures.
    """
    power = (waves**2).sum(axis=1) / freedom
    out = waves.copy()
    for i in range(waves.shape[2]):
        unknown = added[:, i] > KNOWN * added[:, i].max()
        if not unknown.any():
            continue
        of_errors = added[unknown, i]
        fitted = scipy.optimize.isotonic_regression(power[unknown, i] - of_errors, weights=of_errors**-2.0, increasing=False)
        sizes = np.diff(fitted.blocks)
        mean = np.repeat(np.add.reduceat(of_errors, fitted.blocks[:-1]) / sizes, sizes)
        true = np.maximum(fitted.x, 0.0)
        least = true - doubt * np.sqrt((2.0 * mean**2 + 4.0 * mean * true) / (np.repeat(sizes, sizes) * freedom))
        out[unknown, :, i] *= np.sqrt(np.maximum(least, 0.0) / (true + mean))[:, None]
    return out
