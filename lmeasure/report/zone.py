"""Pages about an accuracy zone."""

from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
import xarray as xr
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from lmeasure import files
from lmeasure.rig import Rig

FloatArray = NDArray[np.float64]

# perceptually even, and readable without colour vision
SCALE = "Viridis"
PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<link rel="icon" href="data:,">
<style>
body {{ font: 16px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 72rem; padding: 0 1rem; color: #1a1a1a; }}
h1 {{ font-size: 1.6rem; }} h2 {{ font-size: 1.2rem; margin-top: 2rem; }}
</style>
</head>
<body>
{body}
</body>
</html>
"""


def slices_figure(zone: xr.Dataset) -> go.Figure:
    """Level by level along Z: worst pressure angle and 95 % radius, with the zone's edge; a slider over the levels."""
    x, y, levels = (zone[name].values for name in "xyz")
    limit = zone.attrs["limit_deg"]
    angle, inside = zone["worst_pressure_angle_deg"].values, zone["in_zone"].values.astype(float)
    u95 = np.where(np.isfinite(zone["u95_position_mm"].values), zone["u95_position_mm"].values, np.nan)
    top = float(np.nanpercentile(u95, 95)) if np.isfinite(u95).any() else 1.0
    figure = make_subplots(
        1, 2, subplot_titles=("worst pressure angle, degrees", "95 % radius of the position, mm"), horizontal_spacing=0.14
    )
    per_level = 3
    for k in range(len(levels)):
        shown = k == len(levels) // 2
        common: dict[str, Any] = {"x": x, "y": y, "visible": shown}
        figure.add_trace(
            go.Heatmap(
                z=angle[:, :, k].T, zmin=0, zmax=90, colorscale=SCALE, colorbar={"x": 0.44, "title": "deg"},
                hovertemplate="x %{x} y %{y} mm<br>%{z:.2f} deg<extra></extra>", **common,
            ), 1, 1,
        )  # fmt: skip
        figure.add_trace(
            go.Heatmap(
                z=u95[:, :, k].T, zmin=0, zmax=top, colorscale=SCALE, colorbar={"x": 1.01, "title": "mm"},
                hovertemplate="x %{x} y %{y} mm<br>%{z:.4f} mm<extra></extra>", **common,
            ), 1, 2,
        )  # fmt: skip
        figure.add_trace(
            go.Contour(
                z=inside[:, :, k].T, showscale=False, hoverinfo="skip", name="edge of the zone",
                contours={"start": 0.5, "end": 0.5, "size": 1, "coloring": "none"}, line={"color": "white", "width": 3}, **common,
            ), 1, 1,
        )  # fmt: skip
    steps = [
        {
            "label": f"{level:g}",
            "method": "update",
            "args": [{"visible": [i // per_level == k for i in range(per_level * len(levels))]}],
        }
        for k, level in enumerate(levels)
    ]
    figure.update_layout(
        sliders=[{"active": len(levels) // 2, "currentvalue": {"prefix": "level Z = ", "suffix": " mm"}, "steps": steps, "pad": {"t": 50}}],
        height=560,
        margin={"t": 40, "b": 20},
        title=None,
        meta=f"limit {limit:g} deg",
    )
    figure.update_xaxes(title_text="X, mm", constrain="domain")
    figure.update_yaxes(title_text="Y, mm")
    figure.update_yaxes(scaleanchor="x", row=1, col=1)
    figure.update_yaxes(scaleanchor="x2", row=1, col=2)
    return figure


def write_zone_report(folder: Path, zone: xr.Dataset, rig: Rig) -> None:
    """Write zone.html into the folder."""
    write_zone_page(Path(folder) / "zone.html", zone, rig)


def write_zone_page(path: Path, zone: xr.Dataset, rig: Rig) -> None:
    """Write a self-contained HTML page with the zone's slices, whole or not at all."""
    attrs = zone.attrs
    total = zone["in_zone"].size
    body = [
        f"<h1>Accuracy zone of rig {rig.name}</h1>",
        f"<p>{attrs['nodes_in_zone']} of {total} nodes keep every pressure angle within {attrs['limit_deg']:g} degrees at all "
        f"{zone.sizes['orientation']} orientations: {attrs['zone_volume_mm3'] / 1e9:.4g} m³. "
        f"The 95 % radius covers {attrs['u95_covers']}.</p>",
        "<h2>Slices by level</h2><p>The white line is the edge of the zone.</p>",
        slices_figure(zone).to_html(full_html=False, include_plotlyjs=True),
    ]
    files.write_text(path, PAGE.format(title=f"Accuracy zone of {rig.name}", body="\n".join(body)))
