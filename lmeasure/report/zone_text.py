"""Texts of a zone's page and PDF: findings in sentences, and tables of texts."""

from typing import Any

import numpy as np
import xarray as xr

from lmeasure.accuracy import Extent, messages_of, reasons
from lmeasure.core import FloatArray
from lmeasure.rig import Rig
from lmeasure.text import Say

Rows = list[tuple[str, ...]]


def title(rig: Rig, say: Say) -> str:
    """Return the title of page and PDF."""
    return say("zone.accuracy_zone", rig=rig.name)


def has_edge(zone: xr.Dataset) -> bool:
    """Return whether some positions of the box lie in the zone and some do not."""
    inside = zone["in_zone"].values
    return bool(inside.any() and not inside.all())


def findings(zone: xr.Dataset, found: Extent, say: Say) -> list[str]:
    """A few sentences for a robot engineer."""
    attrs = zone.attrs
    total, inside = zone["in_zone"].size, attrs["nodes_in_zone"]
    ends = [(name.upper(), float(zone[name].values[0]), float(zone[name].values[-1])) for name in "xyz"]
    box = ", ".join(say("zone.to", name=name, low=low, high=high) for name, low, high in ends)
    lines = [say("zone.scanned_mm_places_orientations", box=box, total=total, turns=zone.sizes["orientation"], limit=attrs["limit_deg"])]
    if not inside:
        best = float(zone["worst_pressure_angle_deg"].min())
        lines.append(say("zone.no_place_lies_zone", best=best))
    else:
        u95 = zone["u95_position_mm"].values[zone["in_zone"].values.astype(bool)]
        lines.append(
            say(
                "zone.zone_holds_them_m",
                inside=inside,
                volume=found.volume_mm3 / 1e9,
                error=found.volume_error_mm3 / 1e9,
                worst=float(u95.max()),
                best=float(u95.min()),
            )
        )
    if any(zone["in_zone"].isel({name: end}).values.any() for name in "xyz" for end in (0, -1)):
        lines.append(say("zone.zone_reaches_faces_scanned"))
    if attrs["assemblies_in_zone"] > 1:
        lines.append(say("zone.zone_holds_more_than"))
    return [*lines, say("zone.95_radius_covers", covers=say.message(messages_of(zone, "u95_covers")[0]))]


def assumed(zone: xr.Dataset, say: Say) -> list[str]:
    """Return the assumed part of U95, and the statements that would help most, a sentence each."""
    return [f"{say.sentence(line)}." for line in messages_of(zone, "assumed")]


def tables(zone: xr.Dataset, found: Extent, rig: Rig, say: Say) -> list[tuple[str, tuple[str, ...], Rows]]:
    """(title, header, rows) of all tables."""
    place = (say("page.x_mm"), say("page.y_mm"), say("page.z_mm"))
    out: list[tuple[str, tuple[str, ...], Rows]] = [
        (say("zone.figures"), (say("page.figure"), say("page.value")), figures(zone, found, say))
    ]
    if found.cube_points:
        out.append((say("zone.test_cube_iso_9283"), *iso_table(found, say)))
    out += [
        (say("zone.both_criteria_side_side"), (say("zone.criterion"), say("zone.nodes"), say("zone.volume_m")), criteria(zone, say)),
        (say("zone.why_nodes_not_zone"), (say("zone.reason"), say("zone.nodes"), say("zone.share")), rejected(zone, say)),
        (say("page.rig"), (say("page.cable"), say("page.from"), *place, say("zone.pulley_radius_mm"), say("page.to")), rig_rows(rig, say)),
    ]
    return out


def figures(zone: xr.Dataset, found: Extent, say: Say) -> Rows:
    """Table of the zone's figures."""
    inside = zone["in_zone"].values.astype(bool)
    rows: Rows = [
        (say("zone.volume"), say("zone.m", m3=found.volume_mm3 / 1e9)),
        (say("zone.grid_error_volume"), say("zone.m_2", m3=found.volume_error_mm3 / 1e9)),
    ]
    if found.box is not None:
        low, high = found.box
        size = " × ".join(say.number(v, "g") for v in high - low)
        rows.append((say("zone.largest_box"), say("zone.mm_from", size=size, low=_place(low, say), high=_place(high, say))))
    if found.cube is not None:
        rows.append((say("zone.largest_cube"), say("zone.mm_about", mm=found.cube[1], place=_place(found.cube[0], say))))
    if found.ball is not None:
        about = say("zone.radius_mm_about", mm=found.ball[1], place=_place(found.ball[0], say))
        rows.append((say("zone.largest_ball"), about))
    for name, label, unit in (
        ("worst_pressure_angle_deg", say("zone.worst_pressure_angle_zone"), "°"),
        ("u95_position_mm", say("zone.95_radius_tool_origin"), say("zone.mm")),
        ("u95_rotation_deg", say("zone.95_radius_orientation_zone"), "°"),
        ("u95_attachment_mm", say("zone.95_radius_worst_attachment"), say("zone.mm")),
        ("clearance_mm", say("zone.clearance_cables_zone"), say("zone.mm")),
        ("singularity_distance", say("zone.distance_singular_pose_zone"), ""),
    ):
        if name in zone and inside.any():
            values = zone[name].values[inside]
            rows.append((label, say("zone.to_2", low=float(values.min()), high=float(values.max())) + unit))
    return rows + _limits(zone.attrs, say)


