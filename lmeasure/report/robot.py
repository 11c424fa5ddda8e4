"""Values of an identification's page: errors before and after, by joint and in space, and over the workspace."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from markupsafe import Markup

from lmeasure.core import FloatArray, se3
from lmeasure.report import figures, html
from lmeasure.report.text import axes, unit
from lmeasure.robots import HALF, Identified, PredictionMap
from lmeasure.text import ENGLISH, Say, from_stated, message, texts

ARROWS = 0.1
"""Length of the largest error's arrow, as a part of the extent of measured positions."""
BEFORE, AFTER = "#d55e00", "#0072b2"
MOST_NAMED = 40
"""Rows with their weights; all of them are in identified.json."""


def write_robot_page(
    path: Path, found: Identified[Any], record: dict[str, Any], over: PredictionMap | None = None, *, language: str = "en"
) -> None:
    """Write a self-contained HTML page of the identification, whole or not at all."""
    say, number = Say(language), Say(language).number
    used = found.kept & found.rows.placed
    before, after = found.nominal_errors_mm()[used], found.errors_mm()[used]
    plots: dict[str, Markup] = {}
    times, joints = 0.0, list[tuple[str, ...]]()
    if record["learning_curve"]:
        plots["curve"] = figures.figure(_curve(record["learning_curve"], say), "curve", language)
    if used.any():
        space, times = errors_figure(found.rows.position[used], before, after, say)
        by_joint, joints = _by_joint(found, np.flatnonzero(used), after, say)
        plots |= {"space": figures.figure(space, "space", language), "joints": figures.figure(by_joint, "joints", language)}
    if over is not None:
        flat, cubes = _workspace(over, say)
        plots |= {"reach": figures.figure(flat, "reach", language), "cubes": figures.figure(cubes, "cubes", language)}
    if found.settings.weights == "biweight":
        plots["weights"] = figures.figure(_weights(found, say), "weights", language)
    html.write_page(
        path, "robot.html", answer(path.parent.name, record, before, after, say=say), say,
        record=record, plots=plots, times=times, joints=joints, over=over,
        errors=[(name, *(number(v, ".4f") for v in values)) for name, values in _errors(record, before, after, say)],
        weights=found.weight, few=_few(found, say), families=[(say.message(family_name(w["family"])), w) for w in record["worth_freeing"]],
        parameters=[(p, unit(language, p["unit"])) for p in record["parameters"]],
        inputs=[(Path(i["file"]).name, i["sha256"]) for i in record["inputs"]],
    )  # fmt: skip


def answer(folder: str, record: dict[str, Any], before: FloatArray, after: FloatArray, *, say: Say) -> html.Answer:
    """Return the first screen: the error before and after, whether validation poses confirm it, its limits, and the next step."""
    held, stays = record["held_out"], record["stays"]
    rows = [
        html.Number(say("robot.mean_of", robot=name), say("comparison.mm", mm=mean), say("robot.mean_worst", worst=worst))
        for name, (mean, worst) in _errors(record, before, after, say)
    ]
    noise = record["noise"]["position_mm"]
    if noise is not None:
        rows.append(html.Number(say("robot.scatter"), say("comparison.mm", mm=noise), say("robot.scatter_note")))
    rows += html.assumed_numbers((from_stated(w["finding"]) for w in record["warnings"]), say)
    state, verdict = "good", say("robot.identified_verdict")
    improved = held["mean_mm"] if held is not None else float(np.linalg.norm(after, axis=1).mean()) if len(after) else math.nan
    nominal = float(np.linalg.norm(before, axis=1).mean()) if len(before) else math.nan
    if improved < nominal:
        verdict = say("robot.nearer", times=nominal / improved)
    elif improved >= nominal:
        state, verdict = "bad", say("robot.not_nearer")
    if record["unobservable"] or record["warnings"]:
        state = "warn" if state == "good" else state
        verdict += " " + say("robot.limitations", number=len(record["unobservable"]) + len(record["warnings"]))
    limits = say("robot.measurements_too_few_tell") if noise is None else say("robot.limited_scatter", mm=noise)
    if record["unobservable"]:
        limits = say("robot.limited_undetermined", number=len(record["unobservable"]))
    if record["workspace"]:
        limits += " " + say("robot.limited_workspace", mm=record["workspace"]["largest_u95_mm"])
    used = sum(row["used"] for row in record["residuals"])
    picture = figures.figure(_spread(before, after, say), "spread", say.language, hero=True) if len(before) else Markup()
    correct = html.Step(say("robot.next_correct"), f"lmeasure correct PROGRAM --identified {folder} --out corrected")
    plan = html.Step(say("robot.next_plan"), f"lmeasure plan-poses RIG.toml --robot {folder}/robot.toml --poses 20 --out more.csv")
    return html.Answer(
        say("robot.identification_robot", robot=record["robot"]), verdict, state, tuple(rows), limits,
        (plan, correct) if record["unobservable"] or state == "bad" else (correct,), picture,
        say("robot.subject", rows=used, stays=stays), say("robot.histogram_caption"),
    )  # fmt: skip


