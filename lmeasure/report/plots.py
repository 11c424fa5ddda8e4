"""A figure of any noun of the pipeline, for a notebook or a page; `lmeasure.plot` is the way to it.

A figure brings along all that it needs to show itself: plotly's own ways of showing one fetch MathJax from a server elsewhere.
"""

import math
import tempfile
import webbrowser
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
import xarray as xr
from plotly.graph_objects import Figure as Figure
from plotly.subplots import make_subplots

from lmeasure.accuracy import Placed
from lmeasure.acquisition import Scan
from lmeasure.calibration import Calibration, Plan
from lmeasure.certificate import Certificate
from lmeasure.core import FloatArray, LMeasureError
from lmeasure.iso9283 import Evaluation
from lmeasure.kernels import BASE_XYZ, wrap_geometry
from lmeasure.recording import Counts, Poses, Program, Run
from lmeasure.report import correction, figures, html, structure
from lmeasure.report.calibration_figures import residuals_figure
from lmeasure.report.robot import errors_figure
from lmeasure.report.text import axes, unit as unit_of
from lmeasure.report.zone_figures import quantity_figure, space_figure, u95_figure
from lmeasure.rig import CalibrationRecord, Rig
from lmeasure.robot_programs import Corrected
from lmeasure.robots import Identified
from lmeasure.sensors import Lengths
from lmeasure.simulation import Simulated
from lmeasure.structure import Boundary, Described
from lmeasure.text import ENGLISH, Say, message
from lmeasure.trajectory import Trajectory

JSON = "application/vnd.plotly.v1+json"
"""Type that front ends which draw plotly's figures by themselves read."""
CONFIG = {"responsive": True, "displaylogo": False}


class ShownFigure(go.Figure):  # type: ignore[misc]
    """A plotly figure with its own display, in a notebook and by `show`, that fetches nothing."""

    def _repr_mimebundle_(self, *args: Any, **kwargs: Any) -> dict[str, Any]:
        return {JSON: {**self.to_plotly_json(), "config": CONFIG}, "text/html": self._repr_html_()}

    def _repr_html_(self) -> str:
        # every figure contains its script: a cell may be shown without the others
        return str(self.to_html(full_html=False, include_plotlyjs=True, include_mathjax=False, config=CONFIG))

    def _ipython_display_(self) -> None:
        from IPython import display

        show: Any = display.display
        show(self._repr_mimebundle_(), raw=True)

    def show(self, *args: Any, **kwargs: Any) -> None:
        """Show it below the cell of a notebook, elsewhere in a browser; with arguments as plotly's figures do."""
        if args or kwargs:
            super().show(*args, **kwargs)
        elif _in_a_notebook():
            self._ipython_display_()
        else:
            page = Path(tempfile.mkdtemp(prefix="lmeasure-")) / "figure.html"
            self.write_html(page, include_plotlyjs=True, include_mathjax=False, config=CONFIG)
            webbrowser.open(page.as_uri())


def _in_a_notebook() -> bool:
    try:
        from IPython.core.getipython import get_ipython
    except ImportError:
        return False
    shell: Any = get_ipython()  # type: ignore[no-untyped-call]
    return shell is not None and getattr(shell, "kernel", None) is not None


HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
STEP_MM = 5.0
MOST_POINTS = 20_000
MOST_PANELS = 24
FRAMES = 90


def figure_of(what: Any, rig: Rig | None = None, say: Say = ENGLISH) -> go.Figure:
    """Return the figure of a noun; rig is drawn with objects in space. LMeasureError for an unknown noun."""
    for kind, draw in DRAWN.items():
        if isinstance(what, kind):
            return ShownFigure(figures.settled(draw(what, rig, say)))
    known = ", ".join(kind.__name__ for kind in DRAWN)
    raise LMeasureError(message("error.is_nothing_that_can", name=type(what).__name__, known=known))


