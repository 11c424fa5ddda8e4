"""Paths between their samples: how far a true path may lie off from the one that is read there.

Between samples i and i + 1 the slowest change is none. The robot keeps the velocity it had before i until somewhere it takes the one it has
behind i + 1. It leaves the straight line between the two by tau times D, and comes back to it by (1 - tau) times E, where

    D = dt_i (V_i - V_(i-1)),    E = dt_i (V_(i+1) - V_i)

are the changes of the velocity V between samples, over the step. It turns where both meet, |D| |E| / (|D| + |E|) off the line: the apex of
the triangle of the step and of its neighbours' extensions. Every path that bends to one side only lies within these triangles.

A motion that the samples resolve is known far better: its samples lie on the cubics through their neighbours. Where an apex hides between
them, they lie off by at least a third of its height (`OF_KINK`), and by at least a tenth of the bend there (`OF_BEND`). A sample of weight
w that is stamped late by e at a velocity v lies off the cubic by w v e. With times known to u, independent from sample to sample, the
covariance of how far a sample lies off is

    C (1 + sum w_i^2) + u^2 (v v' + sum w_i^2 v_i v_i'),

C of its place, w_i of its four neighbours. Errors of times lie along the motion and hide no corner across it: the comparison is made along
each principal axis of that covariance.

The corner of a program is known beforehand to be one. A path that rounds it at a distance c on an arc that turns by phi has
N = c phi / ((1 / cos(phi / 2) - 1) s) steps of a length s there. Cubics read the distance with less error than `SHARP` of the apex of a
sharp corner, and than `ROUNDED` / N^2 of it where it is too large for a sharp one (`READ`).

No robot goes through a corner faster than before and behind it. Between samples at a distance d its path is therefore no longer than L, the
largest speed of the neighbouring steps times the time between the two, and lies within the ellipse about them of the half width
sqrt(L^2 - d^2) / 2. A path that bends to one side passes the corner no farther away than its chords (`Chords`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from lmeasure.core import FloatArray, IntArray, lagrange
from lmeasure.text import message
from lmeasure.trajectory import ErrorSource, PoseErrors

OF_KINK = 3.0
OF_BEND = 0.1
NOISE = 15.0
"""Times the variance of how far samples lie off the cubics along an axis, that noise alone hardly reaches in any of a few."""
SHARP = 0.85
ROUNDED = 0.4
READ = 0.8
"""Distance from the apex of a sharp corner, as a part of its own, from which a value may be read."""
OF_NOISE = 2.0
"""Tolerance of a step between samples, in standard deviations."""
EDGE = 1.25
"""Times a bound at whose very edge a path may lie, so that U95 includes it."""
AS_UNIFORM = 1.0 / np.sqrt(3.0)
"""Standard deviation of a value anywhere within a bound, over the bound."""


@dataclass(frozen=True)
class Steps:
    """Steps between samples, by one course of time.

    apex (k, 3) [mm] from the straight line to the apex of each, from where (k,) on it, as a part of the step; off (k, 4, 3) [mm]: how far
    the four samples about the step lie off the cubics through their neighbours; noise (k, 4): the part of a sample's variance that has;
    late (k, 4, 3, 3) [mm²/s²]: its covariance by errors of times, over their variance; bend (k,) [mm]: the largest change of velocity
    about the step, over it.
    """

    apex: FloatArray
    where: FloatArray
    off: FloatArray
    noise: FloatArray
    late: FloatArray
    bend: FloatArray

    @property
    def values(self) -> tuple[FloatArray, ...]:
        """Return all arrays, in order."""
        return self.apex, self.where, self.off, self.noise, self.late, self.bend

    def heights(self, covariance: FloatArray, u_time_s: float) -> FloatArray:
        """Return how far off the line the path may lie (k,) [mm], see `Between.bound`."""
        of_noise = self.noise[..., None, None] * np.asarray(covariance)[..., None, :, :] + u_time_s**2 * self.late
        variance, axes = np.linalg.eigh(of_noise)
        along = np.einsum("...ij,...i->...j", axes, self.off)
        off = np.sqrt(np.maximum(along**2 - NOISE * variance, 0.0).sum(axis=-1)).max(axis=-1)
        seen = OF_KINK * off * np.minimum(off / np.maximum(OF_BEND * self.bend, 1e-300), 1.0)
        return np.asarray(np.minimum(np.linalg.norm(self.apex, axis=-1), seen))


@dataclass(frozen=True)
class Between:
    """Steps between samples: taken as even, and by their times.

    A path's shape depends on neither, so the smoother one is used.
    """

    courses: tuple[Steps, ...]

    def __getitem__(self, steps: IntArray) -> "Between":
        return Between(tuple(Steps(*(values[steps] for values in course.values)) for course in self.courses))

    def bound(self, covariance: FloatArray, u_time_s: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Return how far, and to which side, the path may lie off (k, 3) [mm], and from where (k,) on the step.

        covariance (k, 3, 3) or (3, 3) [mm²] of a sample's place; u_time_s: standard uncertainty of its time.
        """
        heights = [course.heights(covariance, u_time_s) for course in self.courses]
        row = np.arange(len(heights[0]))
        course = np.argmin(heights, axis=0)
        height, apex, where = (np.stack(each)[course, row] for each in (heights, *zip(*(c.values[:2] for c in self.courses), strict=True)))
        whole = np.linalg.norm(apex, axis=1)
        return apex * np.divide(height, whole, out=np.zeros_like(whole), where=whole > 0.0)[:, None], where