def _errors(record: dict[str, Any], before: FloatArray, after: FloatArray, say: Say) -> list[tuple[str, tuple[float, float]]]:
    """Return name, mean and worst error of the nominal and the identified robot, and of poses that took no part."""
    robots = ((say("robot.nominal_robot"), before), (say("robot.identified_robot"), after))
    sizes = [(name, np.linalg.norm(errors, axis=1)) for name, errors in robots if len(errors)]
    rows = [(name, (float(size.mean()), float(size.max()))) for name, size in sizes]
    held = record["held_out"]
    return rows if held is None else [*rows, (say("robot.identified_robot_rows_held"), (held["mean_mm"], held["max_mm"]))]


def _curve(curve: Sequence[dict[str, Any]], say: Say) -> go.Figure:
    n = [c["poses"] for c in curve]
    figure = go.Figure()
    for key, name in (("mean_mm", "robot.median_random_sets"), ("least_mm", "robot.best_set"), ("largest_mm", "robot.worst_set")):
        figure.add_scatter(x=n, y=[c[key] for c in curve], mode="lines+markers", name=say(name))
    # the very numbers that were tried: between them a scale of logarithms has ticks that crowd
    ticks = {"tickmode": "array", "tickvals": n, "ticktext": [str(v) for v in n]}
    figure.update_layout(xaxis={"type": "log", "title": say("robot.poses"), **ticks}, yaxis={"title": say("robot.mean_error_poses_left")})
    return figure.update_layout(height=420)


def errors_figure(places: FloatArray, before: FloatArray, after: FloatArray, say: Say = ENGLISH) -> tuple[go.Figure, float]:
    """Errors (n, 3) [mm] of the nominal and the identified robot at places (n, 3), and how many times they are enlarged."""
    space = go.Figure()
    extent = float(np.ptp(places, axis=0).max())
    size = ARROWS * extent / max(float(np.linalg.norm(before, axis=1).max()), 1e-9)
    for errors, name, colour in ((before, say("robot.nominal"), BEFORE), (after, say("robot.identified"), AFTER)):
        ends = places + size * errors
        line = np.stack([places, ends, np.full_like(places, np.nan)], axis=1).reshape(-1, 3)
        space.add_scatter3d(x=line[:, 0], y=line[:, 1], z=line[:, 2], mode="lines", name=name, line={"color": colour, "width": 4})
    space.update_layout(scene=axes(say), height=640, margin={"t": 10, "b": 10})
    return space, size


def _spread(before: FloatArray, after: FloatArray, say: Say) -> go.Figure:
    """Return histograms of the errors before and after."""
    spread = go.Figure()
    for errors, name, colour in ((before, say("robot.nominal"), BEFORE), (after, say("robot.identified"), AFTER)):
        spread.add_histogram(x=np.linalg.norm(errors, axis=1), name=name, opacity=0.6, marker_color=colour, bingroup="errors")
    return spread.update_layout(barmode="overlay", xaxis_title=say("page.error_mm"), yaxis_title=say("robot.rows"), height=420)


