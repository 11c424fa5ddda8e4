"""Progress of the readings in a capture's folder: the campaign a calibration will find there, its worth, the counts expected next."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from lmeasure.accuracy import radii_95
from lmeasure.calibration import (
    CHECKS_LOG2,
    Campaign,
    Instrument,
    Model,
    Outlook,
    Region,
    extended,
    lengths_over,
    of_cables,
    outlook_of,
    read_campaign,
)
from lmeasure.core import FloatArray, LMeasureError
from lmeasure.estimation import estimated_covariance, fit, parameter_information
from lmeasure.kernels import span_rows
from lmeasure.procedures.capture.folder import CaptureFolder
from lmeasure.recording import Poses
from lmeasure.rig import CABLES_FOR_A_POSE, Cable, Rig
from lmeasure.sensors import count_variance
from lmeasure.text import composed, message

U95 = 1.96
"""Half width of a normal distribution's 95 % interval, in standard deviations."""
POSES_TRIED = 64


@dataclass(frozen=True)
class Worth:
    """Value of readings: number of determined parameter combinations, the 95 % uncertainty of a length over the poses' box [mm], its root
    mean square and largest with the cable, and the largest U95 of a position there [mm], None if the cables determine no pose."""

    rank: int
    unknowns: int
    rms_mm: float
    worst_mm: float
    worst_cable: str
    position_mm: float | None

    least: int
    """Poses that have as many equations as there are unknowns."""

    def enough(self, poses: int) -> bool:
        """Return whether so many poses can determine the solved parameters; with fewer, the figures are little but the rig's own
        uncertainties."""
        return poses >= self.least


@dataclass(frozen=True)
class Expected:
    """Distances of the lengths (m,) counted at a pose from those expected there [mm], and the standard uncertainty of that."""

    cables: tuple[Cable, ...]
    off_mm: FloatArray
    u_mm: FloatArray


class Forecast:
    """Forecast of a rig's pass and the poses to be read, linearised at the rig; of_all: the worth of all of them, once they are read.

    CalibrationError where its cables cannot run over them.
    """

    def __init__(self, rig: Rig, passage: int, poses: Poses, solve: tuple[str, ...] = ("position", "guide")) -> None:
        self._instrument = Instrument(rig, rig.cables_of(passage), solve, np.zeros(6), visit=np.zeros(6))
        self._zone = region_of(poses)
        self._lengths = lengths_over(self._instrument, self._zone, CHECKS_LOG2, 0)
        m = len(self._instrument.cables)
        all_read = Campaign(rig, poses, self._instrument.cables, np.zeros((len(poses), m)), np.zeros(m, np.int64))
        all_read = self._instrument.predicted(all_read)
        self.of_all = self.worth(all_read)
        # compile now, while nothing moves
        self.expected(all_read, poses.of(np.array([0])), np.zeros((1, m)))

    def worth(self, campaign: Campaign) -> Worth:
        """Return the worth of the readings of a campaign."""
        p = len(self._instrument.unknowns.names)
        information = parameter_information(self._instrument.recorded(campaign)[0], p)
        reported: Outlook = outlook_of(information, self._lengths)
        least = 1 + math.ceil(p / len(self._instrument.cables))
        return Worth(
            reported.rank, p, U95 * reported.rms_mm, U95 * reported.worst_mm, reported.worst_cable, self._position(information), least
        )

    def _position(self, information: FloatArray) -> float | None:
        """The largest 95 % radius over the zone of a position measured with whole counts and the calibration that is had so far."""
        rig, cables = self._instrument.rig, self._instrument.cables
        if len(cables) < CABLES_FOR_A_POSE:
            return None
        unit = np.random.default_rng(1).uniform(0.0, 1.0, (POSES_TRIED, 6))
        rows, start = self._zone.rows(unit), self._zone.centre[None, :]
        gradients = self._instrument.gradients(rows, start, np.zeros(len(cables), np.int64), cables)
        covariance = gradients @ estimated_covariance(information)[0] @ gradients.transpose(0, 2, 1)
        covariance += 2.0 * np.diag(count_variance(rig, cables))  # counted here and where the run begins
        P = np.array([span_rows(rig.cable_rows(cables), row) for row in np.ascontiguousarray(rows)])
        normal = P.transpose(0, 2, 1) @ np.linalg.solve(covariance, P)
        with np.errstate(all="ignore"):
            good = np.isfinite(normal).all(axis=(1, 2)) & (np.linalg.cond(normal) < 1e12)
        return float(radii_95(np.linalg.inv(normal[good])[:, 3:, 3:]).max()) if good.any() else None

    def expected(self, campaign: Campaign, pose: Poses, counts: FloatArray) -> Expected | None:
        """Compare counts k (1, m) at a further pose with those expected from the campaign so far, or the rig alone; None without an
        expectation."""
        try:
            unknowns = self._instrument.unknowns
            theta, covariance = unknowns.nominal, np.diag(unknowns.width**2)
            if campaign.used.any():
                model = Model(campaign, unknowns)
                found = fit(model, model.start)
                theta, covariance = found.theta, found.covariance
            with_it = Model(extended(campaign, pose, counts), unknowns)
            own = with_it.pose_index == len(campaign.poses)
            residuals, J = with_it.residuals(theta)[own], with_it.jacobian(theta)[own]
            variance = np.einsum("ei,ij,ej->e", J, covariance, J) + np.diag(with_it.measurement_covariance(theta))[own]
        except (LMeasureError, np.linalg.LinAlgError):
            return None
        return Expected(tuple(campaign.drums[j] for j in with_it.cable_index[own]), -residuals, np.sqrt(variance))


