"""The pictures of these documents, drawn from the program's own geometry: `python docs/draw_pictures.py [FOLDER]`.

cable.svg: one cable in the plane of its swivel pulley. cell.svg: a reconstructed run of `tests/authorities/truth/cell-run-long`.
structures.svg: the structures of six links. mechanisms.svg: those of mechanisms.md at home. architecture.svg: the layers of packages.
"""

import math
import re
import sys
import tomllib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lmeasure.kernels import wrap_geometry
from lmeasure.linkages import start_systems, structures
from lmeasure.recording import read_run
from lmeasure.report.structure_drawing import sheet
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.robots import ParallelFile, any_shipped, mechanism_outline
from lmeasure.sensors import changes_from_counts
from lmeasure.trajectory import reconstruct

FloatArray = NDArray[np.float64]

HERE = Path(__file__).parent
RUN = HERE.parent / "tests" / "authorities" / "truth" / "cell-run-long"

INK, SOFT, CABLE, ACCENT, STEEL = "#1f2933", "#8a94a0", "#c2410c", "#1d4ed8", "#e5e9ee"
STYLE = f"""<style>
text {{ font: 15px system-ui, sans-serif; fill: {INK} }}
.small {{ font-size: 12.5px; fill: #52606d }}
.sym {{ font-style: italic; font-size: 17px }}
.cable {{ stroke: {CABLE}; stroke-width: 2.6; fill: none; stroke-linecap: round }}
.body {{ fill: {STEEL}; stroke: {INK}; stroke-width: 1.4 }}
.axis {{ stroke: {SOFT}; stroke-width: 1.2; stroke-dasharray: 7 4; fill: none }}
.arrow {{ stroke: {ACCENT}; stroke-width: 2; fill: none }}
</style>
<defs><marker id="tip" viewBox="0 0 10 10" refX="8" refY="5" markerWidth="6" markerHeight="6" orient="auto-start-reverse">
<path d="M0 0 10 5 0 10z" fill="{ACCENT}"/></marker></defs>"""


def point_on(p: FloatArray) -> str:
    return f"{p[0]:.1f},{p[1]:.1f}"


def line(a: FloatArray, b: FloatArray, kind: str, extra: str = "") -> str:
    return f'<line x1="{a[0]:.1f}" y1="{a[1]:.1f}" x2="{b[0]:.1f}" y2="{b[1]:.1f}" class="{kind}" {extra}/>'


def circle(c: FloatArray, r: float, kind: str) -> str:
    return f'<circle cx="{c[0]:.1f}" cy="{c[1]:.1f}" r="{r:.1f}" class="{kind}"/>'


def dot(p: FloatArray, colour: str = INK) -> str:
    return f'<circle cx="{p[0]:.1f}" cy="{p[1]:.1f}" r="3.6" fill="{colour}"/>'


def text(p: FloatArray, words: str, kind: str = "", anchor: str = "start") -> str:
    return f'<text x="{p[0]:.1f}" y="{p[1]:.1f}" class="{kind}" text-anchor="{anchor}">{words}</text>'


def arc(c: FloatArray, r: float, start: float, end: float, kind: str) -> str:
    """Arc about c from angle start to end [rad, anticlockwise on the page as seen]."""
    a = c + r * np.array([math.cos(start), -math.sin(start)])
    b = c + r * np.array([math.cos(end), -math.sin(end)])
    large, sweep = int(abs(end - start) > math.pi), int(end < start)
    return f'<path d="M{point_on(a)} A{r:.1f} {r:.1f} 0 {large} {sweep} {point_on(b)}" class="{kind}"/>'


def svg(width: int, height: int, title: str, parts: list[str]) -> str:
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img"><title>{title}</title>'
    return "\n".join([head, STYLE, f'<rect width="{width}" height="{height}" fill="white"/>', *parts, "</svg>\n"])


def one_cable_rig() -> Rig:
    """A cable in the XZ plane with a pulley large enough to see."""
    drum = {
        "counts_per_revolution": 6000,
        "count_length_mm": 0.012,
        "groove_pitch_mm": 1.0,
        "tangent_length_mm": 190.0,
        "axial_offset_mm": 70.0,
    }
    point = {
        "name": "B",
        "position_mm": [0.0, 0.0, 0.0],
        "guide_alpha_deg": 52.0,
        "guide_beta_deg": -90.0,
        "pulley_radius_mm": 74.0,
        "drum": drum,
    }
    return rig_from_dict(
        {
            "schema": "lmeasure.rig/1",
            "name": "one cable",
            "observation_point": [point],
            "tool": {"P": [0.0, 0.0, 0.0]},
            "cable": [{"name": "c", "channel": "ch1", "from": "B", "to": "P"}],
        },
        "picture",
    )