def _by_joint(found: Identified[Any], rows: Any, after: FloatArray, say: Say) -> tuple[go.Figure, list[tuple[str, ...]]]:
    """Return residuals across each joint's own direction of motion, against its value: an error of a joint shows as a wave."""
    of = found.rows.of(rows)
    state = found.state
    _, by_joints, _ = state.robot.derivatives(of.joints, of.side)
    places = se3.apply(state.robot.forward(of.joints, of.side), state.targets[of.target_of, :3])
    moves = (by_joints[..., 3:] + np.cross(by_joints[..., :3], places[:, None])) @ se3.matrices(state.base).T
    figure, mean = go.Figure(), list[tuple[str, ...]]()
    for i, name in enumerate(found.nominal.joint_names):
        reach = np.linalg.norm(moves[:, i], axis=1)
        along = (after * moves[:, i]).sum(axis=1) / np.maximum(reach, 1e-9)
        value = of.joints[:, i] if found.nominal.sliding[i] else np.degrees(of.joints[:, i])
        figure.add_scatter(x=value, y=along, mode="markers", name=html.label(name), marker={"size": 4})
        mean.append((name, say.number(float(np.sqrt(np.mean(along**2))), ".4f"), f"{reach.mean():.0f}"))
    figure.update_layout(xaxis_title=say("robot.joint_value_mm"), yaxis_title=say("robot.residual_along_joints_motion"))
    return figure, mean


def _weights(found: Identified[Any], say: Say) -> go.Figure:
    """Return how the weights of all rows spread."""
    figure = go.Figure(go.Histogram(x=found.weight, xbins={"start": 0.0, "end": 1.05, "size": 0.05}, marker_color=AFTER))
    return figure.update_layout(xaxis_title=say("page.weight"), yaxis_title=say("robot.rows"), height=320)


def _few(found: Identified[Any], say: Say) -> list[tuple[str, ...]]:
    """Return rows that count for less than half, those that count least first."""
    weight, errors = found.weight, np.linalg.norm(found.errors_mm(), axis=1)
    few = np.flatnonzero(weight < HALF)
    few = few[np.argsort(weight[few], kind="stable")][:MOST_NAMED]
    off = ["" if np.isnan(errors[i]) else say.number(errors[i], ".4f") for i in few]
    return [(found.rows.names[i], say.number(weight[i], ".2g"), error) for i, error in zip(few.tolist(), off, strict=True)]


def _workspace(over: PredictionMap, say: Say) -> tuple[go.Figure, go.Figure]:
    """Return how exactly the robot is predicted over its reach: as a map of distance from its first axis and height, and in space."""
    bar: dict[str, Any] = {"title": {"text": say("page.u95_mm"), "side": "top"}} | figures.BAR
    hover = f"%{{x:.0f}}, %{{y:.0f}}: %{{z:.3f}} {say('page.mm')}<extra></extra>"
    flat = go.Figure(go.Heatmap(**_flat_map(over), colorbar=bar | {"y": -0.25}, colorscale="Viridis", hovertemplate=hover))
    flat.update_layout(xaxis_title=say("robot.distance_from_bases_z"), yaxis_title=say("robot.height_mm"), height=600)
    flat.update_layout(xaxis_constrain="domain", yaxis_scaleanchor="x", yaxis_constrain="domain", margin={"b": 110})
    marker = {"color": over.median_mm, "size": 7, "symbol": "square", "opacity": 0.6, "colorbar": bar, "colorscale": "Viridis"}
    space = go.Figure(go.Scatter3d(x=over.cells[:, 0], y=over.cells[:, 1], z=over.cells[:, 2], mode="markers", marker=marker, name="U95"))
    return flat, space.update_layout(scene=axes(say), height=640, margin={"t": 10})


def _flat_map(over: PredictionMap) -> dict[str, FloatArray]:
    """Mean u95 over squares of distance from the base's z axis and height, NaN where no pose lies, with their middles."""
    across, height = np.hypot(over.places[:, 0], over.places[:, 1]), over.places[:, 2]
    edge = over.edge_mm / 3.0
    ends = [edge * np.arange(np.floor(v.min() / edge), np.floor(v.max() / edge) + 2.0) for v in (across, height)]
    total, count = (np.histogram2d(across, height, ends, weights=w)[0] for w in (over.u95_mm, None))
    x, y = (0.5 * (e[1:] + e[:-1]) for e in ends)
    return {"x": x, "y": y, "z": np.where(count > 0, total / np.maximum(count, 1.0), np.nan).T}


def family_name(family: str) -> str:
    """Return the name of a family of parameters, a message where the catalogues have it."""
    code = f"robot.families.{family}"
    return message(code) if code in texts("en") else family
