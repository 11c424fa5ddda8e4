"""Values of a structure's page: its figure with assemblies, tetrahedra and screws, along a path, and the workspace's boundary."""

from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from markupsafe import Markup
from plotly.subplots import make_subplots

from lmeasure.core import FloatArray, se3
from lmeasure.linkages import LINKS, incidence, parse, rim_mm, structures
from lmeasure.report import figures, html
from lmeasure.report.structure_drawing import svg
from lmeasure.report.text import axes
from lmeasure.structure import Linkage, lines
from lmeasure.text import ENGLISH, Say

BASE_INK, PLATFORM_INK, LINK_INK, SCREW, GRADIENT = "#1f2933", "#1d4ed8", "#c2410c", "#7c3aed", "#15803d"
TETRAHEDRA = ("#f59e0b", "#10b981", "#ec4899", "#6366f1")
SMALL = 0.25
"""Part of the base's extent below which the names of a platform's points would overlap, and are shown by pointing."""
FACES = ((0, 0, 0, 1), (1, 1, 2, 2), (2, 3, 3, 3))


def write_structure_page(
    path: Path, name: str, linkage: Linkage, record: dict[str, Any], *, pose: FloatArray | None, language: str = "en"
) -> None:
    """Write a self-contained page of links and their record (`structure.record.described`); pose (7,) at which they were looked at."""
    say, plots = Say(language), {}
    if "way" in record:
        plots["way"] = figures.figure(way_figure(record["way"], say), "way", language)
    if record.get("boundary", {}).get("slices"):
        plots["boundary"] = figures.figure(slices_figure(record["boundary"], pose, say), "boundary", language)
    drawing = svg(incidence(linkage.base, linkage.platform).structure) if len(linkage.base) == LINKS else ""
    html.write_page(
        path, "structure.html", answer(name, linkage, record, pose, say=say), say, plots=plots,
        said=[line for line in lines(record) if not line.detail], drawing=drawing,
        assemblies=_rows(record, say) if record.get("assemblies") else [], at_pose=_at_pose(record, say) if "rank" in record else [],
        design=record.get("design"), links=_links(linkage, say), place=[say("page.x_mm"), say("page.y_mm"), say("page.z_mm")],
    )  # fmt: skip


def answer(name: str, linkage: Linkage, record: dict[str, Any], pose: FloatArray | None, *, say: Say) -> html.Answer:
    """Return the first screen: whether the lengths determine the pose, how well, the motion they determine least, and the next step."""
    rows = [html.Number(say("structure.class"), str(record["class"]), say("structure.of_links", number=len(linkage.base)))]
    assemblies = record["complex_assemblies"]
    known = say("structure.closed_form") if record["closed_form"] else say("structure.homotopy")
    if assemblies is not None:
        rows.append(html.Number(say("structure.complex_assemblies"), str(assemblies), known))
    if record.get("assemblies"):
        rows.append(html.Number(say("structure.assemblies_real"), str(len(record["assemblies"]))))
    state, verdict, limits = "good", say("structure.verdict_class"), say("structure.limited_unknown")
    if "rank" in record:
        u95 = record["u95_mm_per_mm"]
        rows.append(html.Number(say("structure.u95_by_1_mm"), say("page.none") if u95 is None else say("structure.in_mm", mm=u95)))
        rows.append(html.Number(say("structure.worst_pressure_angle"), f"{say.number(max(record['pressure_angles_deg']), '.1f')}°"))
        limits = say("structure.limited_screw", mm=record["least_seen_screw"]["mm_per_mm"])
        state, verdict = (
            ("good", say("structure.verdict_regular")) if record["rank"] == FREEDOMS else ("bad", say("structure.verdict_singular"))
        )
    if record["degenerate"] or record["architecturally_singular"]:
        state, verdict = "bad", say("structure.verdict_degenerate")
    ask = html.Step(say("structure.next_pose"), f"lmeasure structure {name} --out s.json --position-mm 0,0,0 --quaternion 0,0,0,1")
    zone = html.Step(say("calibration.next_zone"), "lmeasure zone RIG.toml --x -500:500:50 --y -500:500:50 --z 0:500:50 --out zone.nc")
    return html.Answer(
        say("structure.structure", name=name), verdict, state, tuple(rows), limits, (zone if "rank" in record else ask,),
        figures.figure(space_figure(linkage, record, pose, say), "figure0", say.language, hero=True), "", _space_words(record, say),
    )  # fmt: skip


