"""Slow study: what becomes of calibrations and runs when nobody states how good drums, pulleys, attachment points and reference poses are.

    python benchmarks/unstated.py --rigs 24 --keep benchmarks/results/unstated.jsonl --write

The simulator below shares no code with lmeasure. A world breaks one assumption of the solver. Each rig is calibrated by 20 reference poses,
and then measures a motion whose start, the calibration's zero pose, is stated to be exact. Both state 20 deg C. "stated": rig.toml
and reference_poses.csv state the typical size of every effect that the world has, and 0 of the others; "unstated": they state nothing. A
world that is broken beyond its sizes states the typical ones. "exact": the plain fit, with stated references and nothing else uncertain.

inside: share of measured positions in the 95 % region; u: stated standard uncertainty of a coordinate [mm]; refused: exit with a message;
warnings: codes of the rigs that were not refused, with the number of rigs where it is not all.
"""

import itertools
import math
import tempfile
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from study import Study, percent, table

FloatArray = NDArray[np.float64]

COUNT_MM, TURN = 0.012, 6000
SIZES = {
    "u_count_length_mm": 5e-4 * COUNT_MM, "u_groove_pitch_mm": 0.01, "u_run_out_mm": 0.02, "u_pulley_eccentricity_mm": 0.05,
    "u_swivel_offset_mm": 0.05, "u_attachment_mm": 0.3, "u_backlash_counts": 1.0, "u_friction_counts": 4.0,
}  # fmt: skip
"""Typical sizes, by the keys of rig.toml."""
MODES = ("unstated", "exact", "stated")


@dataclass(frozen=True)
class World:
    """What is wrong: sizes of effects by their keys, of references [mm, rad], and of single breaks."""

    sizes: dict[str, float] = field(default_factory=dict)
    u_mm: float = 0.05
    u_rad: float = 0.0
    poses: int = 20
    fault: str = ""
    robot_mm: float = 0.3
    kind: str = "broken"
    elsewhere: bool = False
    """Whether the run's counters are set to zero at another pose than the calibration's; measured: with lengths there by a tape measure."""
    measured: bool = True


def _typical(**other: float) -> dict[str, float]:
    return SIZES | other


WORLDS = {
    "sound": World(kind="sound"),
    "sound, 0.01 mm and 0.01 mrad": World(u_mm=0.01, u_rad=1e-5, kind="sound"),
    "sound, 40 poses": World(poses=40, kind="sound"),
    "sound, 12 poses": World(poses=12, kind="sound"),
    "typical": World(_typical(), u_rad=1e-4, kind="typical"),
    "typical, 40 poses": World(_typical(), u_rad=1e-4, poses=40, kind="typical"),
    "typical, 12 poses": World(_typical(), u_rad=1e-4, poses=12, kind="typical"),
    "typical, references 0.2 mm": World(_typical(), u_mm=0.2, u_rad=4e-4, kind="typical"),
    "sound, zeroed elsewhere": World(kind="sound", elsewhere=True),
    "typical, zeroed elsewhere": World(_typical(), u_rad=1e-4, kind="typical", elsewhere=True),
    "zeroed elsewhere, lengths not stated": World(elsewhere=True, measured=False),
    "attachments 2 mm": World({"u_attachment_mm": 2.0}),
    "attachments 0.5 mm": World({"u_attachment_mm": 0.5}),
    "circumferences 0.2 %": World({"u_count_length_mm": 2e-3 * COUNT_MM}),
    "one circumference 0.3 %": World(fault="circumference"),
    "one drum 5 mm": World(fault="drum"),
    "one attachment 3 mm": World(fault="attachment"),
    "eccentricities 0.3 mm": World({"u_pulley_eccentricity_mm": 0.3}),
    "run-out 0.15 mm": World({"u_run_out_mm": 0.15}),
    "friction 30 counts": World({"u_friction_counts": 30.0}),
    "a point moves 1 mm": World(fault="moved"),
    "a typing error of 10 mm": World(fault="typo"),
    "two poses exchanged": World(fault="exchanged"),
    "angles of another convention": World(fault="convention"),
    "a sticking swivel": World(fault="sticking"),
    "references of a robot 0.3 mm": World(fault="robot"),
    "references 0.3 mm, 0.3 mrad": World(u_mm=0.3, u_rad=3e-4),
    **{
        f"robot {size:g} mm, {n} poses": World(fault="robot", robot_mm=size, poses=n, u_mm=0.02, kind="robot")
        for size in (0.1, 0.3, 1.0)
        for n in (20, 100)
    },
}


