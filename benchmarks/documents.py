"""Every section of the source documents: what is printed, and what the program gives by the command or function named.

    python benchmarks/documents.py [--write]

It writes docs/documents.md. A row is computed where it stands: commands run in a folder of their own, functions are called. A row says
`corrected` where the print errs, and `no` where no command and no function has the section.
"""

import json
import tempfile
import tomllib
from collections.abc import Callable, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from study import options, table
from typer.testing import CliRunner

from lmeasure.cli.app import app
from lmeasure.core import se3
from lmeasure.linkages import Bounds, Tetrahedron, adjusted, detour, singularity, somov_malyshev, structures
from lmeasure.linkages.flat_tetrahedra import bands, safe_band
from lmeasure.robots import ParallelFile, PlatformFile, any_shipped, misses

PAGE = Path(__file__).parents[1] / "docs" / "documents.md"
HERE = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
FOLDER = Path(tempfile.mkdtemp())


class Row(NamedTuple):
    """Document and section, subject, command or function, printed value, ours, and what is to be said of the print."""

    section: str
    subject: str
    how: str
    printed: str
    ours: Callable[[], str]
    verdict: str = "same"


def run(*words: object) -> dict[str, Any]:
    """The JSON that a command writes with --out."""
    out = FOLDER / "out.json"
    done = CliRunner().invoke(app, [*map(str, words), "--out", str(out), "--force"])
    assert done.exit_code == 0, done.output
    return dict(json.loads(out.read_text(encoding="utf-8")))


def structure(base: Sequence[Sequence[float]], platform: Sequence[Sequence[float]], links: Sequence[Sequence[float]]) -> Path:
    """A structure file; links (base point, platform point) or with a length."""
    text = 'schema = "lmeasure.structure/1"\n'
    for side, points in (("base", base), ("platform", platform)):
        text += f"[{side}]\n" + "".join(f"{side[0].upper()}{i} = {[float(v) for v in p]}\n" for i, p in enumerate(points, 1))
    for link in links:
        text += f'[[link]]\nfrom = "B{link[0]}"\nto = "P{link[1]}"\n' + (f"length_mm = {link[2]}\n" if len(link) > 2 else "")
    path = FOLDER / "structure.toml"
    path.write_text(text, encoding="utf-8")
    return path


COLUMNS = (
    [(0, -1, -1.6), (1, 0, -1.6), (0, 1, -1.6), (0, -2.6, 0), (2.6, 0, 0), (0, 2.6, 0)],
    [(0, -1, 0), (1, 0, 0), (0, 1, 0)],
    [(1, 1), (2, 2), (3, 3), (4, 1), (5, 2), (6, 3)],
)


def singular_columns() -> dict[str, Any]:
    return dict(run("structure", structure(*COLUMNS), "--position-mm", "0,0,0", "--singular")["singular_pose"])


def variants() -> str:
    out = FOLDER / "list.json"
    done = CliRunner().invoke(app, ["structure", "--list", "--out", str(out), "--force"])
    assert done.exit_code == 0, done.output
    own = next(one["variants"] for one in json.loads(out.read_text(encoding="utf-8")) if one["class"] == "L-222-321")
    return f"{own['drives_moved'][0]} and {own['drives_moved'][1]}, rods {own['rods'][0]} and {own['rods'][1]}"


def rods() -> str:
    found = run("structure", "rods")
    return f"{len(found['assemblies'])} assembly modes, {found['status']}"


def design_of_rods() -> str:
    sound = run("structure", "rods", "--design")["design"]["clear_as_given"]
    return f"45.2: {sum(sound)} of {len(sound)} tetrahedra never flat"


def input_rods() -> str:
    words = ["structure", "input-rods", "--position-mm", "0,0,400", "--boundary", "xy"]
    found = run(*words, "--lengths-mm", "390,390,430,390,450,390")
    (piece,) = found["boundary"]["slices"]
    x, y, z = found["forward"]["position_mm"]
    return f"det {found['determinant']:.4g}; driven to ({x:.2f}, {y:.2f}, {z:.2f}); {piece['area_mm2']:.0f} mm² at z = 400"


