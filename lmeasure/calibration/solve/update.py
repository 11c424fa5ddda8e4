"""A continued calibration: information of ordinary runs beside a record, and a test whether the rig is still the record's.

The record states theta ~ N(theta_0, C_0) for its parameters and dimensions. The run's readings r(theta, poses) have covariance V. With the
poses eliminated (`estimation.elimination`: A the whitened derivatives that no pose compensates, y such residuals) the step of Gauss and
Newton is

    theta = theta_0 + d,   d = -(C_0^-1 + A'A)^-1 A'(y - A (theta_k - theta_0)),   C = (C_0^-1 + A'A)^-1,

and y'y + d' C_0^-1 d at the optimum is chi-squared, one degree of freedom for each y, while nothing has moved. C_0 may be singular: with
C_0 = F F' the step is in F's coordinates, whose prior is a unit normal.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy

from lmeasure.calibration.campaign.campaign import Campaign
from lmeasure.calibration.solve.frame import model_of
from lmeasure.calibration.solve.unknown_poses import free_components
from lmeasure.calibration.solve.unknowns import Model, rig_with
from lmeasure.core import CalibrationError, FloatArray, se3
from lmeasure.estimation import Eliminated, Parameters
from lmeasure.rig import CalibrationRecord, Finding, Residual, Rig, value_of
from lmeasure.sensors import axial_travel
from lmeasure.text import joined, message

MOVED = 1e-3
"""Probability of chance under which the rig is not that of the record any more."""
STEPS = 30
SETTLED = 1e-4  # of a standard uncertainty
APART = 2.0 * math.log(100.0)
"""Twice the logarithm of odds of a hundred."""
AGAIN = "calibration.moved.again"


@dataclass(frozen=True)
class Continued:
    """Refined rig and record; chi_squared of the run's readings and the record together, its degrees of freedom, and its probability while
    nothing has moved; moved: reasons why the two must not be combined, the best first."""

    rig: Rig
    record: CalibrationRecord
    chi_squared: float
    freedom: int
    probability: float
    moved: str | None


def continued(campaign: Campaign, record: CalibrationRecord) -> Continued:
    """Refine the record of a campaign's rig by its samples, at unknown poses.

    Its dimensions are solved too, so that no size is assumed for found values, and axial offsets of drums that were zeroed elsewhere, where
    they may differ. CalibrationError if the record was made of the same counts, the channels have no redundancy, or it does not converge.
    """
    known = {given.sha256 for given in record.inputs}
    again = [given.file for given in campaign.inputs if given.sha256 in known and given.file != "run.toml"]
    if again:
        raise CalibrationError(message("error.its_counts_are_in", where=again[0]))
    travel = {} if campaign.rig.unstated == "exact" else axial_travel(campaign.rig, record)
    offsets = {f"{c.from_point}.axial_offset_mm": travel[c.name] for c in campaign.drums if c.name in travel}
    q, solved = len(record.names), tuple(dict.fromkeys((*record.names, *offsets)))
    names, nominal, per = _solved(campaign.rig, solved)
    C0 = np.diag([offsets.get(name, 0.0) ** 2 for name in solved])
    C0[:q, :q] += record.joint_matrix() * np.outer(per[:q], per[:q])
    width = np.sqrt(np.maximum(np.diag(C0), 0.0))
    unit = np.where(width > 0.0, width, 1.0)
    values, vectors = np.linalg.eigh(C0 / np.outer(unit, unit))
    kept = values > 1e-12 * max(float(values.max()), 1e-300)
    F = unit[:, None] * vectors[:, kept] * np.sqrt(values[kept])
    model = model_of(campaign, Parameters(names, nominal, unit), free_components(campaign, trusted=False), "rig")
    theta, z = model.start, np.zeros(F.shape[1])
    for _ in range(STEPS):
        part, y, A = _seen(model, theta, F)
        step = np.linalg.solve(np.eye(len(z)) + A.T @ A, -(A.T @ y + z))
        dp = part.follow_up(model.residuals(theta), F @ step / unit)
        theta, z = theta + np.r_[F @ step, dp], z + step
        if np.abs(step).max(initial=0.0) < SETTLED and np.abs(dp).max(initial=0.0) < 1e-6:
            break
    else:
        raise CalibrationError(message("error.the_run_and_the"))
    part, y, A = _seen(model, theta, F)
    determined = np.linalg.inv(np.eye(len(z)) + A.T @ A)
    C = F @ determined @ F.T
    chi2, freedom = float(y @ y + z @ z), len(y)
    probability = float(scipy.stats.chi2.sf(chi2, freedom))
    moved = _moved(model, part, theta, y, A, z, probability) if probability < MOVED else None
    C = (C / np.outer(per, per))[:q, :q]
    values = np.array([value_of(campaign.rig, name) or 0.0 for name in record.names]) + ((theta[: model.own] - nominal) / per)[:q]
    u = np.sqrt(np.maximum(np.diag(C), 0.0))
    rig = rig_with(campaign, Parameters(record.names, values, u), values, "calibration.json", u=u)
    return Continued(rig, _record(record, model, theta, values, C, (chi2, freedom, probability)), chi2, freedom, probability, moved)


def _solved(rig: Rig, solved: tuple[str, ...]) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
    """Return names (q,) of the solved parameters, their values in the rig, and changes by one unit of the record's: the scale for a count's
    length."""
    drums = {
        f"{p.name}.count_length_mm": (f"{p.name}.scale", p.drum.scale, -p.drum.scale / p.drum.count_length_mm)
        for p in rig.observation_point
    }
    every = [drums.get(name, (name, value_of(rig, name) or 0.0, 1.0)) for name in solved]
    return tuple(e[0] for e in every), np.array([e[1] for e in every]), np.array([e[2] for e in every])


def _seen(model: Model, theta: FloatArray, F: FloatArray) -> tuple[Eliminated, FloatArray, FloatArray]:
    """The problem at theta with the poses eliminated; whitened residuals (f,), and their derivatives (f, r) in the record's coordinates."""
    part = Eliminated(model, theta, model.covariance(theta), model.own)
    if part.loose:
        raise CalibrationError(model.undetermined_block(part.loose[0]))
    return part, part.W @ model.residuals(theta), part.W @ part.A @ (F / model.parameters.width[:, None])


