"""The page of a structure: drawn, in space with its assemblies, tetrahedra and screws, along a way, and the workspace's boundary."""

from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from lmeasure import se3
from lmeasure.arrays import FloatArray
from lmeasure.kernels.cable import wrap_geometry
from lmeasure.lcoordinate.singularity import rim_mm
from lmeasure.lcoordinate.structures import LINKS, incidence, parse, structures
from lmeasure.linkage.links import Linkage
from lmeasure.linkage.words import told
from lmeasure.report import html
from lmeasure.report.structure_drawing import svg

BASE_INK, PLATFORM_INK, LINK_INK, SCREW, GRADIENT = "#1f2933", "#1d4ed8", "#c2410c", "#7c3aed", "#15803d"
TETRAHEDRA = ("#f59e0b", "#10b981", "#ec4899", "#6366f1")
CARD = 'style="display:inline-block;vertical-align:top;width:200px;margin:0 0 1rem 0;font-size:.8rem;text-align:center"'
FACES = ((0, 0, 0, 1), (1, 1, 2, 2), (2, 3, 3, 3))


def write_structure_page(path: Path, name: str, linkage: Linkage, record: dict[str, Any], *, pose: FloatArray | None) -> None:
    """Write a self-contained page of links and their record (`linkage.record.described`); pose (7,) at which they were looked at."""
    scripts: Any = True
    body = [html.paragraph(line.strip(), "warning" if line.startswith(("warning", "singular")) else "") for line in _head(record)]
    if len(linkage.base) == LINKS:
        body.append(svg(incidence(linkage.base, linkage.platform).structure))
        body.append(html.paragraph("Platform above, base below; a dot is larger where more links meet."))
    figures = [("In space", space_figure(linkage, record, pose), _space_words(record))]
    if "way" in record:
        figures.append(("On the way", way_figure(record["way"]), WAY_WORDS))
    if record.get("boundary", {}).get("slices"):
        figures.append(("Boundary of the workspace", slices_figure(record["boundary"], pose), SLICES_WORDS))
    for number, (title, figure, words) in enumerate(figures):
        body += [html.heading(title), html.paragraph(words)]
        body.append(html.figure(figure, f"figure{number}", first=scripts))
        scripts = False
    if record.get("assemblies"):
        body += [html.heading("Assemblies"), html.table(("", "x, mm", "y, mm", "z, mm", "quaternion x, y, z, w", "proved"), _rows(record))]
    if "rank" in record:
        body += [html.heading("At the pose"), html.table(("figure", "value"), _at_pose(record))]
    if "design" in record:
        made = record["design"]
        rows = [(n, *(f"{v:.4f}" for v in made["given"][n]), *(f"{v:.4f}" for v in made["free"][n])) for n in made["given"]]
        body += [html.heading("Lengths within which nothing is singular")]
        body.append(html.table(("link", "given from, mm", "to, mm", "free from, mm", "to, mm"), rows))
    body += [
        html.heading("The links"),
        html.table(("link", "from", "x, mm", "y, mm", "z, mm", "to", "x, mm", "y, mm", "z, mm"), _links(linkage)),
    ]
    html.write_page(path, f"Structure of {name}", body)


WAY_WORDS = (
    "The determinant, whose size depends on units, above; below what a user can judge by: how far the platform's rim moves by lengths that "
    "are off by 1 mm together, and the largest pressure angle. Dotted lines are singular poses."
)
SLICES_WORDS = (
    "The boundary at each level, coloured by the limit that is met there; the dot is the pose. Point at a line to read its level."
)


def _head(record: dict[str, Any]) -> list[str]:
    return [line for line in told(record) if not line.startswith(("  (", "  link", "gradient", "pressure"))]


def _space_words(record: dict[str, Any]) -> str:
    words = "Drag to turn, scroll to come nearer, click in the legend to show and hide. Black is the base, blue the platform."
    if record.get("assemblies"):
        words += " The buttons show one assembly after the other."
    if record.get("closed_form"):
        words += " Coloured bodies are the tetrahedra by which the assemblies are found."
    if "rank" in record:
        words += " Violet is the axis of the screw that the lengths see least, green that of the determinant's gradient."
    return words