def between(time_s: FloatArray, positions: FloatArray) -> Between:
    """Return the steps between k samples at time_s (k,) [s] at positions (k, 3) [mm]."""
    k = len(time_s)
    if k < 5:
        return Between((Steps(*(np.zeros((k - 1, *more)) for more in ((3,), (), (4, 3), (4,), (4, 3, 3), ()))),))
    even = _steps(np.arange(k, dtype=np.float64), positions)
    even = replace(even, late=np.zeros_like(even.late))
    return Between((even, _steps(time_s, positions)) if (np.diff(time_s) > 0.0).all() else (even,))


def _steps(time_s: FloatArray, positions: FloatArray) -> Steps:
    k = len(time_s)
    step = np.diff(time_s)
    velocity = np.diff(positions, axis=0) / step[:, None]
    before, behind = np.zeros((k - 1, 3)), np.zeros((k - 1, 3))
    before[1:] = step[1:, None] * np.diff(velocity, axis=0)
    behind[:-1] = step[:-1, None] * np.diff(velocity, axis=0)
    one, other = np.linalg.norm(before, axis=1), np.linalg.norm(behind, axis=1)
    where = other / np.maximum(one + other, 1e-300)
    apex = -0.5 * (before * where[:, None] + behind * (1.0 - where)[:, None])
    apex[[0, -1]] = 0.0
    # each sample against the cubic through two on either side
    around = np.arange(2, k - 2)[:, None] + np.array([0, -2, -1, 1, 2])
    weights = np.ones((k - 4, 5))
    weights[:, 1:] = -lagrange(time_s[around[:, 1:]] - time_s[2:-2, None], np.zeros(k - 4))
    middle = (positions[2:] - positions[:-2]) / (time_s[2:] - time_s[:-2])[:, None]
    moving = (weights[:, :, None] * np.vstack([velocity[:1], middle, velocity[-1:]])[around])[..., None]
    off, noise, late = np.zeros((k, 3)), np.ones(k), np.zeros((k, 3, 3))
    off[2:-2] = np.einsum("mk,mki->mi", weights, positions[around])
    noise[2:-2] = (weights**2).sum(axis=1)
    late[2:-2] = (moving @ np.swapaxes(moving, 2, 3)).sum(axis=1)
    about = np.clip(np.arange(k - 1)[:, None] + np.arange(-1, 3), 0, k - 1)
    return Steps(apex, where, off[about], noise[about], late[about], scipy.ndimage.maximum_filter1d(np.maximum(one, other), 3))


