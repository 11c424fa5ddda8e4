"""Where the observation points are: calibration from reference poses and counts."""

from lmeasure.calibration.campaign import Campaign
from lmeasure.calibration.campaign_files import read_campaign
from lmeasure.calibration.points import Settings
from lmeasure.calibration.solve import Calibration, calibrate

__all__ = ["Calibration", "Campaign", "Settings", "calibrate", "read_campaign"]
