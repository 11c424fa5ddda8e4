"""The page of a mechanism: in space at a pose, its joints, how far it goes, and slices of its workspace."""

from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go

from lmeasure.core import FloatArray
from lmeasure.report import html
from lmeasure.report.text import axes
from lmeasure.robots import Drawn, Grid, ParallelFile, Workspace, drawn
from lmeasure.text import ENGLISH, Say

BASE, PLATFORM, LEG, ARM, INSIDE = "#1f2933", "#1d4ed8", "#c2410c", "#7c3aed", "#15803d"
MOST_SLICES = 6
RIM = 1e-6
"""In mm: by how much an outline at the edge of the grid lies beyond it."""


def write_mechanism_page(path: Path, file: ParallelFile, record: dict[str, Any], grid: Grid | None, *, language: str = "en") -> None:
    """Write a self-contained page of a mechanism, its record (`parallel.study.described`) and its workspace where it was looked for."""
    say = Say(language)
    pose = np.array([*record["position_mm"], *record["quaternion_xyzw"]])
    many = {"freedoms": record["freedoms"], "parameters": record["parameters"]}
    reported = say("mechanism.1_freedom_parameters", **many) if many["freedoms"] == 1 else say("mechanism.freedoms_parameters", **many)
    near = say("mechanism.distance_from_singular_pose", near=record["nearness"])
    body = [html.paragraph(reported), html.paragraph(near), html.heading(say("page.space"))]
    body.append(html.figure(space_figure(file, pose, grid, say), "space", first=True, language=language))
    rows = [
        (name, say.number(v, ".3f"), *(say.number(w, "g") for w in record["joint_limits"][name])) for name, v in record["joints"].items()
    ]
    body += [
        html.heading(say("mechanism.joints")),
        html.table((say("page.joint"), say("page.value"), say("mechanism.lowest"), say("mechanism.highest")), rows),
    ]
    if "ranges" in record:
        body += [html.heading(say("mechanism.how_far_goes_from"))]
        units = {name: "°" if name.startswith("r") else say("page.mm") for name in record["ranges"]}
        rows = [(f"{n}, {units[n]}", *(say.number(v, ".2f") for v in ends)) for n, ends in record["ranges"].items()]
        body.append(html.table((say("mechanism.coordinate"), say("mechanism.lowest"), say("mechanism.highest")), rows))
    if "leg_turns_deg" in record:
        rows = [(name, say.number(v, ".3f")) for name, v in record["leg_turns_deg"].items()]
        body += [html.heading(say("mechanism.how_much_legs_turn")), html.table((say("mechanism.leg"), "°"), rows)]
    if grid is not None:
        body += [html.heading(say("mechanism.workspace")), html.paragraph(workspace_words(grid, say))]
        if grid.found.inside.any():
            body.append(html.figure(slices_figure(grid.found, say), "slices", first=False, language=language))
    html.write_page(path, say("mechanism.mechanism", name=file.name), body, language)


def workspace_words(grid: Grid, say: Say = ENGLISH) -> str:
    """Its volume, extent, and what ends it."""
    found = grid.found
    if not found.inside.any():
        return say("mechanism.no_place_grid_inside")
    words = say("mechanism.litres_places", volume=found.volume_mm3 / 1e6, nodes=int(found.inside.sum()), of=found.inside.size)
    out = [words]
    for i, name in enumerate("xyz"):
        held = found[i][found.inside.any(axis=tuple(k for k in range(3) if k != i))]
        out.append(say("mechanism.from_mm", name=name, low=held[0], high=held[-1]))
    if grid.yaw_free:
        out.append(say("mechanism.any_turn_about_vertical"))
    if grid.ended_by:
        most, named = sorted(grid.ended_by.items(), key=lambda one: -one[1]), limit_words(say)
        out.append(say("mechanism.ended", limits=", ".join(f"{named[name]} ({n})" for name, n in most)))
    return "; ".join(out)


