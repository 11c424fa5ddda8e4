"""Slips in a campaign's files: positions in another unit than stated, and rows that are copies of others."""

from dataclasses import replace

import numpy as np

from lmeasure.calibration.campaign.campaign import Campaign
from lmeasure.core import CalibrationError, FloatArray, GeometryError
from lmeasure.rig import unlikely_size
from lmeasure.sensors import counts_from_poses
from lmeasure.text import message

UNITS = {"metres": 1e3, "inches": 25.4, "centimetres": 10.0, "micrometres": 1e-3}
"""Units of positions that are stated as millimetres: millimetres in one."""
RIGS = {"metres": 1e-3, "inches": 1.0 / 25.4}
"""Units of a rig's dimensions: factors by which positions then seem too large."""
CURES = 10.0
"""Factor by which another unit must improve the fit of the nominal rig's lengths to be no error of the rig."""


def without_slips(campaign: Campaign, name: str) -> Campaign:
    """Return the campaign with copies of poses counted once; its notes name them.

    CalibrationError if the positions of the file `name`, or the nominal rig, are in another unit: predicted and counted lengths then differ
    by far, and agree in that unit.
    """
    as_said = _misfit(campaign, 1.0)
    # a rig that is too small and positions that are too large look alike, but for its own size
    rigs = RIGS if campaign.poses.oriented and unlikely_size(campaign.rig.model_dump(), name) is not None else {}
    fits = {unit: _misfit(campaign, factor) for unit, factor in rigs.items()}
    if rigs and min(fits.values()) < as_said / CURES:
        unit = min(fits, key=lambda unit: fits[unit])
        raise CalibrationError(message("error.its_positions_fit_the", where=name, unit=unit))
    other = {unit: _misfit(campaign, factor) for unit, factor in UNITS.items()}
    best = min(other, key=lambda unit: other[unit])
    if campaign.poses.oriented and other[best] < as_said / CURES:
        raise CalibrationError(message("error.its_positions_are_where", where=name, best=best, other=other[best], as_said=as_said))
    return _counted_once(campaign)


def _misfit(campaign: Campaign, factor: float) -> float:
    """Return the root mean square [mm] of counted minus nominal changes of length, with positions times a factor; infinite if no cable
    could run."""
    rows = campaign.poses.rows * np.array([factor] * 3 + [1.0] * 4)
    off: list[FloatArray] = []
    for j, cable in enumerate(campaign.cables):
        if not cable.is_cable:
            continue
        drum = campaign.rig.point(cable.from_point).drum
        try:
            predicted = counts_from_poses(campaign.rig, rows, rows[campaign.zero[j]], (cable,))[:, 0]
        except GeometryError:
            return float("inf")
        there = campaign.used[:, j]
        off.append((campaign.counts[there, j] - predicted[there]) * drum.count_length_mm)
    every = np.concatenate(off) if off else np.zeros(0)
    return float(np.sqrt(np.mean(every**2))) if len(every) else float("inf")


def _counted_once(campaign: Campaign) -> Campaign:
    """Merge poses whose numbers and counts are those of an earlier one to the last digit: they add no information."""
    values = np.column_stack([campaign.poses.rows, campaign.counts])
    counts, notes, first = campaign.counts.copy(), [], dict[bytes, int]()
    for i, row in enumerate(values + 0.0):
        earlier = first.setdefault(row.tobytes(), i)
        if earlier != i and campaign.reference_of[i] == i and np.isfinite(counts[i]).any() and not (campaign.zero == i).any():
            counts[i] = np.nan
            notes.append(message("calibration.copied_pose", pose=campaign.poses.names[i], earlier=campaign.poses.names[earlier]))
    return replace(campaign, counts=counts, notes=(*campaign.notes, *notes)) if notes else campaign
