"""What a campaign tells of dimensions that are not solved but stated to be uncertain: length of a count, pitch of a groove, attachments.

In the least squares they are errors of the residuals, r = r(theta) + C z with z of unit variance, so that V = R + C C'. At the optimum the
residuals that remain tell z as well: its conditional mean is -C' V^-1 r, and with K the gain of the fit (Henderson, Biometrics 31, 1975)

    cov(z) = I - C' V^-1 (I - J K) C,        cov(theta, z) = -K C        (true less found),

which is what solving for them with their stated uncertainties as priors would give. The calibrated rig has these values, or what the points
were given to make up for a wrong drum would be left without it.
"""

from dataclasses import dataclass

import numpy as np

from lmeasure.arrays import FloatArray
from lmeasure.calibration.refine import Fit
from lmeasure.calibration.unknowns import Model
from lmeasure.calibration_record import Dimension
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.unsolved import PARAMETERS


@dataclass(frozen=True)
class Dimensions:
    """Names (s) and corrections (s,) of dimensions, their stated standard uncertainties (s,), covariance (s, s) and that with the fit's
    values of the rig (p, s), in the units of the names; residuals (e,) of the fit with the corrections [mm]."""

    names: tuple[str, ...]
    correction: FloatArray
    stated: FloatArray
    covariance: FloatArray
    with_values: FloatArray
    residuals: FloatArray

    def entries(self, rig: Rig) -> tuple[Dimension, ...]:
        """For the record; rig has the corrected values."""
        u, found = np.sqrt(np.diag(self.covariance)), values(rig)
        return tuple(
            Dimension(
                name=name,
                value=found[name],
                u=float(u[i]),
                prior_u=float(self.stated[i]),
                covariance=tuple(map(float, [*self.with_values[:, i], *self.covariance[:, i]])),
            )
            for i, name in enumerate(self.names)
        )


def dimensions_of(model: Model, found: Fit) -> Dimensions:
    """What a fit tells of the dimensions that its rig states to be uncertain, none where it states none.

    Where the residuals are larger than anything explains they are not believed to tell it: nothing is corrected.
    """
    listed = [(name, v.u, v.kind in PARAMETERS) for v in model.unsolved.variables for name in v.names]
    mine = [i for i, (_, _, dimension) in enumerate(listed) if dimension]
    u = np.array([listed[i][1] for i in mine])
    names = tuple(listed[i][0] for i in mine)
    if not names:
        return Dimensions((), u, u, np.empty((0, 0)), np.empty((model.own, 0)), found.residuals)
    C = model.unsolved_shifts(found.theta)[:, mine]
    follows = found.gain(model) @ C
    z, covariance = np.zeros(len(u)), np.eye(len(u))
    if found.excess == 1.0:
        z = -C.T @ np.linalg.solve(found.V, found.residuals)
        left = C - model.jacobian(found.theta) @ follows
        covariance = covariance - C.T @ np.linalg.solve(found.V, left)
        covariance = _possible(found.covariance[: model.own, : model.own], -follows[: model.own], (covariance + covariance.T) / 2)
    return Dimensions(names, u * z, u, covariance * np.outer(u, u), -follows[: model.own] * u, found.residuals + C @ z)


def _possible(T: FloatArray, X: FloatArray, Z: FloatArray) -> FloatArray:
    """Z (s, s), widened where rounding or a direction that only a prior holds leaves [[T, X], [X', Z]] no covariance."""
    width = np.sqrt(np.maximum(np.diag(T), 1e-300))
    least = (X / width[:, None]).T @ np.linalg.pinv(T / np.outer(width, width), hermitian=True) @ (X / width[:, None])
    values, vectors = np.linalg.eigh(Z - least)
    return np.asarray(least + (vectors * np.maximum(values, 0.0)) @ vectors.T)


def values(rig: Rig) -> dict[str, float]:
    """The dimensions of a rig by their names."""
    out = {f"{p.name}.count_length_mm": p.drum.count_length_mm for p in rig.observation_point}
    out |= {f"{p.name}.groove_pitch_mm": p.drum.groove_pitch_mm for p in rig.observation_point}
    return out | {f"tool.{name}.{axis}_mm": x for name, at in rig.tool.items() for axis, x in zip("xyz", at, strict=True)}


def with_dimensions(rig: Rig, found: Dimensions) -> Rig:
    """The rig with corrected dimensions."""
    if not found.names:
        return rig
    data = rig.to_dict()
    points = {p["name"]: p for p in data["observation_point"]}
    for name, by in zip(found.names, found.correction.tolist(), strict=True):
        owner, key = name.rsplit(".", 1)
        if owner.startswith("tool."):
            data["tool"][owner.removeprefix("tool.")]["xyz".index(key[0])] += by
        else:
            points[owner]["drum"][key] += by
    return rig_from_dict(data, "calibrated rig")