def assembly() -> str:
    path = structure(
        [(1, 5, 0), (3, 3, 0), (4, 2, 0), (1, 1, 0)],
        [(0, 0, 0), (1, 2, 0), (-2, 2, 0), (0, 4, 0)],
        [(2, 1, 10.0), (3, 1, 10.5), (4, 1, 11.0), (1, 4, 8.9), (1, 3, 7.98), (3, 2, 9.9)],
    )
    found = run("structure", path)
    x, y, z = found["assemblies"][0]["position_mm"]
    return f"{len(found['assemblies'])} assembly modes, P1 ({x:.4f}, {y:.4f}, {z:.4f})"


def band() -> str:
    limits = {"l1": (3.0, 3.5), "l2": (3.0, 3.5), "l3": (4.5, 5.0), "l4": (3.5, 4.0), "l5": (3.5, 4.0), "l6": (3.5, 4.0)}
    sides = {"b12": 1.5, "b23": 2.4, "b13": 2.4, "p12": 1.5, "p23": 1.25, "p13": 1.25}
    limits |= {name: (side, side) for name, side in sides.items()}
    corners = [
        Tetrahedron("b12", "l1", "l2", "b13", "b23", "l3"),
        Tetrahedron("l4", "l2", "p12", "b23", "l5", "l3"),
        Tetrahedron("p23", "p12", "p13", "l5", "l6", "l3"),
    ]
    assert adjusted(corners, limits, ["l3"])
    free = safe_band(corners, limits, "l3")
    assert free is not None
    return f"l3 from {free[0]:.4f} to {free[1]:.4f}"


def flat() -> str:
    file = any_shipped("rods")
    assert isinstance(file, PlatformFile)
    rods = file.model.links
    assert rods is not None
    low, high = rods.link_box(np.array([[38.0, 45.0]] * 6))[1]
    limits = {"a1b2": (low, high), "a1b3": (low, high), "a2b2": (25.0, 32.0), "a2b3": (low, high), "b23": (20.0, 20.0), "a12": (1.0, 90.0)}
    found = bands(Tetrahedron("b23", "a1b2", "a1b3", "a2b2", "a2b3", "a12"), limits, "a12")
    return f"{low:.4f} to {high:.4f}; flat {found.near.low[0]:.2f} to {found.near.high[1]:.2f} and from {found.far.low[0]:.2f}"


def screw() -> str:
    base = np.array([(0, 3, 0), (-2, 1, 0), (0, 1, -2), (1, 0, -2), (3, 0, 0), (-1, 0, -2)], dtype=float)
    body = np.array([(0, 1, 0), (1, 0, 0), (-1, 0, 0)], dtype=float)[[0, 0, 0, 1, 1, 2]]
    rows, _, _ = singularity.link_rows(base, body, HERE)
    twist = np.linalg.solve(np.roll(rows, 3, axis=1), np.array([0.1, 0.1, 0.1, 0.0, 0.0, 0.1]))
    return f"det {np.linalg.det(rows):.4g}, twist ({', '.join(f'{v:z.3g}' for v in twist.round(12))})"


def gradient(base: Any, body: Any) -> str:
    K = singularity.gradients(np.array(base, dtype=float), np.array(body, dtype=float), HERE)
    return f"({', '.join(f'{v:z.4g}' for v in K)})"


EX1 = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (-1, 1, -1), (-1, -1, -1), (1, -1, -1)]
EX3 = [(0, 1, -2), (2, 0, 0), (-2, 0, 0)]


