"""What a page and a PDF of a zone say: findings in sentences, and tables of texts."""

from typing import Any

import numpy as np
import xarray as xr

from lmeasure.accuracy import Extent, reasons
from lmeasure.core import FloatArray
from lmeasure.rig import Rig
from lmeasure.text import Say

Rows = list[tuple[str, ...]]


def title(rig: Rig, say: Say) -> str:
    """Of page and PDF."""
    return say("Accuracy zone of {rig}", rig=rig.name)


def has_edge(zone: xr.Dataset) -> bool:
    """Whether some places of the box lie in the zone and some do not."""
    inside = zone["in_zone"].values
    return bool(inside.any() and not inside.all())


def findings(zone: xr.Dataset, found: Extent, say: Say) -> list[str]:
    """A few sentences for a robot engineer."""
    attrs = zone.attrs
    total, inside = zone["in_zone"].size, attrs["nodes_in_zone"]
    ends = [(name.upper(), float(zone[name].values[0]), float(zone[name].values[-1])) for name in "xyz"]
    box = ", ".join(say("{name} {low:g} to {high:g}", name=name, low=low, high=high) for name, low, high in ends)
    lines = [
        say(
            "Scanned: {box} mm, {total} places with {turns} orientations of the tool each. A place belongs to the zone when every "
            "orientation keeps every pressure angle within {limit:g}° and every other limit asked for.",
            box=box,
            total=total,
            turns=zone.sizes["orientation"],
            limit=attrs["limit_deg"],
        )
    ]
    if not inside:
        best = float(zone["worst_pressure_angle_deg"].min())
        lines.append(
            say(
                "No place lies in the zone. The best one has a worst pressure angle of {best:.1f}°. Move the observation points (lmeasure "
                "place), or ask for less.",
                best=best,
            )
        )
    else:
        u95 = zone["u95_position_mm"].values[zone["in_zone"].values.astype(bool)]
        lines.append(
            say(
                "The zone holds {inside} of them: {volume:.4g} m³ with a grid error of {error:.2g} m³. There a measured position lies "
                "within {worst:.3g} mm of the true one in 95 of 100 cases at the worst place and orientation, within {best:.3g} mm at "
                "the best place.",
                inside=inside,
                volume=found.volume_mm3 / 1e9,
                error=found.volume_error_mm3 / 1e9,
                worst=float(u95.max()),
                best=float(u95.min()),
            )
        )
    if any(zone["in_zone"].isel({name: end}).values.any() for name in "xyz" for end in (0, -1)):
        lines.append(
            say("The zone reaches faces of the scanned box and may go on beyond them; the volume counts half a step beyond each such face.")
        )
    if attrs["assemblies_in_zone"] > 1:
        lines.append(say("The zone holds more than one assembly: between its parts the cables do not determine the pose."))
    return [*lines, say("The 95 % radius covers {covers}.", covers=say.told(attrs["u95_covers"]))]


def taken_as_exact(zone: xr.Dataset, say: Say) -> list[str]:
    """What nobody stated and nothing has solved, a sentence each."""
    told = map(say.told, str(zone.attrs.get("taken_as_exact", "")).splitlines())
    return [f"{line[:1].upper()}{line[1:]}." for line in told]


def tables(zone: xr.Dataset, found: Extent, rig: Rig, say: Say) -> list[tuple[str, tuple[str, ...], Rows]]:
    """(title, header, rows) of all tables."""
    place = (say("x, mm"), say("y, mm"), say("z, mm"))
    out: list[tuple[str, tuple[str, ...], Rows]] = [(say("Figures"), (say("figure"), say("value")), figures(zone, found, say))]
    if found.cube_points:
        out.append((say("Test cube of ISO 9283 in the zone"), *iso_table(found, say)))
    out += [
        (say("Both criteria side by side"), (say("criterion"), say("nodes"), say("volume, m³")), criteria(zone, say)),
        (say("Why nodes are not in the zone"), (say("reason"), say("nodes"), say("share")), rejected(zone, say)),
        (say("The rig"), (say("cable"), say("from"), *place, say("pulley radius, mm"), say("to")), rig_rows(rig, say)),
    ]
    return out


def figures(zone: xr.Dataset, found: Extent, say: Say) -> Rows:
    """Table of the zone's figures."""
    inside = zone["in_zone"].values.astype(bool)
    rows: Rows = [
        (say("volume"), say("{m3:.5g} m³", m3=found.volume_mm3 / 1e9)),
        (say("grid error of the volume"), say("{m3:.2g} m³", m3=found.volume_error_mm3 / 1e9)),
    ]
    if found.box is not None:
        low, high = found.box
        size = " × ".join(say.number(v, "g") for v in high - low)
        rows.append((say("largest box"), say("{size} mm, from {low} to {high}", size=size, low=_place(low, say), high=_place(high, say))))
    if found.cube is not None:
        rows.append((say("largest cube"), say("{mm:g} mm about {place}", mm=found.cube[1], place=_place(found.cube[0], say))))
    if found.ball is not None:
        about = say("radius {mm:.4g} mm about {place}", mm=found.ball[1], place=_place(found.ball[0], say))
        rows.append((say("largest ball"), about))
    for name, label, unit in (
        ("worst_pressure_angle_deg", say("worst pressure angle in the zone"), "°"),
        ("u95_position_mm", say("95 % radius of the tool origin in the zone"), say(" mm")),
        ("u95_rotation_deg", say("95 % radius of the orientation in the zone"), "°"),
        ("u95_attachment_mm", say("95 % radius of the worst attachment point in the zone"), say(" mm")),
        ("clearance_mm", say("clearance of the cables in the zone"), say(" mm")),
        ("singularity_distance", say("distance to a singular pose in the zone"), ""),
    ):
        if name in zone and inside.any():
            values = zone[name].values[inside]
            rows.append((label, say("{low:.4g} to {high:.4g}", low=float(values.min()), high=float(values.max())) + unit))
    return rows + _limits(zone.attrs, say)


