"""Each observation point alone, at poses that are known: coarse solutions, LP-search, descent from several starts.

The coarse position takes straight cables from four or more reference poses. Thesis Rashoyan 2021, 5.5, eqs. 5.6-5.8. With Q_j = P_j -
P_1, x = B - P_1 and dl_j the change of the cable since pose 1, |x - Q_j|^2 = (l_1 + dl_j)^2 and |x|^2 = l_1^2 give the linear equations

    Q_j . x + l_1 dl_j = (|Q_j|^2 - dl_j^2) / 2,

so x = a + b l_1 and (b.b - 1) l_1^2 + 2 a.b l_1 + a.a = 0: two roots. (The printed 5.7 has squares on the coordinate differences and
5.8 repeats its first row's terms; both are misprints.) Changing the sign of all dl leaves B and turns l_1 over, so l_1 > 0 decides the
sign of the counts.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from lmeasure.calibration.campaign.campaign import Campaign, of_cables
from lmeasure.calibration.campaign.known_lengths import Distance
from lmeasure.calibration.solve.lp_search import Box, point_data, search_point
from lmeasure.calibration.solve.residuals import Frame, unknowns_of
from lmeasure.calibration.solve.unknowns import Model
from lmeasure.calibration.validation.diagnosis import EVIDENCE
from lmeasure.core import FloatArray, words_of
from lmeasure.estimation import Fit, fit
from lmeasure.rig import GUIDE, PLACE, azimuth_stretch

FLAT = 1e-6  # of the largest spread of the poses: below it they lie in a plane and B has a mirror image


@dataclass(frozen=True)
class CoarseSolution:
    """One root: position (3,) of B [mm, base frame], first_length of the straight cable at the zero pose [mm], rms of the straight
    lengths' misfit [mm], physical when the length and all later ones are positive."""

    position: FloatArray
    first_length: float
    rms: float
    physical: bool


def coarse_solutions(points: FloatArray, changes: FloatArray, zero: int, near: FloatArray) -> list[CoarseSolution]:
    """Return both roots from (n, 3) positions of the attachment point [mm] and (n,) changes of the cable [mm].

    Physical roots come first; of two, the one nearer to the point's nominal position near (3,): four poses fit both exactly.

    Empty with fewer than four poses or poses in a plane. If noise leaves no real root, the nearest (double) one is returned.
    """
    others = np.delete(np.arange(len(points)), zero)
    Q, dl = points[others] - points[zero], changes[others] - changes[zero]
    if len(others) < 3:
        return []
    spread = np.linalg.svd(Q, compute_uv=False)
    if spread[2] < FLAT * spread[0]:
        return []
    right = np.column_stack([(np.einsum("ij,ij->i", Q, Q) - dl**2) / 2, -dl])
    a, b = np.linalg.lstsq(Q, right, rcond=None)[0].T
    A, B, C = b @ b - 1.0, a @ b, a @ a
    root = np.sqrt(max(B * B - A * C, 0.0))
    # the stable pair of roots of A l^2 + 2 B l + C
    s = -(B + np.copysign(root, B))
    lengths = {s / A if A != 0 else np.inf, C / s if s != 0 else 0.0}
    out = []
    for length in lengths:
        if not np.isfinite(length):
            continue
        x = a + b * length
        misfit = np.linalg.norm(x - Q, axis=1) - (length + dl)
        physical = bool(length > 0 and (length + dl > 0).all())
        out.append(CoarseSolution(points[zero] + x, float(length), float(np.sqrt(np.mean(misfit**2))), physical))
    return sorted(out, key=lambda c: (not c.physical, float(np.linalg.norm(c.position - near))))


STARTS = 6  # distinct LP candidates that are polished per point
APART = 10.0  # standard uncertainties between two results that are not one


@dataclass(frozen=True)
class CalibrationSettings:
    """Settings of a calibration, the options of `lmeasure calibrate`.

    Examples
    --------
    >>> lm.CalibrationSettings(solve=("position",), robust=True).neighbourhood_mm
    100.0
    """

    solve: tuple[str, ...] = ()
    """Groups of parameters to estimate, such as "position", "guide" and "radius". Default: all that is uncertain."""
    neighbourhood_mm: float = 100.0
    """Search range of a point's coordinates about their nominal values [mm]."""
    neighbourhood_deg: float = 15.0
    """Search range of a guide's angles about their nominal values [deg]."""
    prior: bool = False
    """Whether the nominal values enter the fit as prior information."""
    seed: int = 0
    """Seed of the random starts."""
    robust: bool = False
    """Whether wrong poses get smaller weights (Tukey's biweight)."""
    hold_out: tuple[str, ...] = ()
    """Names of validation poses, which are not used in the fit."""
    self_calibration: bool = False
    """Whether the reference poses are estimated with the points; see `calibration.solve.joint_estimation`."""
    distances: tuple[Distance, ...] = ()
    """Known distances between poses, which determine the scale of a self-calibration."""
    frame: Frame = "rig"
    """Reference of a self-calibration's frame: the nominal rig or the reference poses."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "solve", words_of(self.solve))
        object.__setattr__(self, "hold_out", words_of(self.hold_out))

    @property
    def groups(self) -> tuple[str, ...]:
        """Return the parameters that are solved freely: all others follow from their priors."""
        return self.solve or ("position", "guide")


@dataclass(frozen=True)
class Point:
    """A point's coarse solutions by channel, the boxes searched, its best fit with the model, and others that fit as well."""

    name: str
    coarse: dict[str, list[CoarseSolution]]
    boxes: list[Box]
    fit: Fit
    model: Model
    rivals: list[Fit]


