"""Figures of a calibration: the rig in space, residuals, determined combinations, and the uncertainty of lengths."""

from collections import Counter

import plotly.graph_objects as go

from lmeasure.calibration import Calibration
from lmeasure.report import figures, html
from lmeasure.report.text import axes
from lmeasure.report.zone_maps import ticks
from lmeasure.rig import CalibrationRecord, Rig
from lmeasure.text import ENGLISH, Say

BEFORE, AFTER = figures.PALETTE[1], figures.PALETTE[0]
"""Colours before and after, as in other pages."""
POWERS = 1e6
"""Range over which each power of ten has a mark on a telephone."""
FEW = 8
"""Most marks with names beside them on a telephone; the outer names are hidden."""


def residuals_figure(record: CalibrationRecord, rig: Rig | None, say: Say = ENGLISH) -> go.Figure:
    """Return residuals of each channel at each reference pose; the rig shows which are angles, without it the solved zeros do."""
    figure = go.Figure()
    encoders = {p.name.removesuffix(".zero_deg") for p in record.parameters if p.name.endswith(".zero_deg")}
    if rig is not None:
        encoders = {o.channel for o in rig.observed if not o.is_length}
    angles = any(r.channel in encoders for r in record.residuals)
    for channel in Counter(r.channel for r in record.residuals):
        own = [r for r in record.residuals if r.channel == channel]
        figure.add_scatter(x=[r.pose for r in own], y=[r.mm for r in own], mode="markers", name=html.label(channel))
    title = say("calibration.residual_mm_angles_mrad") if angles else say("calibration.residual_mm")
    axes_of = {"xaxis": {"title": say("calibration.reference_pose"), "type": "category"}, "yaxis": {"title": title}}
    return figure.update_layout(height=420, margin={"t": 20}, **axes_of)


def rig_figure(calibration: Calibration, say: Say = ENGLISH) -> go.Figure:
    """Observation points, reference poses, and the cables at the first pose with their tangent points."""
    campaign, rig = calibration.campaign, calibration.rig
    figure = go.Figure()
    for c, way in zip(campaign.drums, figures.cable_ways(rig.cable_rows(campaign.drums), campaign.poses.rows[0]), strict=True):
        x, y, z = way.T
        figure.add_scatter3d(x=x, y=y, z=z, mode="lines", line={"width": 4}, name=html.label(c.name))
    figures.add_points(figure, (p for p in rig.observation_point if any(c.from_point == p.name for c in campaign.drums)), say)
    x, y, z = campaign.poses.rows[:, :3].T
    names = [html.label(n) for n in campaign.poses.names]
    figure.add_scatter3d(
        x=x, y=y, z=z, mode="markers", text=names, marker={"size": 3, "color": "gray"}, name=say("calibration.reference_poses")
    )
    figure.update_layout(height=640, margin={"t": 10}, scene=axes(say))
    return figure


def worst_figure(calibration: Calibration, say: Say = ENGLISH) -> go.Figure:
    """Standard uncertainty of the worst cable's length at poses of the workspace."""
    worst = calibration.predicted.length_mm.max(axis=1)
    x, y, z = calibration.predicted.rows[:, :3].T
    unit = say("page.mm")
    marker = {
        "size": 4,
        "color": worst,
        "colorscale": "Viridis",
        "colorbar": {"title": {"text": say("calibration.u_length_mm"), "side": "top"}} | figures.BAR,
    }
    reported = f"%{{marker.color:.4f}} {unit}<br>%{{x:.0f}}, %{{y:.0f}}, %{{z:.0f}}<extra></extra>"
    figure = go.Figure(go.Scatter3d(x=x, y=y, z=z, mode="markers", marker=marker, hovertemplate=reported))
    return figure.update_layout(height=560, margin={"t": 10}, scene=axes(say))


def spectrum_figure(record: CalibrationRecord, say: Say = ENGLISH) -> go.Figure:
    """Return the uncertainty of parameter combinations after the counts, as parts of the prior."""
    figure = go.Figure()
    for point in sorted({str(d["point"]) for d in record.spectrum}):
        own = [(i, d) for i, d in enumerate(record.spectrum, 1) if d["point"] == point]
        symbols = ["circle" if d["known"] else "x" for _, d in own]
        figure.add_scatter(
            x=[i for i, _ in own],
            y=[d["left"] for _, d in own],
            mode="markers",
            name=html.label(say("calibration.frame_of_poses") if point == "frame" else point),
            marker={"symbol": symbols, "size": 8},
        )
    figure.add_hline(y=1.0, line={"dash": "dash"})
    # on a logarithmic axis an annotation is at the logarithm; the area above the line at the left is free
    at = {"x": 0.0, "xref": "paper", "xanchor": "left", "y": 0.0, "yanchor": "bottom", "showarrow": False}
    figure.add_annotation(text=say("calibration.prior_good"), **at)
    # the names take a line each on a telephone
    figure.update_layout(
        height=300 + 19 * len(figure.data), margin={"t": 20}, xaxis={"title": say("calibration.direction_best_seen_first")}
    )
    left = [float(d["left"]) for d in record.spectrum]
    # a mark for each power of ten, or every other one; room for the text above the line
    powers = 1 if max(left) / max(min(left), 1e-300) < POWERS else 2
    return figure.update_yaxes(title=say("calibration.u_left_prior_u"), type="log", dtick=powers, autorangeoptions={"include": 6.0})


def narrowed_figure(record: CalibrationRecord, say: Say = ENGLISH) -> go.Figure:
    """Return the uncertainty of values after the counts, as parts of their own prior."""
    figure = go.Figure()
    names = [html.label(p.name) for p in record.parameters]
    priors = [p.prior_u for p in record.parameters]
    line = {"symbol": "line-ns-open", "size": 9, "line": {"width": 2}}
    figure.add_scatter(y=names, x=priors, mode="markers", name=say("calibration.prior"), marker=line | {"color": BEFORE})
    figure.add_scatter(
        y=names, x=[p.u for p in record.parameters], mode="markers", name=say("calibration.calibrated"), marker={"color": AFTER}
    )
    # a row for each name, so that names never overlap
    figure.update_layout(height=110 + 18 * len(names), margin={"t": 20, "r": 10})
    every = priors + [p.u for p in record.parameters]
    marks = ticks(min(v for v in every if v > 0.0) / 3.0, 3.0 * max(every)) if any(v > 0.0 for v in every) else [1.0]
    # powers of ten, and 2 and 5 times them if these are few; some beyond the data, for the margin
    marks = [v for v in marks if f"{v:e}".startswith("1")] if len(marks) > FEW else marks
    figure.update_xaxes(title=say("calibration.u_mm_2"), type="log", tickvals=marks, ticktext=[say.number(v, ".3g") for v in marks])
    return figure.update_yaxes(autorange="reversed", dtick=1, automargin=True)
