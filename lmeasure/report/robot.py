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
from lmeasure.text import ENGLISH, Say, message, texts

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
    body = [html.warning(say.message(w["text"]), w["code"]) for w in record["warnings"]]
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
        texts = "".join(f"<li>{html.kept(say.message(u['text']))}</li>" for u in record["unobservable"])
        body += [html.heading(say("robot.measurements_cannot_tell")), f"<ul>{texts}</ul>"]
    header = (say("page.value"), say("page.result"), say("robot.nominal"), "u", say("page.unit"), say("robot.determined"))
    body += [html.heading(say("page.values")), html.table(header, _rows(record["parameters"], say))]
    inputs = ((Path(i["file"]).name, i["sha256"]) for i in record["inputs"])
    body += [html.heading(say("page.inputs")), html.table((say("page.file"), "SHA-256"), inputs, "text hashes")]
    html.write_page(path, say("robot.identification_robot", robot=record["robot"]), body, language)


def _figures(record: dict[str, Any], before: FloatArray, after: FloatArray, say: Say) -> list[str]:
    robots = ((say("robot.nominal_robot"), before), (say("robot.identified_robot"), after))
    rows = [(name, *_mean_and_worst(errors, say)) for name, errors in robots if len(errors)]
    held = record["held_out"]
    if held is not None:
        whose = say("robot.identified_robot_rows_held")
        rows.append((whose, say.number(held["mean_mm"], ".4f"), say.number(held["max_mm"], ".4f")))
    parts = [html.table((say("robot.errors_mm"), say("robot.mean"), say("robot.worst")), rows)]
    used = sum(row["used"] for row in record["residuals"])
    reported = say("robot.rows_stays_robot_robot", rows=used, stays=record["stays"])
    parts.append(html.paragraph(reported))
    noise = record["noise"]["position_mm"]
    if noise is None:
        parts.append(html.paragraph(say("robot.measurements_too_few_tell")))
    else:
        reported = say("robot.robot_instrument_scatter_mm", mm=noise)
        parts.append(html.paragraph(reported))
    reading = record["noise"]["reading_mm"]
    if reading is not None:
        reported = say("robot.one_reading_scatters_mm", mm=reading)
        parts.append(html.paragraph(reported))
    if record["beyond"]["factor"]:
        reported = say("robot.far_from_measured_joint", factor=record["beyond"]["factor"])
        parts.append(html.paragraph(reported))
    if held is not None:
        percent = 100 * held["within_u95"]
        parts.append(html.paragraph(say("robot.rows_held_out_lie", percent=percent)))
    return parts


def _mean_and_worst(errors: FloatArray, say: Say) -> tuple[str, str]:
    size = np.linalg.norm(errors, axis=1)
    return say.number(float(size.mean()), ".4f"), say.number(float(size.max()), ".4f")


def _curve(curve: Sequence[dict[str, Any]], say: Say) -> list[str]:
    if not curve:
        return []
    n = [c["poses"] for c in curve]
    figure = go.Figure()
    for key, name in (
        ("mean_mm", say("robot.median_random_sets")),
        ("least_mm", say("robot.best_set")),
        ("largest_mm", say("robot.worst_set")),
    ):
        figure.add_scatter(x=n, y=[c[key] for c in curve], mode="lines+markers", name=name)
    # the very numbers that were tried: between them a scale of logarithms has ticks that crowd
    ticks = {"tickmode": "array", "tickvals": n, "ticktext": [str(v) for v in n]}
    figure.update_layout(xaxis={"type": "log", "title": say("robot.poses"), **ticks}, yaxis={"title": say("robot.mean_error_poses_left")})
    figure.update_layout(height=420)
    # the first figure of the page brings plotly along
    return [html.heading(say("robot.error_against_number_poses")), html.figure(figure, "curve", first=True, language=say.language)]


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


