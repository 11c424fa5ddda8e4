"""A scanned zone as a dataset over x, y, z: limits applied, printed for the reader, written and read."""

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lmeasure.accuracy.limits import REASONS, Limits, broken_limits
from lmeasure.accuracy.readings import Readings, worst_faults
from lmeasure.accuracy.scan import digest_of
from lmeasure.core import AccuracyError, FileFormatError, FloatArray, pasted
from lmeasure.io import files, open_regular
from lmeasure.rig import CABLES_FOR_A_POSE, Rig
from lmeasure.text import Lines, message, restored, settled

if TYPE_CHECKING:
    import xarray as xr

SCHEMA = "lmeasure.zone/1"
DIMS = ("x", "y", "z")
ABOUT = {
    "worst_pressure_angle_deg": ("largest pressure-angle analogue, worst over the orientations", "degree"),
    "u95_position_mm": ("radius at the tool origin that holds 95 %, worst over the orientations", "mm"),
    "u95_rotation_deg": ("radius of the rotation vector that holds 95 %, worst over the orientations", "degree"),
    "u95_attachment_mm": ("radius at the worst attachment point that holds 95 %, worst over the orientations", "mm"),
    "shortest_cable_mm": ("shortest cable, B to attachment point", "mm"),
    "longest_cable_mm": ("longest cable, B to attachment point", "mm"),
    "largest_wrap_deg": ("largest angle that a cable wraps around its swivel pulley", "degree"),
    "singularity_distance": ("least 1/|J^-1|, J with moments divided by the platform's size", "1"),
    "clearance_mm": ("least distance between cables, and from cable to body", "mm"),
    "assembly": ("sign of the determinant, 0 where it changes", "1"),
    "least_fault": ("smallest fault of a channel that one sample shows (0.1 %, power 80 %), worst over the orientations", "channel_unit"),
    "least_fault_apart": ("smallest that is distinguished from one of any other channel, worst over the orientations", "channel_unit"),
    "fault_effect_mm": ("what a fault that is just not found does to the tool's place, worst over the orientations", "mm"),
    "flags": ("cable cannot run 1, singular 2", "1"),
}


def about(text: str, units: str) -> dict[str, Any]:
    """Attributes of a variable."""
    return {"long_name": text, "units": units}


def within(data: "xr.Dataset", limits: Limits) -> "xr.Dataset":
    """The dataset with the limits applied: in_zone, rejected_because, volume."""
    because, sign = broken_limits({str(name): values.values for name, values in data.data_vars.items()}, limits)
    inside = because == 0
    masks = np.array([1 << bit for bit in range(len(REASONS))], np.int32)
    bits = about("limits broken at some orientation", "1") | {"flag_masks": masks, "flag_meanings": " ".join(REASONS)}
    of_node = about("1 where every orientation is within every limit", "1")
    out = data.assign(in_zone=(DIMS, inside.astype(np.int8), of_node), rejected_because=(DIMS, because, bits))
    named = {f"limit_{name}": value for name, value in asdict(limits).items() if value is not None and value is not False}
    out = out.assign_attrs(
        {"limit_deg": float(limits.angle_deg)}
        | {name: list(value) if isinstance(value, tuple) else float(value) for name, value in named.items()}
        | {
            "zone_volume_mm3": float(inside.sum() * math.prod(data.attrs["node_spacing_mm"])),
            "nodes_in_zone": int(inside.sum()),
            "assemblies_in_zone": len(np.unique(data["assembly"].values[inside])) if "assembly" in data else int(inside.any()),
            "assembly_sign": sign,
        }
    )
    return out.assign_attrs(result_sha256=digest_of({str(name): out[name].values for name in sorted(map(str, out.data_vars))}))


def reasons(zone: "xr.Dataset") -> dict[str, int]:
    """Return how many nodes each of `REASONS` takes from the zone; a node may have several."""
    because = zone["rejected_because"].values
    return {reason: int((because >> bit & 1).sum()) for bit, reason in enumerate(REASONS)}


def sole_reasons(zone: "xr.Dataset") -> dict[str, int]:
    """Return how many nodes each of `REASONS` takes from the zone without any other."""
    because = zone["rejected_because"].values
    return {reason: int((because == 1 << bit).sum()) for bit, reason in enumerate(REASONS)}


def summary(zone: "xr.Dataset") -> str:
    """A few lines for a person: how much of the box is in the zone, the best node, why the rest is not."""
    angle, inside = zone["worst_pressure_angle_deg"], zone["in_zone"].values.astype(bool)
    refined = [zone.attrs[key] / 1e9 for key in ("refined_volume_mm3", "refined_volume_change_mm3") if key in zone.attrs]
    best = np.unravel_index(int(np.argmin(angle.values)), angle.shape)
    where = ", ".join(f"{name} {settled(float(zone[name][i])):g}" for name, i in zip("xyz", best, strict=True))
    turns = zone.sizes["orientation"]
    nodes = {"inside": int(inside.sum()), "of": inside.size, "turns": turns, "limit": float(zone.attrs["limit_deg"])}
    lines = [message("zone_line.nodes", **nodes, volume=float(zone.attrs["zone_volume_mm3"]) / 1e9)]
    lines += [message("zone_line.refined", volume=refined[0], change=refined[1])] if refined else []
    lines.append(message("accuracy.smallest_worst_pressure_angle", angle=float(angle.values[best]), where=where))
    if inside.any():
        u95 = zone["u95_position_mm"].values[inside]
        lines.append(message("accuracy.95_radius_tool_origin", least=u95.min(), most=u95.max()))
    if zone.attrs["assemblies_in_zone"] > 1:
        lines.append(message("accuracy.zone_holds_more_than"))
    rejected = {reason: n for reason, n in reasons(zone).items() if n}
    if rejected:
        listed = tuple(message("zone_line.reason", reason=message(f"zone_reason.{reason}"), n=n) for reason, n in rejected.items())
        lines.append(message("zone_line.rejected", reasons=listed))
    covered = message("accuracy.95_radius_covers", covers=messages_of(zone, "u95_covers")[0])
    return Lines([*lines, covered, *messages_of(zone, "assumed")])


