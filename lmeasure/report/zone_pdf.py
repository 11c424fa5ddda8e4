"""The zone on paper."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import plotly.colors
import typst
import xarray as xr

from lmeasure.accuracy import extent
from lmeasure.core import BoolArray, FloatArray
from lmeasure.io import files
from lmeasure.report import html, zone_text
from lmeasure.report.zone_figures import views
from lmeasure.report.zone_maps import SCALE
from lmeasure.rig import Rig
from lmeasure.text import Say

SLICES = 9
TEMPLATE = Path(__file__).with_name("zone.typ")


def write_zone_pdf(path: Path, zone: xr.Dataset, rig: Rig, language: str = "en") -> None:
    """Write the PDF (A4, PDF/A-2b): findings, slices, figures, reasons, the rig's drawing; whole or not at all."""
    found, say = extent(zone), Say(language)
    limit = f"{say.number(zone.attrs['limit_deg'], 'g')}°"
    levels = ("zone.worst_pressure_angle_over_orientations_x", "zone.worst_pressure_angle_over_orientations")[zone_text.has_edge(zone)]
    sides = [(say("zone.right_up", right=h.upper(), up=v.upper()), lines) for h, v, lines in views(zone, rig)]
    content: dict[str, Any] = {
        "language": language,
        "title": zone_text.title(rig, say),
        "findings": zone_text.findings(zone, found, say),
        "assumed": zone_text.assumed(zone, say),
        "slices": [{"level": say("zone.z_mm", mm=level), "svg": svg} for level, svg in _slices(zone)],
        "scale": _scale(float(zone.attrs["limit_deg"])),
        "limit": float(zone.attrs["limit_deg"]) / 90.0,
        "views": [{"axes": axes, "svg": _drawing(lines)} for axes, lines in sides],
        # a unit alone on a header line would be unclear
        "tables": [
            {"title": title, "header": [name.replace(", ", ",\u00a0") for name in header], "rows": rows}
            for title, header, rows in zone_text.tables(zone, found, rig, say)
        ],
        "digest": str(zone.attrs["result_sha256"]),
        "words": {
            "result": say("page.result"),
            "page": say("zone.page"),
            "of": say("zone.of"),
            "levels": say("zone.level_level"),
            "levels reported": say(levels),
            "limit": say("zone.limit", angle=limit),
            "scale": say("zone.colour_scale_0_90"),
            "sides": say("zone.rig_seen_along_axes"),
            "sides reported": say("zone.green_scanned_box_red"),
        },
    }
    pdf = typst.compile(TEMPLATE.read_bytes(), sys_inputs={"content": json.dumps(html.on_paper(content))}, pdf_standards=["a-2b"])
    with files.whole(path) as temporary:
        temporary.write_bytes(pdf)


def _colour(fraction: float) -> str:
    return str(plotly.colors.sample_colorscale(SCALE, [min(max(fraction, 0.0), 1.0)], colortype="rgb")[0])


def _scale(limit_deg: float) -> str:
    """SVG of the colours from 0 to 90 degrees, with a mark at the limit."""
    mark = f'<path d="M{limit_deg:g} 0v4" stroke="white" stroke-width="0.4"/>'
    bars = "".join(f'<rect x="{i}" y="0" width="1.05" height="4" fill="{_colour(i / 90)}"/>' for i in range(90))
    return f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 90 4">{bars}{mark}</svg>'


def _slices(zone: xr.Dataset) -> list[tuple[float, str]]:
    """(level, SVG) of a few levels: a cell per node in the colour of its worst angle, cells of the zone framed along its edge."""
    x, y, z = (zone[name].values for name in "xyz")
    chosen = sorted({round(i) for i in np.linspace(0, len(z) - 1, min(len(z), SLICES))})
    angle, inside = zone["worst_pressure_angle_deg"].values, zone["in_zone"].values.astype(bool)
    out = []
    for k in chosen:
        cells = "".join(
            f'<rect x="{i}" y="{len(y) - 1 - j}" width="1.03" height="1.03" fill="{_colour(angle[i, j, k] / 90)}"/>'
            for i in range(len(x))
            for j in range(len(y))
        )
        frame = f'<path d="{_edge(inside[:, :, k])}" stroke="white" stroke-width="{0.012 * len(x) + 0.08:.3f}" fill="none"/>'
        out.append((float(z[k]), f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {len(x)} {len(y)}">{cells}{frame}</svg>'))
    return out


def _edge(inside: BoolArray) -> str:
    """Return the SVG path between cells inside the zone and neighbours outside; the region beyond the box was not scanned."""
    n = inside.shape[1]
    padded = np.pad(inside, 1, mode="edge")
    parts = [f"M{i} {n - 1 - j}v1" for i, j in np.argwhere(padded[1:, 1:-1] != padded[:-1, 1:-1])]
    parts += [f"M{i} {n - j}h1" for i, j in np.argwhere(padded[1:-1, 1:] != padded[1:-1, :-1])]
    return "".join(parts)


def _drawing(lines: list[FloatArray]) -> str:
    """SVG of the scanned box and the cables, in mm, the second coordinate up."""
    points = np.concatenate(lines)
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.06 * float((high - low).max())
    width, height = (high - low) + 2 * margin

    def path(line: FloatArray) -> str:
        return "M" + "L".join(f"{x - low[0] + margin:.1f} {high[1] - y + margin:.1f}" for x, y in line)

    stroke = 0.004 * max(width, height)
    box = f'<path d="{path(lines[0])}" fill="#e8f1ec" stroke="#1a7f4b" stroke-width="{stroke:.2f}"/>'
    cables = "".join(f'<path d="{path(line)}" fill="none" stroke="#30343f" stroke-width="{stroke:.2f}"/>' for line in lines[1:])
    ends = "".join(
        f'<circle cx="{line[0, 0] - low[0] + margin:.1f}" cy="{high[1] - line[0, 1] + margin:.1f}" r="{3 * stroke:.2f}" fill="#b3261e"/>'
        for line in lines[1:]
    )
    return f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.1f} {height:.1f}">{box}{cables}{ends}</svg>'