def _errors(places: FloatArray, before: FloatArray, after: FloatArray, say: Say, *, with_code: bool) -> list[str]:
    space, size = errors_figure(places, before, after, say)
    spread = go.Figure()
    for errors, name, colour in ((before, say("robot.nominal"), BEFORE), (after, say("robot.identified"), AFTER)):
        spread.add_histogram(x=np.linalg.norm(errors, axis=1), name=name, opacity=0.6, marker_color=colour, bingroup="errors")
    spread.update_layout(barmode="overlay", xaxis_title=say("page.error_mm"), yaxis_title=say("robot.rows"), height=420)
    return [
        html.heading(say("robot.errors_space")),
        html.paragraph(say("robot.measured_less_predicted_places", times=size)),
        html.figure(space, "space", first=with_code, language=say.language),
        html.heading(say("robot.histogram")),
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
    figure.update_layout(xaxis_title=say("robot.joint_value_mm"), yaxis_title=say("robot.residual_along_joints_motion"))
    header = (say("page.joint"), say("robot.rms_along_motion_mm"), say("robot.targets_distance_from_mean"))
    return [
        html.heading(say("robot.residuals_against_joint_values")),
        html.paragraph(say("robot.part_each_residual_along")),
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
    figure.update_layout(xaxis_title=say("page.weight"), yaxis_title=say("robot.rows"), height=320)
    about = say("robot.rows_each_counts_tukeys", rows=weight.sum(), all=len(weight))
    parts = [
        html.heading(say("robot.weights_rows")),
        html.paragraph(about),
        html.figure(figure, "weights", first=False, language=say.language),
    ]
    if not len(few):
        return parts
    rows = [
        (found.rows.names[i], say.number(weight[i], ".2g"), "" if np.isnan(errors[i]) else say.number(errors[i], ".4f"))
        for i in few.tolist()
    ]
    return [*parts, html.table((say("robot.row"), say("page.weight"), say("robot.off_mm")), rows)]


def _workspace(over: PredictionMap, reported: dict[str, Any], say: Say, *, with_code: bool) -> list[str]:
    """How exactly the robot is predicted over its reach: in figures, as a map of distance from its first axis and height, and in space."""
    figures = (
        (say("robot.median"), reported["median_u95_mm"]),
        (say("robot.95_poses_below"), reported["quantile_95_u95_mm"]),
        (say("robot.worst_pose"), reported["largest_u95_mm"]),
        (say("robot.median_measured_poses"), reported["measured_u95_mm"]),
    )
    worst = ", ".join(f"{name} {say.number(value, '.1f')}" for name, value in reported["worst_pose"].items())
    bar: dict[str, Any] = {"title": {"text": say("page.u95_mm"), "side": "top"}} | html.BAR
    hover = f"%{{x:.0f}}, %{{y:.0f}}: %{{z:.3f}} {say('page.mm')}<extra></extra>"
    flat = go.Figure(go.Heatmap(**_flat_map(over), colorbar=bar | {"y": -0.25}, colorscale="Viridis", hovertemplate=hover))
    flat.update_layout(xaxis_title=say("robot.distance_from_bases_z"), yaxis_title=say("robot.height_mm"), height=600)
    flat.update_layout(xaxis_constrain="domain", yaxis_scaleanchor="x", yaxis_constrain="domain", margin={"b": 110})
    marker = {"color": over.median_mm, "size": 7, "symbol": "square", "opacity": 0.6, "colorbar": bar, "colorscale": "Viridis"}
    space = go.Figure(go.Scatter3d(x=over.cells[:, 0], y=over.cells[:, 1], z=over.cells[:, 2], mode="markers", marker=marker, name="U95"))
    space.update_layout(scene=axes(say), height=640, margin={"t": 10})
    about = say("robot.poses_spread_evenly_over", poses=reported["poses"], worst=worst)
    rows = ((name, say.number(value, ".4f")) for name, value in figures)
    return [
        html.heading(say("robot.predicted_accuracy_over_workspace")),
        html.table((say("robot.u95_targets_place"), say("page.mm")), rows),
        html.paragraph(about),
        html.paragraph(say("robot.mean_over_all_directions")),
        html.figure(flat, "reach", first=with_code, language=say.language),
        html.paragraph(say("robot.median_cubes_mm_workspace", mm=over.edge_mm)),
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
            say.message(family_name(w["family"])),
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
        say("robot.family"),
        say("robot.freed"),
        say("robot.directions_determined"),
        say("robot.chi_squared_explains"),
        say("page.chance"),
        say("robot.change_schwarzs_criterion"),
        say("robot.worth_freeing"),
    )
    return [html.heading(say("robot.parameters_worth_freeing")), html.table(head, rows)]


def family_name(family: str) -> str:
    """Return the name of a family of parameters, a message where the catalogues have it."""
    code = f"robot.families.{family}"
    return message(code) if code in texts("en") else family


def _yes(so: bool, say: Say) -> str:
    return say("page.yes") if so else say("page.no")


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