def rotation(w: FloatArray) -> FloatArray:
    """(3, 3) of a rotation vector (Rodrigues)."""
    a = float(np.linalg.norm(w))
    K = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    return np.eye(3) + K * np.sinc(a / np.pi) + K @ K * 0.5 * np.sinc(a / 2 / np.pi) ** 2


def quaternion(R: FloatArray) -> FloatArray:
    """(4,) x, y, z, w, from the eigenvector of Bar-Itzhack's matrix."""
    K = np.array([
        [R[0, 0] - R[1, 1] - R[2, 2], R[1, 0] + R[0, 1], R[2, 0] + R[0, 2], R[2, 1] - R[1, 2]],
        [R[1, 0] + R[0, 1], R[1, 1] - R[0, 0] - R[2, 2], R[2, 1] + R[1, 2], R[0, 2] - R[2, 0]],
        [R[2, 0] + R[0, 2], R[2, 1] + R[1, 2], R[2, 2] - R[0, 0] - R[1, 1], R[1, 0] - R[0, 1]],
        [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], R.trace()],
    ])  # fmt: skip
    return np.linalg.eigh(K)[1][:, 3]


def matrix(q: FloatArray) -> FloatArray:
    """(3, 3) of a quaternion x, y, z, w."""
    x, y, z, w = q
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


@dataclass
class Drum:
    """A true observation point with pulley and drum."""

    place: FloatArray
    alpha: float
    beta: float
    radius: float
    count: float
    pitch: float
    tangent: float
    axial: float
    run_out: FloatArray
    eccentric: FloatArray
    offset: float
    half_band: float
    sticking: float = 0.0

    @property
    def way(self) -> FloatArray:
        """Unit direction of the cable at B."""
        a, b = self.alpha, self.beta
        return np.array([-math.cos(a) * math.sin(b), -math.cos(a) * math.cos(b), math.sin(a)])

    def free(self, P: FloatArray, passed: float, normal: FloatArray | None = None) -> float:
        """Length from B to P when so much cable has passed the pulley."""
        u, v = self.way, P - self.place
        n = v - (v @ u) * u if normal is None else normal
        n = n / np.linalg.norm(n)
        psi = passed / self.radius
        shift = self.eccentric[0] * np.array([math.cos(psi), math.sin(psi)])
        shift += self.eccentric[1] * np.array([-math.sin(psi), math.cos(psi)])
        shift += np.array([0.0, self.offset])
        x, y = v @ u - shift[0], v @ n - shift[1] - self.radius
        beside = v - (v @ u) * u - (v @ n) * n
        far = math.sqrt(max(x * x + y * y - self.radius**2, 0.0))
        wrap = math.atan2(y, x) + math.atan2(self.radius, far)
        return self.radius * (wrap % (2 * math.pi)) + math.hypot(far, float(np.linalg.norm(beside))) + shift[0]

    def paid(self, k: float) -> float:
        """Cable that the drum has paid out at true count k."""
        turn = 2 * math.pi * k / TURN
        helix = k * self.count - math.hypot(self.tangent, self.axial + self.pitch * k / TURN) + math.hypot(self.tangent, self.axial)
        return helix + self.run_out[0] * (math.cos(turn) - 1) + self.run_out[1] * math.sin(turn)

    def counts(self, points: FloatArray, moved_at: int = 10**9, move: FloatArray | None = None) -> FloatArray:
        """(n,) whole counts at points (n, 3), zeroed at the first; moved_at: the point is elsewhere from there on."""
        begun = self.free(points[0], 0.0)
        rng = np.random.default_rng(abs(int(1e6 * begun)))
        # the cable came to where the counter is zeroed, and the encoder is at that side of its band
        phase, k, play, out = rng.uniform(-0.5, 0.5), 0.0, rng.choice([-1.0, 1.0]) * self.half_band, []
        zero, home, normal = play, self.place, None
        for i, P in enumerate(points):
            if i == moved_at and move is not None:
                self.place = home + move
            u = self.way
            n = P - self.place - ((P - self.place) @ u) * u
            n /= np.linalg.norm(n)
            if normal is not None and self.sticking:
                # the swivel follows by all but an angle of friction
                side = float(np.cross(normal, n) @ u)
                n = rotation(-u * math.copysign(min(self.sticking, abs(side)), side)) @ n
            normal = n
            for _ in range(12):
                # a helix is nearly linear in k, and so is Newton's step
                paid = self.paid(k)
                step = (paid - (self.free(P, paid, n if self.sticking else None) - begun)) / self.count
                k -= step
                if abs(step) < 1e-9:
                    break
            # the encoder follows when the band is crossed
            play = min(max(play, k - self.half_band), k + self.half_band) if self.half_band else k
            out.append((play - zero if self.half_band else k) + phase)
        self.place = home
        return np.rint(out)