def draw_cable() -> str:
    """One cable from drum to gripper, in the plane of the swivel pulley."""
    rig = one_cable_rig()
    tool = np.array([[340.0, 0.0, -120.0, 0.0, 0.0, 0.0, 1.0]])
    centre, tangent, attachment, wrapped = wrap_geometry(rig.cable_rows(), tool)
    origin = np.array([455.0, 190.0])

    def page(p: FloatArray) -> FloatArray:
        return origin + np.array([p[0], -p[2]])

    B, C, T, P = page(np.zeros(3)), page(centre[0, 0]), page(tangent[0, 0]), page(attachment[0, 0])
    phi, R = float(wrapped[0, 0]), rig.observation_point[0].pulley_radius_mm
    alpha = math.radians(rig.observation_point[0].guide_alpha_deg)
    u = np.array([math.cos(alpha), -math.sin(alpha)])
    way = -150.0 * u
    H = B + way
    small = 14.0
    # the fixed pulley touches the guide from below and the drum's cable from above
    drum = rig.observation_point[0].drum
    E1 = H + np.array([-drum.tangent_length_mm, 0.0])
    EC = E1 + np.array([0.0, -drum.axial_offset_mm])
    start = math.atan2(-(B - C)[1], (B - C)[0])
    parts = [
        line(B - 255.0 * u, B + 170.0 * u, "axis"),
        text(B + 176.0 * u + [4.0, 4.0], "swivel axis", "small"),
        circle(C, R, "body"),
        f'<rect x="{E1[0] - 62:.1f}" y="{E1[1] - 122:.1f}" width="62" height="140" rx="3" class="body"/>',
        *[line(E1 + [-62.0, y], E1 + [0.0, y + 4.0], "", f'stroke="{SOFT}" stroke-width="1"') for y in np.arange(-118.0, 14.0, 8.0)],
        line(E1 + [-31.0, -142.0], E1 + [-31.0, 38.0], "axis"),
        line(E1, H, "axis"),
        line(EC, H, "cable"),
        line(H, B, "cable"),
        arc(C, R, start, start - phi, "cable"),
        line(T, P, "cable"),
        circle(H + small * np.array([math.sin(alpha), math.cos(alpha)]), small, "body"),
        f'<path d="M{point_on(P + [-6.0, 0.0])} h46 v64 h-10 v-34 h-26 v34 h-10 z" class="body"/>',
        line(B, B + 92.0 * u, "arrow", 'marker-end="url(#tip)"'),
        line(T, T + 66.0 * (P - T) / np.linalg.norm(P - T), "arrow", 'marker-end="url(#tip)"'),
        line(C, B, "", f'stroke="{SOFT}"'),
        line(C, T, "", f'stroke="{SOFT}"'),
        arc(C, 30.0, start, start - phi, "arrow"),
        line(B, B + [-130.0, 0.0], "axis"),
        arc(B, 72.0, math.pi, math.pi + alpha, "arrow"),
        *[dot(p) for p in (B, C, T, P, H, EC)],
        text(B + [-20.0, -10.0], "B", "sym"),
        text(C + [8.0, 18.0], "O", "sym"),
        text(T + [6.0, -8.0], "T", "sym"),
        text(P + [10.0, -8.0], "P", "sym"),
        text(B + 92.0 * u + [-20.0, 2.0], "u", "sym"),
        text(T + 66.0 * (P - T) / np.linalg.norm(P - T) + [10.0, -4.0], "e", "sym"),
        text((C + B) / 2 + [-4.0, 18.0], "R", "sym"),
        text(C + 42.0 * np.array([math.cos(start - phi / 2), -math.sin(start - phi / 2)]) + [-4.0, 0.0], "φ", "sym"),
        text(B + [-92.0, 36.0], "α", "sym"),
        text(C + [R - 6.0, -R + 4.0], "swivel pulley"),
        text(H + [24.0, 26.0], "fixed pulley"),
        text(E1 + [-31.0, 60.0], "drum with encoder: k counts", "", "middle"),
        text((E1 + H) / 2 + [0.0, 18.0], "tangent length", "small", "middle"),
        text(E1 + [-70.0, -30.0], "axial(k)", "small", "end"),
        text((EC + H) / 2 + [-6.0, -12.0], "h(k)", "sym"),
        text((T + P) / 2 + [14.0, 0.0], "free span, length t", "small"),
        text(P + [54.0, 24.0], "attachment point"),
        text(P + [54.0, 44.0], "on the gripper"),
        text(np.array([30.0, 40.0]), "k · count length = [h(k) + Rφ + t] − [h(0) + Rφ₀ + t₀]", "sym"),
    ]
    return svg(1000, 420, "One cable: drum, fixed pulley, swivel pulley, gripper", parts)