FREEDOMS = 6


def _space_words(record: dict[str, Any], say: Say) -> str:
    words = [say("structure.drag_turn_scroll_come")]
    if record.get("assemblies"):
        words.append(say("structure.buttons_show_one_assembly"))
    if record.get("closed_form"):
        words.append(say("structure.coloured_bodies_tetrahedra_assemblies"))
    if "rank" in record:
        words.append(say("structure.violet_axis_screw_lengths"))
    return " ".join(words)


def _rows(record: dict[str, Any], say: Say) -> list[tuple[str, ...]]:
    out = []
    for i, one in enumerate(record["assemblies"], 1):
        place = (say.number(v, ".4f") for v in one["position_mm"])
        out.append((str(i), *place, say.numbers(one["quaternion_xyzw"], ".6f"), say("page.yes") if one["certified"] else say("page.no")))
    return out


def _at_pose(record: dict[str, Any], say: Say) -> list[tuple[str, str]]:
    rows = [
        (say("structure.determinant_mm"), _figure(record["determinant"], say)),
        (say("structure.rank"), str(record["rank"])),
        (say("structure.condition"), _figure(record["condition"], say)),
        (say("structure.rim_lengths_off"), _figure(record["mm_per_mm"], say)),
        (say("structure.u95_position_each_length"), _figure(record["u95_mm_per_mm"], say)),
    ]
    if "wrapped" in record:
        rows.append((say("structure.u95_position_counts"), _figure(record["wrapped"]["u95_position_mm"], say)))
    rows.append((say("structure.pressure_angles"), say.numbers(record["pressure_angles_deg"], ".1f")))
    if record["gradient"] is not None:
        rows.append((say("structure.gradient_v"), say.numbers(record["gradient"], ".4g")))
    screw = record["least_seen_screw"]
    axis = say(
        "structure.axis_through_mm_along", point=say.numbers(screw["point_mm"], ".4g"), direction=say.numbers(screw["direction"], ".3f")
    )
    pitch = say("structure.shift") if screw["pitch_mm"] is None else say("structure.mm_per_turn", mm=screw["pitch_mm"])
    motion = say("structure.mm_per_mm", mm=screw["mm_per_mm"])
    rows.append((say("structure.screw_seen_least"), f"{axis}, {pitch}, {motion}"))
    return rows


def _figure(value: float | None, say: Say) -> str:
    return say("page.none") if value is None else say.number(value, ".5g")


def _places(at: FloatArray, say: Say) -> tuple[str, ...]:
    """Return coordinates without their rounding errors."""
    return tuple(say.number(round(float(v), 6), "g") for v in at)


def _links(linkage: Linkage, say: Say) -> list[tuple[str, ...]]:
    each = zip(linkage.names, linkage.base, linkage.platform, strict=True)
    return [(name, b, *_places(at, say), p, *_places(of, say)) for (name, b, p), at, of in each]


def space_figure(linkage: Linkage, record: dict[str, Any], pose: FloatArray | None, say: Say = ENGLISH) -> go.Figure:
    """Base, platform and links at the pose and at every assembly, with tetrahedra, screws and boundary slices where they are known."""
    figure = go.Figure()
    figure.add_trace(_outline(linkage.base, BASE_INK, say("page.base"), [name for _, name, _ in linkage.names]))
    fixed = 1
    shown: list[tuple[str, FloatArray]] = [(say("page.pose"), pose)] if pose is not None else []
    for i, one in enumerate(record.get("assemblies", []), 1):
        shown.append((say("structure.assembly_2", i=i), np.array([*one["position_mm"], *one["quaternion_xyzw"]])))
    if not shown:
        figure.update_layout(title=say("structure.base_alone_pose_lengths"), title_font_size=13)
    groups = []
    for n, (name, at) in enumerate(shown):
        traces = _platform(linkage, at, name, say) + _tetrahedra(linkage, at, say)
        if at is pose and "rank" in record:
            traces += _screws(linkage, record, at, say)
        as_first = [trace.visible or True for trace in traces]
        for trace, visible_first in zip(traces, as_first, strict=True):
            trace.visible = visible_first if n == 0 else False
            figure.add_trace(trace)
        groups.append((name, as_first))
    for piece in record.get("boundary", {}).get("slices", []):
        x, y, z = _closed(piece).T
        figure.add_scatter3d(
            x=x, y=y, z=z, mode="lines", line={"width": 4, "color": GRADIENT}, name=say("structure.boundary_mm", mm=piece["level_mm"])
        )
    after = len(record.get("boundary", {}).get("slices", []))
    buttons = []
    for n, (name, _) in enumerate(groups):
        visible: list[Any] = [True] * fixed
        for k, (_, as_first) in enumerate(groups):
            visible += as_first if k == n else [False] * len(as_first)
        buttons.append({"label": name, "method": "restyle", "args": [{"visible": visible + [True] * after}]})
    if len(buttons) > 1:
        figure.update_layout(
            updatemenus=[{"buttons": buttons, "x": 0.0, "y": 1.0, "xanchor": "left", "yanchor": "bottom", "showactive": True}]
        )
    scene = axes(say)
    return figure.update_layout(height=640, margin={"t": 40, "b": 10, "l": 0, "r": 0}, scene=scene)


