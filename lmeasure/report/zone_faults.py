"""Of a zone's page: which faults of single channels would show, and what one that does not does to the tool."""

import numpy as np
import plotly.graph_objects as go
import xarray as xr

from lmeasure.accuracy import VARIABLES
from lmeasure.report import html
from lmeasure.report.zone_maps import log_colours
from lmeasure.text import Say


def faults(zone: xr.Dataset, say: Say) -> list[str]:
    """Table and map; nothing where they were not asked for, or no place is in the zone."""
    if VARIABLES[0] not in zone or not zone["in_zone"].values.any():
        return []
    about = say("zone.smallest_fault_channel_single")
    header = say("page.channel"), say("zone.smallest_found"), say("zone.smallest_told_apart"), say("zone.effect_tool_mm")
    return [
        html.heading(say("zone.faults_would_show")),
        html.paragraph(about),
        html.table(header, _rows(zone, say)),
        # a title of the figure's own would be cut off on a telephone
        html.heading(say("zone.effect_fault_just_not", z=float(zone["z"].values[_level(zone)])), 3),
        html.figure(_map(zone, say), "faults", first=False, language=say.language),
    ]


def _rows(zone: xr.Dataset, say: Say) -> list[tuple[str, ...]]:
    inside = zone["in_zone"].values.astype(bool)
    rows = []
    for k, name in enumerate(zone["channel"].values):
        unit = "°" if zone["channel_unit"].values[k] == "degree" else say("zone.mm")
        values = [zone[v].values[inside][:, k] for v in VARIABLES]
        rows.append((str(name), *(_span(v, u, say) for v, u in zip(values, (unit, unit, ""), strict=True))))
    return rows


def _span(values: np.ndarray, unit: str, say: Say) -> str:
    low, high = float(values.min()), float(values.max())
    if not np.isfinite(low):
        return say("page.none")
    best = say.number(low, ".3g")
    return f"{best}\u00a0… {say.number(high, '.3g')}{unit}" if np.isfinite(high) else say("zone.none", best=best + unit)


def _level(zone: xr.Dataset) -> int:
    """The level with most of the zone, by its number."""
    return int(np.argmax(zone["in_zone"].values.sum(axis=(0, 1))))


def _map(zone: xr.Dataset, say: Say) -> go.Figure:
    """Effect on the tool at that level: of the worst channel, or of one that is chosen."""
    x, y = zone["x"].values, zone["y"].values
    effect = zone["fault_effect_mm"].values[:, :, _level(zone)]
    known = effect[np.isfinite(effect) & (effect > 0.0)]
    low, high = (float(known.min()), float(np.percentile(known, 98))) if len(known) else (0.01, 1.0)
    high = max(high, 1.01 * low)
    figure = go.Figure()
    names = [say("zone.worst_channel"), *map(str, zone["channel"].values)]
    for n, values in enumerate([effect.max(axis=2), *np.moveaxis(effect, 2, 0)]):
        shown = np.where(np.isfinite(values) & (values > 0.0), values, np.nan)
        figure.add_trace(
            go.Heatmap(
                x=x, y=y, z=np.float32(np.log10(shown).T), customdata=np.float32(values.T), visible=n == 0, colorscale="Viridis_r",
                zmin=np.log10(low), zmax=np.log10(high), colorbar={"title": say("page.mm")} | log_colours(low, high, say),
                hovertemplate=f"x %{{x}} y %{{y}} {say('page.mm')}<br>%{{customdata:.3g}} {say('page.mm')}<extra></extra>",
            )
        )  # fmt: skip
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
