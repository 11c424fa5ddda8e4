"""The zone on a page: its findings and tables, and one self-contained HTML file of them."""

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
import xarray as xr
from plotly.subplots import make_subplots

from lmeasure.accuracy.extent import Extent, extent
from lmeasure.accuracy.zone_dataset import reasons
from lmeasure.arrays import FloatArray
from lmeasure.calibration_record import CalibrationRecord
from lmeasure.kernels.cable import wrap_geometry
from lmeasure.kernels.layout import BASE_XYZ
from lmeasure.report import html
from lmeasure.report.zone_maps import log_colours, maps
from lmeasure.rig import Rig

Rows = list[tuple[str, ...]]

# perceptually even, and readable without colour vision
SCALE = "Viridis"
EDGE = "#e4572e"
MOST_LEVELS = 41
MOST_NODES_IN_SPACE = 40


def write_zone_page(path: Path, zone: xr.Dataset, rig: Rig, calibration: CalibrationRecord | None = None) -> None:
    """Write a self-contained HTML page: what was found, the zone in space, its maps, figures, reasons, the rig. calibration: that of the
    zone."""
    found = extent(zone)
    space = html.figure(space_figure(zone, rig), "space", first=True)
    body = [
        *(html.paragraph(line) for line in findings(zone, found)),
        html.heading("The zone in space"),
        html.paragraph(
            "Drag to turn, scroll to come nearer. The orange surface is the edge of the zone; the slider moves a plane through it, "
            "coloured by the worst pressure angle. Lines are the cables with the tool in the middle of the box."
        ),
        space,
        html.heading("Level by level"),
        html.paragraph(
            "The white line is the edge of the zone within the limits of the sliders. Click a place: below stand its figures, the "
            "ellipsoid that holds 95 % of its measured positions, and the direction of the cable with the largest pressure angle (orange)."
        ),
        *maps(zone, rig, calibration),
        html.heading("Figures"),
        html.table(("figure", "value"), figures(zone, found)),
        *_section("Test cube of ISO 9283 in the zone", html.table(*iso_table(found)) if found.cube_points else ""),
        html.heading("Both criteria side by side"),
        html.table(("criterion", "nodes", "volume, m³"), criteria(zone)),
        html.heading("Why nodes are not in the zone"),
        html.table(("reason", "nodes", "share"), rejected(zone)),
        html.heading("The rig"),
        html.table(("cable", "from", "x, mm", "y, mm", "z, mm", "pulley radius, mm", "to"), rig_rows(rig)),
        *_section("Not in the 95 % radius", "".join(html.paragraph(line, "small") for line in taken_as_exact(zone))),
        *(html.paragraph(f"Nobody measured these values: {', '.join(rig.assumed)}.", "warning") for _ in range(bool(rig.assumed))),
    ]
    html.write_page(path, f"Accuracy zone of {rig.name}", body)


def _section(title: str, content: str) -> list[str]:
    return [html.heading(title), content] if content else []


def findings(zone: xr.Dataset, found: Extent) -> list[str]:
    """A few sentences for a robot engineer."""
    attrs = zone.attrs
    total, inside = zone["in_zone"].size, attrs["nodes_in_zone"]
    box = ", ".join(f"{name.upper()} {zone[name].values[0]:g} to {zone[name].values[-1]:g}" for name in "xyz")
    lines = [
        f"Scanned: {box} mm, {total} places with {zone.sizes['orientation']} orientations of the tool each. A place belongs to the zone "
        f"when every orientation keeps every pressure angle within {attrs['limit_deg']:g}° and every other limit asked for."
    ]
    if not inside:
        best = float(zone["worst_pressure_angle_deg"].min())
        lines.append(
            f"No place lies in the zone. The best one has a worst pressure angle of {best:.1f}°. Move the observation points "
            "(lmeasure place), or ask for less."
        )
    else:
        u95 = zone["u95_position_mm"].values[zone["in_zone"].values.astype(bool)]
        lines.append(
            f"The zone holds {inside} of them: {found.volume_mm3 / 1e9:.4g} m³ with a grid error of {found.volume_error_mm3 / 1e9:.2g} m³. "
            f"There a measured position lies within {u95.max():.3g} mm of the true one in 95 of 100 cases at the worst place and "
            f"orientation, within {u95.min():.3g} mm at the best place."
        )
    if any(zone["in_zone"].isel({name: end}).values.any() for name in "xyz" for end in (0, -1)):
        lines.append(
            "The zone reaches faces of the scanned box and may go on beyond them; the volume counts half a step beyond each such face."
        )
    if attrs["assemblies_in_zone"] > 1:
        lines.append("The zone holds more than one assembly: between its parts the cables do not determine the pose.")
    return [*lines, f"The 95 % radius covers {attrs['u95_covers']}."]