def _closed(piece: dict[str, Any]) -> FloatArray:
    places = np.array(piece["places_mm"])
    return np.vstack([places, places[:1]]) if piece["closed"] else places


def _outline(points: FloatArray, ink: str, title: str, names: list[str]) -> go.Scatter3d:
    """A body's points, each once, in order around their middle, with their names."""
    unique: dict[tuple[float, ...], list[str]] = {}
    for point, name in zip(points, names, strict=True):
        unique.setdefault(tuple(point), []).append(name)
    places = np.array(list(unique))
    texts = [html.label(", ".join(dict.fromkeys(n))) for n in unique.values()]
    centred = places - places.mean(axis=0)
    axes = np.linalg.svd(centred)[2]
    order = np.argsort(np.arctan2(centred @ axes[1], centred @ axes[0]))
    order = np.append(order, order[0])
    x, y, z = places[order].T
    return go.Scatter3d(
        x=x, y=y, z=z, mode="lines+markers+text", text=[*(texts[i] for i in order[:-1]), ""], name=title, textfont={"color": ink},
        line={"width": 5, "color": ink}, marker={"size": 4, "color": ink},
    )  # fmt: skip


def _platform(linkage: Linkage, pose: FloatArray, name: str, say: Say) -> list[Any]:
    points, strips = se3.apply(pose, linkage.platform), linkage.strips(pose)
    x, y, z = np.concatenate([strips, np.full((len(strips), 1, 3), np.nan)], axis=1).reshape(-1, 3).T
    links = go.Scatter3d(x=x, y=y, z=z, mode="lines", line={"width": 4, "color": LINK_INK}, name=say("structure.links_2"), hoverinfo="skip")
    platform = _outline(points, PLATFORM_INK, say("structure.platform", name=name), [p for _, _, p in linkage.names])
    if np.ptp(linkage.platform, axis=0).max() < SMALL * np.ptp(linkage.base, axis=0).max():
        platform.update(mode="lines+markers", hoverinfo="x+y+z+text")
    return [platform, links]


def _tetrahedra(linkage: Linkage, pose: FloatArray, say: Say) -> list[Any]:
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
            x=x, y=y, z=z, i=i_, j=j_, k=k_, opacity=0.35, color=TETRAHEDRA[(n - 1) % len(TETRAHEDRA)],
            name=say("structure.tetrahedron", n=n), showlegend=True,
        )  # fmt: skip
        mesh.visible = "legendonly"
        out.append(mesh)
    return out


def _screws(linkage: Linkage, record: dict[str, Any], pose: FloatArray, say: Say) -> list[Any]:
    """Axes of the screw that is seen least, and of the determinant's gradient."""
    size = 1.5 * rim_mm(linkage.platform)
    screw = record["least_seen_screw"]
    out = [_axis(np.array(screw["point_mm"]), np.array(screw["direction"]), pose[:3], size, SCREW, say("structure.screw_seen_least"), say)]
    if record["gradient"] is not None and np.any(record["gradient"]):
        omega, v = np.split(np.array(record["gradient"]), 2)
        turn = float(np.linalg.norm(omega))
        shift = turn * size <= 1e-6 * float(np.linalg.norm(v))
        direction = v / np.linalg.norm(v) if shift else omega / turn
        point = pose[:3] if shift else np.cross(omega, v) / turn**2
        out.append(_axis(point, direction, pose[:3], size, GRADIENT, say("structure.gradient_determinant"), say))
    return out