def goes_on(zone: "xr.Dataset") -> list[str]:
    """Directions, such as +X, in which the zone reaches the scanned box's face."""
    inside = zone["in_zone"].values.astype(bool)
    out = []
    for axis, name in enumerate("XYZ"):
        for sign, end in (("-", 0), ("+", -1)):
            if inside.shape[axis] > 1 and inside.take(end, axis).any():
                out.append(f"{sign}{name}")
    return out


def advice(zone: "xr.Dataset", rig: Path) -> list[str]:
    """Return advice for a zone without a node."""
    reason, nodes = max(sole_reasons(zone).items(), key=lambda item: item[1])
    command = f"lmeasure place {pasted(rig)} --task placement.toml --out placed"
    because_of = message("zone_line.nothing_because", nodes=nodes, reason=message(f"zone_reason.{reason}"))
    return [
        because_of if nodes else message("zone_line.nothing"),
        message("accuracy.try_another_box_other", command=command),
        message("accuracy.points_lmeasure_init_writes"),
    ]


def write_zone(path: Path, zone: "xr.Dataset") -> None:
    """Write a zone as netCDF-4, complete or not at all.

    Parameters
    ----------
    path
        File to write.
    zone
        Result of `zone`.

    Examples
    --------
    >>> lm.write_zone(Path("zone.nc"), zone)
    """
    # the image in memory first: on a full disk HDF5 does not end, it crashes
    files.write_bytes(path, zone.to_netcdf(engine="h5netcdf", format="NETCDF4"))


def read_zone(path: Path) -> "xr.Dataset":
    """Read a zone file into memory.

    Parameters
    ----------
    path
        netCDF-4 file that `write_zone` wrote.

    Returns
    -------
    xarray.Dataset
        The zone.

    Raises
    ------
    FileFormatError
        If the file is no zone. The message names what it lacks.

    Examples
    --------
    >>> lm.write_zone(Path("zone.nc"), zone)
    >>> bool(lm.read_zone(Path("zone.nc")).in_zone.all())
    True
    """
    import xarray as xr

    open_regular(path).close()
    try:
        with xr.open_dataset(path, engine="h5netcdf", phony_dims="access") as stored:
            data = stored.load()
    except Exception as error:  # HDF5's readers raise whatever a broken file leads them into
        raise FileFormatError(message("error.is_no_netcdf_file", where=path, error=" ".join(str(error).split())[:200])) from error
    if data.attrs.get("schema") != SCHEMA:
        raise FileFormatError(message("error.schema_this_program_reads", where=path, stated=data.attrs.get("schema"), schema=SCHEMA))
    _check(path, data)
    return data


def _check(path: Path, data: "xr.Dataset") -> None:
    """Raise FileFormatError if an axis, variable or attribute of a zone is missing or wrong: another program wrote or changed the file."""
    for name in DIMS:
        if name not in data.coords or data.coords[name].dims != (name,):
            raise FileFormatError(message("error.coordinate_is_missing", where=path, name=name))
        values = data.coords[name].values
        if values.dtype.kind not in "fiu" or not np.isfinite(values).all() or (np.diff(values) <= 0).any():
            raise FileFormatError(message("error.coordinate_does_not_hold", where=path, name=name))
    if "in_zone" not in data:
        raise FileFormatError(message("error.variable_in_zone_is", where=path))
    for name in ("in_zone", *(v for v in ABOUT if v in data)):
        if data[name].dims not in (DIMS, (*DIMS, "channel")) or data[name].values.dtype.kind not in "fiub":
            raise FileFormatError(message("error.variable_does_not_hold", where=path, name=name, dims=", ".join(DIMS)))
    if not np.isin(data["in_zone"].values, (0, 1)).all():
        raise FileFormatError(message("error.variable_in_zone_holds", where=path))
    for name, count in (("node_spacing_mm", 3), ("zone_volume_mm3", 1), ("limit_deg", 1)):
        values = np.atleast_1d(data.attrs.get(name, np.empty(0)))
        if values.shape != (count,) or values.dtype.kind not in "fiu" or not np.isfinite(values).all():
            raise FileFormatError(message("error.attribute_does_not_hold", where=path, name=name, count=count))


def messages_of(zone: "xr.Dataset", name: str) -> list[str]:
    """Return the lines of an attribute of a zone: messages, where the zone keeps their ids."""
    return list(restored(str(zone.attrs.get(name, "")).splitlines(), json.loads(str(zone.attrs.get("messages", "[]")))))


VARIABLES = ("least_fault", "least_fault_apart", "fault_effect_mm")


def with_faults(data: "xr.Dataset", rig: Rig, readings: Readings, positions: FloatArray) -> "xr.Dataset":
    """The dataset of a zone with `VARIABLES` over its nodes, positions (n, 3), and channels, worst over the orientations: of single
    samples. AccuracyError where no channel is to spare."""
    if len(readings.rows) == CABLES_FOR_A_POSE:
        raise AccuracyError(message("error.rig_has_six_channels", name=rig.name))
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
    """Return for each channel its largest minimal detectable fault in the zone, and the effect of one that is just not found."""
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