def taken_as_exact(zone: xr.Dataset) -> list[str]:
    """What nobody stated and nothing has solved, a sentence each."""
    return [f"{line[:1].upper()}{line[1:]}." for line in str(zone.attrs.get("taken_as_exact", "")).splitlines()]


def figures(zone: xr.Dataset, found: Extent) -> Rows:
    """Table of the zone's figures."""
    inside = zone["in_zone"].values.astype(bool)
    rows: Rows = [
        ("volume", f"{found.volume_mm3 / 1e9:.5g} m³"),
        ("grid error of the volume", f"{found.volume_error_mm3 / 1e9:.2g} m³"),
    ]
    if found.box is not None:
        low, high = found.box
        rows.append(("largest box", " x ".join(f"{v:g}" for v in high - low) + f" mm, from {_place(low)} to {_place(high)}"))
    if found.cube is not None:
        rows.append(("largest cube", f"{found.cube[1]:g} mm about {_place(found.cube[0])}"))
    if found.ball is not None:
        rows.append(("largest ball", f"radius {found.ball[1]:.4g} mm about {_place(found.ball[0])}"))
    for name, label, unit in (
        ("worst_pressure_angle_deg", "worst pressure angle in the zone", "°"),
        ("u95_position_mm", "95 % radius of the tool origin in the zone", " mm"),
        ("u95_rotation_deg", "95 % radius of the orientation in the zone", "°"),
        ("u95_attachment_mm", "95 % radius of the worst attachment point in the zone", " mm"),
        ("clearance_mm", "clearance of the cables in the zone", " mm"),
        ("singularity_distance", "distance to a singular pose in the zone", ""),
    ):
        if name in zone and inside.any():
            values = zone[name].values[inside]
            rows.append((label, f"{values.min():.4g} to {values.max():.4g}{unit}"))
    limits = sorted(key for key in map(str, zone.attrs) if key.startswith("limit_") and key not in {"limit_deg", "limit_angle_deg"})
    rows += [(f"limit: {key.removeprefix('limit_')}", str(np.asarray(zone.attrs[key]).tolist())) for key in limits]
    return rows


def _place(at: FloatArray) -> str:
    return "(" + ", ".join(f"{v:g}" for v in at) + ")"


def iso_table(found: Extent) -> tuple[tuple[str, ...], Rows]:
    """Header and rows of P1 to P5 of the largest cube."""
    names = {
        "worst_pressure_angle_deg": "pressure angle, °",
        "u95_position_mm": "U95 position, mm",
        "u95_rotation_deg": "U95 orientation, °",
        "u95_attachment_mm": "U95 attachment, mm",
    }
    kept = [key for key in names if key in found.cube_points[0]]
    rows = [(p["name"], _place(np.array(p["position_mm"])), *(f"{p[key]:.4g}" for key in kept)) for p in found.cube_points]
    return ("pose", "position, mm", *(names[key] for key in kept)), rows


def criteria(zone: xr.Dataset) -> Rows:
    """Nodes and volume by the pressure angle alone, by the 95 % radius alone, and by all limits."""
    cell = float(np.prod(zone.attrs["node_spacing_mm"])) / 1e9
    angle, u95 = zone["worst_pressure_angle_deg"].values, zone["u95_position_mm"].values
    # without a limit of its own the radius is held to what it is at most within the angle
    asked = zone.attrs.get("limit_u95_mm")
    within_angle = angle <= zone.attrs["limit_deg"]
    radius = float(asked) if asked is not None else float(u95[within_angle].max()) if within_angle.any() else float(np.nanmedian(u95))
    note = "" if asked is not None else " (the largest within the angle)" if within_angle.any() else " (the median)"
    masks = {
        f"pressure angle within {zone.attrs['limit_deg']:g}°": within_angle,
        f"95 % radius within {radius:.3g} mm{note}": u95 <= radius,
        "all limits": zone["in_zone"].values == 1,
    }
    return [(name, str(int(mask.sum())), f"{mask.sum() * cell:.5g}") for name, mask in masks.items()]


def rejected(zone: xr.Dataset) -> Rows:
    """How many nodes each reason takes from the zone; a node may have several."""
    total = zone["in_zone"].size
    rows: Rows = [(reason.replace("_", " "), str(n), f"{100 * n / total:.1f} %") for reason, n in reasons(zone).items() if n]
    return rows or [("none", "0", "0 %")]