ROBOTS = (
    # wrist whose axes meet; three parallel axes; inclined wrist; four axes of assembly with a tilting wrist
    ([[0, 600, 50, 90], [0, 0, 900, 0], [0, 0, 70, 90], [0, 850, 0, -90], [0, 0, 0, 90], [0, 120, 0, 0]], [0, 100, -40, 0, 50, 0], 9),
    ([[0, 180, 0, 90], [0, 0, -900, 0], [0, 0, -800, 0], [0, 170, 0, 90], [0, 120, 0, -90], [0, 110, 0, 0]], [0, -100, 90, -80, -90, 0], 9),
    (
        [[0, 700, 200, 90], [0, 0, 1100, 0], [0, 0, 150, 90], [0, 1200, 0, -60], [0, 150, 0, 60], [0, 120, 0, 0]],
        [0, 100, -40, 20, 70, 0],
        9,
    ),
    ([[0, 900, 700, 0], [0, 0, 600, 180], [0, 400, 0, 0], [0, 150, 0, -90], [0, 0, 0, 90], [0, 150, 0, 0]], [-40, 80, 0, 20, 60, 0], 2),
)
"""Robots of six axes: theta, d, a, alpha of the joints (standard Denavit-Hartenberg), joint values in the middle, and the joint that
slides (none: 9); mm and degrees."""


def _chain(dh: FloatArray, q: FloatArray, slides: int) -> tuple[FloatArray, FloatArray]:
    """(n, 4, 4) where a robot is at joint values (n, 6) in radians and metres, and its derivatives (n, 6, 6), positions first."""
    T, frames = np.broadcast_to(np.eye(4), (len(q), 4, 4)), []
    for i, ((theta, d, a, alpha), value) in enumerate(zip(dh, q.T, strict=True)):
        frames.append(T)
        t, al = math.radians(theta) + value * (i != slides), math.radians(alpha)
        c, s, ca, sa, o = np.cos(t), np.sin(t), math.cos(al), math.sin(al), np.zeros(len(q))
        link = [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [o, o + sa, o + ca, o + d + 1e3 * value * (i == slides)]]
        T = T @ np.moveaxis(np.array([*link, [o, o, o, o + 1]]), 2, 0)
    J = np.zeros((len(q), 6, 6))
    for i, F in enumerate(frames):
        z, arm = F[:, :3, 2], T[:, :3, 3] - F[:, :3, 3]
        J[:, :, i] = np.hstack([1e3 * z, 0.0 * z] if i == slides else [np.cross(z, arm), z])
    return T, J