def _moved(model: Model, part: Eliminated, theta: FloatArray, y: FloatArray, A: FloatArray, z: FloatArray, probability: float) -> str:
    """Return the best explanation of a contradiction between run and record: a changed owner of parameters, throughout or from some sample
    on, or one channel that reads more from some sample on."""
    base = np.vstack([A, np.eye(len(z))])
    Q, _ = np.linalg.qr(base)
    residual = np.r_[y, z]
    free, no_prior = residual - Q @ (Q.T @ residual), np.zeros(len(z))
    whitened, campaign = part.W @ part.A, model.campaign

    def gain(columns: FloatArray) -> float:
        """Return the fall of chi-squared, minus twice the number of values, by columns (f, c) that no pose compensates."""
        own = np.vstack([columns, np.zeros((len(z), columns.shape[1]))])
        own -= Q @ (Q.T @ own)
        U, s, _ = np.linalg.svd(own, full_matrices=False)
        U = U[:, s > 1e-6 * max(float(s[0]), 1e-300)]
        return float(np.sum((U.T @ free) ** 2)) - 2.0 * U.shape[1]

    owners = {owner: model.parameters.of(owner) for owner in dict.fromkeys(model.parameters.owner(i) for i in range(model.own))}
    found = [(gain(whitened[:, own]), message("calibration.moved.owner", owner=owner), AGAIN) for owner, own in owners.items()]
    # as many places as there are samples to begin at
    samples, names = range(2, len(campaign.poses)), campaign.poses.names
    begins, place = (model.pose_index[:, None] >= samples).astype(np.float64), 2.0 * math.log(max(len(samples), 1))
    for owner, own in owners.items():
        steps = [gain(part.W @ (part.A[:, own] * behind[:, None])) - place for behind in begins.T]
        if steps:
            found.append((max(steps), message("calibration.moved.during", owner=owner, name=names[samples[int(np.argmax(steps))]]), AGAIN))
    for j, c in enumerate(campaign.cables):
        own = np.vstack([part.W @ (begins * (model.cable_index == j)[:, None]), np.tile(no_prior[:, None], len(samples))])
        own -= Q @ (Q.T @ own)
        square, along = np.sum(own**2, axis=0), own.T @ free
        determined = square > 1e-6 * square.max(initial=1e-300)
        gains = np.where(determined, along**2 / np.where(determined, square, 1.0), 0.0) - 2.0 - place
        if len(gains):
            k = int(np.argmax(gains))
            # modelled less measured
            size = -float(along[k] / square[k]) / campaign.mm_per_unit[j]
            code, by = ("reads_mm", size) if c.is_length else ("reads_deg", math.degrees(size))
            text = message(f"calibration.moved.{code}", channel=c.channel, by=by, name=names[samples[k]])
            found.append((float(gains[k]), text, "calibration.moved.lost"))
    found.sort(key=lambda one: -one[0])
    near = [one for one in found if one[0] > found[0][0] - APART]
    if len(near) == 1:
        return message("calibration.moved.one", p=probability, what=near[0][1], cure=message(near[0][2]))
    return message("calibration.moved.several", p=probability, what=joined(text for _, text, _ in near[:4]))