def led() -> str:
    base = np.array([(0.25, -0.75, -1.3), (2.3, -0.85, 0.5), (1.25, -0.8, 1.5), (-1, 0, 1.2), (-2.5, 0, 0), (-1, 0, -1.1)])
    body = np.array([(0.6, -0.4, 1.1), (2, -0.4, 0.3), (0.9, -0.4, 1.35), (-1, -1, 0), (-1, -1, 0), (-1, -1, 0)])
    t = np.arange(-200, 201, 2) / 100
    path = np.column_stack([t, t**2 + 1, 0 * t, np.tile([0, 0, 0, 1.0], (len(t), 1))])
    found = detour(Bounds(base, body, path[0], determinant=0.0207), path)
    return f"least determinant {np.abs(singularity.determinants(base, body, found.poses)).min():.4f}, moved by {found.norm_mm.max():.4f}"


def edge() -> str:
    path = structure(
        [(0, -5, 0), (5, 0, 0), (-4, 1, 0), (0, -1, -4), (1, 0, -4), (0, 1, -4)],
        [(0, -1, 0), (1, 0, 0), (0, 1, 0)],
        [(1, 1), (2, 2), (3, 3), (4, 1), (5, 2), (6, 3)],
    )
    words = ["structure", path, "--position-mm", "0,0,0", "--boundary", "xz", "--reach-mm", "40"]
    (one,), (other,) = (run(*words, *more)["boundary"]["slices"] for more in ([], ["--limit-deg", "84"]))
    return f"{'closed' if one['closed'] else 'open'}; with 84 degrees {'closed' if other['closed'] else 'open'}, {other['area_mm2']:.0f}"


def hooke() -> str:
    found = run("mechanism", "logos", "--quaternion", "fixed-xyz:0,0,20")["leg_turns_deg"]
    return f"{found['leg_1']:.3f} degrees"


def own_robot(name: str, scale: float, **leg: float) -> Path:
    """A rotopod of 4.1: its home lower than that of the shipped one."""
    data = tomllib.loads(files("lmeasure.robots").joinpath(f"shipped/{name}.toml").read_text(encoding="utf-8"))
    text = files("lmeasure.robots").joinpath(f"shipped/{name}.toml").read_text(encoding="utf-8")
    z = data["home"]["position_mm"][2]
    text = text[: text.index("[limits]")].replace(f"{z}", f"{scale}") + text[text.index("[[leg]]") :]
    path = FOLDER / f"{name}.toml"
    path.write_text(text, encoding="utf-8")
    return path


def rotopod() -> str:
    found = run("mechanism", own_robot("rotopod", 700.0))
    A = 2.0 * 980.0 * np.array(found["A"]) / ([1e6] * 3 + [1e3] * 3)
    q = [v % 360.0 for v in found["joints"].values()]
    twist = np.array(found["V"]) @ np.full(6, 0.1)
    return (
        f"q1 {np.radians(q[0]):.4f}, det A {np.linalg.det(A):.4f}, twist of equal rates ({', '.join(f'{v:z.2g}' for v in twist.round(9))})"
    )


def scan(robot: str, z: str) -> str:
    found = run("mechanism", robot, "--x=-200:200:50", "--y=-200:200:100", f"--z={z}", "--tilt-rad", "0.004", "--tilt-steps", "3")[
        "workspace"
    ]
    return f"{found['places']} positions of {found['poses']} poses, {found['volume_mm3'] / 1e6:.2f} litres"


def cranks() -> str:
    found = run("mechanism", "crank-platform", "--x=-18:18:2", "--y=-18:18:2", "--z=176:208:1", "--drives", "41")["workspace"]
    at = any_shipped("crank-platform").model.forward(np.radians([[10.0, -5.0, 20.0]]))[0]
    return f"{found['volume_mm3'] / 1e6:.4f} litres; (10, -5, 20) degrees: ({', '.join(f'{v:.3f}' for v in at[:3])})"


