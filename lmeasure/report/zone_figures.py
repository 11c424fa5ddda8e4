"""The figures of a zone: in space with its rig, level by level, and the rig seen along its axes."""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
import xarray as xr

from lmeasure.core import FloatArray, LMeasureError
from lmeasure.report import figures, html
from lmeasure.report.text import axes, unit
from lmeasure.report.zone_maps import SCALE, log_colours
from lmeasure.rig import Rig
from lmeasure.structure import Piece
from lmeasure.text import ENGLISH, Say, message

EDGE, CABLES = "#e4572e", "#4a5568"
MOST_LEVELS = 41
MOST_NODES_IN_SPACE = 40


def middle_pose(zone: xr.Dataset) -> FloatArray:
    """(7,) the box's centre with the middle orientation, at which the rig is drawn."""
    centre = [0.5 * float(zone[name].values[0] + zone[name].values[-1]) for name in "xyz"]
    turns = zone["quaternion_xyzw"].values
    return np.concatenate([centre, turns[len(turns) // 2]])


def _shown_levels(count: int) -> list[int]:
    return sorted({round(i) for i in np.linspace(0, count - 1, min(count, MOST_LEVELS))})


def _margin(zone: xr.Dataset) -> FloatArray:
    """Return the distance of each node from the limit of the angle [deg]: positive in the zone, negative outside, whatever limit cuts it
    there."""
    inside = zone["in_zone"].values.astype(bool)
    margin = float(zone.attrs["limit_deg"]) - zone["worst_pressure_angle_deg"].values
    return np.where(inside, np.maximum(margin, 0.01), np.minimum(margin, -0.01))


def space_figure(zone: xr.Dataset, rig: Rig, say: Say = ENGLISH, followed: Sequence[Piece] = ()) -> go.Figure:
    """The zone's edge as a surface and, where it was followed, in lines, a plane at the slider's level, cables and points of the rig."""
    stride = max(1, -(-max(zone.sizes[name] for name in "xyz") // MOST_NODES_IN_SPACE))
    coarse = zone.isel(x=slice(None, None, stride), y=slice(None, None, stride))
    x, y, z = (coarse[name].values for name in "xyz")
    angle, inside = coarse["worst_pressure_angle_deg"].values, coarse["in_zone"].values.astype(bool)
    figure = go.Figure()
    levels = _shown_levels(len(z))
    first = len(levels) // 2
    bar = {"title": {"text": say("zone.worst_angle"), "side": "top"}} | figures.BAR
    for n, k in enumerate(levels):
        figure.add_surface(
            x=x, y=y, z=np.full((len(y), len(x)), z[k]), surfacecolor=np.float32(angle[:, :, k].T), cmin=0, cmax=90, colorscale=SCALE,
            colorbar=bar, opacity=0.9, visible=n == first, name=say("zone.level_mm", mm=float(z[k])),
            hovertemplate=f"x %{{x}} y %{{y}} z %{{z}} {say('page.mm')}<br>%{{surfacecolor:.1f}}°<extra></extra>",
        )  # fmt: skip
    if inside.any() and not inside.all():
        grid = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.float32)
        figure.add_isosurface(
            x=grid[:, 0], y=grid[:, 1], z=grid[:, 2], value=np.float32(_margin(coarse).ravel()),
            isomin=0, isomax=90, surface_count=1, opacity=0.35,
            colorscale=[[0, EDGE], [1, EDGE]], showscale=False, hoverinfo="skip", name=say("zone.edge_zone"),
            caps={"x_show": True, "y_show": True, "z_show": True}, showlegend=True,
        )  # fmt: skip
    for n, piece in enumerate(followed):
        x, y, z = np.append(piece.places, piece.places[: int(piece.closed)], axis=0).T
        figure.add_scatter3d(
            x=x, y=y, z=z, mode="lines", line={"width": 3, "color": EDGE}, name=say("zone.edge_followed_2"), legendgroup="followed",
            showlegend=n == 0,
        )  # fmt: skip
    ways = figures.cable_ways(rig.cable_rows(), middle_pose(zone))
    figures.add_cables(figure, ways, say("zone.cables"), line={"width": 4, "color": CABLES})
    figures.add_points(figure, rig.observation_point, say)
    figure.update_layout(
        sliders=[_slider(coarse["z"].values[levels], len(figure.data), first, say) | {"pad": {"t": 84}}],
        scene=axes(say) | {"camera": {"eye": {"x": 1.9, "y": -1.9, "z": 1.1}, "center": figures.CAMERA["center"]}},
        height=760,
        margin={"t": 10, "b": 10, "l": 10, "r": 10},
        legend={"orientation": "h", "x": 0, "y": 1, "yanchor": "bottom"},
        modebar={"orientation": "v"},
    )
    return figure


def fullest_level(zone: xr.Dataset) -> int:
    """Return the number of the level with most of the zone, the middle one where there is none."""
    held = zone["in_zone"].values.sum(axis=(0, 1))
    return int(np.argmax(held)) if held.any() else len(held) // 2


def u95_figure(zone: xr.Dataset, say: Say = ENGLISH, *, every: bool = False) -> go.Figure:
    """U95 of the position at the level with most of the zone, and its edge; every: a slider over the levels."""
    levels = _shown_levels(zone.sizes["z"]) if every else [fullest_level(zone)]
    margin, radius = _margin(zone), zone["u95_position_mm"]
    u95 = radius.values
    heats = [_heat(zone["x"].values, zone["y"].values, u95[:, :, k], u95[:, :, levels], say, most=95) for k in levels]
    return _level_figure(radius, levels, heats, margin, say)


def quantity_figure(values: xr.DataArray, say: Say = ENGLISH) -> go.Figure:
    """Draw one variable of a zone level by level, with a slider. LMeasureError unless it has one value at each node."""
    if values.dims != tuple("xyz"):
        raise LMeasureError(message("error.is_nothing_that_can", name=str(values.name), known="in_zone, worst_pressure_angle_deg, u95_..."))
    levels, shown = _shown_levels(values.sizes["z"]), values.values.astype(np.float32)
    known = shown[np.isfinite(shown)]
    ends = {"zmin": float(known.min()), "zmax": float(known.max())} if len(known) else {}
    look = {"colorscale": SCALE, "colorbar": {"title": unit(say.language, values.attrs.get("units", "")), "thickness": 14}, **ends}
    heats = [go.Heatmap(x=values["x"].values, y=values["y"].values, z=shown[:, :, k].T, **look) for k in levels]
    return _level_figure(values, levels, heats, None, say)


def _level_figure(values: xr.DataArray, levels: list[int], heats: Sequence[go.Heatmap], margin: FloatArray | None, say: Say) -> go.Figure:
    """Show the map of each level [index], and the edge of the zone where its margin (nx, ny, nz) is zero; a slider where there are more."""
    x, y = values["x"].values, values["y"].values
    first, figure = len(levels) // 2, go.Figure()
    for n, (k, heat) in enumerate(zip(levels, heats, strict=True)):
        figure.add_trace(heat.update(visible=n == first))
        if margin is not None:
            figure.add_contour(
                x=x, y=y, z=np.float32(margin[:, :, k].T), showscale=False, hoverinfo="skip", visible=n == first,
                contours={"start": 0, "end": 0, "size": 1, "coloring": "none"}, line={"color": "white", "width": 3},
            )  # fmt: skip
    every = len(levels) > 1
    if every:
        each = len(figure.data) // len(levels)
        figure.update_layout(sliders=[_slider(values["z"].values[levels], len(figure.data), first, say, each=each)])
    figure.update_xaxes(title_text=say("page.x_mm"), constrain="domain")
    figure.update_yaxes(title_text=say("page.y_mm"), constrain="domain", scaleanchor="x")
    return figure.update_layout(height=560 if every else 450, margin={"t": 10, "b": 40, "l": 60}, showlegend=False)


def _heat(x: FloatArray, y: FloatArray, values: FloatArray, all_values: FloatArray, say: Say, *, most: float, **look: Any) -> go.Heatmap:
    """Colours of positive values (nx, ny) [mm] by their logarithm, from the least of all values to a percentile of them."""
    known = all_values[np.isfinite(all_values) & (all_values > 0.0)]
    low, top = (float(known.min()), float(np.percentile(known, most))) if len(known) else (0.1, 1.0)
    top = max(top, 1.01 * low)
    logarithm = np.log10(values, out=np.full(values.shape, np.nan), where=np.isfinite(values) & (values > 0.0))
    return go.Heatmap(
        x=x, y=y, z=np.float32(logarithm.T), zmin=np.log10(low), zmax=np.log10(top), customdata=np.float32(values.T),
        colorbar={"title": say("page.mm"), "thickness": 14} | log_colours(low, top, say),
        hovertemplate=f"x %{{x}} y %{{y}} {say('page.mm')}<br>%{{customdata:.4g}} {say('page.mm')}<extra></extra>",
        **{"colorscale": SCALE} | look,
    )  # fmt: skip


def _slider(levels: FloatArray, traces: int, first: int, say: Say, each: int = 1) -> dict[str, Any]:
    """Return a slider over levels [mm], each with so many of the first traces; all other traces stay."""
    of = [i // each if i < each * len(levels) else None for i in range(traces)]
    steps = [
        {"label": html.joined(f"{level:g}"), "method": "restyle", "args": [{"visible": [k in (n, None) for k in of]}]}
        for n, level in enumerate(levels)
    ]
    return {"active": first, "currentvalue": {"prefix": say("zone.level_z"), "suffix": say("zone.mm")}, "steps": steps, "pad": {"t": 60}}


def views(zone: xr.Dataset, rig: Rig) -> list[tuple[str, str, list[Any]]]:
    """(horizontal axis, vertical axis, lines) of the rig seen from above and from the side, for drawing on paper."""
    lines = list(figures.cable_ways(rig.cable_rows(), middle_pose(zone)))
    low, high = (np.array([zone[n].values[i] for n in "xyz"], dtype=np.float64) for i in (0, -1))
    out = []
    for h, v in itertools.combinations(range(3), 2):
        box = np.array([[low[h], low[v]], [high[h], low[v]], [high[h], high[v]], [low[h], high[v]], [low[h], low[v]]])
        out.append(("xyz"[h], "xyz"[v], [box, *(line[:, [h, v]] for line in lines)]))
    return out


def faults_figure(zone: xr.Dataset, say: Say) -> go.Figure:
    """Effect on the tool at that level: of the worst channel, or of one that is chosen."""
    effect = zone["fault_effect_mm"].values[:, :, fullest_level(zone)]
    names = [say("zone.worst_channel"), *map(str, zone["channel"].values)]
    figure = go.Figure(
        [
            _heat(zone["x"].values, zone["y"].values, values, effect, say, most=98, visible=n == 0, colorscale="Viridis_r")
            for n, values in enumerate([effect.max(axis=2), *np.moveaxis(effect, 2, 0)])
        ]
    )
    buttons = [
        {"label": html.label(name), "method": "restyle", "args": [{"visible": [i == n for i in range(len(names))]}]}
        for n, name in enumerate(names)
    ]
    figure.update_layout(
        updatemenus=[{"buttons": buttons, "x": 0.0, "xanchor": "left", "y": 1.02, "yanchor": "bottom"}],
        height=530,
        margin={"t": 70, "b": 20},
    )
    figure.update_xaxes(title_text=say("page.x_mm"), constrain="domain", scaleanchor="y")
    figure.update_yaxes(title_text=say("page.y_mm"), constrain="domain")
    return figure
