"""Rows that the others contradict: set aside, or counted by what all others say of them, and named."""

from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from lmeasure import se3
from lmeasure.arrays import BoolArray, FloatArray, IntArray
from lmeasure.errors import RobotError
from lmeasure.robots.measurements import Measurements
from lmeasure.robots.noted import Noted, noted
from lmeasure.robots.problem import Fit, distances, solved, weighted, with_noise
from lmeasure.robots.unknowns import R

OUTLYING = 1e-6
"""Probability, over all rows, with which a row of Gaussian errors would be taken for an outlier."""
OUTLIER_ROUNDS = 12
LEAST_SPARE = 2.0
"""Residuals beyond what they determine, with which they tell how exact robot and instrument are."""
HALF = 0.5
"""Of a row: weight below which it is named. Of all rows: what their weights must leave."""


def of_all(fit: Fit[R], rows: Measurements, used: BoolArray) -> tuple[FloatArray, IntArray]:
    """`distances` of all rows, (N,) of which were used for the fit, and how many components each has (N,)."""
    problem = replace(fit.problem, rows=rows)
    return distances(fit, problem, problem.linearised(fit.theta), used.astype(np.float64)), np.asarray(rows.known.sum(axis=1))


def without_outliers(fit: Fit[R], rows: Measurements, kept: BoolArray, used: BoolArray) -> tuple[Fit[R], BoolArray]:
    """The fit with rows set aside that the others contradict, and which are used: begun with those nearest, then let in as they fit.

    Distances are judged by their median, which half of the rows may spoil.
    """
    for _ in range(OUTLIER_ROUNDS):
        square, components = of_all(fit, rows, used)
        normal = chi2.ppf(0.5, np.arange(1, 7))[np.maximum(components, 1) - 1]
        counted = kept & (components > 0)
        scale = max(1.0, float(np.median((square / normal)[counted]))) if fit.equations > 1.5 * len(fit.theta) else 1.0
        limit = chi2.isf(OUTLYING / len(rows), np.maximum(components, 1)) * scale
        now = kept & ((square <= limit) | (components == 0))
        if (now == used).all():
            break
        used = now
        fit = with_noise(replace(fit.problem, rows=rows.of(np.flatnonzero(used))), fit.theta)
    return fit, used


def weighed(fit: Fit[R], rows: Measurements, kept: BoolArray, used: BoolArray) -> tuple[Fit[R], BoolArray]:
    """The fit with all rows weighed, begun with those used, and which keep a weight. RobotError where there is not enough to weigh, or the
    weights leave too little."""
    of = np.flatnonzero(kept)
    if fit.spare < LEAST_SPARE:
        raise RobotError(
            f"{fit.equations} measured values are used up by what they determine: nothing tells how much each row is to count; measure "
            "more poses, or let all count alike"
        )
    fit = weighted(solved(replace(fit.problem, rows=rows.of(of), weight=used[of].astype(np.float64)), fit.theta))
    weight = fit.problem.weight
    assert weight is not None
    if fit.spare < LEAST_SPARE or weight.sum() < HALF * len(of):
        raise RobotError(
            f"weights leave {weight.sum():.1f} of {len(of)} rows, too few: they contradict each other, and which of them are right cannot "
            "be told"
        )
    used = np.zeros(len(rows), np.bool_)
    used[of[weight > 0.0]] = True
    return solved(replace(fit.problem, rows=rows.of(np.flatnonzero(used)), weight=weight[weight > 0.0]), fit.theta), used


def outlying(fit: Fit[R], rows: Measurements, kept: BoolArray, used: BoolArray) -> list[Noted]:
    """What is said of each row that is kept and not used: out of reach, or by how much it differs from what is predicted [mm, deg]."""
    out = []
    state = fit.problem.unknowns.state(fit.x)
    predicted = state.predicted(rows)
    reach = state.robot.reach_mm + np.linalg.norm(state.targets[:, :3], axis=1)
    away = np.linalg.norm(rows.position - state.base[:3], axis=1)
    for row in np.flatnonzero(kept & ~used).tolist():
        of, row_said = rows.names[row], rows.subject(row)
        if rows.placed[row] and away[row] > reach[rows.target_of[row]]:
            off = float(away[row])
            reaches = float(reach[rows.target_of[row]])
            out.append(noted("row-out-of-reach", "out_of_reach", of, off, row=row_said, away_mm=off, reach_mm=reaches))
        elif not rows.placed[row]:
            off = float(np.abs(fit.problem.unknowns.residuals(fit.x, rows)[row]).max())
            out.append(noted("outlier", "outlier.length", of, off, row=row_said, off_mm=off))
        else:
            off = float(np.linalg.norm(rows.position[row] - predicted[row, :3]))
            if not rows.oriented[row]:
                out.append(noted("outlier", "outlier", of, off, row=row_said, off_mm=off))
                continue
            turned = se3.between(predicted[row], np.concatenate([rows.position[row], rows.quaternion[row]]))
            angle = float(np.degrees(se3.rotation(turned).magnitude()))
            out.append(noted("outlier", "outlier.turned", of, off, row=row_said, off_mm=off, turned_deg=angle))
    return out