def _rows(record: dict[str, Any]) -> list[tuple[str, ...]]:
    out = []
    for i, one in enumerate(record["assemblies"], 1):
        turn = ", ".join(f"{v:.6f}" for v in one["quaternion_xyzw"])
        out.append((str(i), *(f"{v:.4f}" for v in one["position_mm"]), turn, "yes" if one["certified"] else "no"))
    return out


def _at_pose(record: dict[str, Any]) -> list[tuple[str, str]]:
    rows = [
        ("determinant, mm³", _figure(record["determinant"])),
        ("rank", str(record["rank"])),
        ("condition", _figure(record["condition"])),
    ]
    rows.append(("rim by lengths off by 1 mm together, mm", _figure(record["mm_per_mm"])))
    rows.append(("U95 of the position, each length uncertain by 1 mm, mm", _figure(record["u95_mm_per_mm"])))
    if "wrapped" in record:
        rows.append(("U95 of the position by counts of ±1/2, mm", _figure(record["wrapped"]["u95_position_mm"])))
    rows.append(("pressure angles, °", ", ".join(f"{v:.1f}" for v in record["pressure_angles_deg"])))
    if record["gradient"] is not None:
        rows.append(("gradient (ω; v)", ", ".join(f"{v:.4g}" for v in record["gradient"])))
    screw = record["least_seen_screw"]
    axis = (
        f"axis through ({', '.join(f'{v:.4g}' for v in screw['point_mm'])}) mm along ({', '.join(f'{v:.3f}' for v in screw['direction'])})"
    )
    pitch = "a shift" if screw["pitch_mm"] is None else f"{screw['pitch_mm']:.4g} mm per turn"
    rows.append(("screw seen least", f"{axis}, {pitch}, {screw['mm_per_mm']:.3g} mm per mm"))
    return rows


def _figure(value: float | None) -> str:
    return "none" if value is None else f"{value:.5g}"


def _links(linkage: Linkage) -> list[tuple[str, ...]]:
    each = zip(linkage.names, linkage.base, linkage.platform, strict=True)
    return [(name, b, *(f"{v:g}" for v in at), p, *(f"{v:g}" for v in of)) for (name, b, p), at, of in each]


def space_figure(linkage: Linkage, record: dict[str, Any], pose: FloatArray | None) -> go.Figure:
    """Base, platform and links at the pose and at every assembly, with tetrahedra, screws and boundary slices where they are known."""
    figure = go.Figure()
    figure.add_trace(_outline(linkage.base, BASE_INK, "base", [name for _, name, _ in linkage.names]))
    fixed = 1
    shown: list[tuple[str, FloatArray]] = [("pose", pose)] if pose is not None else []
    for i, one in enumerate(record.get("assemblies", []), 1):
        shown.append((f"assembly {i}", np.array([*one["position_mm"], *one["quaternion_xyzw"]])))
    if not shown:
        figure.update_layout(title="The base alone: with --position-mm or lengths the platform is drawn too", title_font_size=13)
    groups = []
    for n, (name, at) in enumerate(shown):
        traces = _platform(linkage, at, name) + _tetrahedra(linkage, at)
        if name == "pose" and "rank" in record:
            traces += _screws(linkage, record, at)
        as_first = [trace.visible or True for trace in traces]
        for trace, visible_first in zip(traces, as_first, strict=True):
            trace.visible = visible_first if n == 0 else False
            figure.add_trace(trace)
        groups.append((name, as_first))
    for piece in record.get("boundary", {}).get("slices", []):
        x, y, z = _closed(piece).T
        figure.add_scatter3d(x=x, y=y, z=z, mode="lines", line={"width": 4, "color": GRADIENT}, name=f"boundary, {piece['level_mm']:g} mm")
    after = len(record.get("boundary", {}).get("slices", []))
    buttons = []
    for n, (name, _) in enumerate(groups):
        visible: list[Any] = [True] * fixed
        for k, (_, as_first) in enumerate(groups):
            visible += as_first if k == n else [False] * len(as_first)
        buttons.append({"label": name, "method": "restyle", "args": [{"visible": visible + [True] * after}]})
    if len(buttons) > 1:
        figure.update_layout(updatemenus=[{"buttons": buttons, "x": 0.0, "y": 1.08, "xanchor": "left", "showactive": True}])
    scene = {"xaxis_title": "X, mm", "yaxis_title": "Y, mm", "zaxis_title": "Z, mm", "aspectmode": "data"}
    return figure.update_layout(height=640, margin={"t": 40, "b": 10, "l": 0, "r": 0}, scene=scene, legend={"x": 1.0, "y": 1.0})