def region_of(poses: Poses) -> Region:
    """The least box and tilts about a mean orientation that hold all poses."""
    mean = poses.rotation.mean()
    tilt = np.abs((poses.rotation * mean.inv()).as_rotvec()).max()
    return Region(poses.rows[:, :3].min(axis=0), poses.rows[:, :3].max(axis=0), float(min(tilt, np.pi / 2)), mean.as_quat())


class Progress:
    """Progress of the pass that a folder captures; say prints lines. worth: value of the readings, None if it is unknown."""

    def __init__(self, folder: CaptureFolder, say: Callable[[str], None]) -> None:
        self._folder, self._say = folder, say
        self._campaign: Campaign | None = None
        self._forecast: Forecast | None = None
        self.worth: Worth | None = None
        self.history: list[tuple[int, Worth]] = []
        """Number of readings and their value then."""

    @property
    def of_all(self) -> Worth | None:
        """The worth of all poses, once they are read."""
        return None if self._forecast is None else self._forecast.of_all

    def renew(self) -> None:
        """Once the folder's readings are others."""
        folder = self._folder
        self._campaign = self._read_campaign()
        self.worth = None
        try:
            if self._forecast is None and folder.poses.oriented:
                self._forecast = Forecast(folder.rig, folder.passage, folder.poses)
            if self._forecast is not None and self._campaign is not None and self._campaign.used.any():
                self.worth = self._forecast.worth(self._campaign)
                self._remember(self._forecast, self._campaign)
        except LMeasureError as error:
            self._say(message("capture.no_forecast", error=error))

    def _remember(self, forecast: Forecast, campaign: Campaign) -> None:
        """Record the value now behind that of fewer readings, which a continued session does not know yet."""
        readings = len(self._folder.of_pass)
        self.history = [(count, worth) for count, worth in self.history if count < readings]
        if not self.history and campaign.counted is not None:
            read = np.flatnonzero(np.isfinite(campaign.counts).any(axis=1))
            order = read[np.argsort(campaign.counted[read].max(axis=1))]
            for count in range(2, len(order)):
                counts = np.full_like(campaign.counts, np.nan)
                counts[order[:count]] = campaign.counts[order[:count]]
                self.history.append((count, forecast.worth(replace(campaign, counts=counts))))
        if self.worth is not None:
            self.history.append((readings, self.worth))

    def expected(self, pose: str, mean: FloatArray) -> Expected | None:
        """Compare recorded counts (m,) with those expected at a pose; None without an expectation."""
        if self._forecast is None or self._campaign is None:
            return None
        poses = self._folder.poses
        return self._forecast.expected(self._campaign, poses.of(np.array([poses.names.index(pose)])), self._true_counts(mean)[None, :])

    def _read_campaign(self) -> Campaign | None:
        """Return the campaign of this pass that the calibration will find in the folder."""
        folder = self._folder
        readings, poses = folder.of_pass, folder.poses
        if not readings or not poses.oriented:
            return None
        cables = folder.rig.cables_of(folder.passage)
        if len({r.pose for r in readings}) < 2:
            first = poses.of(np.array([poses.names.index(readings[0].pose)]))
            return Campaign(folder.rig, first, cables, self._true_counts(readings[0].mean)[None, :], np.zeros(len(cables), np.int64))
        try:
            campaign = read_campaign(folder.path)
        except LMeasureError as error:
            self._say(composed("  ! {error}", error=error))
            return None
        return of_cables(campaign, [j for j, c in enumerate(campaign.drums) if c.passage == folder.passage])

    def _true_counts(self, mean: FloatArray) -> FloatArray:
        """(c,) true counts k of the pass' cables of recorded ones (m,)."""
        rig, passage = self._folder.rig, self._folder.passage
        drums, column = rig.drums_of(passage), dict(zip(self._folder.channels, mean, strict=True))
        return np.array([column[c.channel] * drums[c.channel].count_sign / drums[c.channel].scale for c in rig.cables_of(passage)])