def limit_words(say: Say = ENGLISH) -> dict[str, str]:
    """What each limit of a workspace is called."""
    return {
        "reached": say("mechanism.reach_legs"),
        "joints": say("mechanism.limits_joints"),
        "gaps": say("mechanism.gaps_carriages"),
        "base_cone": say("mechanism.angle_axis_base"),
        "platform_cone": say("mechanism.angle_axis_platform"),
        "regular": say("mechanism.nearness_singular_pose"),
        "stands": say("mechanism.standing"),
    }


def space_figure(file: ParallelFile, pose: FloatArray, grid: Grid | None = None, say: Say = ENGLISH) -> go.Figure:
    """Base, legs and platform at a pose (7,), and the places of a workspace."""
    figure, found = go.Figure(), drawn(file, pose)
    for strips, ink, width, name in _parts(found, say):
        if strips:
            rows = np.concatenate([np.vstack([strip, np.full((1, 3), np.nan)]) for strip in strips])
            x, y, z = rows.T
            figure.add_scatter3d(x=x, y=y, z=z, mode="lines", line={"width": width, "color": ink}, name=name, hoverinfo="skip")
    x, y, z = found.hinges.T
    figure.add_scatter3d(
        x=x, y=y, z=z, mode="markers", marker={"size": 3, "color": PLATFORM}, text=found.names, name=say("mechanism.hinges")
    )
    if grid is not None and grid.found.inside.any():
        at = np.argwhere(_rim(grid.found))
        x, y, z = (axis[at[:, i]] for i, axis in enumerate(grid.found[:3]))
        figure.add_scatter3d(
            x=x, y=y, z=z, mode="markers", marker={"size": 2, "color": INSIDE, "opacity": 0.5}, name=say("mechanism.workspace_2")
        )
    return figure.update_layout(height=640, margin={"t": 20, "b": 10, "l": 0, "r": 0}, scene=axes(say))


def _parts(found: Drawn, say: Say) -> list[tuple[list[FloatArray], str, int, str]]:
    return [
        (found.base, BASE, 4, say("page.base")),
        (found.arms, ARM, 6, say("mechanism.cranks_arms")),
        (found.legs, LEG, 4, say("mechanism.legs")),
        ([found.platform], PLATFORM, 6, say("mechanism.platform")),
    ]


def _rim(found: Workspace) -> FloatArray:
    """Places inside with one outside beside them."""
    inner = np.pad(found.inside, 1)
    whole = inner.copy()
    for axis in range(3):
        whole &= np.roll(inner, 1, axis) & np.roll(inner, -1, axis)
    return np.asarray((inner & ~whole)[1:-1, 1:-1, 1:-1])


def slices_figure(found: Workspace, say: Say = ENGLISH) -> go.Figure:
    """Places inside at some heights, one under the other in one picture: the outline of each."""
    levels = np.flatnonzero(found.inside.any(axis=(0, 1)))
    chosen = levels[np.unique(np.linspace(0, len(levels) - 1, MOST_SLICES).round().astype(int))]
    figure = go.Figure()
    # a rim of nothing around the grid: what ends at its edge is an outline too, that closes
    x, y = (np.pad(axis, 1, mode="linear_ramp", end_values=(axis[0] - RIM, axis[-1] + RIM)) for axis in (found.x_mm, found.y_mm))
    inside = np.pad(found.inside, ((1, 1), (1, 1), (0, 0)))
    for colour, level in zip(html.PALETTE, chosen, strict=False):
        figure.add_contour(
            x=x, y=y, z=inside[:, :, level].T.astype(float),
            contours={"start": 0.5, "end": 0.5, "coloring": "lines"}, line={"color": colour, "width": 2, "smoothing": 0}, showscale=False,
            name=say("mechanism.z_mm", z=found.z_mm[level]), showlegend=True, colorscale=[[0.0, colour], [1.0, colour]], hoverinfo="skip",
        )  # fmt: skip
    figure.update_xaxes(title_text=say("page.x_mm"), scaleanchor="y", constrain="domain")
    figure.update_yaxes(title_text=say("page.y_mm"), constrain="domain")
    return figure.update_layout(height=560, margin={"t": 20})