def _turn(D: FloatArray) -> FloatArray:
    """(n, 3) small rotation vectors of matrices."""
    return np.stack([D[:, 2, 1] - D[:, 1, 2], D[:, 0, 2] - D[:, 2, 0], D[:, 1, 0] - D[:, 0, 1]], axis=1) / 2


def robot_errors(rng: np.random.Generator, poses: list[tuple[FloatArray, FloatArray]], size_mm: float, number: int) -> list[Any]:
    """(shift, turn) of where a robot comes to, less where it says, in the base frame: its links are wrong, its gears are eccentric, and it
    gives way to gravity. It comes to all poses in the same configuration."""
    shape, middle_deg, slides = ROBOTS[number % len(ROBOTS)]
    places, turns, weight = np.array([p for p, _ in poses]), np.array([logarithm(R) for _, R in poses]), np.repeat([1.0, 500.0], 3)
    for _ in range(60):
        size = rng.uniform(0.7, 1.5)
        nominal = np.array(shape) * [1, size, size, 1] + rng.normal(0, 1, (6, 4)) * [0, 20.0, 20.0, 0]
        home = np.radians(middle_deg) + rng.normal(0, 0.1, 6)
        middle = _chain(nominal, home[None], slides)[0][0]
        q, worst = np.repeat(home[None], len(poses), axis=0), 0.0
        # a straight way from the middle keeps to one configuration
        for part in np.repeat(np.linspace(0.1, 1.0, 10), 5):
            T, J = _chain(nominal, q, slides)
            R = np.array([rotation(part * w) for w in turns]) @ middle[:3, :3]
            goal = middle[:3, 3] + part * places
            e = np.hstack([goal - T[:, :3, 3], _turn(R @ np.swapaxes(T[:, :3, :3], 1, 2))]) * weight
            J = J * weight[:, None]
            q = q + np.clip(
                np.linalg.solve(np.swapaxes(J, 1, 2) @ J + 1e-6 * np.eye(6), np.einsum("nij,ni->nj", J, e)[..., None])[..., 0], -0.3, 0.3
            )
            worst = float(np.linalg.norm(e, axis=1).max())
        if worst < 1e-6 and np.linalg.cond(J).max() < 100.0:
            break
    else:
        raise ValueError(f"robot {number}: no joint values for a pose")
    small = size_mm / 1000
    wrong = nominal + rng.normal(0, 1, (6, 4)) * [math.degrees(small), size_mm, size_mm, math.degrees(small)]
    bent = q.copy()
    for i in range(6):
        if i != slides:
            for times in (1, 2):
                bent[:, i] += 0.3 * small / times * rng.normal() * np.sin(times * q[:, i] + rng.uniform(0, 2 * np.pi))
            # the torque of a weight at the flange
            bent[:, i] -= 0.3 * small * abs(rng.normal()) * J[:, 2, i] / 1000
    true = _chain(wrong, bent, slides)[0]
    shift, turn = true[:, :3, 3] - goal, _turn(true[:, :3, :3] @ np.swapaxes(R, 1, 2))
    # the base frame is where the robot says it is on the whole: a rigid motion of the field is no error
    A = np.vstack([np.hstack([np.array([[0, p[2], -p[1]], [-p[2], 0, p[0]], [p[1], -p[0], 0]]), np.eye(3)]) for p in places])
    x = np.linalg.lstsq(A, shift.ravel(), rcond=None)[0]
    return [(s - A[3 * i : 3 * i + 3] @ x, t - x[:3]) for i, (s, t) in enumerate(zip(shift, turn, strict=True))]