def rig_rows(rig: Rig) -> Rows:
    """Table of the rig's cables."""
    rows: Rows = []
    for c in rig.cable:
        p = rig.point(c.from_point)
        rows.append((c.name, p.name, *(f"{v:.2f}" for v in p.position_mm), f"{p.pulley_radius_mm:g}", c.to_point))
    return rows


def middle_pose(zone: xr.Dataset) -> FloatArray:
    """(7,) the box's centre with the middle orientation, at which the rig is drawn."""
    centre = [0.5 * float(zone[name].values[0] + zone[name].values[-1]) for name in "xyz"]
    turns = zone["quaternion_xyzw"].values
    return np.concatenate([centre, turns[len(turns) // 2]])


def _shown_levels(count: int) -> list[int]:
    return sorted({round(i) for i in np.linspace(0, count - 1, min(count, MOST_LEVELS))})


def _margin(zone: xr.Dataset) -> FloatArray:
    """How far each node is from the limit of the angle [deg]: positive in the zone, negative outside, whatever limit cuts it there."""
    inside = zone["in_zone"].values.astype(bool)
    margin = float(zone.attrs["limit_deg"]) - zone["worst_pressure_angle_deg"].values
    return np.where(inside, np.maximum(margin, 0.01), np.minimum(margin, -0.01))


def space_figure(zone: xr.Dataset, rig: Rig) -> go.Figure:
    """The zone's edge as a surface, a plane at the slider's level, the cables and points of the rig."""
    stride = max(1, -(-max(zone.sizes[name] for name in "xyz") // MOST_NODES_IN_SPACE))
    coarse = zone.isel(x=slice(None, None, stride), y=slice(None, None, stride))
    x, y, z = (coarse[name].values for name in "xyz")
    angle, inside = coarse["worst_pressure_angle_deg"].values, coarse["in_zone"].values.astype(bool)
    figure = go.Figure()
    levels = _shown_levels(len(z))
    first = len(levels) // 2
    bar = {"title": {"text": "worst angle, °", "side": "right"}, "len": 0.5, "y": 0.35, "thickness": 14}
    for n, k in enumerate(levels):
        figure.add_surface(
            x=x, y=y, z=np.full((len(y), len(x)), z[k]), surfacecolor=np.float32(angle[:, :, k].T), cmin=0, cmax=90, colorscale=SCALE,
            colorbar=bar, opacity=0.9, visible=n == first, name=f"level {z[k]:g} mm",
            hovertemplate="x %{x} y %{y} z %{z} mm<br>%{surfacecolor:.1f}°<extra></extra>",
        )  # fmt: skip
    if inside.any() and not inside.all():
        grid = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.float32)
        figure.add_isosurface(
            x=grid[:, 0], y=grid[:, 1], z=grid[:, 2], value=np.float32(_margin(coarse).ravel()),
            isomin=0, isomax=90, surface_count=1, opacity=0.35,
            colorscale=[[0, EDGE], [1, EDGE]], showscale=False, hoverinfo="skip", name="edge of the zone",
            caps={"x_show": True, "y_show": True, "z_show": True}, showlegend=True,
        )  # fmt: skip
    rows = rig.cable_rows()
    _, tangent, attachment, _ = wrap_geometry(rows, middle_pose(zone)[None, :])
    for j, c in enumerate(rig.cable):
        line = np.array([rows[j, BASE_XYZ], tangent[0, j], attachment[0, j]])
        figure.add_scatter3d(x=line[:, 0], y=line[:, 1], z=line[:, 2], mode="lines", line={"width": 4}, name=f"cable {html.label(c.name)}")
    points = np.array([p.position_mm for p in rig.observation_point])
    figure.add_scatter3d(
        x=points[:, 0], y=points[:, 1], z=points[:, 2], mode="markers+text", textposition="middle right",
        text=[f"\u00a0\u00a0{html.label(p.name)}" for p in rig.observation_point],
        marker={"size": 4, "color": "black"}, name="observation points",
    )  # fmt: skip
    others = [True] * (len(figure.data) - len(levels))
    steps = [
        {"label": f"{z[k]:g}", "method": "restyle", "args": [{"visible": [i == n for i in range(len(levels))] + others}]}
        for n, k in enumerate(levels)
    ]
    figure.update_layout(
        sliders=[{"active": first, "currentvalue": {"prefix": "level Z = ", "suffix": " mm"}, "steps": steps}],
        scene={
            "xaxis_title": "X, mm",
            "yaxis_title": "Y, mm",
            "zaxis_title": "Z, mm",
            "aspectmode": "data",
            "camera": {"eye": {"x": 1.7, "y": -1.7, "z": 1.0}},
        },
        height=760,
        margin={"t": 10, "b": 10, "l": 10, "r": 10},
        legend={"orientation": "h", "x": 0, "y": 1, "yanchor": "bottom"},
        modebar={"orientation": "v"},
    )
    return figure


def slices_figure(zone: xr.Dataset) -> go.Figure:
    """Level by level along Z: worst pressure angle and 95 % radius, with the zone's edge; a slider over the levels."""
    x, y, z = (zone[name].values for name in "xyz")
    levels = _shown_levels(len(z))
    first = len(levels) // 2
    margin = _margin(zone)
    radius = zone["u95_position_mm"].values
    known = radius[np.isfinite(radius) & (radius > 0.0)]
    low, top = (float(np.percentile(known, 0)), float(np.percentile(known, 95))) if len(known) else (0.1, 1.0)
    u95 = np.log10(radius, out=np.full(radius.shape, np.nan), where=np.isfinite(radius) & (radius > 0.0))
    span = (np.log10(low), np.log10(max(top, 1.01 * low)))
    maps = (
        (zone["worst_pressure_angle_deg"].values, (0.0, 90.0), 0.44, {"title": "°"}, "%{z:.2f} °"),
        (u95, span, 1.01, {"title": "mm"} | log_colours(low, max(top, 1.01 * low)), "%{customdata:.4f} mm"),
    )
    figure = make_subplots(1, 2, subplot_titles=("worst pressure angle, °", "95 % radius of the position, mm"), horizontal_spacing=0.14)
    for n, k in enumerate(levels):
        for column, (values, ends, place, bar, told) in enumerate(maps, 1):
            figure.add_trace(
                go.Heatmap(
                    x=x, y=y, z=np.float32(values[:, :, k].T), zmin=ends[0], zmax=ends[1], colorscale=SCALE, visible=n == first,
                    customdata=np.float32(radius[:, :, k].T), colorbar={"x": place} | bar,
                    hovertemplate=f"x %{{x}} y %{{y}} mm<br>{told}<extra></extra>",
                ), 1, column,
            )  # fmt: skip
            figure.add_trace(
                go.Contour(
                    x=x, y=y, z=np.float32(margin[:, :, k].T), showscale=False, hoverinfo="skip", visible=n == first,
                    contours={"start": 0, "end": 0, "size": 1, "coloring": "none"}, line={"color": "white", "width": 3},
                ), 1, column,
            )  # fmt: skip
    each = 2 * len(maps)
    steps = [
        {"label": f"{z[k]:g}", "method": "restyle", "args": [{"visible": [i // each == n for i in range(each * len(levels))]}]}
        for n, k in enumerate(levels)
    ]
    figure.update_layout(
        sliders=[{"active": first, "currentvalue": {"prefix": "level Z = ", "suffix": " mm"}, "steps": steps, "pad": {"t": 50}}],
        height=560,
        margin={"t": 40, "b": 20},
        showlegend=False,
    )
    figure.update_xaxes(title_text="X, mm", constrain="domain")
    figure.update_yaxes(title_text="Y, mm", constrain="domain")
    figure.update_yaxes(scaleanchor="x", row=1, col=1)
    figure.update_yaxes(scaleanchor="x2", row=1, col=2)
    return figure


def views(zone: xr.Dataset, rig: Rig) -> list[tuple[str, str, list[Any]]]:
    """(horizontal axis, vertical axis, lines) of the rig seen from above and from the side, for drawing on paper."""
    rows = rig.cable_rows()
    _, tangent, attachment, _ = wrap_geometry(rows, middle_pose(zone)[None, :])
    lines = [np.array([rows[j, BASE_XYZ], tangent[0, j], attachment[0, j]]) for j in range(len(rows))]
    low, high = (np.array([zone[n].values[i] for n in "xyz"], dtype=np.float64) for i in (0, -1))
    out = []
    for h, v in itertools.combinations(range(3), 2):
        box = np.array([[low[h], low[v]], [high[h], low[v]], [high[h], high[v]], [low[h], high[v]], [low[h], low[v]]])
        out.append(("xyz"[h], "xyz"[v], [box, *(line[:, [h, v]] for line in lines)]))
    return out
