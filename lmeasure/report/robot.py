"""The page of an identification: what must be known first, errors before and after, by joint and in space, and the values."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go

from lmeasure import se3
from lmeasure.arrays import FloatArray
from lmeasure.report import html
from lmeasure.robots.identify import Identified
from lmeasure.robots.workspace import Workspace

ARROWS = 0.1
"""Of the measured places' extent: length at which the largest error is drawn."""


def write_robot_page(path: Path, found: Identified[Any], record: dict[str, Any], over: Workspace | None = None) -> None:
    """Write a self-contained HTML page of the identification, whole or not at all."""
    used = found.kept & found.rows.placed
    before, after = found.nominal_errors_mm()[used], found.errors_mm()[used]
    body = [html.paragraph(f"{w['code']}: {w['text']}", "warning") for w in record["warnings"]]
    body += _figures(record, before, after)
    body += _curve(record["learning_curve"])
    if used.any():
        body += _errors(found.rows.position[used], before, after, with_code=not record["learning_curve"])
        body += _by_joint(found, np.flatnonzero(used), after)
    if over is not None:
        body += _workspace(over, record["workspace"], with_code=not (record["learning_curve"] or used.any()))
    body += _worth(record["worth_freeing"])
    if record["unobservable"]:
        texts = "".join(f"<li>{html.text(u['text'])}</li>" for u in record["unobservable"])
        body += [html.heading("What the measurements cannot tell"), f"<ul>{texts}</ul>"]
    body += [html.heading("Values"), html.table(("value", "result", "nominal", "u", "unit", "determined"), _rows(record["parameters"]))]
    body += [html.heading("Inputs"), html.table(("file", "SHA-256"), ((i["file"], i["sha256"]) for i in record["inputs"]))]
    html.write_page(path, f"Identification of robot {record['robot']}", body)


def _figures(record: dict[str, Any], before: FloatArray, after: FloatArray) -> list[str]:
    rows = [(said, *_mean_and_worst(errors)) for said, errors in (("nominal robot", before), ("identified robot", after)) if len(errors)]
    held = record["held_out"]
    if held is not None:
        rows.append(("identified robot, at rows held out", f"{held['mean_mm']:.4f}", f"{held['max_mm']:.4f}"))
    parts = [html.table(("errors [mm]", "mean", "worst"), rows)]
    noise = record["noise"]["position_mm"]
    told = "The measurements are too few to tell by how much robot and instrument scatter."
    if noise is not None:
        told = f"Robot and instrument scatter by {noise:.4f} mm, one standard deviation of each coordinate, beyond what is stated of the "
        told += "instrument."
    parts.append(html.paragraph(told))
    if held is not None:
        parts.append(
            html.paragraph(f"{100 * held['within_u95']:.1f} % of the rows held out lie within the u95 that was predicted for them.")
        )
    return parts


def _mean_and_worst(errors: FloatArray) -> tuple[str, str]:
    size = np.linalg.norm(errors, axis=1)
    return f"{size.mean():.4f}", f"{size.max():.4f}"


def _curve(curve: Sequence[dict[str, Any]]) -> list[str]:
    if not curve:
        return []
    n = [c["rows"] for c in curve]
    figure = go.Figure()
    for key, name in (("mean_mm", "median of random sets"), ("least_mm", "best set"), ("largest_mm", "worst set")):
        figure.add_scatter(x=n, y=[c[key] for c in curve], mode="lines+markers", name=name)
    figure.update_layout(xaxis_title="rows", yaxis_title="mean error at rows left out [mm]", xaxis_type="log")
    # the first figure of the page brings plotly along
    return [html.heading("Error against number of rows"), html.figure(figure, first=True)]


def errors_figure(places: FloatArray, before: FloatArray, after: FloatArray) -> tuple[go.Figure, float]:
    """Errors (n, 3) [mm] of the nominal and the identified robot at places (n, 3), and how many times they are enlarged."""
    space = go.Figure()
    extent = float(np.ptp(places, axis=0).max())
    size = ARROWS * extent / max(float(np.linalg.norm(before, axis=1).max()), 1e-9)
    for errors, name in ((before, "nominal"), (after, "identified")):
        ends = places + size * errors
        line = np.stack([places, ends, np.full_like(places, np.nan)], axis=1).reshape(-1, 3)
        space.add_scatter3d(x=line[:, 0], y=line[:, 1], z=line[:, 2], mode="lines", name=name)
    scene = {"aspectmode": "data", "xaxis_title": "x [mm]", "yaxis_title": "y [mm]", "zaxis_title": "z [mm]"}
    space.update_layout(scene=scene, height=640, margin={"t": 10, "b": 10})
    return space, size


def _errors(places: FloatArray, before: FloatArray, after: FloatArray, *, with_code: bool) -> list[str]:
    space, size = errors_figure(places, before, after)
    spread = go.Figure()
    for errors, name in ((before, "nominal"), (after, "identified")):
        spread.add_histogram(x=np.linalg.norm(errors, axis=1), name=name, opacity=0.6)
    spread.update_layout(barmode="overlay", xaxis_title="error [mm]", yaxis_title="rows")
    return [
        html.heading("Errors in space"),
        html.paragraph(f"Measured less predicted places, {size:.3g} times enlarged, before and after."),
        html.figure(space, first=with_code),
        html.heading("Histogram"),
        html.figure(spread, first=False),
    ]