@dataclass
class Bench:
    """What is true, what the user has, and poses (place, turn)."""

    drums: list[Drum]
    tool: FloatArray
    nominal: dict[str, Any]
    reference: list[tuple[FloatArray, FloatArray]]
    measured: list[tuple[FloatArray, FloatArray]]
    stated: list[tuple[FloatArray, FloatArray]]


NAMES = ("P1", "P2", "P3")


def _places(rng: np.random.Generator, tool: FloatArray) -> FloatArray:
    """(6, 3) the best of some arrangements of points: whose cables tell all six freedoms best at the worst of nine poses."""
    corners = [np.zeros(6), *(np.r_[rng.choice([-1, 1], 3) * 300.0, rng.choice([-1, 1], 3) * 0.3] for _ in range(8))]
    poses = [(v[:3], rotation(v[3:])) for v in corners]

    def least(places: FloatArray) -> float:
        out = []
        for p, R in poses:
            arms = (R @ tool.T).T[[0, 1, 2, 0, 1, 2]]
            e = p + arms - places
            e /= np.linalg.norm(e, axis=1)[:, None]
            out.append(np.linalg.svd(np.hstack([np.cross(arms, e) / 150, e]), compute_uv=False)[-1])
        return float(min(out))

    drawn = rng.normal(size=(400, 6, 3))
    drawn *= rng.uniform(1200, 2200, (400, 6, 1)) / np.linalg.norm(drawn, axis=2, keepdims=True)
    return np.asarray(max(drawn, key=least))


