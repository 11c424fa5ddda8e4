"""Progress of the readings in a capture's folder: the campaign a calibration will find there, its worth, the counts expected next."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lmeasure.calibration import Campaign, of_cables, read_campaign
from lmeasure.core import FloatArray, LMeasureError
from lmeasure.procedures.capture.folder import CaptureFolder
from lmeasure.procedures.capture.forecast import Expected, Forecast, Worth
from lmeasure.text import composed, message


class Progress:
    """Progress of the pass that a folder captures; say takes lines for a person. worth: of the readings, None where nothing can be said of
    it."""

    def __init__(self, folder: CaptureFolder, say: Callable[[str], None]) -> None:
        self._folder, self._say = folder, say
        self._campaign: Campaign | None = None
        self._forecast: Forecast | None = None
        self.worth: Worth | None = None
        self.history: list[tuple[int, Worth]] = []
        """After how many readings what they were worth."""

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
        """The worth by now behind that of fewer readings, all of which a session that goes on does not know yet."""
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
        """Recorded counts (m,) held against what is expected at a pose; None where nothing tells it yet."""
        if self._forecast is None or self._campaign is None:
            return None
        poses = self._folder.poses
        return self._forecast.expected(self._campaign, poses.of(np.array([poses.names.index(pose)])), self._true_counts(mean)[None, :])

    def _read_campaign(self) -> Campaign | None:
        """Return what the calibration will find in the folder, of this pass."""
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