def _closed(piece: dict[str, Any]) -> FloatArray:
    places = np.array(piece["places_mm"])
    return np.vstack([places, places[:1]]) if piece["closed"] else places


def _outline(points: FloatArray, ink: str, title: str, names: list[str]) -> go.Scatter3d:
    """A body's points, each once, in order around their middle, with their names."""
    unique: dict[tuple[float, ...], list[str]] = {}
    for point, name in zip(points, names, strict=True):
        unique.setdefault(tuple(point), []).append(name)
    places = np.array(list(unique))
    texts = [html.text(", ".join(dict.fromkeys(n))) for n in unique.values()]
    centred = places - places.mean(axis=0)
    axes = np.linalg.svd(centred)[2]
    order = np.argsort(np.arctan2(centred @ axes[1], centred @ axes[0]))
    order = np.append(order, order[0])
    x, y, z = places[order].T
    return go.Scatter3d(
        x=x, y=y, z=z, mode="lines+markers+text", text=[*(texts[i] for i in order[:-1]), ""], name=title, textfont={"color": ink},
        line={"width": 5, "color": ink}, marker={"size": 4, "color": ink},
    )  # fmt: skip


def _platform(linkage: Linkage, pose: FloatArray, name: str) -> list[Any]:
    points = se3.apply(pose, linkage.platform)
    starts = linkage.base
    if linkage.wrapped is not None:
        starts = wrap_geometry(np.ascontiguousarray(linkage.wrapped), pose[None])[1][0]
    ways = np.full((len(points), 4, 3), np.nan)
    ways[:, 0], ways[:, 1], ways[:, 2] = linkage.base, starts, points
    x, y, z = ways.reshape(-1, 3).T
    links = go.Scatter3d(x=x, y=y, z=z, mode="lines", line={"width": 4, "color": LINK_INK}, name="links", hoverinfo="skip")
    return [_outline(points, PLATFORM_INK, f"platform, {name}", [p for _, _, p in linkage.names]), links]


def _tetrahedra(linkage: Linkage, pose: FloatArray) -> list[Any]:
    """The tetrahedra of the closed form, hidden until the legend is clicked."""
    if len(linkage.base) != LINKS:
        return []
    found = incidence(linkage.base, linkage.platform)
    place: dict[tuple[str, int], FloatArray] = {}
    for number, (p, b) in zip(found.order, found.structure.links, strict=True):
        place["P", p], place["B", b] = se3.apply(pose, linkage.platform[number]), linkage.base[number]
    out = []
    for n, (side, i, corners) in enumerate(found.structure.placements or (), 1):
        points = np.array([place[side, i], *(place[c] for c in corners)])
        x, y, z = points.T
        i_, j_, k_ = FACES
        mesh = go.Mesh3d(
            x=x, y=y, z=z, i=i_, j=j_, k=k_, opacity=0.35, color=TETRAHEDRA[(n - 1) % len(TETRAHEDRA)], name=f"tetrahedron {n}",
            showlegend=True,
        )  # fmt: skip
        mesh.visible = "legendonly"
        out.append(mesh)
    return out


def _screws(linkage: Linkage, record: dict[str, Any], pose: FloatArray) -> list[Any]:
    """Axes of the screw that is seen least, and of the determinant's gradient."""
    size = 1.5 * rim_mm(linkage.platform)
    screw = record["least_seen_screw"]
    out = [_axis(np.array(screw["point_mm"]), np.array(screw["direction"]), pose[:3], size, SCREW, "screw seen least")]
    if record["gradient"] is not None and np.any(record["gradient"]):
        omega, v = np.split(np.array(record["gradient"]), 2)
        turn = float(np.linalg.norm(omega))
        shift = turn * size <= 1e-6 * float(np.linalg.norm(v))
        direction = v / np.linalg.norm(v) if shift else omega / turn
        point = pose[:3] if shift else np.cross(omega, v) / turn**2
        out.append(_axis(point, direction, pose[:3], size, GRADIENT, "gradient of the determinant"))
    return out