def tables_of_004() -> tuple[np.ndarray, np.ndarray]:
    t1 = np.array(
        [
            [5.002, 4.005, 2.998, 6.709, 48.771], [4.941, 3.950, 3.161, 6.129, 51.907], [4.737, 3.746, 3.678, 7.621, 60.315],
            [4.457, 3.555, 4.181, 11.045, 71.083], [4.175, 3.486, 4.517, 14.656, 80.383], [3.854, 3.497, 4.786, 18.317, 88.596],
            [3.628, 3.570, 4.907, 19.573, 92.861], [3.324, 4.006, 4.784, 14.138, 93.633], [3.070, 4.522, 4.485, 8.398, 90.039],
            [2.840, 5.011, 4.100, 4.257, 85.597],
        ]
    )  # fmt: skip
    phi = np.array([109.31628, 107.71351, 103.72216, 100.98456, 100.36138, 100.55560, 99.75441, 91.45164, 83.87869, 78.96665])
    t2 = np.array(
        [
            [0.0719, 0.1017, 0.0870, 0.0360, -0.0041, 0.0017, 6.9443], [-0.0577, 1.0088, 6.0376, 5.6409, -0.0029, 3.0300, 5.8457],
            [8.0163, -5.0071, -1.0001, 6.0916, -1.7899, -2.658, 17.1448], [6.0091, 1.0059, 3.9998, 11.8596, 4.4247, 0.8208, 14.2324],
            [4.9661, 6.0074, 6.9915, 8.9407, -14.607, -2.036, 14.2527],
        ]
    )  # fmt: skip
    from lmeasure.core import rotation_from_angles

    return se3.pose(t1[:, :3], rotation_from_angles("zxz", np.column_stack([t1[:, 3:], phi]))), t2


def table_2() -> str:
    poses, t2 = tables_of_004()
    return ", ".join(f"{v:.4f}" for v in np.ptp(misses(poses, t2[:, :3], t2[:, 3:6], t2[:, 6]), axis=0) / 2.0)


def synthesis() -> str:
    poses, _ = tables_of_004()
    path, names = FOLDER / "poses.csv", "x_mm,y_mm,z_mm,qx,qy,qz,qw"
    np.savetxt(path, poses, delimiter=",", header=names, comments="", fmt="%.17g")
    done = CliRunner().invoke(app, ["dyads", str(path), "--out", str(FOLDER / "links"), "--free", "point-on-a-line", "--force", "--json"])
    assert done.exit_code == 0, done.output
    found = json.loads(done.output)["figures"]
    return f"{found['largest_miss_mm']:.5f} by least squares, {found['largest_miss_minimax_mm']:.5f} by minimax"


def table_5_1() -> str:
    base = [(3, -4.5, 0), (4, -0.5, 0), (2, -1.5, 0), (3, 1, 0), (2, 1, 0), (0, -2, 0)]
    path = structure(base, [(3, -3, 3), (2, 1, 3), (0, -2, 3)], [(1, 1), (2, 1), (3, 1), (4, 2), (5, 2), (6, 3)])
    return ", ".join(f"{v:.1f}" for v in run("structure", path, "--position-mm", "0,0,0")["pressure_angles_deg"])


def inverse_of_chains() -> str:
    file = any_shipped("three-prr")
    assert isinstance(file, ParallelFile)
    robot = file.model
    joints = robot.inverse(robot.home)[0]
    return f"forward of the inverse: {np.abs(robot.forward(joints[None])[0] - robot.home).max():.0e} mm"


def mobility(name: str) -> str:
    own = run("mechanism", name)["mobility"]
    pairs = ", ".join(f"{k} = {v}" for k, v in own["pairs"].items() if v)
    return f"{own['bodies']} bodies, {pairs}: W = {own['freedoms']} + {own['rods_turn']}"


