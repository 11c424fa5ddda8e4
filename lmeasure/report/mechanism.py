"""Values of a mechanism's page: its figure at a pose, its joints, how far it goes, and slices of its workspace."""

from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go

from lmeasure.core import FloatArray
from lmeasure.report import figures, html
from lmeasure.report.text import axes
from lmeasure.robots import Grid, MechanismOutline, ParallelFile, Workspace, mechanism_outline
from lmeasure.text import ENGLISH, Say

BASE, PLATFORM, LEG, ARM, INSIDE = "#1f2933", "#1d4ed8", "#c2410c", "#7c3aed", "#15803d"
MOST_SLICES = 6
NEAR = 1e-3
"""Smallest over largest singular value below which a pose is called near-singular."""
RIM = 1e-6
"""Distance [mm] of an outline beyond the edge of the grid."""


def write_mechanism_page(path: Path, file: ParallelFile, record: dict[str, Any], grid: Grid | None, *, language: str = "en") -> None:
    """Write a self-contained page of a mechanism, its record (`parallel.study.described`) and its workspace where it was looked for."""
    say = Say(language)
    pose = np.array([*record["position_mm"], *record["quaternion_xyzw"]])
    slices = grid is not None and bool(grid.found.inside.any())
    plots = {"slices": figures.figure(slices_figure(grid.found, say), "slices", language)} if grid is not None and slices else {}
    workspace = "" if grid is None else workspace_words(grid, say)
    html.write_page(
        path, "mechanism.html", answer(file, pose, record, grid, say=say), say, record=record, plots=plots, workspace=workspace,
        units={name: "°" if name.startswith("r") else say("page.mm") for name in record.get("ranges", ())},
    )  # fmt: skip


def answer(file: ParallelFile, pose: FloatArray, record: dict[str, Any], grid: Grid | None, *, say: Say) -> html.Answer:
    """Return the first screen: freedoms, distance from a singular pose, the workspace and its limits, and the next step."""
    near, freedoms = float(record["nearness"]), record["freedoms"]
    rows = [
        html.Number(say("mechanism.freedoms"), str(freedoms), say("mechanism.parameters", number=record["parameters"])),
        html.Number(say("mechanism.nearness"), say.number(near, ".3g"), say("mechanism.nearness_note"), "warn" if near < NEAR else ""),
    ]
    limits = say("mechanism.limited_unknown")
    step = html.Step(
        say("mechanism.next_workspace"), f"lmeasure mechanism {file.name} --x -100:100:10 --y -100:100:10 --z 0:200:10 --report page"
    )
    if grid is not None:
        rows.append(html.Number(say("mechanism.workspace"), _size(*grid.found.size, say)))
        if grid.ended_by:
            name, number = max(grid.ended_by.items(), key=lambda one: one[1])
            limits = say("mechanism.limited", limit=limit_words(say)[name], number=number)
        step = html.Step(say("mechanism.next_identify"), f"lmeasure identify --robot {file.name} --measurements FILE.csv --out identified")
    state, verdict = ("warn", say("mechanism.near_singular")) if near < NEAR else ("good", say("mechanism.away_from_singular"))
    return html.Answer(
        say("mechanism.mechanism", name=file.name), verdict, state, tuple(rows), limits, (step,),
        figures.figure(space_figure(file, pose, grid, say), "space", say.language, hero=True), "", say("mechanism.caption"),
    )  # fmt: skip


def workspace_words(grid: Grid, say: Say = ENGLISH) -> str:
    """Return its volume, extent, and limits."""
    found = grid.found
    if not found.inside.any():
        return say("mechanism.no_place_grid_inside")
    out = [say("mechanism.size_places", size=_size(*found.size, say), nodes=int(found.inside.sum()), of=found.inside.size)]
    for i, name in enumerate("xyz"):
        held = found[i][found.inside.any(axis=tuple(k for k in range(3) if k != i))]
        out.append(say("mechanism.from_mm", name=name, low=held[0], high=held[-1]))
    if grid.every is not None:
        out.append(say("mechanism.at_every_orientation", size=_size(*found.size_of(grid.every), say)))
    if grid.yaw_free:
        out.append(say("mechanism.any_turn_about_vertical"))
    if grid.ended_by:
        most, named = sorted(grid.ended_by.items(), key=lambda one: -one[1]), limit_words(say)
        out.append(say("mechanism.ended", limits=", ".join(f"{named[name]} ({n})" for name, n in most)))
    return "; ".join(out)


def _size(name: str, value: float, say: Say) -> str:
    return say(f"mechanism.{name}", value=value / 1e6 if name == "volume_mm3" else value)


def limit_words(say: Say = ENGLISH) -> dict[str, str]:
    """Return the name of each limit of a workspace."""
    return {
        "reached": say("mechanism.reach_legs"),
        "joints": say("mechanism.limits_joints"),
        "gaps": say("mechanism.gaps_carriages"),
        "base_cone": say("mechanism.angle_axis_base"),
        "platform_cone": say("mechanism.angle_axis_platform"),
        "hooke": say("mechanism.turn_of_legs"),
        "regular": say("mechanism.nearness_singular_pose"),
        "stands": say("mechanism.standing"),
    }


def space_figure(file: ParallelFile, pose: FloatArray, grid: Grid | None = None, say: Say = ENGLISH) -> go.Figure:
    """Base, legs and platform at a pose (7,), and the places of a workspace."""
    figure, found = go.Figure(), mechanism_outline(file, pose)
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


def _parts(found: MechanismOutline, say: Say) -> list[tuple[list[FloatArray], str, int, str]]:
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
    # an empty rim around the grid closes outlines that end at its edge
    x, y = (np.pad(axis, 1, mode="linear_ramp", end_values=(axis[0] - RIM, axis[-1] + RIM)) for axis in (found.x_mm, found.y_mm))
    inside = np.pad(found.inside, ((1, 1), (1, 1), (0, 0)))
    for colour, level in zip(figures.PALETTE, chosen, strict=False):
        figure.add_contour(
            x=x, y=y, z=inside[:, :, level].T.astype(float),
            contours={"start": 0.5, "end": 0.5, "coloring": "lines"}, line={"color": colour, "width": 2, "smoothing": 0}, showscale=False,
            name=say("mechanism.z_mm", z=found.z_mm[level]), showlegend=True, colorscale=[[0.0, colour], [1.0, colour]], hoverinfo="skip",
        )  # fmt: skip
    figure.update_xaxes(title_text=say("page.x_mm"), scaleanchor="y", constrain="domain")
    figure.update_yaxes(title_text=say("page.y_mm"), constrain="domain")
    return figure.update_layout(height=560, margin={"t": 20})