def _axis(point: FloatArray, direction: FloatArray, near: FloatArray, size: float, ink: str, name: str) -> Any:
    """A piece of an axis beside a place, or a piece through the place where the axis is far away."""
    foot = point + direction * float((near - point) @ direction)
    if float(np.linalg.norm(foot - near)) > 10.0 * size:
        foot, name = near, f"{name} (its axis is far away)"
    x, y, z = np.array([foot - size * direction, foot + size * direction]).T
    return go.Scatter3d(x=x, y=y, z=z, mode="lines", line={"width": 6, "color": ink, "dash": "dash"}, name=name)


def way_figure(way: dict[str, Any]) -> go.Figure:
    """Determinant, motion of the rim and pressure angle along a way."""
    figure = make_subplots(3, 1, shared_xaxes=True, vertical_spacing=0.05)
    percent = [100.0 * share for share in way["share"]]
    rows = (
        ("determinant", "determinant, mm³", False),
        ("mm_per_mm", "rim, mm per mm", True),
        ("worst_pressure_angle_deg", "angle, °", False),
    )
    for row, (key, title, log) in enumerate(rows, 1):
        figure.add_scatter(x=percent, y=way[key], mode="lines", line={"color": PLATFORM_INK}, showlegend=False, row=row, col=1)
        figure.update_yaxes(title_text=title, type="log" if log else "linear", row=row, col=1)
        for share in way["singular_at_share"]:
            figure.add_vline(x=100.0 * share, line={"dash": "dot", "color": LINK_INK}, row=row, col=1)
    figure.update_xaxes(title_text="of the way, %", row=3, col=1)
    return figure.update_layout(height=620, margin={"t": 20})


def slices_figure(workspace: dict[str, Any], pose: FloatArray | None) -> go.Figure:
    """The boundaries of all levels in their plane, and the pose (7,)."""
    a, b = ("xyz".index(axis) for axis in workspace["plane"])
    palette = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
    met = list(dict.fromkeys(limit for piece in workspace["slices"] for limit in piece["limits"]))
    figure = go.Figure()
    told_of: set[str] = set()
    for piece in workspace["slices"]:
        places = _closed(piece)
        limits = piece["limits"] + (piece["limits"][:1] if piece["closed"] else [])
        for limit in dict.fromkeys(piece["limits"]):
            keep = np.array([x == limit for x in limits])
            reach = keep | np.append(False, keep[:-1])
            x, y = np.where(reach, places[:, a], np.nan), np.where(reach, places[:, b], np.nan)
            label = f"{piece['level_mm']:g} mm, {'closed' if piece['closed'] else 'open'}: {limit}"
            figure.add_scatter(
                x=x, y=y, mode="lines", line={"color": palette[met.index(limit) % len(palette)]}, name=html.text(limit),
                text=[label] * len(x),
                hovertemplate="%{x:.2f}, %{y:.2f} mm<br>%{text}<extra></extra>", legendgroup=limit, showlegend=limit not in told_of,
            )  # fmt: skip
            told_of.add(limit)
    if pose is not None:
        figure.add_scatter(x=[pose[a]], y=[pose[b]], mode="markers", marker={"color": BASE_INK, "size": 9}, name="pose")
    figure.update_xaxes(title_text=f"{'XYZ'[a]}, mm", scaleanchor="y", constrain="domain")
    figure.update_yaxes(title_text=f"{'XYZ'[b]}, mm", constrain="domain")
    return figure.update_layout(height=620, margin={"t": 20})


def write_list_page(path: Path, every: list[dict[str, Any]]) -> None:
    """Write a page with drawings of all structures of six links."""
    cards, classes = [], {one["class"] for one in every}
    for one in every:
        (structure,) = parse(one["notation"])
        how = "determines no pose" if one["degenerate"] else "closed form" if one["closed_form"] else "homotopy"
        title, words = one["notation"].split(":")
        cards.append(
            f"<div {CARD}>{svg(structure)}<br><b>{title}</b><br>{words}<br>{one['koliskor']}: {one['complex_assemblies']}, {how}</div>"
        )
    body = [
        html.paragraph(
            f"{len(structures())} structures of six links, platform and base told apart, in {len(classes)} classes by how many links meet "
            "in each point, platform first. Platform above, base below; under each drawing the base points of each platform point, "
            "Koliskor's notation and the number of complex assemblies: a platform of it has no more real poses with given lengths."
        ),
        *cards,
    ]
    html.write_page(path, "Structures of six links", body)
