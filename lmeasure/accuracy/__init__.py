"""Accuracy: pressure angles, uncertainty over the cell, zones, and where to put the observation points."""

from lmeasure.accuracy.pressure_angle import limit_from_accuracy
from lmeasure.accuracy.zone import scan_zone
from lmeasure.accuracy.zone_dataset import read_zone, write_zone

__all__ = ["limit_from_accuracy", "read_zone", "scan_zone", "write_zone"]
