"""The page of an identification: what must be known first, errors before and after, by joint and in space, and the values."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go

from lmeasure.core import FloatArray, se3
from lmeasure.report import html
from lmeasure.report.text import axes, unit
from lmeasure.robots import HALF, Identified, PredictionMap
from lmeasure.text import ENGLISH, Say

ARROWS = 0.1
"""Of the measured places' extent: length at which the largest error is drawn."""
BEFORE, AFTER = "#d55e00", "#0072b2"
MOST_NAMED = 40
"""Rows with their weights; all of them are in identified.json."""


def write_robot_page(
    path: Path, found: Identified[Any], record: dict[str, Any], over: PredictionMap | None = None, *, language: str = "en"
) -> None:
    """Write a self-contained HTML page of the identification, whole or not at all."""
    say = Say(language)
    used = found.kept & found.rows.placed
    before, after = found.nominal_errors_mm()[used], found.errors_mm()[used]
    body = [html.warning(say.told(w["text"]), w["code"]) for w in record["warnings"]]
    body += _figures(record, before, after, say)
    body += _curve(record["learning_curve"], say)
    if used.any():
        body += _errors(found.rows.position[used], before, after, say, with_code=not record["learning_curve"])
        body += _by_joint(found, np.flatnonzero(used), after, say)
    if over is not None:
        body += _workspace(over, record["workspace"], say, with_code=not (record["learning_curve"] or used.any()))
    body += _weights(found, say)
    body += _worth(record["worth_freeing"], say)
    if record["unobservable"]:
        texts = "".join(f"<li>{html.kept(say.told(u['text']))}</li>" for u in record["unobservable"])
        body += [html.heading(say("What the measurements cannot tell")), f"<ul>{texts}</ul>"]
    header = (say("value"), say("result"), say("nominal"), "u", say("unit"), say("determined"))
    body += [html.heading(say("Values")), html.table(header, _rows(record["parameters"], say))]
    inputs = ((Path(i["file"]).name, i["sha256"]) for i in record["inputs"])
    body += [html.heading(say("Inputs")), html.table((say("file"), "SHA-256"), inputs, "text hashes")]
    html.write_page(path, say("Identification of robot {robot}", robot=record["robot"]), body, language)


def _figures(record: dict[str, Any], before: FloatArray, after: FloatArray, say: Say) -> list[str]:
    robots = ((say("nominal robot"), before), (say("identified robot"), after))
    rows = [(name, *_mean_and_worst(errors, say)) for name, errors in robots if len(errors)]
    held = record["held_out"]
    if held is not None:
        whose = say("identified robot, at rows held out")
        rows.append((whose, say.number(held["mean_mm"], ".4f"), say.number(held["max_mm"], ".4f")))
    parts = [html.table((say("errors, mm"), say("mean"), say("worst")), rows)]
    used = sum(row["used"] for row in record["residuals"])
    told = say(
        "{rows} rows at {stays} stays of the robot. What the robot adds at a stay counts once, however many rows the stay has.",
        rows=used,
        stays=record["stays"],
    )
    parts.append(html.paragraph(told))
    noise = record["noise"]["position_mm"]
    if noise is None:
        parts.append(html.paragraph(say("The measurements are too few to tell by how much robot and instrument scatter.")))
    else:
        told = say(
            "Robot and instrument scatter by {mm:.4f} mm, one standard deviation of each coordinate, beyond what is stated of the "
            "instrument.",
            mm=noise,
        )
        parts.append(html.paragraph(told))
    reading = record["noise"]["reading_mm"]
    if reading is not None:
        told = say("One reading scatters by {mm:.4f} mm in each coordinate about the mean of its stay (standard deviation).", mm=reading)
        parts.append(html.paragraph(told))
    if record["beyond"]["factor"]:
        told = say(
            "Far from the measured joint values U95 grows faster: parts of the measurements predict each other worse than their "
            "covariance says (factor {factor:.1f}).",
            factor=record["beyond"]["factor"],
        )
        parts.append(html.paragraph(told))
    if held is not None:
        percent = 100 * held["within_u95"]
        parts.append(html.paragraph(say("{percent:.1f} % of the rows held out lie within the U95 predicted for them.", percent=percent)))
    return parts


def _mean_and_worst(errors: FloatArray, say: Say) -> tuple[str, str]:
    size = np.linalg.norm(errors, axis=1)
    return say.number(float(size.mean()), ".4f"), say.number(float(size.max()), ".4f")


def _curve(curve: Sequence[dict[str, Any]], say: Say) -> list[str]:
    if not curve:
        return []
    n = [c["poses"] for c in curve]
    figure = go.Figure()
    for key, name in (("mean_mm", say("median of random sets")), ("least_mm", say("best set")), ("largest_mm", say("worst set"))):
        figure.add_scatter(x=n, y=[c[key] for c in curve], mode="lines+markers", name=name)
    # the very numbers that were tried: between them a scale of logarithms has ticks that crowd
    ticks = {"tickmode": "array", "tickvals": n, "ticktext": [str(v) for v in n]}
    figure.update_layout(xaxis={"type": "log", "title": say("poses"), **ticks}, yaxis={"title": say("mean error at poses left out, mm")})
    figure.update_layout(height=420)
    # the first figure of the page brings plotly along
    return [html.heading(say("Error against number of poses")), html.figure(figure, "curve", first=True, language=say.language)]


