"""A rig as real ones are, for tests and benchmarks only: nothing here imports lmeasure or shares its code.

A forward model in NumPy of drums, swivelling pulleys and straight cables, as the text of a rig file describes them, with what real rigs
have beside it: counters zeroed somewhere within their count, drums of another circumference or groove, that run out, pulleys off their
axis, friction and play of the encoders, attachment points off their drawing, warm days. Millimetres and radians.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

FloatArray = NDArray[np.float64]

COUNTS_PER_REVOLUTION = 6000
COUNT_MM = 0.012


@dataclass(frozen=True)
class Flaws:
    """What a real rig does and its drawing does not say; all zero: the drawing's own world, but for the phase of its counters.

    circumference: relative error of the cable per turn, 1 sigma, another for each drum. pitch_mm: of the groove's pitch, likewise.
    run_out_mm: amplitude of the length error over a turn of the drum. eccentric_mm: of the pulley's centre off its axis. friction_counts
    and play_counts: width of the band within which a reading lies by the way it was come from. attachment_mm: per coordinate.
    expansion_per_k: of the cable against the frame. phase: counters are zeroed anywhere within a count.
    """

    circumference: float = 0.0
    pitch_mm: float = 0.0
    run_out_mm: float = 0.0
    eccentric_mm: float = 0.0
    friction_counts: float = 0.0
    play_counts: float = 0.0
    attachment_mm: float = 0.0
    expansion_per_k: float = 0.0
    phase: bool = True


@dataclass(frozen=True)
class RigErrors:
    """The errors of one rig, drawn: per cable (m,), per pulley and drum two components (m, 2), per attachment point (points, 3)."""

    stretch: FloatArray
    pitch_mm: FloatArray
    run_out_mm: FloatArray
    eccentric_mm: FloatArray
    band_counts: float
    tool: FloatArray
    expansion_per_k: float
    phase: bool


@dataclass(frozen=True)
class RealRig:
    """The true dimensions of m cables, and their flaws: base (m, 3), alpha, beta, radius, tangent, axial, pitch (m,), tool (points, 3),
    tied (m,) index of each cable's attachment point."""

    base: FloatArray
    alpha: FloatArray
    beta: FloatArray
    radius: FloatArray
    tangent: FloatArray
    axial: FloatArray
    pitch: FloatArray
    tool: FloatArray
    tied: NDArray[np.int64]
    flaws: RigErrors

    @property
    def arriving(self) -> FloatArray:
        """(m, 3) unit directions in which the cables travel at B."""
        way = [np.cos(self.alpha) * np.sin(self.beta), np.cos(self.alpha) * np.cos(self.beta), -np.sin(self.alpha)]
        return -np.stack(way, axis=1)

    def spans(self, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n, m) lengths from B over the pulley to the attachment point, and (n, m, 3) unit directions of the free spans."""
        tied = (self.tool + self.flaws.tool)[self.tied]
        points = poses[:, None, :3] + np.einsum("nab,mb->nma", Rotation.from_quat(poses[:, 3:]).as_matrix(), tied)
        u = self.arriving
        d = points - self.base
        along = np.einsum("nmi,mi->nm", d, u)
        across = d - along[..., None] * u
        height = np.linalg.norm(across, axis=2)
        n = across / height[..., None]
        w = height - self.radius
        free = np.sqrt(along**2 + w**2 - self.radius**2)
        wrap = np.mod(np.arctan2(w, along) + np.arctan2(self.radius, free), 2 * np.pi)
        leaving = np.cos(wrap)[..., None] * u + np.sin(wrap)[..., None] * n
        return self.radius * wrap + free, leaving

    def counts(
        self, poses: FloatArray, zero: FloatArray, way: FloatArray | None = None, warmer_k: float = 0.0, phase: FloatArray | None = None
    ) -> FloatArray:
        """(n, m) recorded whole counts at poses (n, 7), zeroed at the pose zero (7,); way (n, m): -1 to 1, whence each reading was come to
        within the band of friction and play; phase (m,) [counts]."""
        true = self.true_counts(poses, zero, warmer_k)
        if way is not None:
            true = true + way * self.flaws.band_counts / 2
        if phase is not None and self.flaws.phase:
            true = true + phase
        return np.rint(true)

    def true_counts(self, poses: FloatArray, zero: FloatArray, warmer_k: float = 0.0) -> FloatArray:
        """(n, m) counts, not rounded, without friction."""
        every = np.vstack([zero[None], poses])
        lengths, leaving = self.spans(every)
        u = self.arriving
        side = u - leaving
        normal = leaving - np.einsum("nmi,mi->nm", leaving, u)[..., None] * u
        normal /= np.maximum(np.linalg.norm(normal, axis=2), 1e-12)[..., None]
        f, cable = self.flaws, COUNT_MM * (1.0 + self.flaws.stretch)
        pitch = (self.pitch + f.pitch_mm) / COUNTS_PER_REVOLUTION
        k = np.zeros_like(lengths)
        for _ in range(30):
            turn = 2 * np.pi * k / COUNTS_PER_REVOLUTION
            wound = k * cable + f.run_out_mm[:, 0] * np.cos(turn) + f.run_out_mm[:, 1] * np.sin(turn)
            # the pulley turns with the cable; its centre goes round the axis, in the plane of u and the free span
            spin = k * cable / self.radius
            a = f.eccentric_mm[:, 0] * np.cos(spin) - f.eccentric_mm[:, 1] * np.sin(spin)
            b = f.eccentric_mm[:, 0] * np.sin(spin) + f.eccentric_mm[:, 1] * np.cos(spin)
            moved = a * np.einsum("nmi,mi->nm", side, u) + b * np.einsum("nmi,nmi->nm", side, normal)
            drum = np.hypot(self.tangent, self.axial + k * pitch)
            # the measured cable: what is laid out by the geometry, less what its own warmth adds
            laid = lengths + drum + moved
            warm = laid * f.expansion_per_k * warmer_k
            wanted = (laid - warm) - (laid - warm)[0]
            k = k + (wanted - (wound - wound[0])) / cable
            k[0] = 0.0
        return np.asarray(k[1:])

    def nominal(self, name: str = "real") -> dict[str, Any]:
        """What the drawing of this very rig says: rig.toml as a dictionary."""
        return {
            "schema": "lmeasure.rig/1",
            "unstated": "exact",
            "name": name,
            "observation_point": [
                {
                    "name": f"B{j + 1}",
                    "position_mm": self.base[j].tolist(),
                    "guide_alpha_deg": float(np.degrees(self.alpha[j])),
                    "guide_beta_deg": float(np.degrees(self.beta[j])),
                    "pulley_radius_mm": float(self.radius[j]),
                    "drum": {
                        "counts_per_revolution": COUNTS_PER_REVOLUTION,
                        "count_length_mm": COUNT_MM,
                        "groove_pitch_mm": float(self.pitch[j]),
                        "tangent_length_mm": float(self.tangent[j]),
                        "axial_offset_mm": float(self.axial[j]),
                    },
                }
                for j in range(len(self.base))
            ],
            "tool": {f"P{i + 1}": p.tolist() for i, p in enumerate(self.tool)},
            "cable": [
                {"name": f"c{j + 1}", "channel": f"ch{j + 1}", "from": f"B{j + 1}", "to": f"P{self.tied[j] + 1}"}
                for j in range(len(self.base))
            ],
        }

    def drawing(self, rng: np.random.Generator, off_mm: float = 1.0, off_deg: float = 0.5) -> dict[str, Any]:
        """`nominal` as somebody measured it: points off_mm and guides off_deg off, 1 sigma, stated as such."""
        data = self.nominal()
        for p in data["observation_point"]:
            p["position_mm"] = (np.array(p["position_mm"]) + rng.normal(0, off_mm, 3)).tolist()
            p["guide_alpha_deg"] += rng.normal(0, off_deg)
            p["guide_beta_deg"] += rng.normal(0, off_deg)
            p["u_position_mm"], p["u_guide_deg"] = off_mm, off_deg
        return data


def draw(seed: int, flaws: Flaws, cables: int = 6) -> RealRig:
    """A rig around a cell of 600 mm, well conditioned in its middle, with flaws drawn."""
    rng = np.random.default_rng([seed, 41])
    tool = 150.0 * np.array([[0.0, 1.0, 0.0], [-0.8660254037844386, -0.5, 0.0], [0.8660254037844386, -0.5, 0.0]])
    tied = np.sort(np.arange(cables) % 3)
    cell = scattered(np.random.default_rng(5), 64)
    while True:
        way = rng.normal(size=(cables, 3))
        base = way / np.linalg.norm(way, axis=1)[:, None] * rng.uniform(1100.0, 1700.0, cables)[:, None]
        if _conditioned(base, tool[tied], cell):
            break
    # the guide leads away from the cell, turned by up to 40 degrees
    inward = -base / np.linalg.norm(base, axis=1)[:, None]
    u = inward + 0.6 * rng.normal(size=(cables, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    alpha, beta = np.arcsin(u[:, 2]), np.arctan2(-u[:, 0], -u[:, 1])

    def pairs(amplitude: float) -> FloatArray:
        angle = rng.uniform(0, 2 * np.pi, cables)
        return amplitude * np.column_stack([np.cos(angle), np.sin(angle)])

    drawn = RigErrors(
        stretch=rng.normal(0, 1, cables) * flaws.circumference,
        pitch_mm=rng.normal(0, 1, cables) * flaws.pitch_mm,
        run_out_mm=pairs(flaws.run_out_mm),
        eccentric_mm=pairs(flaws.eccentric_mm),
        band_counts=flaws.friction_counts + flaws.play_counts,
        tool=rng.normal(0, 1, tool.shape) * flaws.attachment_mm,
        expansion_per_k=flaws.expansion_per_k,
        phase=flaws.phase,
    )
    return RealRig(
        base, alpha, beta, rng.uniform(15.0, 30.0, cables), rng.uniform(130.0, 240.0, cables), rng.uniform(20.0, 30.0, cables),
        rng.uniform(0.8, 1.6, cables), tool, tied, drawn,
    )  # fmt: skip


def _conditioned(base: FloatArray, arms: FloatArray, poses: FloatArray) -> bool:
    """Whether straight cables from base (m, 3) to arms (m, 3) of the tool determine all of the poses (n, 7) well."""
    r = np.einsum("nab,mb->nma", Rotation.from_quat(poses[:, 3:]).as_matrix(), arms)
    e = poses[:, None, :3] + r - base
    e /= np.linalg.norm(e, axis=2)[..., None]
    rows = np.concatenate([np.cross(r, e) / 150.0, e], axis=2)
    return bool(np.linalg.svd(rows, compute_uv=False)[:, 5].min() > 0.2)


def scattered(rng: np.random.Generator, count: int, half_mm: float = 300.0, tilt: float = 0.3) -> FloatArray:
    """(n, 7) poses within half_mm and tilt [rad] of the middle."""
    return np.column_stack(
        [rng.uniform(-half_mm, half_mm, (count, 3)), Rotation.from_rotvec(rng.uniform(-tilt, tilt, (count, 3))).as_quat()]
    )


def path(rng: np.random.Generator, count: int, half_mm: float = 250.0, tilt: float = 0.25) -> FloatArray:
    """(n, 7) poses of a smooth way through the cell, beginning in its middle."""
    s = np.linspace(0.0, 1.0, count)[:, None]
    a, b = rng.uniform(0.3, 1.0, (2, 6)), rng.integers(1, 4, 6)
    wave = np.sin(2 * np.pi * b * s) * a[0] + np.sin(2 * np.pi * (b + 1) * s) * (1 - a[0]) * a[1]
    return np.column_stack([half_mm * wave[:, :3], Rotation.from_rotvec(tilt * wave[:, 3:]).as_quat()])


def stated(rng: np.random.Generator, poses: FloatArray, u_mm: float, u_rad: float) -> FloatArray:
    """(n, 7) the poses as a robot or tracker says them: errors of these standard deviations."""
    out = poses.copy()
    out[:, :3] += rng.normal(0, 1, (len(poses), 3)) * u_mm
    out[:, 3:] = (Rotation.from_rotvec(rng.normal(0, 1, (len(poses), 3)) * u_rad) * Rotation.from_quat(poses[:, 3:])).as_quat()
    return out


def without(rig: RealRig, **flaws: Any) -> RealRig:
    """The rig with some of its drawn flaws replaced."""
    return replace(rig, flaws=replace(rig.flaws, **flaws))
