"""Interactive maps of a zone: a slider for the level and each limit, and the data of a clicked position."""

import base64
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import plotly.graph_objects as go
import scipy
from markupsafe import Markup
from scipy.spatial.transform import Rotation

from lmeasure.accuracy import REASONS, ellipsoids
from lmeasure.core import FloatArray
from lmeasure.report import figures
from lmeasure.rig import CalibrationRecord, Rig
from lmeasure.text import ENGLISH, Say, texts

if TYPE_CHECKING:
    import xarray as xr

SCRIPT = Path(__file__).with_name("zone.js")
# perceptually even, and readable without colour vision
SCALE = "Viridis"
MOST_ALONG = 61
MOST_LEVELS = 41
ASKED = 1 << REASONS.index("pressure_angle") | 1 << REASONS.index("u95_position")
"""Reasons that the sliders decide anew; all others keep their settings."""
RADIUS = float(np.sqrt(2.0 * scipy.special.gammaincinv(1.5, 0.95)))
"""Radius of the ellipsoid that holds 95 %, in standard deviations."""


def maps(zone: "xr.Dataset", rig: Rig, calibration: CalibrationRecord | None, say: Say) -> dict[str, Any]:
    """Return the template's values: sliders (name, title, low, high, value, step), both maps, the ellipsoid of a position, and the data and
    code of the script that fills them."""
    seen = thinned(zone)
    held = seen["in_zone"].values.sum(axis=(0, 1))
    # the middle where the zone is there, else where there is most of it
    middle = len(held) // 2
    level = middle if held[middle] or not held.any() else int(np.argmax(held))
    data = _data(seen, zone, rig, calibration) | {"words": _words(say), "mark": texts(say.language)["number.decimal_mark"]}
    sliders = (
        ("level", say("zone.level_z_2"), 0, len(data["z"]) - 1, level, 1),
        ("angle", say("zone.largest_pressure_angle"), 0, 90, data["limit_deg"], 0.5),
        # its position is on a logarithmic scale, as the colours are
        ("u95", say("zone.largest_95_radius_position"), 0, 1000, round(1000 * _part(data["limit_u95"], data)), 1),
    )
    return {
        "sliders": sliders,
        "angles": figures.figure(_map(data, [0.0, 90.0], say), "map-angle", say.language),
        "radii": figures.figure(_map(data, list(np.log10(data["range_u95"])), say, log=True), "map-u95", say.language),
        "ellipsoid": figures.figure(_ellipsoid(say), "ellipsoid", say.language),
        "data": Markup(json.dumps(data).replace("<", chr(92) + "u003c")),
        "script": Markup(SCRIPT.read_text(encoding="utf-8")),
    }


def _words(say: Say) -> dict[str, str]:
    """Return the texts of the page's script."""
    return {
        "mm": say("zone.mm").replace(" ", "\u00a0"),
        "any": say("zone.any"),
        "yes": say("page.yes"),
        "no": say("page.no"),
        "place": say("zone.place"),
        "inside": say("zone.zone"),
        "angle": say("zone.worst_pressure_angle_over"),
        "u95": say("zone.95_radius_position_worst"),
        "weakest": say("zone.weakest_cable_middle_orientation"),
        "cable": say("zone.name_pressure_angle_angle"),
        "unknown": say("page.not_told"),
        "stuck": say("zone.cable_cannot_run"),
        "left": say("zone.within_these_limits_inside"),
    }


