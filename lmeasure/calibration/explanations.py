"""What may be wrong where residuals exceed the stated noise: competing explanations, and their evidence.

Each explanation adds a covariance u^2 F F' to that of the residuals: errors of the reference poses, lengths that err on their own, or a
value that is taken as exact and is not (F then holds the residuals' derivatives by it, in prior widths). With r' = N'L^-1 r, L L' the
covariance so far and N a basis of what the solved unknowns cannot explain, twice the restricted log likelihood (Patterson and Thompson,
Biometrika 58, 1971) rises by

    gain(u) = sum_i y_i^2 u^2 s_i^2/(1 + u^2 s_i^2) - log(1 + u^2 s_i^2),

s_i the singular values of N'L^-1 F and y = U'r'. Each explanation has one number, so that their gains compare as they stand.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.optimize

from lmeasure.arrays import FloatArray, IntArray
from lmeasure.calibration.refine import Noise
from lmeasure.calibration.unknowns import Model

LEAST, MOST = 1e-6, 1e3  # sizes between which an explanation is looked for; neither is a result
GRID = 60
SWEEPS = 4
FREED = ("scale", "attachment", "radius")
"""Groups of `observation.parameters.GROUPS` that are taken as exact unless asked for, and whose errors look like nothing else."""


@dataclass(frozen=True)
class Explanation:
    """name; F (e, c) how the residuals [mm] follow its independent standard errors, for the size 1; channel it concerns."""

    name: str
    F: FloatArray
    channel: str | None = None


def pose_errors(model: Model, theta: FloatArray) -> FloatArray:
    """(e, n, 6) derivatives of the residuals by errors (rotation; position) of the reference poses; visits of one share its error."""
    reference = model.campaign.reference_of
    visits = reference[:, None] == np.unique(reference)
    return np.asarray(np.einsum("eni,nr->eri", model.pose_jacobian(theta), visits))


def arm_mm(model: Model) -> float:
    """Distance of the attachment points from the tool's origin, root mean square: a turn by 1/arm moves them like a shift of 1 mm."""
    tool = model.campaign.rig.tool
    size = float(np.sqrt(np.mean([np.sum(np.square(tool[c.to_point])) for c in model.campaign.cables])))
    return size if size > 0.0 else 1.0


def _length_errors(model: Model, cables: IntArray) -> FloatArray:
    """(e, c) of independent errors of each length of the cables; that at the zero pose is in every residual of its cable."""
    own = np.isin(model.cable_index, cables)
    zero = (model.cable_index[:, None] == cables).astype(np.float64)
    return np.hstack([np.diag(own.astype(np.float64))[:, own], zero])


def of_noise(model: Model, theta: FloatArray, noise: Noise) -> list[Explanation]:
    """Explanations that are errors: sizes in mm, of rotations the mm that they move the attachment points by; "stated" in stated ones."""
    out = []
    if model.places_known:
        J = pose_errors(model, theta)
        turns, shifts = J[:, :, :3] / arm_mm(model), J[:, :, 3:]
        e = len(J)
        out.append(Explanation("position", shifts.reshape(e, -1)))
        if not model.pose_unknowns:
            out.append(Explanation("rotation", turns.reshape(e, -1)))
            out.append(Explanation("pose", np.concatenate([turns, shifts], axis=2).reshape(e, -1)))
        if noise.stated:
            reference = model.campaign.reference_of
            scaled = noise.scaled(model.pose_jacobian(theta))
            shared = np.einsum("eni,nr->eri", scaled, reference[:, None] == np.unique(reference))
            out.append(Explanation("stated", shared.reshape(e, -1)))
    out.append(every_length(model))
    cables = model.campaign.cables
    if len(cables) > 1:
        out += [Explanation("length", _length_errors(model, np.array([j])), c.channel) for j, c in enumerate(cables)]
    return out


def every_length(model: Model) -> Explanation:
    """All cables' lengths err on their own, alike."""
    return Explanation("length", _length_errors(model, np.arange(len(model.campaign.cables))))


def of_values(model: Model, theta: FloatArray, freed: Callable[[str], Model | None]) -> list[Explanation]:
    """Explanations that are values taken as exact; freed: the model with a group solved for too, None where it is already."""
    out = []
    for group in FREED:
        wider = freed(group)
        if wider is None:
            continue
        new = ~np.isin(wider.unknowns.names, model.unknowns.names)
        if not new.any():
            continue
        J = wider.jacobian(embedded(model, theta, wider))
        out.append(Explanation(group, J[:, new] * wider.unknowns.width[new]))
    return out


def embedded(model: Model, theta: FloatArray, wider: Model) -> FloatArray:
    """theta of a model as values of one that solves for more: nominal where it has none."""
    known = dict(zip(model.unknowns.names, theta, strict=True))
    return np.array([known.get(n, v) for n, v in zip(wider.unknowns.names, wider.unknowns.nominal, strict=True)])


class Evidence:
    """Gains of explanations over a covariance V (e, e) of residuals (e,) with derivatives J (e, p) by what is solved."""

    def __init__(self, residuals: FloatArray, J: FloatArray, V: FloatArray) -> None:
        self._r, self._J, self._V = residuals, J, V

    def best(self, explanation: Explanation, others: FloatArray | None = None) -> tuple[float, float]:
        """Size u and gain of one explanation beside others, a covariance (e, e) [mm^2]; (0, 0) where there is none within the bounds."""
        L = np.linalg.cholesky(self._V if others is None else self._V + others)
        whiten = scipy.linalg.solve_triangular(L, np.column_stack([self._J, self._r, explanation.F]), lower=True)
        p = self._J.shape[1]
        Q, _ = np.linalg.qr(whiten[:, :p], mode="complete")
        rest = Q[:, p:].T @ whiten[:, p:]
        U, s, _ = np.linalg.svd(rest[:, 1:], full_matrices=False)
        y, square = (U.T @ rest[:, 0]) ** 2, s**2

        def loss(log_u: float) -> float:
            x = np.exp(2.0 * log_u) * square
            return float(np.sum(np.log1p(x) - y * x / (1.0 + x)))

        grid = np.linspace(np.log(LEAST), np.log(MOST), GRID)
        losses = [loss(x) for x in grid]
        i = int(np.argmin(losses))
        if i in (0, GRID - 1) or losses[i] >= 0.0:
            return 0.0, 0.0
        found = scipy.optimize.minimize_scalar(loss, bounds=(grid[i - 1], grid[i + 1]), method="bounded", options={"xatol": 1e-4})
        return float(np.exp(found.x)), -float(found.fun)

    def together(self, explanations: list[Explanation], needed: float = 0.0) -> list[float]:
        """Sizes of several explanations at once, each the best beside the others; 0 for one that gains less than needed beside them."""
        sizes = [0.0] * len(explanations)
        for _ in range(SWEEPS if len(explanations) > 1 else 1):
            for i, each in enumerate(explanations):
                others = sum(
                    (u**2 * x.F @ x.F.T for j, (u, x) in enumerate(zip(sizes, explanations, strict=True)) if j != i and u),
                    start=np.zeros_like(self._V),
                )
                u, gain = self.best(each, others)
                sizes[i] = u if gain >= needed else 0.0
        return sizes