def _by_joint(found: Identified[Any], rows: Any, after: FloatArray) -> list[str]:
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
        figure.add_scatter(x=value, y=along, mode="markers", name=html.text(name), marker={"size": 4})
        mean.append((name, f"{np.sqrt(np.mean(along**2)):.4f}", f"{reach.mean():.0f}"))
    figure.update_layout(xaxis_title="joint value [deg or mm]", yaxis_title="residual along the joint's motion [mm]")
    return [
        html.heading("Residuals against joint values"),
        html.paragraph("The part of each residual along the way on which the joint moves the target."),
        html.figure(figure, first=False),
        html.table(("joint", "rms along its motion [mm]", "target's distance from it, mean [mm, or 1]"), mean),
    ]


def _workspace(over: Workspace, told: dict[str, Any], *, with_code: bool) -> list[str]:
    """How exactly the robot is predicted over its reach: in figures, as a map of distance from its first axis and height, and in space."""
    figures = (
        ("median", told["median_u95_mm"]),
        ("95 % of the poses below", told["quantile_95_u95_mm"]),
        ("worst", told["largest_u95_mm"]),
        ("median at the measured poses", told["measured_u95_mm"]),
    )
    worst = ", ".join(f"{name} {value:.1f}" for name, value in told["worst_pose"].items())
    colours = {"colorbar": {"title": "u95 [mm]"}, "colorscale": "Viridis"}
    flat = go.Figure(go.Heatmap(**_flat_map(over), **colours, hovertemplate="%{x:.0f}, %{y:.0f}: %{z:.3f} mm<extra></extra>"))
    flat.update_layout(xaxis_title="distance from the base's z axis [mm]", yaxis_title="z [mm, robot's base]", height=560)
    flat.update_layout(xaxis_constrain="domain", yaxis_scaleanchor="x", yaxis_constrain="domain")
    marker = {"color": over.median_mm, "size": 7, "symbol": "square", "opacity": 0.6, **colours}
    space = go.Figure(go.Scatter3d(x=over.cells[:, 0], y=over.cells[:, 1], z=over.cells[:, 2], mode="markers", marker=marker, name="u95"))
    scene = {"aspectmode": "data", "xaxis_title": "x [mm]", "yaxis_title": "y [mm]", "zaxis_title": "z [mm]"}
    space.update_layout(scene=scene, height=640, margin={"t": 10, "b": 10})
    about = (
        f"{told['poses']} poses spread evenly over what its joint limits allow. u95: radius that holds 95 % of where the target "
        "is from where it is predicted, by the identification and the robot itself, without the instrument. "
    )
    return [
        html.heading("Predicted accuracy over the workspace"),
        html.table(("u95 of the target's place", "mm"), ((name, f"{value:.4f}") for name, value in figures)),
        html.paragraph(f"{about}Worst at {worst}."),
        html.paragraph("Mean over all directions about the base, by distance and height:"),
        html.figure(flat, first=with_code),
        html.paragraph(f"Median in cubes of {over.edge_mm:.0f} mm, as in workspace.csv:"),
        html.figure(space, first=False),
    ]


def _flat_map(over: Workspace) -> dict[str, FloatArray]:
    """Mean u95 over squares of distance from the base's z axis and height, NaN where no pose lies, with their middles."""
    across, height = np.hypot(over.places[:, 0], over.places[:, 1]), over.places[:, 2]
    edge = over.edge_mm / 3.0
    ends = [edge * np.arange(np.floor(v.min() / edge), np.floor(v.max() / edge) + 2.0) for v in (across, height)]
    total, count = (np.histogram2d(across, height, ends, weights=w)[0] for w in (over.u95_mm, None))
    x, y = (0.5 * (e[1:] + e[:-1]) for e in ends)
    return {"x": x, "y": y, "z": np.where(count > 0, total / np.maximum(count, 1.0), np.nan).T}


def _worth(worth: Sequence[dict[str, Any]]) -> list[str]:
    if not worth:
        return []
    rows = [
        (
            w["family"],
            "yes" if w["freed"] else "no",
            w["parameters"],
            f"{w['drop']:.4g}",
            f"{w['chance']:.2g}",
            f"{w['bic']:+.4g}",
            _worthy(w),
        )
        for w in worth
    ]
    head = (
        "family",
        "freed",
        "directions determined",
        "chi-squared it explains",
        "by chance",
        "change of Schwarz's criterion",
        "worth freeing",
    )
    return [html.heading("Which parameters are worth freeing"), html.table(head, rows)]


def _worthy(w: dict[str, Any]) -> str:
    return "yes" if w["bic"] < 0.0 else "no"


def _rows(parameters: Sequence[dict[str, Any]]) -> list[tuple[str, ...]]:
    return [
        (
            p["name"],
            f"{p['value']:.4f}",
            "" if p["nominal"] is None else f"{p['nominal']:.4f}",
            f"{p['u']:.3g}",
            p["unit"],
            "yes" if p["determined"] else "no",
        )
        for p in parameters
    ]