def thinned(zone: "xr.Dataset") -> "xr.Dataset":
    """The nodes that are drawn: few enough for a page."""
    stride = {name: max(1, -(-zone.sizes[name] // (MOST_LEVELS if name == "z" else MOST_ALONG))) for name in "xyz"}
    return zone.isel({name: slice(None, None, step) for name, step in stride.items()})


def _data(seen: "xr.Dataset", zone: "xr.Dataset", rig: Rig, calibration: CalibrationRecord | None) -> dict[str, Any]:
    """Return the data of the page's script; arrays over x, y, z with z fastest, as little-endian floats in base64."""
    axes = [seen[name].values.astype(np.float64) for name in "xyz"]
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    turns = zone["quaternion_xyzw"].values
    start = np.array(zone.attrs["zero_pose_xyz_mm_qxyzw"], dtype=np.float64)
    found = ellipsoids(rig, calibration, places, Rotation.from_quat(turns[len(turns) // 2]), start=start)
    u95 = seen["u95_position_mm"].values.ravel().astype(np.float64)
    known = u95[np.isfinite(u95) & (u95 > 0.0)]
    low, high = (float(np.percentile(known, p)) for p in (0, 95)) if len(known) else (0.1, 1.0)
    high = max(high, 1.01 * low)
    requested = zone.attrs.get("limit_u95_mm")
    upper = np.array([(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]).T
    others = (seen["rejected_because"].values.ravel().astype(np.int64) & ~ASKED) == 0
    cables = [{"name": c.name, "base": list(rig.point(c.from_point).position_mm)} for c in rig.cable]
    return {
        **dict(zip("xyz", (a.tolist() for a in axes), strict=True)),
        "spacing": [float(a[1] - a[0]) if len(a) > 1 else float(s) for a, s in zip(axes, zone.attrs["node_spacing_mm"], strict=True)],
        "limit_deg": float(zone.attrs["limit_deg"]),
        "limit_u95": high if requested is None else float(np.clip(requested, low, high)),
        "range_u95": [low, high],
        "asked_u95": requested is not None,
        "radius": RADIUS,
        "cables": cables,
        "worst_angle": _packed(seen["worst_pressure_angle_deg"].values.ravel()),
        "u95": _packed(u95),
        "others": _packed(others),
        "covariance": _packed(found.covariance[:, upper[0], upper[1]].ravel()),
        "weakest": _packed(found.weakest),
        "angle": _packed(found.angle_deg),
    }


def _packed(values: Any) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode()


def _part(u95: float, data: dict[str, Any]) -> float:
    low, high = np.log10(data["range_u95"])
    return float((np.log10(u95) - low) / (high - low))


def ticks(low: float, high: float) -> list[float]:
    """1, 2 and 5 times powers of ten within a range, for a scale of logarithms; its ends where there are fewer than two."""
    powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    inside = [m * 10.0**p for p in powers for m in (1, 2, 5) if low <= m * 10.0**p <= high]
    return inside if len(inside) > 1 else [low, high]


def log_colours(low: float, high: float, say: Say = ENGLISH) -> dict[str, Any]:
    """A colour scale of logarithms that is labelled by the values themselves."""
    values = ticks(low, high)
    return {"tickvals": [float(np.log10(v)) for v in values], "ticktext": [say.number(v, ".3g") for v in values]}


def _map(data: dict[str, Any], span: list[float], say: Say, *, log: bool = False) -> go.Figure:
    """A map that the script fills: colours, the edge of the zone, the clicked place."""
    mark = {"symbol": "cross-thin-open", "size": 14, "color": "#e4572e", "line": {"width": 3}}
    low, high = data["range_u95"]
    bar: dict[str, Any] = {"thickness": 14, "len": 0.9} | (log_colours(low, high, say) if log else {})
    figure = go.Figure(
        [
            go.Heatmap(x=data["x"], y=data["y"], z=[], zmin=span[0], zmax=span[1], colorscale=SCALE, colorbar=bar, hoverinfo="none"),
            go.Contour(
                x=data["x"], y=data["y"], z=[], showscale=False, hoverinfo="skip", line={"color": "white", "width": 3},
                contours={"start": 0, "end": 0, "size": 1, "coloring": "none"},
            ),
            go.Scatter(x=[], y=[], mode="markers", marker=mark,
                       hoverinfo="skip"),
        ]
    )  # fmt: skip
    figure.update_layout(height=450, margin={"t": 28, "b": 48, "l": 60, "r": 8}, showlegend=False)
    figure.update_xaxes(title_text=say("page.x_mm"), constrain="domain")
    figure.update_yaxes(title_text=say("page.y_mm"), constrain="domain", scaleanchor="x")
    return figure


def _ellipsoid(say: Say) -> go.Figure:
    """The picture of a clicked place: ellipsoid and weakest cable, which the script draws."""
    none: list[FloatArray] = []
    figure = go.Figure(
        [
            go.Surface(x=none, y=none, z=none, showscale=False, opacity=0.6, colorscale=SCALE, hoverinfo="skip"),
            go.Scatter3d(x=none, y=none, z=none, mode="lines", line={"width": 6, "color": "#e4572e"}, hoverinfo="skip"),
        ]
    )
    axes = {f"{axis}axis": {"title": say(f"page.{axis}_mm")} for axis in "xyz"}
    figure.update_layout(height=420, margin={"t": 0, "b": 0, "l": 0, "r": 0}, showlegend=False, scene=axes | {"aspectmode": "data"})
    return figure
