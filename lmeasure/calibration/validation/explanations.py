"""Explanations of a misfit of a campaign: reference poses, independent errors of lengths, values that are taken as exact."""

import math
from dataclasses import dataclass

import numpy as np

from lmeasure.calibration.solve.frame import model_of
from lmeasure.calibration.solve.noise import Noise
from lmeasure.calibration.solve.residuals import unknowns_of
from lmeasure.calibration.solve.unknowns import Model
from lmeasure.core import FloatArray, IntArray
from lmeasure.estimation import Explanation, Key
from lmeasure.rig import GROUPS, group_names


@dataclass(frozen=True)
class Otherwise:
    """Alternatives to a campaign as it is stated: errors of reference poses and of lengths beside the stated noise, and values that are
    solved for."""

    stated: Noise
    values: tuple[str, ...] = ("scale", "attachment", "radius")
    """Groups of `rig.parameters.GROUPS`."""

    def freed(self, problem: Model, group: str) -> Model | None:
        """The model with a group of values solved for."""
        cables, known = problem.campaign.cables, set(problem.parameters.names)
        solved = tuple(g for g in GROUPS if known.issuperset(group_names(cables, g)))
        if group in solved:
            return None
        wider = unknowns_of(problem.campaign, (*solved, group))
        return (
            model_of(problem.campaign, wider, tuple(problem.free.tolist()), problem.frame)
            .with_noise(problem.noise)
            .with_sizes(problem.sizes)
        )

    def errors(self, problem: Model, theta: FloatArray) -> list[Explanation]:
        """Sizes in mm, of rotations the mm that they move the attachment points by; "stated" in stated ones."""
        model, noise = problem, self.stated
        out: list[Explanation] = []
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

    def widened(self, problem: Model, sizes: dict[Key, float]) -> Model:
        """The model with the stated noise and errors of these sizes."""
        noise, model = self.stated, problem
        for (name, channel), u in sizes.items():
            if name == "stated":
                noise = noise.times(math.sqrt(1.0 + u**2))
            elif name == "length":
                own = np.array([channel == c.channel or (channel is None and c.is_cable) for c in model.campaign.cables])
                noise = noise.with_lengths(np.where(own, u, 0.0))
            else:
                noise = noise.widened(0.0 if name == "rotation" else u, 0.0 if name == "position" else u / arm_mm(model))
        return problem.with_noise(noise)


def pose_errors(model: Model, theta: FloatArray) -> FloatArray:
    """(e, n, 6) derivatives of the residuals by errors (rotation; position) of the reference poses; visits of one share its error."""
    reference = model.campaign.reference_of
    visits = reference[:, None] == np.unique(reference)
    return np.asarray(np.einsum("eni,nr->eri", model.pose_jacobian(theta), visits))


def arm_mm(model: Model) -> float:
    """Distance of the attachment points from the tool's origin, root mean square: a turn by 1/arm moves them like a shift of 1 mm."""
    tool = model.campaign.rig.tool
    size = float(np.sqrt(np.mean([np.sum(np.square(tool[c.to_point])) for c in model.campaign.drums])))
    return size if size > 0.0 else 1.0


def _length_errors(model: Model, cables: IntArray) -> FloatArray:
    """(e, c) of independent errors of each reading of the channels; that at the zero pose is in every residual of its channel."""
    own = np.isin(model.cable_index, cables)
    zero = (model.cable_index[:, None] == cables[model.campaign.from_zero[cables]]).astype(np.float64)
    return np.hstack([np.diag(own.astype(np.float64))[:, own], zero])


def every_length(model: Model) -> Explanation:
    """All cable lengths have independent errors of one size."""
    return Explanation("length", _length_errors(model, np.arange(len(model.campaign.drums))), lasting=True)