def four_chains() -> str:
    text = 'schema = "lmeasure.robot/1"\nname = "four"\nkind = "parallel"\nhome = { position_mm = [0.0, 0.0, 172.0] }\n'
    rod = float(1e3 * np.hypot(np.sqrt(8.0) - 2.0, 0.172))
    slide = 'type = "radial"\nslide_min_mm = 1.0\nslide_max_mm = 3000.0\n'
    for i, (x, y, kind) in enumerate(
        (
            (1e3, 2e3, slide),
            (-1e3, 2e3, slide),
            *((x, -2e3, f'type = "carriage"\nrod_mm = {rod}\nelbow = {e}\n') for x, e in ((-1e3, 2), (1e3, 1))),
        ),
        1,
    ):
        text += f'[[leg]]\nname = "leg_{i}"\nplatform_mm = [{x}, {y}, 0.0]\nring_mm = 3000.0\nmin_deg = -400.0\nmax_deg = 800.0\n{kind}'
    path = FOLDER / "four.toml"
    path.write_text(text, encoding="utf-8")
    joints = run("mechanism", path)["joints"]
    turns = [f"{np.radians(v) % (2.0 * np.pi):.4f}" for k, v in joints.items() if k.endswith("_deg")]
    return ", ".join([*turns, *(f"{v / 1e3:.4f}" for k, v in joints.items() if k.endswith("_slide_mm"))][:5])


def wrenches() -> str:
    a, b, c, d, e = 0.638, 0.7701, 2.1781, 0.2715, 0.7947
    rows = [
        [0, a, b, -c, b, -a], [0, a, b, -c, -b, a], [-d, -0.543, e, 2.1323, -1.0661, 0], [0.8944, -0.4472, 0, 0.4472, 0.8944, -2.2361],
        [d, -0.543, e, 2.1323, 1.0661, 0], [0.8944, 0.4472, 0, -0.4472, 0.8944, -2.2361],
    ]  # fmt: skip
    return f"{np.linalg.det(rows):.3f}"