def _space(say: Say, rig: Rig | None = None, pose: FloatArray | None = None) -> go.Figure:
    """An empty space, or one with a rig whose cables run to the tool at a pose (7,), where they can."""
    figure = go.Figure()
    figure.update_layout(height=640, margin={"t": 10, "b": 10}, scene=axes(say))
    if rig is not None and pose is not None:
        for cable, way in zip(rig.cable, figures.cable_ways(rig.cable_rows(), pose), strict=True):
            x, y, z = way.T
            figure.add_scatter3d(x=x, y=y, z=z, mode="lines", line={"width": 4}, name=html.label(cable.name))
        figures.add_points(figure, rig.observation_point, say)
    return figure


def _add_places(figure: go.Figure, places: FloatArray, names: Sequence[str], title: str) -> None:
    x, y, z = places.T
    figure.add_scatter3d(x=x, y=y, z=z, mode="markers", text=[html.label(n) for n in names], marker={"size": 4}, name=title)


def _poses(poses: Poses, rig: Rig | None, say: Say) -> go.Figure:
    figure = _space(say, rig, poses.rows[0])
    _add_places(figure, poses.rows[:, :3], poses.names, say("calibration.reference_poses"))
    return figure


def _trajectory(trajectory: Trajectory, rig: Rig | None, say: Say) -> go.Figure:
    """Its way, coloured by the largest standard uncertainty of a coordinate; gaps are gaps."""
    step = max(1, -(-len(trajectory.poses) // MOST_POINTS))
    x, y, z = trajectory.poses[::step, :3].T
    u = 1e3 * trajectory.u[::step, :3].max(axis=1)
    known = np.flatnonzero(~np.isnan(trajectory.poses).any(axis=1))
    figure = _space(say, rig, trajectory.poses[known[0]] if len(known) else None)
    line = {"width": 5, "color": u, "colorscale": "Viridis", "colorbar": {"title": "u, µm"}}
    time_s = [f"{t:.6g} s" for t in trajectory.time_s[::step]]
    figure.add_scatter3d(x=x, y=y, z=z, mode="lines", line=line, text=time_s, name=say("trajectory.origin"))
    return figure


def playing_figure(rig: Rig, trajectory: Trajectory, say: Say) -> go.Figure:
    """Draw the cell with its cables and the tool as it moves along its path; a button plays it."""
    known = np.flatnonzero(~np.isnan(trajectory.poses).any(axis=1))
    shown = known[np.linspace(0, len(known) - 1, min(FRAMES, len(known))).astype(int)]
    rows, poses = rig.cable_rows(), trajectory.poses[shown]
    _, tangent, attachment, _ = wrap_geometry(rows, poses)
    gap = np.full((len(shown), len(rows), 1, 3), np.nan)
    base = np.broadcast_to(rows[:, BASE_XYZ], attachment.shape)
    cables = np.concatenate([np.stack([base, tangent, attachment], axis=2), gap], axis=2).reshape(len(shown), -1, 3)
    figure = go.Figure()
    figures.add_points(figure, rig.observation_point, say)
    x, y, z = trajectory.poses[known[:: max(1, len(known) // MOST_POINTS)], :3].T
    figure.add_scatter3d(x=x, y=y, z=z, mode="lines", line={"width": 3, "color": "#56b4e9"}, name=say("demo_page.path"))

    def moving(i: int) -> list[go.Scatter3d]:
        (cx, cy, cz), (tx, ty, tz) = cables[i].T, attachment[i].T
        return [
            go.Scatter3d(x=cx, y=cy, z=cz, mode="lines", line={"width": 4, "color": "#d55e00"}, name=say("zone.cables")),
            go.Scatter3d(x=tx, y=ty, z=tz, mode="markers", marker={"size": 6, "color": "#0072b2"}, name=say("demo_page.gripper")),
        ]

    figure.add_traces(moving(0))
    figure.frames = [go.Frame(data=moving(i), traces=[2, 3], name=str(i)) for i in range(len(shown))]
    pace = {"frame": {"duration": 80, "redraw": True}, "transition": {"duration": 0}}
    button = {"label": say("demo_page.play"), "method": "animate", "args": [None, {**pace, "fromcurrent": False}]}
    figure.update_layout(
        updatemenus=[{"type": "buttons", "buttons": [button], "x": 0.0, "y": 1.0, "xanchor": "left", "yanchor": "top"}], scene=axes(say)
    )
    return figure


def errors_beside_figure(time_s: FloatArray, errors_mm: FloatArray, u95_mm: FloatArray, say: Say) -> go.Figure:
    """Draw distances from the truth (n,) and the U95 (n,) that was stated without it over time."""
    step = max(1, len(time_s) // 4000)
    figure = go.Figure()
    line, error = {"color": "#56b4e9"}, {"color": "#d55e00"}
    figure.add_scatter(x=time_s[::step], y=u95_mm[::step], mode="lines", fill="tozeroy", line=line, name=say("demo_page.stated_u95"))
    figure.add_scatter(x=time_s[::step], y=errors_mm[::step], mode="lines", line=error, name=say("demo_page.true_error"))
    figure.update_xaxes(title_text=say("demo_page.time_s")).update_yaxes(title_text=say("page.mm"))
    return figure.update_layout(height=380, margin={"t": 20})


def fault_figure(counts: Counts, at_s: float, without_s: tuple[float, float] | None, say: Say) -> go.Figure:
    """Draw counts over time, the moment of a fault, and the span that has no pose because of it."""
    figure = _over_time([(counts.time_s, counts.channels, counts.recorded)], say("demo_page.counts"), say)
    figure.add_vline(x=at_s, line={"color": "#c1272d", "dash": "dash"})
    if without_s is not None:
        figure.add_vrect(x0=without_s[0], x1=without_s[1], fillcolor="#c1272d", opacity=0.15)
    return figure


def _simulated(made: Simulated, rig: Rig | None, say: Say) -> go.Figure:
    """The true poses: the way of a run, and reference poses."""
    figure = _space(say, *(() if made.run is None else (made.run.run.rig if rig is None else rig, made.run.poses[0])))
    if made.run is not None:
        x, y, z = made.run.poses[:: max(1, -(-len(made.run.poses) // MOST_POINTS)), :3].T
        figure.add_scatter3d(x=x, y=y, z=z, mode="lines", name=say("trajectory.origin"))
    if made.campaign is not None:
        _add_places(figure, made.campaign.poses[:, :3], made.campaign.measured.names, say("calibration.reference_poses"))
    return figure


def _identified(found: Identified[Any], rig: Rig | None, say: Say) -> go.Figure:
    """Errors of the rows that were used, before and after."""
    used = found.kept & found.rows.placed
    return errors_figure(found.rows.position[used], found.nominal_errors_mm()[used], found.errors_mm()[used], say)[0]


def _over_time(passes: Sequence[tuple[FloatArray, Sequence[str], FloatArray]], unit: str, say: Say) -> go.Figure:
    """(time, names, values (n, m)) of each pass, one under the other."""
    figure = make_subplots(len(passes), 1, shared_xaxes=True)
    for row, (time_s, names, values) in enumerate(passes, 1):
        step = max(1, -(-len(time_s) // MOST_POINTS))
        for name, column in zip(names, values.T, strict=True):
            figure.add_scatter(x=time_s[::step], y=column[::step], mode="lines", name=html.label(name), row=row, col=1)
        figure.update_yaxes(title_text=unit, row=row, col=1)
    figure.update_xaxes(title_text=say("demo_page.time_s"), row=len(passes), col=1)
    return figure.update_layout(height=max(420, 280 * len(passes)), margin={"t": 20})


def scans_figure(scans: Sequence[Scan], say: Say = ENGLISH) -> go.Figure:
    """Draw counts over time of everything in logs that moves as a counter does, a panel for each; logs are drawn one upon the other."""
    found = [(scan, carried, one) for scan in scans for carried in scan.carried for one in carried.counters]
    panels = list(dict.fromkeys((carried.name, one.first, one.size) for _, carried, one in found))[:MOST_PANELS]
    titles = [f"{name}, bytes {first}-{first + size - 1}" for name, first, size in panels]
    figure = make_subplots(max(len(panels), 1), 1, shared_xaxes=True, subplot_titles=titles, vertical_spacing=0.3 / max(len(panels), 1))
    for scan, carried, one in found:
        at = carried.name, one.first, one.size
        if at in panels:
            step = max(1, -(-len(one.values) // MOST_POINTS))
            line = {"x": carried.time_s[::step] - scan.begins_s, "y": one.values[::step], "mode": "lines", "showlegend": False}
            figure.add_scatter(**line, name=html.label(scan.path.name), row=panels.index(at) + 1, col=1)
    figure.update_xaxes(title_text=say("demo_page.time_s"), row=max(len(panels), 1), col=1)
    return figure.update_layout(height=max(300, 170 * len(panels)), margin={"t": 30})


def _program(program: Program, rig: Rig | None, say: Say) -> go.Figure:
    places = np.array([p.position_mm for p in program.pose]).reshape(-1, 3)
    figure = _space(say, rig, HOME if not len(places) else np.array([*places[0], *program.pose[0].quaternion_xyzw]))
    _add_places(figure, places, [p.name for p in program.pose], say("certificate.summary.commanded"))
    for path in program.path:
        x, y, z = path.points(STEP_MM).T
        figure.add_scatter3d(x=x, y=y, z=z, mode="lines", line={"width": 4}, name=html.label(path.name))
    return figure


def _characteristics(rows: Sequence[dict[str, Any]], say: Say) -> go.Figure:
    """Values with their U95, a panel for each unit; hollow where the instrument is not capable of the figure."""
    units = list(dict.fromkeys(str(r["unit"]) for r in rows)) or [""]
    figure = make_subplots(math.ceil(len(units) / 2), min(2, len(units)), subplot_titles=[unit_of(say.language, unit) for unit in units])
    for i, unit in enumerate(units):
        own = [r for r in rows if r["unit"] == unit]
        labels = [html.label(" ".join(str(r[k]) for k in ("name", "pose", "path", "part") if r.get(k))) for r in own]
        figure.add_scatter(
            x=labels,
            y=[r["value"] for r in own],
            error_y={"type": "data", "array": [r["u95"] or 0.0 for r in own]},
            mode="markers",
            marker={"symbol": ["circle" if r["capable"] else "circle-open" for r in own], "size": 9},
            showlegend=False,
            row=i // 2 + 1,
            col=i % 2 + 1,
        )
    return figure.update_layout(height=420 * math.ceil(len(units) / 2), margin={"t": 40})


DRAWN: dict[type, Callable[[Any, Rig | None, Say], go.Figure]] = {
    Rig: lambda own, _, say: _space(say, own, HOME),
    Poses: _poses,
    Counts: lambda counts, _, say: _over_time([(counts.time_s, counts.channels, counts.recorded)], say("demo_page.counts"), say),
    Lengths: lambda lengths, _, say: _over_time(
        [(lengths.time_s, lengths.cables, lengths.change_mm)], f"change of length, mm{'; of angles, rad' if lengths.encoders else ''}", say
    ),
    Simulated: _simulated,
    Scan: lambda scan, _, say: scans_figure((scan,), say),
    Run: lambda run, _, say: _over_time([(c.time_s, c.channels, c.recorded) for c in run.passes], say("demo_page.counts"), say),
    Calibration: lambda calibration, _, say: residuals_figure(calibration.record, calibration.rig, say),
    CalibrationRecord: lambda record, rig, say: residuals_figure(record, rig, say),
    Trajectory: _trajectory,
    xr.Dataset: lambda zone, rig, say: u95_figure(zone, say, every=True) if rig is None else space_figure(zone, rig, say),
    xr.DataArray: lambda values, _, say: quantity_figure(values, say),
    Plan: lambda plan, rig, say: _poses(plan.poses, rig, say),
    Placed: lambda placed, _, say: _space(say, placed.rig, HOME),
    Program: _program,
    Identified: _identified,
    Corrected: lambda corrected, _, say: correction.errors_figure(corrected.done, say),
    Described: lambda found, _, say: structure.space_figure(found.linkage, found.record, found.pose, say),
    Boundary: lambda found, _, say: structure.slices_figure(found.content, found.pose, say),
    Evaluation: lambda evaluation, _, say: _characteristics([c.as_dict() for c in evaluation.characteristics], say),
    Certificate: lambda certificate, _, say: _characteristics(certificate.content["characteristics"], say),
}
"""Functions that draw each noun."""