def _axis(point: FloatArray, direction: FloatArray, near: FloatArray, size: float, ink: str, name: str, say: Say) -> Any:
    """A piece of an axis beside a place, or a piece through the place where the axis is far away."""
    foot = point + direction * float((near - point) @ direction)
    if float(np.linalg.norm(foot - near)) > 10.0 * size:
        foot, name = near, say("structure.axis_far_away", name=name)
    x, y, z = np.array([foot - size * direction, foot + size * direction]).T
    return go.Scatter3d(x=x, y=y, z=z, mode="lines", line={"width": 6, "color": ink, "dash": "dash"}, name=name)


def way_figure(way: dict[str, Any], say: Say = ENGLISH) -> go.Figure:
    """Determinant, motion of the rim and pressure angle along a way."""
    figure = make_subplots(3, 1, shared_xaxes=True, vertical_spacing=0.05)
    percent = [100.0 * share for share in way["share"]]
    rows = (
        ("determinant", say("structure.determinant_mm"), False),
        ("mm_per_mm", say("structure.rim_mm_per_mm"), True),
        ("worst_pressure_angle_deg", say("structure.angle"), False),
    )
    for row, (key, title, log) in enumerate(rows, 1):
        figure.add_scatter(x=percent, y=way[key], mode="lines", line={"color": PLATFORM_INK}, showlegend=False, row=row, col=1)
        figure.update_yaxes(title_text=title, type="log" if log else "linear", row=row, col=1)
        for share in way["singular_at_share"]:
            figure.add_vline(x=100.0 * share, line={"dash": "dot", "color": LINK_INK}, row=row, col=1)
    figure.update_xaxes(title_text=say("structure.way_2"), row=3, col=1)
    return figure.update_layout(height=620, margin={"t": 20})


def slices_figure(workspace: dict[str, Any], pose: FloatArray | None, say: Say = ENGLISH) -> go.Figure:
    """The boundaries of all levels in their plane, and the pose (7,)."""
    a, b = ("xyz".index(axis) for axis in workspace["plane"])
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
            how = say("page.closed") if piece["closed"] else say("page.open")
            colour = figures.PALETTE[met.index(limit) % len(figures.PALETTE)]
            label = say("structure.mm_3", mm=piece["level_mm"], how=how, limit=say.message(limit))
            figure.add_scatter(
                x=x, y=y, mode="lines", line={"color": colour}, name=html.label(say.message(limit)),
                text=[label] * len(x),
                hovertemplate=f"%{{x:.2f}}, %{{y:.2f}} {say('page.mm')}<br>%{{text}}<extra></extra>", legendgroup=limit,
                showlegend=limit not in told_of,
            )  # fmt: skip
            told_of.add(limit)
    if pose is not None:
        figure.add_scatter(x=[pose[a]], y=[pose[b]], mode="markers", marker={"color": BASE_INK, "size": 9}, name=say("page.pose"))
    figure.update_xaxes(title_text=say(f"page.{'xyz'[a]}_mm"), scaleanchor="y", constrain="domain")
    figure.update_yaxes(title_text=say(f"page.{'xyz'[b]}_mm"), constrain="domain")
    return figure.update_layout(height=620, margin={"t": 20})


def write_list_page(path: Path, every: list[dict[str, Any]], language: str = "en") -> None:
    """Write a page with drawings of all structures of six links."""
    say, classes = Say(language), {one["class"] for one in every}
    good = [one for one in every if not one["degenerate"]]
    closed = [one for one in good if one["closed_form"]]
    rows = (
        html.Number(say("structure.number"), str(len(every)), say("structure.number_classes", number=len(classes))),
        html.Number(say("structure.number_regular"), str(len(good))),
        html.Number(say("structure.number_closed"), str(len(closed))),
    )
    picture = max(closed, key=lambda one: -int(one["complex_assemblies"]))
    shown = html.Answer(
        say("structure.structures_six_links"),
        say("structure.verdict_list", number=len(good)), "", rows,
        say("structure.limited_list", number=len(every) - len(good)),
        (html.Step(say("structure.next_own"), "lmeasure structure STRUCTURE.toml --out s.json --report page"),),
        Markup('<div class="drawn">{}</div>').format(html.themed(svg(parse(picture["notation"])[0]))),
        caption=say("structure.simplest", notation=picture["notation"]),
    )  # fmt: skip
    about = say("structure.structures_six_links_platform", number=len(structures()), classes=len(classes))
    html.write_page(
        path, "structures.html", shown, say, about=about, cards=[(html.themed(svg(parse(one["notation"])[0])), one) for one in every]
    )
