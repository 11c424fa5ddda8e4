"""Drives outside the work zone: links that end at the far ends of rods (thesis 2.2, 2.3, chapter 3, 4.1, 4.3).

A rod begins in a spherical joint J of one body. Its axis goes through a point T of the other body, and its end is D = J + L w,
w = (T - J)/rho, rho = |T - J|. A rod with L > rho slides through T, and carries the drives on the other side. A rod with L < rho ends
between J and T: there a drive ends on the link beside it (table 2.3). The end moves with one point Y of the moving body, which is J or T:

    dD = K (v + omega x Y),   K = 1 - k (1 - w w') for J on the moving body,   K = k (1 - w w') for T on it,   k = L/rho

A link with the unit direction u between two ends has the rate u . (dD2 - dD1), which is its row. Chapter 3 is the case of J on the base, T
on the platform, and links from D to further points of the platform: each link then acts on the platform with two forces.

If one length gives rho, the lengths between the bodies follow by Stewart's theorem. For a point Q of T's body with c = |T Q|:

    |D Q|^2 = L^2 + d^2 + (L/rho) (c^2 - rho^2 - d^2),   d = |J Q|

These are (4.11), (4.12) and (4.22) to (4.24), with the misprint in (4.11) corrected. Assembly modes and proofs are then those of straight
links from J to Q. The length that gives rho is that of the link D T (L - rho, or rho - L between), or of a straight link J T.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.core import BoolArray, FloatArray, IntArray, se3
from lmeasure.linkages.singularity import cofactors, moved, rim_mm

Point = tuple[float, float, float]
BATCH, MOST, MET, STEPS = 300, 10, 4, 40
"""Starts of one batch, batches, how often each assembly mode must be met, and Newton's steps from a start."""
DIFFERENCE = 1e-5  # Step of difference quotients, as a share of a radian and of the rim
CLOSES, SAME = 1e-10, 1e-6
ROUNDING = 1e-12  # In parts of the rig's size, or of a rod


class End(NamedTuple):
    """End of a link: a point of a body, or the far end of a rod that begins there.

    carried: whether the point is the moving body's; through: point of the other body on the rod's axis; rod_mm: its length, 0 without a
    rod; between: whether the rod ends between both points.
    """

    carried: bool
    point: Point
    through: Point = (0.0, 0.0, 0.0)
    rod_mm: float = 0.0
    between: bool = False


class Beside(NamedTuple):
    """A link that ends at a rod; gauge: the link whose length gives rho; across: |T Q|; direct: the gauge joins J and T themselves."""

    link: int
    gauge: int
    rod: End
    across: float
    direct: bool

    @property
    def by(self) -> float:
        """Rate of rho by the gauge's length."""
        return 1.0 if self.direct or self.rod.between else -1.0

    def rho(self, drives: FloatArray) -> FloatArray:
        """(...,) length between J and T for lengths (..., m) of the drives."""
        q = drives[..., self.gauge]
        return np.asarray(q if self.direct else self.rod.rod_mm + self.by * q)

    def side_kept(self, rho: FloatArray) -> BoolArray:
        """(...,) whether the rod's end is on its side of T."""
        return np.asarray((rho > 0.0) & ((rho > self.rod.rod_mm) == self.rod.between))


class Placed(NamedTuple):
    """Links at poses (...,): lengths (..., m), directions (..., m, 3), rates (..., m, 3, 6) of second ends minus first ends by twists."""

    lengths: FloatArray
    directions: FloatArray
    rates: FloatArray

    @property
    def rows(self) -> FloatArray:
        """(..., m, 6) rates of lengths by twists (omega; v at the base's origin)."""
        return np.asarray(np.einsum("...i,...ij->...j", self.directions, self.rates))