def _record(
    old: CalibrationRecord, model: Model, theta: FloatArray, values: FloatArray, C: FloatArray, test: tuple[float, int, float]
) -> CalibrationRecord:
    """The record with the new values (q,) of parameters and dimensions, covariance (q, q) and residuals."""
    campaign, p = model.campaign, len(old.parameters)
    rows = tuple(tuple(map(float, row)) for row in C[:p, :p])
    u, r = np.sqrt(np.maximum(np.diag(C), 0.0)), model.residuals(theta)
    parameters = tuple(
        q.model_copy(update={"value": float(v), "u": float(s), "prior_u": q.u, "U95": 1.96 * float(s)})
        for q, v, s in zip(old.parameters, values[:p], u[:p], strict=True)
    )
    dimensions = tuple(
        d.model_copy(update={"value": float(v), "u": float(s), "prior_u": d.u, "covariance": tuple(map(float, column))})
        for d, v, s, column in zip(old.dimensions, values[p:], u[p:], C[:, p:].T, strict=True)
    )
    before = float(np.sqrt(np.mean([p.u**2 for p in old.parameters if p.name.endswith("_mm")] or [0.0])))
    after = float(np.sqrt(np.mean([p.u**2 for p in parameters if p.name.endswith("_mm")] or [0.0])))
    places = model.poses(theta)
    reach, turn = (
        float(np.linalg.norm(np.ptp(places[:, :3], axis=0))),
        float(np.linalg.norm(se3.displacement(places, places[0])[:, :3], axis=1).max()),
    )
    text = message(
        "calibration.continued", equations=old.equations, more=model.equations, before=before, after=after, chi2=test[0], freedom=test[1],
        p=test[2], reach=reach, turn=math.degrees(turn),
    )  # fmt: skip
    return old.model_copy(
        update={
            "parameters": parameters,
            "dimensions": dimensions,
            "covariance": rows,
            "tangent_covariance": rows,
            "residuals": tuple(
                Residual(pose=campaign.poses.names[i], channel=campaign.cables[j].channel, mm=-float(x))
                for i, j, x in zip(model.pose_index, model.cable_index, r, strict=True)
            ),
            "equations": model.equations,
            "unknowns": len(theta),
            "rank": len(theta),
            "warnings": (Finding(code="continued", text=text), *old.warnings),
            "inputs": (*old.inputs, *campaign.inputs),
            "poses": (),
            "correlations": (),
            "spectrum": (),
            "validation": {},
            "noise": {"chi_squared": test[0], "degrees_of_freedom": float(test[1]), "residual_rms_mm": float(np.sqrt(np.mean(r**2)))},
        }
    )