def draw_cell() -> str:
    """The rig of a run, its six cables at one sample, and the reconstructed path."""
    run = read_run(RUN)
    trajectory = reconstruct(run)
    at = int(np.argmax(trajectory.poses[:, 0]))
    rows = run.rig.cable_rows()
    _, tangent, attachment, _ = wrap_geometry(rows, trajectory.poses[[at]])
    azimuth, elevation = math.radians(-28.0), math.radians(22.0)
    right = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
    up = np.array([-math.cos(azimuth) * math.sin(elevation), -math.sin(azimuth) * math.sin(elevation), math.cos(elevation)])
    view = np.stack([right, -up])
    bases = np.array([p.position_mm for p in run.rig.observation_point])
    flat = bases @ view.T
    scale = min(560.0 / np.ptp(flat[:, 0]), 400.0 / np.ptp(flat[:, 1]))
    offset = np.array([330.0, 262.0]) - scale * (flat.min(axis=0) + flat.max(axis=0)) / 2

    def page(p: FloatArray) -> FloatArray:
        return np.asarray(scale * (p @ view.T) + offset)

    path = page(trajectory.poses[::7, :3])
    parts = [f'<polyline points="{" ".join(point_on(p) for p in path)}" fill="none" stroke="{ACCENT}" stroke-width="1.8"/>']
    for j, c in enumerate(run.rig.cable):
        B, T, P = page(np.array(run.rig.point(c.from_point).position_mm)), page(tangent[0, j]), page(attachment[0, j])
        parts += [line(B, T, "cable"), line(T, P, "cable"), circle(B, 6.0, "body"), text(B + [10.0, -8.0], c.from_point, "small")]
    corners = page(attachment[0])
    used = list(dict.fromkeys(c.to_point for c in run.rig.cable))
    triangle = [corners[next(j for j, c in enumerate(run.rig.cable) if c.to_point == name)] for name in used]
    parts.append(f'<polygon points="{" ".join(point_on(p) for p in triangle)}" fill="{STEEL}" stroke="{INK}" stroke-width="1.4"/>')
    parts.append(dot(page(trajectory.poses[at, :3]), ACCENT))
    parts += panel(trajectory.time_s, changes_from_counts(run.rig, run.passes[0].recorded), 60.0, "counts → lengths, mm", CABLE)
    parts += panel(trajectory.time_s, trajectory.poses[:, :3], 210.0, "→ position x, y, z, mm", ACCENT)
    parts += panel(trajectory.time_s, trajectory.u[:, :3] * 1e3, 360.0, "→ its standard uncertainty, µm", INK)
    parts.append(text(np.array([676.0, 492.0]), f"0 to {trajectory.time_s[-1]:.0f} s", "small"))
    return svg(960, 510, "A cell of six cables, the path reconstructed from their counts, and its uncertainty", parts)