def bench(seed: int, world: World) -> Bench:
    """One drawn rig of six drums, poses within +-300 mm and +-0.3 rad."""
    rng = np.random.default_rng([seed, 31])
    size = world.sizes.get
    tool = np.array([[150 * math.cos(a), 150 * math.sin(a), rng.uniform(-20, 20)] for a in np.radians([90, 210, 330])])
    true_tool = tool + rng.normal(0, 1, (3, 3)) * size("u_attachment_mm", 0.0)
    drums, points = [], []
    for i, place in enumerate(_places(rng, tool)):
        alpha, beta = math.radians(rng.uniform(35, 65)), math.atan2(place[0], place[1]) + math.radians(rng.uniform(-15, 15))
        shape = {"pulley_radius_mm": rng.uniform(12, 30), "pitch": rng.uniform(0.8, 1.6), "tangent": rng.uniform(130, 240)}
        axial = rng.uniform(20, 30)
        drums.append(
            Drum(
                place, alpha, beta, shape["pulley_radius_mm"], COUNT_MM + rng.normal() * size("u_count_length_mm", 0.0),
                shape["pitch"] + rng.normal() * size("u_groove_pitch_mm", 0.0), shape["tangent"], axial,
                rng.normal(0, 1, 2) * size("u_run_out_mm", 0.0), rng.normal(0, 1, 2) * size("u_pulley_eccentricity_mm", 0.0),
                rng.normal() * size("u_swivel_offset_mm", 0.0),
                abs(rng.normal()) * math.hypot(size("u_backlash_counts", 0.0), size("u_friction_counts", 0.0)),
            )
        )  # fmt: skip
        points.append(
            {
                "name": f"B{i + 1}", "position_mm": (place + rng.normal(0, 12, 3).clip(-30, 30)).tolist(),
                "guide_alpha_deg": math.degrees(alpha) + float(np.clip(rng.normal(0, 2), -5, 5)),
                "guide_beta_deg": math.degrees(beta) + float(np.clip(rng.normal(0, 2), -5, 5)),
                "pulley_radius_mm": shape["pulley_radius_mm"],
                "drum": {
                    "counts_per_revolution": TURN, "count_length_mm": COUNT_MM, "groove_pitch_mm": shape["pitch"],
                    "tangent_length_mm": shape["tangent"], "axial_offset_mm": axial,
                },
            }
        )  # fmt: skip
    fault = np.random.default_rng([seed, 37])
    one = drums[int(fault.integers(6))]
    if world.fault == "circumference":
        one.count *= 1 + 0.003 * fault.choice([-1, 1])
    elif world.fault == "drum":
        one.tangent += 5.0 * fault.choice([-1, 1])
    elif world.fault == "attachment":
        d = fault.normal(size=3)
        true_tool[int(fault.integers(3))] += 3.0 * d / np.linalg.norm(d)
    elif world.fault == "sticking":
        # friction holds it 17 degrees behind; by 0.01 rad no count changes by more than one
        one.sticking = 0.3

    def draw(n: int) -> list[tuple[FloatArray, FloatArray]]:
        return [(rng.uniform(-300, 300, 3), rotation(rng.uniform(-0.3, 0.3, 3))) for _ in range(n)]

    reference = draw(world.poses)
    measured = draw(16)
    if not world.elsewhere:
        measured[0] = reference[0]
    wrong = [(rng.normal(0, 1, 3) * world.u_mm, rng.normal(0, 1, 3) * world.u_rad) for _ in reference]
    if world.fault == "robot":
        more = robot_errors(fault, reference, world.robot_mm, seed)
        wrong = [(a - c, b - d) for (a, b), (c, d) in zip(wrong, more, strict=True)]
    stated = [(p + d, rotation(w) @ R) for (p, R), (d, w) in zip(reference, wrong, strict=True)]
    if world.fault == "typo":
        stated[int(fault.integers(1, len(stated)))][0][int(fault.integers(3))] += 10.0
    elif world.fault == "exchanged":
        i, j = fault.choice(np.arange(1, len(stated)), 2, replace=False)
        stated[i], stated[j] = stated[j], stated[i]
    elif world.fault == "convention":
        # written as roll, pitch, yaw about moving axes, read as about fixed ones: the inverse turn
        stated = [(p, R.T) for p, R in stated]
    at_zero = [d.free(reference[0][0] + reference[0][1] @ true_tool[i % 3], 0.0) for i, d in enumerate(drums)]
    tool_table = dict(zip(NAMES, tool.tolist(), strict=True))
    cables: list[dict[str, Any]] = [
        {"name": f"c{i + 1}", "channel": f"ch{i + 1}", "from": f"B{i + 1}", "to": NAMES[i % 3]} for i in range(6)
    ]
    if world.elsewhere and world.measured:
        cables = [c | {"zero_length_mm": round(length)} for c, length in zip(cables, at_zero, strict=True)]
    nominal = {"schema": "lmeasure.rig/1", "name": f"rig {seed}", "observation_point": points, "tool": tool_table, "cable": cables}
    return Bench(drums, true_tool, nominal, reference, measured, stated)


def counted(b: Bench, poses: list[tuple[FloatArray, FloatArray]], world: World, seed: int, *, run: bool) -> FloatArray:
    """(n, 6) whole counts at poses."""
    rng = np.random.default_rng([seed, 41])
    mover, move, when = int(rng.integers(6)), rng.normal(0, 1, 3), len(poses) // 2
    move /= np.linalg.norm(move)
    out = []
    # drums and pulleys stand as they stood in the calibration
    poses = [b.reference[0], *poses] if run else poses
    for i, drum in enumerate(b.drums):
        points = np.array([p + R @ b.tool[i % 3] for p, R in poses])
        moved = world.fault == "moved" and i == mover
        # it moves within the calibration, and stays there
        place = drum.place
        if moved and run:
            drum.place = place + move
        out.append(drum.counts(points, when if moved and not run else 10**9, move))
        drum.place = place
    k = np.column_stack(out)
    return k[1:] - k[1] if run else k