def errors_figure(places: FloatArray, before: FloatArray, after: FloatArray, say: Say = ENGLISH) -> tuple[go.Figure, float]:
    """Errors (n, 3) [mm] of the nominal and the identified robot at places (n, 3), and how many times they are enlarged."""
    space = go.Figure()
    extent = float(np.ptp(places, axis=0).max())
    size = ARROWS * extent / max(float(np.linalg.norm(before, axis=1).max()), 1e-9)
    for errors, name, colour in ((before, say("nominal"), BEFORE), (after, say("identified"), AFTER)):
        ends = places + size * errors
        line = np.stack([places, ends, np.full_like(places, np.nan)], axis=1).reshape(-1, 3)
        space.add_scatter3d(x=line[:, 0], y=line[:, 1], z=line[:, 2], mode="lines", name=name, line={"color": colour, "width": 4})
    space.update_layout(scene=axes(say), height=640, margin={"t": 10, "b": 10})
    return space, size


def _errors(places: FloatArray, before: FloatArray, after: FloatArray, say: Say, *, with_code: bool) -> list[str]:
    space, size = errors_figure(places, before, after, say)
    spread = go.Figure()
    for errors, name, colour in ((before, say("nominal"), BEFORE), (after, say("identified"), AFTER)):
        spread.add_histogram(x=np.linalg.norm(errors, axis=1), name=name, opacity=0.6, marker_color=colour, bingroup="errors")
    spread.update_layout(barmode="overlay", xaxis_title=say("error, mm"), yaxis_title=say("rows"), height=420)
    return [
        html.heading(say("Errors in space")),
        html.paragraph(say("Measured less predicted places, {times:.3g} times enlarged, before and after.", times=size)),
        html.figure(space, "space", first=with_code, language=say.language),
        html.heading(say("Histogram")),
        html.figure(spread, "spread", first=False, language=say.language),
    ]


def _by_joint(found: Identified[Any], rows: Any, after: FloatArray, say: Say) -> list[str]:
    """Residuals across each joint's own direction of motion, against its value: what a joint does wrong shows as a wave."""
    of = found.rows.of(rows)
    state = found.state
    _, by_joints, _ = state.robot.derivatives(of.joints, of.side)
    places = se3.apply(state.robot.forward(of.joints, of.side), state.targets[of.target_of, :3])
    moves = (by_joints[..., 3:] + np.cross(by_joints[..., :3], places[:, None])) @ se3.matrices(state.base).T
    figure, mean = go.Figure(), []
    for i, name in enumerate(found.nominal.joint_names):
        reach = np.linalg.norm(moves[:, i], axis=1)
        along = (after * moves[:, i]).sum(axis=1) / np.maximum(reach, 1e-9)
        value = of.joints[:, i] if found.nominal.sliding[i] else np.degrees(of.joints[:, i])
        figure.add_scatter(x=value, y=along, mode="markers", name=html.label(name), marker={"size": 4})
        mean.append((name, say.number(float(np.sqrt(np.mean(along**2))), ".4f"), f"{reach.mean():.0f}"))
    figure.update_layout(xaxis_title=say("joint value, ° or mm"), yaxis_title=say("residual along the joint's motion, mm"))
    header = (say("joint"), say("rms along its motion, mm"), say("target's distance from it, mean, mm, or 1"))
    return [
        html.heading(say("Residuals against joint values")),
        html.paragraph(say("The part of each residual along the way on which the joint moves the target.")),
        html.figure(figure, "joints", first=False, language=say.language),
        html.table(header, mean),
    ]


def _weights(found: Identified[Any], say: Say) -> list[str]:
    """How the weights of all rows spread, and rows that count for less than half, those that count least first."""
    if found.settings.weights != "biweight":
        return []
    weight, errors = found.weight, np.linalg.norm(found.errors_mm(), axis=1)
    few = np.flatnonzero(weight < HALF)
    few = few[np.argsort(weight[few], kind="stable")][:MOST_NAMED]
    figure = go.Figure(go.Histogram(x=weight, xbins={"start": 0.0, "end": 1.05, "size": 0.05}, marker_color=AFTER))
    figure.update_layout(xaxis_title=say("weight"), yaxis_title=say("rows"), height=320)
    about = say(
        "{rows:.1f} of {all} rows: each counts by Tukey's biweight of what all others say of it.", rows=weight.sum(), all=len(weight)
    )
    parts = [
        html.heading(say("Weights of rows")),
        html.paragraph(about),
        html.figure(figure, "weights", first=False, language=say.language),
    ]
    if not len(few):
        return parts
    rows = [
        (found.rows.names[i], say.number(weight[i], ".2g"), "" if np.isnan(errors[i]) else say.number(errors[i], ".4f"))
        for i in few.tolist()
    ]
    return [*parts, html.table((say("row"), say("weight"), say("off, mm")), rows)]