def box_of(campaign: Campaign, name: str, settings: CalibrationSettings) -> Box:
    """The neighbourhood of a nominal point."""
    half = np.array([settings.neighbourhood_mm] * 3 + [math.radians(settings.neighbourhood_deg)] * 2)
    # an assumed angle was not measured, so its whole range is searched
    for key, i, whole in zip(GUIDE, (3, 4), (math.pi / 2, math.pi), strict=True):
        if f"{name}.{key}" in campaign.rig.assumed:
            half[i] = whole
    point = campaign.rig.point(name)
    half[4] = min(half[4] * azimuth_stretch(point.guide_alpha_deg), math.pi)
    return Box(np.array([*point.position_mm, *np.radians([point.guide_alpha_deg, point.guide_beta_deg])]), half)


def _of_point(campaign: Campaign, name: str) -> Campaign:
    return of_cables(campaign, [j for j, c in enumerate(campaign.cables) if c.from_point == name])


def solve_point(campaign: Campaign, name: str, settings: CalibrationSettings, roughly: bool = False) -> Point:
    """Coarse solutions, search boxes and the best of several polished starts for one observation
    point; roughly as in `estimation.problem`."""
    own = _of_point(campaign, name)
    unknowns = unknowns_of(own, settings.groups)
    # a start, which errors of a typical size hardly move
    model = Model(own, unknowns).without_assumed()
    nominal = campaign.rig.point(name)
    coarse = {}
    for j, c in enumerate(own.drums):
        rows = np.flatnonzero(np.isfinite(own.counts[:, j]))
        # thesis 5.6: straight cables, dl = k * 0.012 mm; the drum's own part is as small as the wrap that is left out
        change = own.counts[rows, j] * nominal.drum.count_length_mm
        zero = int(np.flatnonzero(rows == own.zero[j])[0])
        points = own.poses.points(own.rig.tool[c.to_point])[rows]
        coarse[c.channel] = coarse_solutions(points, change, zero, np.array(nominal.position_mm))
    around = box_of(campaign, name, settings)
    boxes = [around]
    boxes += [
        Box(np.array([*s.position, *around.centre[3:]]), around.half) for solutions in coarse.values() for s in solutions[:1] if s.physical
    ]
    starts = [unknowns.nominal]
    free = [f"{name}.{key}" for key in (*PLACE, *GUIDE)]
    for candidate in search_point(point_data(campaign, name), boxes, settings.seed):
        start = unknowns.nominal.copy()
        values = [*candidate[:3], *np.degrees(candidate[3:])]
        for key, value in zip(free, values, strict=True):
            if key in unknowns.names:
                start[unknowns.names.index(key)] = value
        starts.append(start)
    best, *others = sorted(
        (fit(model, model.zeros_begun(start), settings.prior, roughly=roughly) for start in _distinct(starts, unknowns.width)),
        key=lambda f: f.objective,
    )
    rivals = [f for f in others if f.objective < best.objective + EVIDENCE and _apart(best, f, unknowns.width) > APART]
    if best.rank < len(unknowns.names):
        rivals = []  # the priors decide there, and a finding reports it
    return Point(name, coarse, boxes, best, model, rivals)


def _apart(a: Fit, b: Fit, width: FloatArray) -> float:
    """Distance of two results in the directions that the data determine at either, in standard uncertainties there: the smaller one."""
    d = (a.theta - b.theta) / width
    return min(float(np.linalg.norm((f.s * (f.directions @ d))[f.known])) for f in (a, b))


def _distinct(starts: list[FloatArray], width: FloatArray) -> list[FloatArray]:
    """The first STARTS starts that differ by more than a hundredth of a prior width in some value."""
    out: list[FloatArray] = []
    for start in starts:
        if all(np.abs((start - other) / width).max() > 1e-2 for other in out):
            out.append(start)
    return out[: STARTS + 1]


def coarse_entry(point: str, channel: str, place: int, s: CoarseSolution) -> dict[str, Any]:
    return {
        "point": point,
        "channel": channel,
        "position_mm": s.position.tolist(),
        "first_length_mm": s.first_length,
        "rms_mm": s.rms,
        "physical": s.physical,
        "chosen": place == 0 and s.physical,
    }