def _toml(nominal: dict[str, Any], mode: str, world: World) -> str:
    """rig.toml of the nominal rig, which states its sizes or nothing."""
    stated = {}
    if mode == "stated":
        own = {key: size for key, size in SIZES.items() if world.kind != "sound"} if world.kind != "typical" else world.sizes
        stated = {key: own.get(key, 0.0) for key in SIZES}
    lines = [f'schema = "lmeasure.rig/1"\nname = "{nominal["name"]}"']
    if mode == "stated":
        lines.append(f"u_attachment_mm = {stated['u_attachment_mm']!r}")
        lines.append("reference_temperature_c = 20.0")
    if mode == "exact":
        lines.append('unstated = "exact"')
    for p in nominal["observation_point"]:
        lines.append("[[observation_point]]")
        of_point = {k: v for k, v in stated.items() if k in ("u_pulley_eccentricity_mm", "u_swivel_offset_mm")}
        lines += [f"{k} = {v!r}" if not isinstance(v, str) else f'{k} = "{v}"' for k, v in (p | of_point).items() if k != "drum"]
        of_drum = {k: v for k, v in stated.items() if k not in of_point and k != "u_attachment_mm"}
        lines += ["[observation_point.drum]", *(f"{k} = {v!r}" for k, v in (p["drum"] | of_drum).items())]
    lines += ["[tool]", *(f"{k} = {v!r}" for k, v in nominal["tool"].items())]
    for c in nominal["cable"]:
        lines += ["[[cable]]", *(f'{k} = "{v}"' if isinstance(v, str) else f"{k} = {v}" for k, v in c.items())]
    return "\n".join(lines) + "\n"


def _pose_rows(poses: list[tuple[FloatArray, FloatArray]]) -> FloatArray:
    return np.array([np.r_[p, quaternion(R)] for p, R in poses])


def folder(where: Path, b: Bench, world: World, seed: int, mode: str) -> None:
    """Write a calibration folder."""
    (where / "rig.toml").write_text(_toml(b.nominal, mode, world))
    data = pd.DataFrame(_pose_rows(b.stated), columns=["x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw"])
    data.insert(0, "pose", [str(i + 1) for i in range(len(data))])
    if mode != "unstated":
        data["u_position_mm"], data["u_rotation_deg"] = world.u_mm, math.degrees(world.u_rad)
    data.to_csv(where / "reference_poses.csv", index=False)
    counts = pd.DataFrame(counted(b, b.reference, world, seed, run=False).astype(int), columns=[f"ch{i + 1}" for i in range(6)])
    counts.insert(0, "pose", data["pose"])
    counts["temperature_c"] = 20.0
    counts.to_csv(where / "counts.csv", index=False)


def draw(seed: int, world: str, mode: str) -> dict[str, Any]:
    """One rig in one world: calibrated, and then 40 poses measured by it."""
    import time

    import lmeasure as lm
    from lmeasure.calibration import CalibrationSettings, calibrate, read_campaign, without_slips

    w = WORLDS[world]
    b = bench(seed, w)
    out: dict[str, Any] = {"world": world, "mode": mode, "seed": seed}
    with tempfile.TemporaryDirectory() as temporary:
        where = Path(temporary)
        folder(where, b, w, seed, mode)
        begun = time.process_time()
        try:
            found = calibrate(without_slips(read_campaign(where), "reference_poses.csv"), CalibrationSettings())
        except (lm.LMeasureError, np.linalg.LinAlgError) as error:
            return out | {"refused": str(error)}
        out["seconds"] = time.process_time() - begun
        out["codes"] = sorted({x.code for x in found.record.warnings})
        if found.refused is not None:
            return out | {"refused": found.refused}
        return out | errors(b, w, seed, found.rig, found.record)


def path(waypoints: list[tuple[FloatArray, FloatArray]], log: Any, steps: int = 20) -> list[tuple[FloatArray, FloatArray]]:
    """A smooth motion through poses, `steps` samples from one to the next."""
    vectors = np.array([np.r_[p, log(R)] for p, R in waypoints])
    at = np.linspace(0, len(vectors) - 1, steps * (len(vectors) - 1) + 1)
    smooth = CubicSpline(np.arange(len(vectors)), vectors, bc_type="clamped")(at)
    return [(v[:3], rotation(v[3:])) for v in smooth]