@dataclass(frozen=True)
class RodLinks:
    """Links whose ends may be the far ends of rods. The first end of a link belongs to the base where that is possible."""

    ends: Sequence[tuple[End, End]]

    @cached_property
    def _arrays(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """carried (m, 2, 1), points and through (m, 2, 3), rod lengths (m, 2, 1)."""
        parts = [np.array([[getattr(e, key) for e in pair] for pair in self.ends]) for key in ("carried", "point", "through", "rod_mm")]
        return parts[0][..., None], parts[1], parts[2], parts[3][..., None]

    def _axes(self, poses: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Joints J, points T (..., m, 2, 3) in the base frame, and the length rho (..., m, 2, 1) between them."""
        carried, points, through, _ = self._arrays
        moved = [se3.apply(poses[..., None, None, :], p) for p in (points, through)]
        J, T = np.where(carried, moved[0], points), np.where(carried, through, moved[1])
        return J, T, np.linalg.norm(T - J, axis=-1, keepdims=True)

    def placed(self, poses: FloatArray) -> Placed:
        """Return lengths, directions and rates at poses (..., 7); NaN where a link or the axis of a rod has no length."""
        carried, _, _, L = self._arrays
        J, T, rho = self._axes(poses)
        with np.errstate(invalid="ignore", divide="ignore"):
            w, k = np.where(L > 0.0, (T - J) / rho, 0.0), np.where(L > 0.0, L / rho, 0.0)[..., None]
        D = J + L * w
        turned = k * (np.eye(3) - w[..., :, None] * w[..., None, :])
        K = np.where(carried[..., None], np.eye(3) - turned, turned)
        Y = np.where(carried, J, T)
        cross = np.zeros((*Y.shape, 3))
        cross[..., 0, 1], cross[..., 0, 2], cross[..., 1, 2] = Y[..., 2], -Y[..., 1], Y[..., 0]
        cross -= np.swapaxes(cross, -1, -2)
        rates = K @ np.concatenate([cross, np.broadcast_to(np.eye(3), cross.shape)], axis=-1)
        along = D[..., 1, :] - D[..., 0, :]
        lengths = np.linalg.norm(along, axis=-1)
        with np.errstate(invalid="ignore", divide="ignore"):
            return Placed(lengths, along / lengths[..., None], rates[..., 1, :, :] - rates[..., 0, :, :])

    def point_rates(self, poses: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Rates of lengths by each end's points J and T (..., m, 2, 3), in their body's frame, and by its rod's length (..., m, 2)."""
        carried, _, _, L = self._arrays
        J, T, rho = self._axes(poses)
        w, k = np.where(L > 0.0, (T - J) / rho, 0.0), np.where(L > 0.0, L / rho, 0.0)
        u = self.placed(poses).directions[..., None, :] * np.array([[-1.0], [1.0]])
        by_T = k * (u - w * (u * w).sum(axis=-1, keepdims=True))
        back = np.swapaxes(se3.matrices(poses.reshape(-1, 7)).reshape(*poses.shape[:-1], 3, 3), -1, -2)[..., None, None, :, :]

        def of_body(by: FloatArray, moves: FloatArray) -> FloatArray:
            return np.where(moves, (back @ by[..., None])[..., 0], by)

        return of_body(u - by_T, carried), of_body(by_T, carried == 0), (u * w).sum(axis=-1)

    def lines(self, poses: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return rows (..., m, 6) (direction; moment), lengths (..., m), and rates of the ends: the `Lines` of `bounds`."""
        found = self.placed(poses)
        rows = found.rows
        return np.concatenate([rows[..., 3:], rows[..., :3]], axis=-1), found.lengths, found.rates

    def strips(self, pose: FloatArray) -> FloatArray:
        """(m, 2, 2, 3) of each link both ends at a pose (7,), each from its joint J to the end itself."""
        J, T, rho = self._axes(pose)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.stack([J, J + np.where(self._arrays[3] > 0.0, self._arrays[3] * (T - J) / rho, 0.0)], axis=-2)

    def gradient(self, pose: FloatArray) -> FloatArray:
        """(6,) rates of the determinant of six rows at a pose (7,) by twists: cofactors by differences of the rows."""
        step = DIFFERENCE * np.repeat([1.0, rim_mm(self.bodies[1])], 3)
        C = cofactors(self.lines(pose)[0])
        ahead, behind = (self.lines(moved(pose, sign * np.diag(step)))[0] for sign in (1.0, -1.0))
        return np.asarray(((ahead - behind) * C).sum(axis=(1, 2)) / (2.0 * step))

    @cached_property
    def rods(self) -> list[End]:
        """Each rod once, in the order of the links."""
        return list(dict.fromkeys(e for pair in self.ends for e in pair if e.rod_mm > 0.0))

    def margins(self, poses: FloatArray) -> FloatArray:
        """Return (..., rods) length [mm] of each rod beyond the point T, negative if it ends before."""
        rho = self._axes(poses)[2][..., 0]
        at = [next((i, j) for i, pair in enumerate(self.ends) for j in (0, 1) if pair[j] == rod) for rod in self.rods]
        each = np.stack([rho[..., i, j] for i, j in at], axis=-1)
        return np.where([rod.between for rod in self.rods], 1.0, -1.0) * (each - [rod.rod_mm for rod in self.rods])

    @cached_property
    def bodies(self) -> tuple[FloatArray, FloatArray]:
        """(m, 3) points of the base and (m, 3) of the platform that each link joins, a rod's end counted as its joint J."""
        base, platform = [], []
        for one, other in self.ends:
            if one.carried == other.carried:  # both joints on one body: the rod's point T is on the other
                rod, plain = (one, other) if one.rod_mm > 0.0 else (other, one)
                one, other = End(plain.carried, plain.point), End(not plain.carried, rod.through)
            platform.append(one.point if one.carried else other.point)
            base.append(other.point if one.carried else one.point)
        return np.array(base), np.array(platform)

    @cached_property
    def gauges(self) -> IntArray | None:
        """(m,) the link whose length gives rho of each link's rod, -1 of links without a rod. None where a rod has no such link, or a link
        joins two rods or a rod and a point of its joint's body: no straight links have the same poses."""
        out = []
        for pair in self.ends:
            rods = [e for e in pair if e.rod_mm > 0.0]
            if not rods:
                out.append(-1)
                continue
            rod, plain = rods[0], pair[pair[0] == rods[0]]
            if len(rods) == 2 or plain.carried == rod.carried:
                return None
            T = End(not rod.carried, rod.through)
            found = [i for i, other in enumerate(self.ends) if set(other) in ({rod, T}, {End(rod.carried, rod.point), T})]
            if not found:
                return None
            out.append(found[0])
        return np.array(out, dtype=np.int64)

    def links_of_drives(self, drives: FloatArray) -> FloatArray:
        """(..., m) lengths between base and platform for lengths (..., m) of the drives; NaN where no mechanism has them."""
        out = np.array(drives, dtype=np.float64)
        for beside in self._beside:
            rho, q = beside.rho(drives), drives[..., beside.link]
            L, s = beside.rod.rod_mm, np.abs(beside.rod.rod_mm - rho)
            with np.errstate(invalid="ignore", divide="ignore"):
                d = np.sqrt((rho * (q**2 - L**2) - L * (beside.across**2 - rho**2)) / (rho - L))
                good = beside.side_kept(rho) & (np.abs(s - beside.across) <= q + ROUNDING * L) & (q <= s + beside.across + ROUNDING * L)
            out[..., beside.link] = np.where(good, rho if beside.link == beside.gauge else d, np.nan)
        return np.where(np.isfinite(out).all(axis=-1, keepdims=True), out, np.nan)

    def drives_of_links(self, lengths: FloatArray) -> FloatArray:
        """(..., m) lengths of the drives for lengths (..., m) between base and platform; NaN where no mechanism has them."""
        out = np.array(lengths, dtype=np.float64)
        for beside in self._beside:
            rho, d = lengths[..., beside.gauge], lengths[..., beside.link]
            L, c = beside.rod.rod_mm, beside.across
            with np.errstate(invalid="ignore", divide="ignore"):
                q = np.sqrt(np.maximum(L**2 + d**2 + L / rho * (c**2 - rho**2 - d**2), 0.0))
                good = beside.side_kept(rho) & (np.abs(rho - c) <= d + ROUNDING * L) & (d <= rho + c + ROUNDING * L)
            out[..., beside.link] = np.where(good, q, np.nan)
        return np.where(np.isfinite(out).all(axis=-1, keepdims=True), out, np.nan)

    def rates_of_drives(self, drives: FloatArray) -> FloatArray:
        """(m, m) derivatives of the lengths between the bodies by lengths (m,) of the drives (thesis 4.4)."""
        links, out = self.links_of_drives(drives), np.eye(len(self.ends))
        for beside in self._beside:
            i, L, rho, by = beside.link, beside.rod.rod_mm, float(beside.rho(drives)), beside.by
            if i == beside.gauge:
                out[i, i] = by
                continue
            q, d = drives[i], links[i]
            part = rho * (q**2 - L**2) - L * (beside.across**2 - rho**2)
            out[i, i] = rho * q / ((rho - L) * d)
            out[i, beside.gauge] = by * ((q**2 - L**2 + 2.0 * L * rho) / (rho - L) - part / (rho - L) ** 2) / (2.0 * d)
        return out

    def link_box(self, drives: FloatArray) -> FloatArray:
        """(m, 2) least and greatest lengths between the bodies for drives between limits (m, 2); NaN where some have no mechanism.

        A length rises or falls with its own drive throughout. By rho it is stationary where (rho - L)^2 = q^2 - c^2.
        """
        out = np.array(drives, dtype=np.float64)
        for beside in self._beside:
            ends, L = np.sort(beside.rho(drives.T)), beside.rod.rod_mm
            values = []
            for q in drives[beside.link]:
                root = np.sqrt(max(q**2 - beside.across**2, 0.0))
                for rho in (*ends, *(r for r in (L - root, L + root) if ends[0] < r < ends[1])):
                    at = drives.mean(axis=1)
                    at[beside.link] = q
                    at[beside.gauge] = rho if beside.direct else beside.by * (rho - L)
                    values.append(self.links_of_drives(at)[beside.link])
            out[beside.link] = np.min(values), np.max(values)
        return out

    @cached_property
    def _beside(self) -> "list[Beside]":
        """The links that end at rods."""
        assert self.gauges is not None
        out = []
        for i, gauge in enumerate(self.gauges):
            if gauge >= 0:
                rod, plain = self.ends[i] if self.ends[i][0].rod_mm > 0.0 else self.ends[i][::-1]
                across = float(np.linalg.norm(np.array(plain.point) - rod.through))
                out.append(Beside(i, int(gauge), rod, across, rod not in self.ends[gauge]))
        return out

    def poses_of(self, lengths: FloatArray, near: FloatArray | None = None, seed: int = 0) -> FloatArray:
        """(k, 7) poses with the drives' lengths (6,), found by Newton's method from many starts; near (7,): a start of its own.

        Nothing proves that there are no others. Poses at which a rod is on the wrong side of its point T are left out.
        """
        base, platform = self.bodies
        size = max(float(np.ptp(base, axis=0).max()), float(np.ptp(platform, axis=0).max()), float(lengths.max()))
        reach = size + max((rod.rod_mm for rod in self.rods), default=0.0)
        rim = max(float(np.linalg.norm(platform, axis=1).max()), 1e-3 * size)
        found: list[FloatArray] = []
        met: list[int] = []
        rng = np.random.default_rng(seed)
        for batch in range(MOST):
            places = base.mean(axis=0) + reach * rng.uniform(-1.0, 1.0, (BATCH, 3))
            starts = se3.pose(places, Rotation.random(BATCH, rng=rng))
            if batch == 0 and near is not None:
                starts = np.concatenate([near[None], starts])
            for pose in self._closed(starts, lengths, rim, size):
                away = (np.abs(se3.displacement(pose, other) * np.repeat([rim, 1.0], 3)).max() for other in found)
                k = next((k for k, far in enumerate(away) if far < SAME * size), len(found))
                if k == len(found):
                    found.append(pose)
                    met.append(0)
                met[k] += 1
            if batch > 0 and found and min(met) >= MET:
                break
        return np.array(found).reshape(-1, 7)

    def _closed(self, poses: FloatArray, lengths: FloatArray, rim: float, size: float) -> FloatArray:
        """Those poses (k, 7) that Newton's steps from poses (n, 7) end at."""
        unit, done = np.repeat([1.0 / rim, 1.0], 3), [np.empty((0, 7))]
        for _ in range(STEPS):
            found = self.placed(poses)
            off = np.abs(found.lengths - lengths).max(axis=1)
            done.append(poses[off < CLOSES * size])
            good = np.isfinite(found.rows).all(axis=(1, 2)) & (off >= CLOSES * size)
            poses, lacks, rows = poses[good], (lengths - found.lengths)[good], found.rows[good]
            at = np.concatenate([rows[..., :3] - np.cross(poses[:, None, :3], rows[..., 3:]), rows[..., 3:]], axis=-1)
            step = (np.linalg.pinv(at * unit, rcond=1e-9) @ lacks[..., None])[..., 0]
            step *= np.minimum(1.0, 0.3 * size / np.maximum(np.abs(step).max(axis=1), 1e-300))[:, None]
            poses = se3.displaced(poses, step * unit)
        ended = np.concatenate(done)
        return np.asarray(ended[(self.margins(ended) > 0.0).all(axis=-1)])
