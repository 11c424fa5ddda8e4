"""Rows that the others contradict: set aside, or counted by what all others say of them, and named."""

from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from lmeasure.core import BoolArray, FloatArray, IntArray, RobotError, se3
from lmeasure.robots.identification.measurements import Measurements, Noted, noted
from lmeasure.robots.identification.problem import Fit, Linear, Problem, distances, solved, weighted, with_noise
from lmeasure.robots.identification.unknowns import R
from lmeasure.text import message

OUTLYING = 1e-6
"""Probability, over all rows, with which a row of Gaussian errors would be taken for an outlier."""
OUTLIER_ROUNDS = 12
LEAST_SPARE = 2.0
"""Residuals beyond what they determine, with which they tell how exact robot and instrument are."""
HALF = 0.5
"""Of a row: weight below which it is named. Of all rows: what their weights must leave."""


def of_all(fit: Fit[R], rows: Measurements, used: BoolArray) -> tuple[FloatArray, IntArray]:
    """`distances` of all rows, (N,) of which were used for the fit, and how many components each has (N,); of a row of a stay with several,
    from what the used ones of the others say too."""
    problem = replace(fit.problem, rows=rows, weight=None)
    at, square = problem.linearised(fit.theta), np.zeros(len(rows))
    for of in problem.stays:
        if of.shape[1] == 1:
            square[of[:, 0]] = distances(fit, problem, at, of, counts=used[of[:, 0]].astype(np.float64))
        else:
            for one in of:
                square[one] = _within(fit, problem, at, one, used[one])
    return square, np.asarray(rows.known.sum(axis=1))


def _within(fit: Fit[R], problem: Problem[R], at: Linear, of: IntArray, used: BoolArray) -> FloatArray:
    """(m,) squared distances of the rows (m,) of one stay from what all others say of them, those of the stay that are used (m,) among
    them."""
    n = at.residuals.shape[1]
    r, J, V = at.residuals[of].reshape(-1), at.jacobian[of].reshape(len(of) * n, -1), problem.of_stays(of[None])[0]
    known, owner = problem.rows.known[of].reshape(-1), np.repeat(np.arange(len(of)), n)
    on = known & used[owner]
    out = np.zeros(len(of))
    inverse = np.linalg.inv(V[np.ix_(on, on)])
    left = inverse - inverse @ J[on] @ fit.covariance @ J[on].T @ inverse
    seen = inverse @ r[on]
    for i in range(len(of)):
        own = known & (owner == i)
        if used[i]:
            part = owner[on] == i
            out[i] = float(seen[part] @ np.linalg.pinv(left[np.ix_(part, part)], hermitian=True) @ seen[part])
            continue
        gain = V[np.ix_(own, on)] @ inverse
        by = J[own] - gain @ J[on]
        spread = V[np.ix_(own, own)] - gain @ V[np.ix_(on, own)] + by @ fit.covariance @ by.T
        off = r[own] - gain @ r[on]
        out[i] = float(off @ np.linalg.solve(spread, off))
    return out


def _contradicted_stays(fit: Fit[R], rows: Measurements, used: BoolArray, fits: BoolArray, *, scale: float) -> BoolArray:
    """(N,) rows whose stay the others contradict, where several of its rows that fit each other are used, or would be."""
    problem = replace(fit.problem, rows=rows, weight=None)
    at, out = problem.linearised(fit.theta), np.zeros(len(rows), np.bool_)
    for of in problem.stays[1:] if problem.stays[0].shape[1] == 1 else problem.stays:
        for one in of:
            part = one[fits[one]]
            if len(part) < 2:
                continue
            square = distances(fit, problem, at, part[None], counts=np.array([float(used[part].all())]))[0]
            out[part] = square > chi2.isf(OUTLYING / len(rows), int(rows.known[part].sum())) * scale
    return out


def without_outliers(fit: Fit[R], rows: Measurements, used: BoolArray) -> tuple[Fit[R], BoolArray]:
    """The fit with rows set aside that the others contradict, and which are used: begun with those nearest, then let in as they fit.

    Distances are judged by their median, which half of the rows may spoil.
    """
    for _ in range(OUTLIER_ROUNDS):
        square, components = of_all(fit, rows, used)
        normal = chi2.ppf(0.5, np.arange(1, 7))[np.maximum(components, 1) - 1]
        scale = max(1.0, float(np.median((square / normal)[components > 0]))) if fit.equations > 1.5 * len(fit.theta) else 1.0
        limit = chi2.isf(OUTLYING / len(rows), np.maximum(components, 1)) * scale
        now = (square <= limit) | (components == 0)
        now &= ~_contradicted_stays(fit, rows, used, now, scale=scale)
        if (now == used).all():
            break
        used = now
        fit = with_noise(replace(fit.problem, rows=rows.of(np.flatnonzero(used))), fit.theta)
    return fit, used


def weighed(fit: Fit[R], rows: Measurements, used: BoolArray) -> tuple[Fit[R], BoolArray]:
    """The fit with all rows weighed, begun with those used, and which keep a weight. RobotError where there is not enough to weigh, or the
    weights leave too little."""
    if fit.spare < LEAST_SPARE:
        raise RobotError(message("error.measured_values_are_used", equations=fit.equations))
    fit = weighted(solved(replace(fit.problem, rows=rows, weight=used.astype(np.float64)), fit.theta))
    weight = fit.problem.weight
    assert weight is not None
    if fit.spare < LEAST_SPARE or weight.sum() < HALF * len(rows):
        raise RobotError(message("error.weights_leave_of_rows", weight=weight.sum(), n_rows=len(rows)))
    used = weight > 0.0
    return solved(replace(fit.problem, rows=rows.of(np.flatnonzero(used)), weight=weight[used]), fit.theta), used


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
