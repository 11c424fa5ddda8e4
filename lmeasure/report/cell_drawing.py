"""Draw the plan of a cell: observation points, cables and tool, and how well positions are known in its zone."""

import itertools
from collections.abc import Callable

import numpy as np
import xarray as xr
from markupsafe import escape
from scipy.spatial.transform import Rotation

from lmeasure.certificate import round_up
from lmeasure.core import FloatArray
from lmeasure.report.zone_figures import fullest_level, middle_pose
from lmeasure.rig import Rig
from lmeasure.text import Say

WIDE, HIGH, MARGIN = 640.0, 400.0, 48.0
At = Callable[[FloatArray], tuple[float, float]]


def cell_plan(rig: Rig, zone: xr.Dataset | None, say: Say) -> str:
    """Return a drawing (SVG) from above, or from the side on which the points lie farther apart.

    A style sheet colours its classes: `point`, `cable`, `tool`, `zone` (all of it at its fullest level), `better` (its half with the
    smaller U95) and `scale`. Without a zone the tool is at the origin of the base frame.
    """
    pose = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]) if zone is None else middle_pose(zone)
    points = {p.name: np.array(p.position_mm) for p in rig.observation_point}
    tool = dict(zip(rig.tool, pose[:3] + Rotation.from_quat(pose[3:]).apply(list(rig.tool.values())), strict=True))
    every = np.vstack([*points.values(), *tool.values()])
    span = np.ptp(every, axis=0)
    # from above in doubt
    h, v = max(((0, 1), (0, 2), (1, 2)), key=lambda pair: span[pair[0]] * span[pair[1]] * (1.5 if pair == (0, 1) else 1.0))
    low, high = every[:, [h, v]].min(axis=0), every[:, [h, v]].max(axis=0)
    scale = float(min((np.array([WIDE, HIGH]) - 2 * MARGIN) / np.maximum(high - low, 1.0)))
    middle = 0.5 * (low + high)

    def at(place: FloatArray) -> tuple[float, float]:
        return WIDE / 2 + scale * float(place[h] - middle[0]), HIGH / 2 - scale * float(place[v] - middle[1])

    parts = _zone(zone, at, scale) if zone is not None and (h, v) == (0, 1) else []
    for cable in rig.cable:
        (x, y), (to_x, to_y) = at(points[cable.from_point]), at(tool[cable.to_point])
        parts.append(f'<path class="cable" d="M{x:.1f} {y:.1f}L{to_x:.1f} {to_y:.1f}"/>')
    for place in tool.values():
        x, y = at(place)
        parts.append(f'<circle class="tool" cx="{x:.1f}" cy="{y:.1f}" r="4"/>')
    for name, place in points.items():
        x, y = at(place)
        across, anchor = (9.0, "start") if x < WIDE / 2 else (-9.0, "end")
        parts.append(f'<circle class="point" cx="{x:.1f}" cy="{y:.1f}" r="6"/>')
        parts.append(f'<text x="{x + across:.1f}" y="{y - 8:.1f}" text-anchor="{anchor}">{escape(name[:16])}</text>')
    length = round_up(90.0 / scale)
    parts.append(f'<path class="scale" d="M12 {HIGH - 18:g}v8m0 -4h{scale * length:.1f}m0 -4v8"/>')
    plane = "XYZ"[h] + "XYZ"[v]
    parts.append(f'<text class="scale" x="12" y="{HIGH - 24:g}">{plane}, {say.number(length, "g")}\u00a0{say("page.mm")}</text>')
    label = escape(say("cell.plan", name=rig.name, plane=plane))
    return f'<svg class="plan" viewBox="0 0 {WIDE:g} {HIGH:g}" role="img" aria-label="{label}">{"".join(parts)}</svg>'


def _zone(zone: xr.Dataset, at: At, scale: float) -> list[str]:
    """Return the cells of the zone's fullest level, each row of neighbours as one rectangle."""
    k = fullest_level(zone)
    inside, u95 = zone["in_zone"].values.astype(bool)[:, :, k], zone["u95_position_mm"].values[:, :, k]
    if not inside.any():
        return []
    better = inside & (u95 <= np.median(u95[inside]))
    x, y = zone["x"].values, zone["y"].values
    step_x, step_y = (float(s) for s in zone.attrs["node_spacing_mm"][:2])
    parts = []
    for name, cells in (("zone", inside), ("better", better)):
        for j in range(len(y)):
            for held, run in itertools.groupby(range(len(x)), key=lambda i, own=cells[:, j]: bool(own[i])):  # type: ignore[misc]
                columns = list(run)
                if held:
                    left, top = at(np.array([x[columns[0]] - step_x / 2, y[j] + step_y / 2, 0.0]))
                    size = scale * (x[columns[-1]] - x[columns[0]] + step_x), scale * step_y
                    parts.append(f'<rect class="{name}" x="{left:.1f}" y="{top:.1f}" width="{size[0]:.1f}" height="{size[1]:.1f}"/>')
    return parts