EX4 = [(0, 0, 0), (1, 0, 0), (0, 3, 0), (0, 2, 0), (3, 0, 0), (2, 1, 0)]
ROWS = (
    Row(
        "thesis 1",
        "structures that determine a pose",
        "`structure --list`",
        "59",
        lambda: str(sum(s.degenerate is None for s in structures())),
    ),
    Row(
        "thesis 2.1",
        "freedoms W of figure 3.1",
        "`somov_malyshev`",
        "15 = 6 + 9",
        lambda: "{} + {}".format(*somov_malyshev(rods=3, fingers=False)),
    ),
    Row("thesis 2.2, 2.3", "drives moved, rods, L-222-321", "`structure --list`", "3 and 3", variants),
    Row(
        "thesis 3", "mobility with input rods merged with links", "`somov_malyshev`", "6", lambda: str(somov_malyshev(rods=3, merged=1)[0])
    ),
    Row("thesis 3", "kinematics and workspace with input rods", "`structure input-rods`", "-", input_rods),
    Row(
        "thesis 4.1",
        "assembly modes of given lengths",
        "`structure FILE`",
        "P1 (2.5625, 6.6875, 9.285)",
        assembly,
        "corrected: B, P3 and P4",
    ),
    Row(
        "thesis 4.2",
        "limits of l3 without a singular pose",
        "`structure --design`",
        "4.9; 4.54; 4.923",
        band,
        "corrected: not reproducible",
    ),
    Row(
        "thesis 4.2",
        "which drive leads out, which jams",
        "`structure --singular`",
        "-",
        lambda: ", ".join(f"{k} {v}" for k, v in singular_columns()["leads_out"].items() if v != "no part"),
    ),
    Row("thesis 4.1", "drives below the base, rods", "`structure rods`", "(4.11), (4.12)", rods, "corrected: (4.11)"),
    Row("thesis 4.3", "design without singular poses", "`structure rods --design`", "A1A2 above 45.10", design_of_rods),
    Row("thesis 4.3", "A1B2; flat A1A2", "`RodLinks`, `bands`", "35.32 to 41.96; to 45.10", flat, "corrected: an upper end too"),
    Row("thesis 4.4", "screw method", "`link_rows`", "det -2, (.05, .05, -.1; 0, -.1, .05)", screw, "corrected: a sign of P1"),
    Row(
        "thesis 4.5",
        "gradient of the columns",
        "`structure --singular`",
        "0.016 about z",
        lambda: ", ".join(f"{v:z.3g}" for v in singular_columns()["gradient"]),
        "corrected: 6.5",
    ),
    Row(
        "thesis 4.5",
        "extra drive of chain 6 at the base",
        "`structure --singular`",
        "-",
        lambda: next(
            f"{one['drives'][0]['rates'][0]:.3f}" for one in singular_columns()["extra_drives"] if one["drives"][0]["link"] == "link 6"
        ),
    ),
    Row(
        "thesis 4.6",
        "gradient twist, example 1",
        "`gradients`",
        "(0; 0; 0; 0; 0; 2.828)",
        lambda: gradient(EX1, [(0, 0, 0)] * 3 + [(-1, 1, 0), (-1, -1, 0), (0, -1, 0)]),
    ),
    Row(
        "thesis 4.6",
        "gradient twist, example 2",
        "`gradients`",
        "(0; -2.828; 2.828; 0; 0; 5.657)",
        lambda: gradient(EX1, [(0.5, 0, 0), (-0.5, 0, 0), (0, 0, 0), (-1, 1, 0), (-1, -1, 0), (0, -1, 0)]),
    ),
    Row(
        "thesis 4.6",
        "gradient twist, example 3",
        "`gradients`",
        "along (0, 1, 0; 0, 0, 6.5)",
        lambda: gradient(
            [EX3[0], EX3[1], EX3[2], EX3[0], EX3[1], EX3[2]], [(1, 4.5, 0), (1, 4.5, 0), (-1, 3.5, 0), (-1, 3.5, 0), (0, 3, 0), (0, 3, 0)]
        ),
    ),
    Row(
        "thesis 4.6",
        "gradient twist, example 4",
        "`gradients`",
        "along (0, 0, 1; 0, 1.333, 0)",
        lambda: gradient(EX4, [(1, 0, 2), (1, 0, 2), (1, 0, 3), (1, 0, 3), (2, 0, 2), (2, 0, 2)]),
        "corrected: the points are those of its matrix",
    ),
    Row("thesis 5.1", "table 5.1, pressure angles", "`structure --position-mm`", "36.7, 57.2, 61.2, 72.1, 72, 0", table_5_1),
    Row(
        "thesis 5.1",
        "pressure angles at a singular pose",
        "`structure --position-mm`",
        "90 degrees",
        lambda: ", ".join(f"{v:.0f}" for v in run("structure", structure(*COLUMNS), "--position-mm", "0,0,0")["pressure_angles_deg"]),
    ),
    Row("thesis 5.2", "corrected path", "`detour`, `program --correct`", "least determinant 0.0207", led, "corrected: the interval"),
    Row("thesis 5.3", "boundary of the workspace", "`structure --boundary xz`", "closed", edge, "corrected: open without 84 degrees"),
    Row("thesis 5.4", "instrument of drums, pulleys and encoders", "`rig.toml`, `import`", "-", lambda: "see published-rig.md"),
    Row("thesis 5.5", "points of the base from counts", "`calibrate`", "-", lambda: "see published-rig.md"),
    Row("thesis 5.6", "trajectory from counts", "`reconstruct`", "-", lambda: "see published-rig.md"),
    Row(
        "thesis 5.7",
        "limit of the pressure angle for 0.05 mm",
        "`zone --limit-deg`",
        "60 degrees",
        lambda: f"{np.degrees(np.arccos(0.025 / 0.05)):.1f} degrees",
    ),
    Row("thesis 5.8", "turn of a leg on Hooke joints", "`mechanism logos`", "16.555 degrees", hooke),
    Row(
        "thesis, conclusion",
        "two parts of a motion near singular poses",
        "`structure --trajectory --parts`",
        "-",
        lambda: "see singular_motions.md",
    ),
    Row("001, 3", "PRR chains: inverse problem, equation (4)", "`mechanism three-prr`", "-", inverse_of_chains, "corrected: a minus of b"),
    Row(
        "001, 4",
        "PRR chains: area of the workspace",
        "`mechanism three-prr`",
        "-",
        lambda: "{:.0f} mm²".format(
            run("mechanism", "three-prr", "--x=-250:250:5", "--y=-250:250:5", "--z=0:0:1")["workspace"]["area_mm2"]
        ),
    ),
    Row("002, 2.1", "mobility with slides", "`mechanism four-chains`", "W = 6", lambda: mobility("four-chains")),
    Row("002, 2.2", "mobility with arms", "`mechanism four-chains-arms`", "W = 6", lambda: mobility("four-chains-arms")),
    Row(
        "002, 3.1",
        "workspace of the rotopod, six coordinates",
        "`mechanism rotopod --tilt-rad`",
        "-",
        lambda: scan("rotopod", "960:980:10"),
    ),
    Row(
        "002, 3.2",
        "workspace of four chains, six coordinates",
        "`mechanism four-chains-cabin`",
        "-",
        lambda: scan("four-chains-cabin", "960:1040:10"),
    ),
    Row(
        "002, 4.1",
        "velocities of the rotopod",
        "`mechanism --matrices`",
        "q1 5.53, (0, 0, 0.1; 0, 0, 0)",
        rotopod,
        "corrected: r and ten entries",
    ),
    Row(
        "002, 4.2",
        "joint values of four chains",
        "`mechanism`",
        "1.107, 2.034, 4.373, 5.052, 0.783",
        four_chains,
        "corrected: rods of 0.8461",
    ),
    Row("002, 5.1", "determinant of six wrenches", "numpy", "-3.945", wrenches, "corrected: a sign of row four"),
    Row("002, 5.2", "vibration", "`motion`", "18.8 Hz, 25 Hz", lambda: "spectrum of a recorded run", "same; no record in print"),
    Row("002, 5.3", "steps of 1.8 ± 0.09 degrees", "`resolution_deg` in robot.toml", "-", lambda: "U95 of the pose"),
    Row("003, 1", "inverse problem of the cranks", "`mechanism crank-platform`", "-", lambda: mobility("crank-platform")),
    Row("003, 2, 3", "forward solution; workspace by drives", "`mechanism crank-platform --drives`", "-", cranks, "corrected: C3, b6"),
    Row("004, table 2", "half ranges of five links", "`misses`", "0.0010, 0.0005, 0.0016, 0.0008, 0.0006", table_2, "corrected: l5"),
    Row("004, 7 to 10", "synthesis with the turn free", "`dyads --free point-on-a-line`", "0.0016", synthesis),
    Row("004, 6", "positions that five links take exactly", "N (n S - m) <= n k - m", "8", lambda: str((5 * 7 - 1) // (5 - 1))),
)


def main() -> None:
    arguments = options(__doc__).parse_args()
    rows = []
    for row in ROWS:
        rows.append(
            (
                row.section,
                row.subject,
                row.how,
                row.printed,
                row.ours(),
                "not printed" if row.printed == "-" and row.verdict == "same" else row.verdict,
            )
        )
        print(rows[-1], flush=True)
    text = f"""# The source documents, section by section

Use this page to find the command for a section of the source documents, and to see where their print is wrong. The thesis is Rashoyan's
(2021). 001 is on PRR chains, 002 is Skvortsov's thesis (2017), 003 is on the crank platform, 004 on synthesis. The command
`python benchmarks/documents.py --write` computes the table.

{table(("section", "subject", "command or function", "printed", "ours", "print"), rows)}

The pages on [structures](structures.md), [assembly modes](assemblies.md), [singular poses](singularities.md), [lengths](free-lengths.md),
[workspaces](workspaces.md), [mechanisms](mechanisms.md) and [the published rig](published-rig.md) list every misprint. The published rig
has sections 5.4 to 5.7. Chapter 1 of the thesis and of 002 is a review, and 5.3.2 of 002 is on hardware. They have nothing to compute.
"""
    path = arguments.out or PAGE
    if arguments.write or arguments.out:
        path.write_text(text, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