def logarithm(R: FloatArray) -> FloatArray:
    """(3,) rotation vector of a turn under pi."""
    q = quaternion(R)
    q = q * math.copysign(1.0, q[3])
    s = float(np.linalg.norm(q[:3]))
    return q[:3] * (2.0 * math.atan2(s, q[3]) / s if s else 2.0)


def errors(b: Bench, w: World, seed: int, rig: Any, record: Any) -> dict[str, Any]:
    """Errors of the positions of a motion that the calibrated rig measures from counts, and what is stated of them."""
    import lmeasure as lm
    from lmeasure.recording import Counts, Run

    poses = path(b.measured, logarithm)
    recorded = np.asarray(counted(b, poses, w, seed, run=True), dtype=np.float64)
    counts = Counts(0.05 * np.arange(len(poses), dtype=np.float64), tuple(f"ch{i + 1}" for i in range(6)), recorded)
    run = Run(rig=rig, start=_pose_rows(poses[:1])[0], passes=(counts,), calibration=record, temperature_c=20.0, unstated="exact")
    try:
        found = lm.reconstruct(run)
    except (lm.LMeasureError, np.linalg.LinAlgError) as refusal:
        return {"refused": f"reconstruct: {refusal}"}
    good = (np.asarray(found.status) == 0) & (np.arange(len(poses)) > 20)
    error = (found.poses[:, :3] - np.array([p for p, _ in poses]))[good]
    covariance = (found.random + found.systematic)[good][:, 3:, 3:]
    square = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error)
    return {
        "error_mm": float(np.sqrt(np.mean(error**2))),
        "u_mm": float(np.sqrt(np.mean(np.einsum("nii->n", covariance)) / 3)),
        "inside": float(np.mean(square <= 7.814728)),
        "nees": float(np.mean(square) / 3),
        "ok": float(np.mean(np.asarray(found.status) == 0)),
    }


def page(records: list[dict[str, Any]]) -> str:
    """A row for each world and mode."""
    data = pd.DataFrame(records)
    rows = []
    for mode in dict.fromkeys(data["mode"]):
        for world in [w for w in WORLDS if w in set(data["world"])]:
            own = data[(data["world"] == world) & (data["mode"] == mode)]
            if not len(own):
                continue
            whole = own[own["error_mm"].notna()] if "error_mm" in own else own[:0]
            cells = (
                (f"{np.sqrt(np.mean(whole['error_mm'] ** 2)):.4f}", f"{np.sqrt(np.mean(whole['u_mm'] ** 2)):.4f}",
                 percent(whole["inside"]), f"{np.mean(whole['nees']):.2f}") if len(whole) else ("-",) * 4
            )  # fmt: skip
            codes = Counter(c for own_codes in whole.get("codes", ()) for c in own_codes)
            rows.append(
                (
                    world,
                    mode,
                    len(own),
                    len(own) - len(whole),
                    *cells,
                    f"{whole['seconds'].mean():.1f}" if len(whole) else "-",
                    " ".join(code if count == len(whole) else f"{code} ({count})" for code, count in codes.most_common()),
                )
            )
    return table(("world", "mode", "rigs", "refused", "error / mm", "u / mm", "inside / %", "NEES/3", "s", "warnings"), rows)


def cases(options: Any, _seed: int) -> list[tuple[str, str]]:
    """Return the worlds and modes of a rig: all worlds by what users write first. The plain fit is for worlds that it is right for."""
    every = itertools.product(options.mode, options.world)
    return [(world, mode) for mode, world in every if mode != "exact" or WORLDS[world].kind == "sound"]


STUDY = Study(
    "unstated", draw, page, runs="rigs", count=6, factors={"world": tuple(WORLDS), "mode": MODES}, key="{world} {mode} {seed}", cases=cases
)

if __name__ == "__main__":
    raise SystemExit(STUDY.command(__doc__))