def panel(time_s: FloatArray, values: FloatArray, top: float, title: str, colour: str) -> list[str]:
    """Curves (n, m) over time (n,) in a small frame at the right."""
    left, width, height = 676.0, 240.0, 96.0
    low, high = float(values.min()), float(values.max())
    out = [
        f'<rect x="{left}" y="{top + 12}" width="{width}" height="{height}" fill="none" stroke="{SOFT}"/>',
        text(np.array([left, top + 4]), title),
        text(np.array([left - 6, top + 24]), f"{high:.3g}", "small", "end"),
        text(np.array([left - 6, top + 12 + height]), f"{low:.3g}", "small", "end"),
    ]
    some = slice(None, None, max(1, len(time_s) // 150))
    x = left + width * (time_s[some] - time_s[0]) / (time_s[-1] - time_s[0])
    for column in values.T:
        y = top + 12 + height * (high - column[some]) / (high - low)
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
        out.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.1" stroke-opacity="0.75"/>')
    return out


def draw_structures() -> str:
    """All structures of six links, and how many complex assemblies each has."""
    captions = []
    for s in structures():
        title, words = s.notation.split(":")
        count = "determines no pose" if s.degenerate else f"{start_systems.complex_assemblies(s)}{', closed form' if s.closed_form else ''}"
        captions.append((title, words, count))
    return sheet(structures(), captions)


MECHANISMS = {
    "rotopod": "six carriages on one circle",
    "four-chains": "four carriages, two of them with slides",
    "crank-platform": "three cranks, three plain rods",
    "logos": "legs between Hooke joints",
    "seven-link": "five rods, one way",
    "three-prr": "three carriages in a plane",
}
"""Those of docs/mechanisms.md, each with what it stands on."""
VIEW_DEG, CELL = (30.0, 28.0), (310.0, 250.0)


def draw_mechanisms() -> str:
    """Every mechanism of the documents at home, as its robot.toml has it, seen from one direction."""
    turn, lift = np.radians(VIEW_DEG)
    right = np.array([-np.sin(turn), np.cos(turn), 0.0])
    up = np.array([-np.sin(lift) * np.cos(turn), -np.sin(lift) * np.sin(turn), np.cos(lift)])
    parts = []
    for number, (name, words) in enumerate(MECHANISMS.items()):
        file = any_shipped(name)
        assert isinstance(file, ParallelFile)
        what = mechanism_outline(file, file.model.home)
        # a body that has outgrown its rods is drawn by these
        strips = [(strip, kind) for kind in ("base", "arms", "legs") for strip in getattr(what, kind)] + [(what.platform, "platform")]
        flat = [(np.column_stack([strip @ right, -(strip @ up)]), kind) for strip, kind in strips]
        every = np.concatenate([strip for strip, _ in flat])
        low, high = every.min(axis=0), every.max(axis=0)
        corner = np.array([20.0 + (number % 3) * CELL[0], 50.0 + (number // 3) * (CELL[1] + 50.0)])
        size = min((CELL[0] - 30.0) / (high[0] - low[0]), (CELL[1] - 30.0) / (high[1] - low[1]))
        middle = corner + np.array(CELL) / 2.0 - [15.0, 5.0]
        for strip, kind in flat:
            points = " ".join(point_on(p) for p in middle + size * (strip - (low + high) / 2.0))
            look = {
                "base": ("none", INK, 1.4),
                "arms": ("none", "#7c3aed", 3.2),
                "legs": ("none", CABLE, 2.6),
                "platform": ("#1d4ed833", ACCENT, 2.0),
            }
            fill, stroke, width = look[kind]
            parts.append(f'<polyline points="{points}" fill="{fill}" stroke="{stroke}" stroke-width="{width}" stroke-linejoin="round"/>')
        parts.append(text(corner - [0.0, 26.0], name))
        parts.append(text(corner - [0.0, 8.0], words, "small"))
    return svg(960, 610, "Mechanisms at home", parts)


def draw_architecture() -> str:
    """The layers of packages, as the contract in pyproject.toml has them."""
    project = tomllib.loads((HERE.parent / "pyproject.toml").read_text(encoding="utf-8"))
    layers = next(c["layers"] for c in project["tool"]["importlinter"]["contracts"] if c["type"] == "layers")
    width, height, gap = 900, 34, 12
    parts = []
    for row, layer in enumerate(layers):
        names = [name.strip() for name in re.split(r"[|:]", layer)]
        top, wide = 10 + row * (height + gap), (width - 20 - gap * (len(names) - 1)) / len(names)
        for column, name in enumerate(names):
            left = 10 + column * (wide + gap)
            parts.append(f'<rect x="{left:.0f}" y="{top}" width="{wide:.0f}" height="{height}" rx="6" class="body"/>')
            parts.append(text(np.array([left + wide / 2, top + 22]), name, anchor="middle"))
    return svg(width, 10 + len(layers) * (height + gap), "Packages of lmeasure: each imports only packages below it", parts)


def main(folder: Path) -> None:
    """Write the pictures into the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, draw in (
        ("cable.svg", draw_cable),
        ("cell.svg", draw_cell),
        ("structures.svg", draw_structures),
        ("mechanisms.svg", draw_mechanisms),
        ("architecture.svg", draw_architecture),
    ):
        (folder / name).write_text(draw(), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "images")