def _workspace(over: PredictionMap, told: dict[str, Any], say: Say, *, with_code: bool) -> list[str]:
    """How exactly the robot is predicted over its reach: in figures, as a map of distance from its first axis and height, and in space."""
    figures = (
        (say("median"), told["median_u95_mm"]),
        (say("95 % of the poses below"), told["quantile_95_u95_mm"]),
        (say("worst pose"), told["largest_u95_mm"]),
        (say("median at the measured poses"), told["measured_u95_mm"]),
    )
    worst = ", ".join(f"{name} {say.number(value, '.1f')}" for name, value in told["worst_pose"].items())
    bar: dict[str, Any] = {"title": {"text": say("U95, mm"), "side": "top"}} | html.BAR
    hover = f"%{{x:.0f}}, %{{y:.0f}}: %{{z:.3f}} {say('mm')}<extra></extra>"
    flat = go.Figure(go.Heatmap(**_flat_map(over), colorbar=bar | {"y": -0.25}, colorscale="Viridis", hovertemplate=hover))
    flat.update_layout(xaxis_title=say("distance from the base's z axis, mm"), yaxis_title=say("height, mm"), height=600)
    flat.update_layout(xaxis_constrain="domain", yaxis_scaleanchor="x", yaxis_constrain="domain", margin={"b": 110})
    marker = {"color": over.median_mm, "size": 7, "symbol": "square", "opacity": 0.6, "colorbar": bar, "colorscale": "Viridis"}
    space = go.Figure(go.Scatter3d(x=over.cells[:, 0], y=over.cells[:, 1], z=over.cells[:, 2], mode="markers", marker=marker, name="U95"))
    space.update_layout(scene=axes(say), height=640, margin={"t": 10})
    about = say(
        "{poses} poses spread evenly over what its joint limits allow. U95: radius that holds 95 % of where the target is from where it is "
        "predicted, by the identification and the robot itself, without the instrument. Worst at {worst}.",
        poses=told["poses"],
        worst=worst,
    )
    rows = ((name, say.number(value, ".4f")) for name, value in figures)
    return [
        html.heading(say("Predicted accuracy over the workspace")),
        html.table((say("U95 of the target's place"), say("mm")), rows),
        html.paragraph(about),
        html.paragraph(say("Mean over all directions about the base, by distance and height:")),
        html.figure(flat, "reach", first=with_code, language=say.language),
        html.paragraph(say("Median in cubes of {mm:.0f} mm, as in workspace.csv:", mm=over.edge_mm)),
        html.figure(space, "cubes", first=False, language=say.language),
    ]


def _flat_map(over: PredictionMap) -> dict[str, FloatArray]:
    """Mean u95 over squares of distance from the base's z axis and height, NaN where no pose lies, with their middles."""
    across, height = np.hypot(over.places[:, 0], over.places[:, 1]), over.places[:, 2]
    edge = over.edge_mm / 3.0
    ends = [edge * np.arange(np.floor(v.min() / edge), np.floor(v.max() / edge) + 2.0) for v in (across, height)]
    total, count = (np.histogram2d(across, height, ends, weights=w)[0] for w in (over.u95_mm, None))
    x, y = (0.5 * (e[1:] + e[:-1]) for e in ends)
    return {"x": x, "y": y, "z": np.where(count > 0, total / np.maximum(count, 1.0), np.nan).T}


def _worth(worth: Sequence[dict[str, Any]], say: Say) -> list[str]:
    if not worth:
        return []
    number = say.number
    rows = [
        (
            say.told(w["family"]),
            _yes(w["freed"], say),
            w["parameters"],
            number(w["drop"], ".4g"),
            number(w["chance"], ".2g"),
            number(w["bic"], "+.4g"),
            _yes(w["bic"] < 0.0, say),
        )
        for w in worth
    ]
    head = (
        say("family"),
        say("freed"),
        say("directions determined"),
        say("chi-squared it explains"),
        say("by chance"),
        say("change of Schwarz's criterion"),
        say("worth freeing"),
    )
    return [html.heading(say("Which parameters are worth freeing")), html.table(head, rows)]


def _yes(so: bool, say: Say) -> str:
    return say("yes") if so else say("no")


def _rows(parameters: Sequence[dict[str, Any]], say: Say) -> list[tuple[str, ...]]:
    number = say.number
    return [
        (
            p["name"],
            number(p["value"], ".4f"),
            "" if p["nominal"] is None else number(p["nominal"], ".4f"),
            number(p["u"], ".3g"),
            unit(say.language, p["unit"]),
            _yes(p["determined"], say),
        )
        for p in parameters
    ]