def _limits(attrs: dict[str, Any], say: Say) -> Rows:
    """What was asked for beside the pressure angle."""
    rows: Rows = []
    if "limit_length_mm" in attrs:
        low, high = np.asarray(attrs["limit_length_mm"], dtype=np.float64).tolist()
        rows.append((say("limit of the cables' lengths"), say("{low:.4g} to {high:.4g}", low=low, high=high) + say(" mm")))
    for name, label, unit in (
        ("u95_mm", say("limit of the 95 % radius of the position"), say(" mm")),
        ("u95_rotation_deg", say("limit of the 95 % radius of the orientation"), "°"),
        ("u95_attachment_mm", say("limit of the 95 % radius of the worst attachment point"), say(" mm")),
        ("wrap_deg", say("limit of the angle wrapped around a pulley"), "°"),
        ("clearance_mm", say("least clearance of the cables"), say(" mm")),
        ("singularity", say("least distance to a singular pose"), ""),
    ):
        if f"limit_{name}" in attrs:
            rows.append((label, say.number(float(attrs[f"limit_{name}"]), "g") + unit))
    return [*rows, *([(say("one assembly alone"), say("yes"))] if attrs.get("limit_one_assembly") else [])]


def _place(at: FloatArray, say: Say) -> str:
    return f"({say.numbers(at, 'g')})"


def iso_table(found: Extent, say: Say) -> tuple[tuple[str, ...], Rows]:
    """Header and rows of P1 to P5 of the largest cube."""
    names = {
        "worst_pressure_angle_deg": say("pressure angle, °"),
        "u95_position_mm": say("U95 position, mm"),
        "u95_rotation_deg": say("U95 orientation, °"),
        "u95_attachment_mm": say("U95 attachment, mm"),
    }
    kept = [key for key in names if key in found.cube_points[0]]
    rows = [(p["name"], _place(np.array(p["position_mm"]), say), *(say.number(p[key], ".4g") for key in kept)) for p in found.cube_points]
    return (say("pose"), say("position, mm"), *(names[key] for key in kept)), rows


def criteria(zone: xr.Dataset, say: Say) -> Rows:
    """Nodes and volume by the pressure angle alone, by the 95 % radius alone, and by all limits."""
    cell = float(np.prod(zone.attrs["node_spacing_mm"])) / 1e9
    angle, u95 = zone["worst_pressure_angle_deg"].values, zone["u95_position_mm"].values
    # without a limit of its own the radius is held to what it is at most within the angle
    asked = zone.attrs.get("limit_u95_mm")
    within_angle = angle <= zone.attrs["limit_deg"]
    if asked is not None:
        radius, by_radius = float(asked), say("95 % radius within {mm:.3g} mm", mm=float(asked))
    elif within_angle.any():
        radius = float(u95[within_angle].max())
        by_radius = say("95 % radius within {mm:.3g} mm (the largest within the angle)", mm=radius)
    else:
        radius = float(np.nanmedian(u95))
        by_radius = say("95 % radius within {mm:.3g} mm (the median)", mm=radius)
    masks = (
        (say("pressure angle within {deg:g}°", deg=zone.attrs["limit_deg"]), within_angle),
        (by_radius, u95 <= radius),
        (say("all limits"), zone["in_zone"].values == 1),
    )
    return [(name, str(int(mask.sum())), say.number(mask.sum() * cell, ".5g")) for name, mask in masks]


def rejected(zone: xr.Dataset, say: Say) -> Rows:
    """How many nodes each reason takes from the zone; a node may have several."""
    words = {
        "cable_cannot_run": say("a cable cannot run"),
        "singular": say("singular"),
        "pressure_angle": say("pressure angle"),
        "cable_too_short": say("a cable is too short"),
        "cable_too_long": say("a cable is too long"),
        "u95_position": say("95 % radius of the position"),
        "u95_rotation": say("95 % radius of the orientation"),
        "u95_attachment": say("95 % radius of an attachment point"),
        "wrap": say("angle wrapped around a pulley"),
        "clearance": say("clearance"),
        "other_assembly": say("another assembly"),
        "near_singular": say("near a singular pose"),
    }
    total = zone["in_zone"].size
    rows: Rows = [(words[reason], str(n), f"{say.number(100 * n / total, '.1f')} %") for reason, n in reasons(zone).items() if n]
    return rows or [(say("none"), "0", "0 %")]


def rig_rows(rig: Rig, say: Say) -> Rows:
    """Table of the rig's cables."""
    rows: Rows = []
    for c in rig.cable:
        p = rig.point(c.from_point)
        rows.append((c.name, p.name, *(say.number(v, ".2f") for v in p.position_mm), say.number(p.pulley_radius_mm, "g"), c.to_point))
    return rows
