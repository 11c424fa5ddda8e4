"""Which faults of single channels would show at each place of a zone: reliability as Baarda states it (`trajectory.faults.redundancy`)."""

from typing import TYPE_CHECKING

import numpy as np

from lmeasure.accuracy.readings import Readings, worst_faults
from lmeasure.accuracy.zone_dataset import ABOUT, DIMS, about
from lmeasure.core import AccuracyError, FloatArray
from lmeasure.rig import CABLES_FOR_A_POSE, Rig
from lmeasure.text import message

if TYPE_CHECKING:
    import xarray as xr

VARIABLES = ("least_fault", "least_fault_apart", "fault_effect_mm")


def with_faults(data: "xr.Dataset", rig: Rig, readings: Readings, positions: FloatArray) -> "xr.Dataset":
    """The dataset of a zone with `VARIABLES` over its nodes, positions (n, 3), and channels, worst over the orientations: of single
    samples. AccuracyError where no channel is to spare."""
    if len(readings.rows) == CABLES_FOR_A_POSE:
        raise AccuracyError(f"rig {rig.name!r}: has six channels for six unknowns: none is to spare, and no fault of any would show")
    lengths = ~readings.angular
    unit = np.where(lengths, 1.0, 180.0 / np.pi)
    smallest, apart, effect = worst_faults(readings, positions, data["quaternion_xyzw"].values)
    shape = [data.sizes[name] for name in DIMS]
    return data.assign(
        {
            name: ((*DIMS, "channel"), values.reshape(*shape, -1), about(*ABOUT[name]))
            for name, values in zip(VARIABLES, (smallest * unit, apart * unit, effect), strict=True)
        }
    ).assign_coords(
        channel=("channel", [o.name for o in rig.observed], {"long_name": "cable, or channel of an encoder"}),
        channel_unit=("channel", np.where(lengths, "mm", "degree").tolist(), {"long_name": "of a channel's faults"}),
    )


def said(zone: "xr.Dataset") -> list[str]:
    """For each channel, of the places in the zone: the largest of its smallest faults, and what one that is just not found does."""
    if "least_fault" not in zone or not zone["in_zone"].values.any():
        return []
    inside = zone["in_zone"].values.astype(bool)
    lines: list[str] = [message("accuracy.single_faults_one_sample")]
    found, apart, effect = (zone[name].values[inside].max(axis=0) for name in VARIABLES)
    for k, name in enumerate(zone["channel"].values):
        unit = " deg" if zone["channel_unit"].values[k] == "degree" else " mm"
        lines.append(f"  {name}: {_of(found[k], unit)}, {_of(apart[k], unit)}; {_of(effect[k], ' mm')}")
    return lines


def _of(value: float, unit: str) -> str:
    return f"{value:.3g}{unit}" if np.isfinite(value) else "none"