def joined(cycles: Sequence[Between]) -> Between:
    """Return the steps (m,) of each of n cycles as one of m n, step by step."""
    least = min(len(c.courses) for c in cycles)
    courses = []
    for each in zip(*(c.courses[:least] for c in cycles), strict=True):
        stacked = (np.stack(arrays, axis=1) for arrays in zip(*(course.values for course in each), strict=True))
        courses.append(Steps(*(a.reshape(-1, *a.shape[2:]) for a in stacked)))
    return Between(tuple(courses))


def of_samples(errors: PoseErrors) -> FloatArray:
    """Return the covariances (n, 3, 3) [mm²] of single samples about a smooth path, from their own errors and their place's."""
    each = np.concatenate([errors.own[:, 3:], errors.local[:, 3:]], axis=2)
    return np.asarray(each @ np.swapaxes(each, 1, 2))


def with_hidden(errors: PoseErrors, own: FloatArray, common: FloatArray) -> PoseErrors:
    """Return errors of n places, and those hidden between samples: up to own (n, 3) [mm] anew at every place, and up to common (n, 3) [mm]
    in common: a corner is read too round in all cycles."""
    added = [np.pad(AS_UNIFORM * bound, ((0, 0), (3, 0))) for bound in (own, common)]
    if own.any():
        errors = replace(errors, own=np.concatenate([errors.own, added[0][:, :, None]], axis=2))
    return errors.with_shared(added[1], ErrorSource(message("source.between")), uniform=True) if common.any() else errors


def at_corner(distance_mm: float, step_mm: float, cosine: float) -> float:
    """Return how far [mm] the distance at which a path passes a corner may be off, by steps about it.

    cosine: of the angle between the directions of its lines.
    """
    turn = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
    sharp = 0.5 * step_mm * np.sin(0.5 * turn)
    if distance_mm <= READ * sharp:
        return float(SHARP * sharp)
    opening = 1.0 / max(np.cos(0.5 * turn), 1e-3) - 1.0
    steps = distance_mm * turn / max(opening * step_mm, 1e-300)
    return float(sharp * min(SHARP, ROUNDED / max(steps, 1e-9) ** 2))


@dataclass(frozen=True)
class Chords:
    """Steps between samples about a corner.

    distance (k,) [mm] of each from the corner; length (k,) [mm]; lasts (k,) [s]; pace (k,) [mm/s]: the largest speed of its neighbours.
    """

    distance: FloatArray
    length: FloatArray
    lasts: FloatArray
    pace: FloatArray

    @classmethod
    def about(cls, time_s: FloatArray, positions: FloatArray) -> "Chords":
        """Return the steps between samples at time_s (n,), at positions (n, 3) [mm] from the corner."""
        steps, lasts = np.diff(positions, axis=0), np.maximum(np.diff(time_s), 1e-300)
        length = np.linalg.norm(steps, axis=1)
        part = np.clip(-(positions[:-1] * steps).sum(axis=1) / np.maximum(length**2, 1e-300), 0.0, 1.0)
        distance = np.linalg.norm(positions[:-1] + part[:, None] * steps, axis=1)
        pace = scipy.ndimage.maximum_filter(length / lasts, footprint=[True] * 3 + [False] + [True] * 3, mode="nearest")
        return cls(distance, length, lasts, np.asarray(pace))

    def passes(self, noise_mm: float, u_time_s: float, *, outside: bool) -> tuple[float, float]:
        """Return the least and the most [mm] at which the path may pass the corner, by samples that err so much.

        outside: it passes on the outer side, where it need not lie between its chords and the corner.
        """
        longest = np.maximum(self.pace * (self.lasts + OF_NOISE * u_time_s), self.length) + OF_NOISE * noise_mm
        width = 0.5 * np.sqrt(longest**2 - self.length**2)
        least = np.maximum(self.distance - width, 0.0)
        return float(least.min()), float((self.distance + width * outside).min())
