"""Each observation point alone, at poses that are known: coarse solutions, LP-search, descent from several starts."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from lmeasure.calibration.campaign.campaign import Campaign, of_cables
from lmeasure.calibration.campaign.known_lengths import Distance
from lmeasure.calibration.solve.coarse import CoarseSolution, coarse_solutions
from lmeasure.calibration.solve.lp_search import Box, point_data, search_point
from lmeasure.calibration.solve.residuals import Frame, unknowns_of
from lmeasure.calibration.solve.unknowns import Model
from lmeasure.calibration.validation.diagnosis import EVIDENCE
from lmeasure.core import FloatArray
from lmeasure.estimation import Fit, fit
from lmeasure.rig import GUIDE, PLACE, azimuth_stretch

STARTS = 6  # distinct LP candidates that are polished per point
APART = 10.0  # standard uncertainties between two results that are not one


@dataclass(frozen=True)
class CalibrationSettings:
    """Options of a calibration; see the contract's `lmeasure calibrate`."""

    solve: tuple[str, ...] = ("position", "guide")
    neighbourhood_mm: float = 100.0
    neighbourhood_deg: float = 15.0
    prior: bool = False
    seed: int = 0
    robust: bool = False
    hold_out: tuple[str, ...] = ()
    """Poses that take no part in the fit and judge it."""
    self_calibration: bool = False
    """Poses are estimated with the points, and not trusted; see `calibration.solve.joint_estimation`."""
    distances: tuple[Distance, ...] = ()
    """Known distances between poses, with which a self-calibration's scale is not only that of the counts."""
    frame: Frame = "rig"
    """What holds the frame of a self-calibration: the nominal rig or the reference poses."""


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
    # nobody measured an assumed angle: all of its range is searched
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
    point; roughly as in `estimation.fit_result`."""
    own = _of_point(campaign, name)
    unknowns = unknowns_of(own, settings.solve)
    model = Model(own, unknowns)
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
        rivals = []  # the priors decide there, which is said
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
