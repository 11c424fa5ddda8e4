"""Known distances between poses that are found with the rig: they give a self-calibration its scale.

Residuals hardly change if a rig, its poses and the length of its counts grow together. So a distance D of uncertainty u adds information.
With g the derivatives of the distance by all unknowns and C their covariance, k = C g / (g'C g + u^2). The unknowns move by k (D - d).
Their errors become (I - k g') times the former ones, and k u (the linear least squares of both, in Joseph's form).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lmeasure.calibration.solve.unknowns import Model
from lmeasure.core import CalibrationError, FloatArray
from lmeasure.estimation import Fit
from lmeasure.rig import Finding
from lmeasure.text import message

STEPS = 4
SHIFTS = (3, 4, 5)
CONTRADICTED = 4.0  # standard uncertainties


class Distance(NamedTuple):
    """A known distance of the tool's origin at two poses, by their names, and its standard uncertainty [mm]."""

    a: str
    b: str
    mm: float
    u_mm: float


def with_distances(model: Model, found: Fit, distances: Sequence[Distance]) -> tuple[Fit, list[Finding]]:
    """Return the fit with known distances, one after the other, and the error of each before.

    CalibrationError if poses are not found with the rig, or lack these names.
    """
    findings = []
    for requested in distances:
        found, off, u = _conditioned(model, found, requested)
        text = message("calibration.distance_off", a=requested.a, b=requested.b, off=float(off), u=float(u))
        findings.append(Finding(code="misfit" if abs(off) > CONTRADICTED * u else "note", text=text, value=off))
    return found, findings


def distance_of(model: Model, theta: FloatArray, requested: Distance) -> tuple[float, FloatArray]:
    """The distance [mm] when the unknowns are theta (P,), and its derivatives by them (P,)."""
    if not set(SHIFTS) <= set(model.free.tolist()):
        raise CalibrationError(message("error.distance_goes_with_self"))
    names, at = model.campaign.poses.names, []
    for name in (requested.a, requested.b):
        if name not in names or names.index(name) not in model.at:
            raise CalibrationError(message("error.distance_is_none_of", name=name, names=", ".join(names[:6])))
        at.append(names.index(name))
    rows = model.poses(theta)
    way = rows[at[1], :3] - rows[at[0], :3]
    length = float(np.linalg.norm(way))
    if not length > 0.0:
        raise CalibrationError(message("error.distance_and_are_one", a=requested.a, b=requested.b))
    g, free = np.zeros(len(theta)), model.free.tolist()
    for i, sign in zip(at, (-1.0, 1.0), strict=True):
        begin = model.own + len(free) * int(np.flatnonzero(model.at == i)[0])
        g[[begin + free.index(c) for c in SHIFTS]] += sign * way / length
    return length, g


def _conditioned(model: Model, found: Fit, requested: Distance) -> tuple[Fit, float, float]:
    assert found.eliminated is not None
    follows, held = found.eliminated
    before, g = distance_of(model, found.theta, requested)
    u = float(np.sqrt(g @ found.covariance @ g + requested.u_mm**2))
    k, theta = found.covariance @ g / u**2, found.theta
    for _ in range(STEPS):
        length, g = distance_of(model, theta, requested)
        theta = found.theta + k * (requested.mm - length - g @ (found.theta - theta))
    follows, held = follows - np.outer(k, g @ follows), np.column_stack([held - np.outer(k, g @ held), k * requested.u_mm])
    residuals, covariance = model.residuals(theta), follows @ found.V @ follows.T + held @ held.T
    fit = replace(
        found, theta=theta, residuals=residuals, covariance=np.asarray((covariance + covariance.T) / 2), eliminated=(follows, held)
    )
    return fit, before - requested.mm, u