def _limits(attrs: dict[str, Any], say: Say) -> Rows:
    """Return the limits besides the pressure angle."""
    rows: Rows = []
    if "limit_length_mm" in attrs:
        low, high = np.asarray(attrs["limit_length_mm"], dtype=np.float64).tolist()
        rows.append((say("zone.limit_cables_lengths"), say("zone.to_2", low=low, high=high) + say("zone.mm")))
    for name, label, unit in (
        ("u95_mm", say("zone.limit_95_radius_position"), say("zone.mm")),
        ("u95_rotation_deg", say("zone.limit_95_radius_orientation"), "°"),
        ("u95_attachment_mm", say("zone.limit_95_radius_worst"), say("zone.mm")),
        ("wrap_deg", say("zone.limit_angle_wrapped_around"), "°"),
        ("clearance_mm", say("zone.least_clearance_cables"), say("zone.mm")),
        ("singularity", say("zone.least_distance_singular_pose"), ""),
    ):
        if f"limit_{name}" in attrs:
            rows.append((label, say.number(float(attrs[f"limit_{name}"]), "g") + unit))
    return [*rows, *([(say("zone.one_assembly_alone"), say("page.yes"))] if attrs.get("limit_one_assembly") else [])]


def _place(at: FloatArray, say: Say) -> str:
    return f"({say.numbers(at, 'g')})"


def iso_table(found: Extent, say: Say) -> tuple[tuple[str, ...], Rows]:
    """Header and rows of P1 to P5 of the largest cube."""
    names = {
        "worst_pressure_angle_deg": say("zone.pressure_angle"),
        "u95_position_mm": say("zone.u95_position_mm"),
        "u95_rotation_deg": say("zone.u95_orientation"),
        "u95_attachment_mm": say("zone.u95_attachment_mm"),
    }
    kept = [key for key in names if key in found.cube_points[0]]
    rows = [(p["name"], _place(np.array(p["position_mm"]), say), *(say.number(p[key], ".4g") for key in kept)) for p in found.cube_points]
    return (say("page.pose"), say("zone.position_mm"), *(names[key] for key in kept)), rows


def criteria(zone: xr.Dataset, say: Say) -> Rows:
    """Nodes and volume by the pressure angle alone, by the 95 % radius alone, and by all limits."""
    cell = float(np.prod(zone.attrs["node_spacing_mm"])) / 1e9
    angle, u95 = zone["worst_pressure_angle_deg"].values, zone["u95_position_mm"].values
    # without its own limit the radius is limited by its largest value within the angle
    requested = zone.attrs.get("limit_u95_mm")
    within_angle = angle <= zone.attrs["limit_deg"]
    if requested is not None:
        radius, by_radius = float(requested), say("zone.95_radius_within_mm", mm=float(requested))
    elif within_angle.any():
        radius = float(u95[within_angle].max())
        by_radius = say("zone.95_radius_within_mm_largest", mm=radius)
    else:
        radius = float(np.nanmedian(u95))
        by_radius = say("zone.95_radius_within_mm_median", mm=radius)
    masks = (
        (say("zone.pressure_angle_within", deg=zone.attrs["limit_deg"]), within_angle),
        (by_radius, u95 <= radius),
        (say("zone.all_limits"), zone["in_zone"].values == 1),
    )
    return [(name, str(int(mask.sum())), say.number(mask.sum() * cell, ".5g")) for name, mask in masks]


def reason_words(say: Say) -> dict[str, str]:
    """Return the name of each reason that takes a node from the zone."""
    return {
        "cable_cannot_run": say("zone.cable_cannot_run"),
        "singular": say("zone.singular"),
        "pressure_angle": say("zone.pressure_angle_2"),
        "cable_too_short": say("zone.cable_too_short"),
        "cable_too_long": say("zone.cable_too_long"),
        "u95_position": say("zone.95_radius_position"),
        "u95_rotation": say("zone.95_radius_orientation"),
        "u95_attachment": say("zone.95_radius_attachment_point"),
        "wrap": say("zone.angle_wrapped_around_pulley"),
        "clearance": say("zone.clearance"),
        "other_assembly": say("zone.another_assembly"),
        "near_singular": say("zone.near_singular_pose"),
    }


def rejected(zone: xr.Dataset, say: Say) -> Rows:
    """Return how many nodes each reason takes from the zone; a node may have several."""
    words = reason_words(say)
    total = zone["in_zone"].size
    rows: Rows = [(words[reason], str(n), f"{say.number(100 * n / total, '.1f')} %") for reason, n in reasons(zone).items() if n]
    return rows or [(say("page.none"), "0", "0 %")]


def rig_rows(rig: Rig, say: Say) -> Rows:
    """Table of the rig's cables."""
    rows: Rows = []
    for c in rig.cable:
        p = rig.point(c.from_point)
        rows.append((c.name, p.name, *(say.number(v, ".2f") for v in p.position_mm), say.number(p.pulley_radius_mm, "g"), c.to_point))
    return rows
