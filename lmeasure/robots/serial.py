"""Serial arms by Denavit and Hartenberg's parameters: forward kinematics and its derivatives of any arm, and all joint values that take an
arm's tool to a pose: in closed form for an elbow arm with a spherical wrist, by Newton's method from many starts for any other.

Link i turns about z by theta, moves along z by d, along the new x by a, turns about it by alpha, and about the new y by beta: T_i = Rz(q_i
+ theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i) Ry(beta_i); where the joint is prismatic, q_i is added to d_i. The beta, zero in a nominal arm, is
Hayati's: without it a small tilt between parallel axes would need a distant d (Hayati and Mirmirani, J. Robotic Systems 2, 1985).

A general arm of six turning joints has at most 16 solutions (Raghavan and Roth, J. Mech. Design 115, 1993); one of seven has whole curves
of them, from which the starts give single points. Solutions that differ by whole turns of a joint count as one, that nearest to its middle.

Each joint's effective value is q + sum of terms: scale_error q, sin1 sin q + cos1 cos q + sin2 sin 2q + cos2 cos 2q (an encoder off its
axis has one period per turn, an oval one two), compliance times the torque of the stated payload about the joint, and half the play on the
side of the joint's approach. Torques are those of the nominal arm: identified lengths change them by a thousandth.
"""

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import scipy
from scipy.spatial.transform import Rotation

from lmeasure.core import BoolArray, FloatArray, IntArray, RobotError, se3
from lmeasure.robots.model import Parameter, nearest_turns
from lmeasure.text import message

LINK_COLUMNS = OFFSET, D, A, ALPHA, BETA = range(5)
"""Columns of a link table (n, 5): theta [rad], d [mm], a [mm], alpha [rad], beta [rad]."""
ELBOW_AXES = 6
ELBOW_ALPHA = (-0.5 * math.pi, 0.0, -0.5 * math.pi, 0.5 * math.pi, -0.5 * math.pi, 0.0)
WAYS = 8
"""Ways in which an elbow arm with a spherical wrist reaches a pose."""
MAX_STEP_RAD = 0.2
"""Between samples of a path; a wrist that flips turns by far more."""
_ROUNDING = 1e-12


@dataclass(frozen=True)
class Coupling:
    """Dependence of links on joint values: values of links (m,) are matrix (m, n) times joint values (n,); driven (n,): each joint's
    link."""

    matrix: FloatArray
    driven: IntArray


@dataclass(frozen=True)
class SerialArm:
    """An arm of n joints standing in the base frame of the commands.

    links (m, 5): see `LINK_COLUMNS`; foot (7,): base_from_foot, where the first axis is the foot's z; tool (7,): flange_from_tool; low,
    high (n,): joint limits [rad, mm]; prismatic (m,): links that slide, none where it is None; seat (7,): the flange in the frame behind
    the last link, that frame itself where it is None; coupling: where links follow the joints of others, else m is n. Joint values are
    rad, or mm where they slide.
    """

    links: FloatArray
    foot: FloatArray
    tool: FloatArray
    low: FloatArray
    high: FloatArray
    prismatic: BoolArray | None = None
    seat: FloatArray | None = None
    coupling: Coupling | None = None

    @property
    def axes_count(self) -> int:
        """Number of its joints."""
        return len(self.low)

    @property
    def sliding(self) -> BoolArray:
        """(n,) whether a joint is prismatic."""
        return self.slides if self.coupling is None else np.asarray(self.slides[self.coupling.driven])

    @property
    def slides(self) -> BoolArray:
        """(m,) whether a link is prismatic."""
        return np.zeros(len(self.links), np.bool_) if self.prismatic is None else self.prismatic

    def link_values(self, joints: FloatArray) -> FloatArray:
        """(..., m) values of the links at joint values (..., n)."""
        joints = np.asarray(joints, dtype=np.float64)
        return joints if self.coupling is None else np.asarray(joints @ self.coupling.matrix.T)

    def with_errors(self, errors: FloatArray) -> "SerialArm":
        """Return the arm with (n, 5) errors added to its links: the built arm, beside the one that its controller assumes."""
        return replace(self, links=self.links + errors)

    def forward(self, joints: FloatArray, growth: FloatArray | float = 0.0) -> FloatArray:
        """(..., 7) poses base_from_tool, qw not negative, at (..., n) joint values; growth (...): relative growth of all d and a."""
        joints = np.asarray(joints, dtype=np.float64)
        at, turn = self.flange(joints, growth)
        at = at + np.einsum("...ij,j->...i", turn, self.tool[:3])
        rotation = se3.rotation(self.foot) * Rotation.from_matrix(turn.reshape(-1, 3, 3)) * se3.rotation(self.tool)
        place = se3.apply(self.foot, at.reshape(-1, 3))
        return np.concatenate([place, rotation.as_quat(canonical=True)], axis=1).reshape(*joints.shape[:-1], 7)

    def flange(self, joints: FloatArray, growth: FloatArray | float = 0.0) -> tuple[FloatArray, FloatArray]:
        """(..., 3) positions [mm] and (..., 3, 3) rotations foot_from_flange."""
        values = self.link_values(joints)
        at, turn = np.zeros((*values.shape[:-1], 3)), np.broadcast_to(np.eye(3), (*values.shape[:-1], 3, 3))
        for i in range(len(self.links)):
            at, turn = self._past(i, values[..., i], at, turn, growth)
        if self.seat is None:
            return at, turn
        return at + np.einsum("...ij,j->...i", turn, self.seat[:3]), turn @ se3.matrices(self.seat)

    def twists(self, joints: FloatArray) -> tuple[FloatArray, FloatArray]:
        """base_from_flange (N, 7) at joint values (N, n), and (N, m, 5, 6) its derivatives by every entry of the links.

        A derivative is a twist (omega; v) at the base's origin in its axes: each entry is a turn about, or a shift along, an axis that
        the entries before it have placed. That of the joint's own value is the one of theta, or of d where it slides.
        """
        joints = self.link_values(joints)
        shape = joints.shape[:-1]
        stand = se3.matrices(self.foot)
        x, y, z = (np.broadcast_to(stand[:, k], (*shape, 3)) for k in range(3))
        at = np.broadcast_to(self.foot[:3], (*shape, 3))
        out = np.zeros((*shape, len(self.links), 5, 6))
        for i, (offset, d, a, alpha, beta) in enumerate(self.links):
            slides = bool(self.slides[i])
            of = out[..., i, :, :]
            of[..., OFFSET, :3], of[..., OFFSET, 3:], of[..., D, 3:] = z, np.cross(at, z), z
            x, y = _turned(x, y, offset if slides else offset + joints[..., i, None])
            at = at + ((d + joints[..., i, None]) if slides else d) * z + a * x
            of[..., A, 3:], of[..., ALPHA, :3], of[..., ALPHA, 3:] = x, x, np.cross(at, x)
            y, z = _turned(y, z, alpha)
            of[..., BETA, :3], of[..., BETA, 3:] = y, np.cross(at, y)
            z, x = _turned(z, x, beta)
        turn = Rotation.from_matrix(np.stack([x, y, z], axis=-1)).as_quat(canonical=True)
        poses = np.concatenate([at, turn], axis=-1)
        return (poses if self.seat is None else se3.compose(poses, self.seat)), out

    def joint_twists(self, twists: FloatArray) -> FloatArray:
        """(N, n, 6) derivatives by the joints' own values, of those by the links' entries."""
        by_links = np.asarray(np.where(self.slides[:, None], twists[..., D, :], twists[..., OFFSET, :]))
        return by_links if self.coupling is None else np.asarray(np.einsum("...mk,mn->...nk", by_links, self.coupling.matrix))

    def axes(self, joints: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(..., m, 3) points on the links' axes [mm] and their directions, in the base frame."""
        joints = self.link_values(joints)
        shape = joints.shape[:-1]
        at, turn = np.zeros((*shape, 3)), np.broadcast_to(np.eye(3), (*shape, 3, 3))
        points, directions = np.empty((*shape, len(self.links), 3)), np.empty((*shape, len(self.links), 3))
        stand = se3.matrices(self.foot)
        for i in range(len(self.links)):
            points[..., i, :], directions[..., i, :] = self.foot[:3] + at @ stand.T, turn[..., 2] @ stand.T
            at, turn = self._past(i, joints[..., i], at, turn, 0.0)
        return points, directions

    def _past(
        self, i: int, value: FloatArray, at: FloatArray, turn: FloatArray, growth: FloatArray | float
    ) -> tuple[FloatArray, FloatArray]:
        """The frame behind link i, of the frame before it."""
        offset, d, a, alpha, beta = self.links[i]
        if self.slides[i]:
            theta, d = np.broadcast_to(offset, value.shape), (d + value)[..., None]
        else:
            theta = value + offset
        c, s = np.cos(theta), np.sin(theta)
        x, y, z = turn[..., 0], turn[..., 1], turn[..., 2]
        out = c[..., None] * x + s[..., None] * y
        side = c[..., None] * y - s[..., None] * x
        stretch = np.asarray(1.0 + growth)[..., None]
        twist = (Rotation.from_rotvec([alpha, 0.0, 0.0]) * Rotation.from_rotvec([0.0, beta, 0.0])).as_matrix()
        return at + stretch * (d * z + a * out), np.stack([out, side, z], axis=-1) @ twist

    def ways(self, poses: FloatArray) -> FloatArray:
        """(..., 8, 6) joint angles in (-pi, pi] that take the tool to (..., 7) poses, NaN where a way does not reach.

        The ways are shoulder (front, back) x elbow (two) x wrist (two), wrist fastest. A way beyond the joint limits is NaN. RobotError
        unless the links are those of an elbow arm with a spherical wrist.
        """
        poses = np.asarray(poses, dtype=np.float64)
        joints = np.stack([self._way(poses.reshape(-1, 7), way) for way in range(WAYS)], axis=1)
        return np.asarray(joints.reshape(*poses.shape[:-1], WAYS, ELBOW_AXES))

    def _way(self, rows: FloatArray, way: int) -> FloatArray:
        """(n, 6) joint angles of one way to (n, 7) poses."""
        if not self.is_elbow:
            raise RobotError(message("error.the_closed_inverse_is"))
        end = self.tool if self.seat is None else se3.compose(self.seat, self.tool)
        stand, tool = se3.rotation(self.foot), se3.rotation(end)
        turn = (stand.inv() * se3.rotation(rows) * tool.inv()).as_matrix()
        flange = stand.inv().apply(rows[:, :3] - self.foot[:3]) - turn @ end[:3]
        wrist = flange - self.links[5, D] * turn[:, :, 2]
        q1, out = self._shoulder(wrist, way // 4)
        q2, q3 = self._elbow(out, wrist[:, 2] - self.links[0, D], way // 2 % 2)
        joints = np.column_stack([q1, q2, q3, *_wrist(q1, q2 + q3, turn, way % 2)]) - self.links[:, OFFSET]
        joints = _turns(joints)
        joints[~((joints >= self.low) & (joints <= self.high)).all(axis=1)] = np.nan
        return joints

    @property
    def is_elbow(self) -> bool:
        """Return whether `ways` solves it."""
        links = self.links
        if len(links) != ELBOW_AXES or self.coupling is not None or self.sliding.any():
            return False
        rest = (links[[1, 2, 4], D], links[[3, 4, 5], A], links[:, BETA], links[:, ALPHA] - ELBOW_ALPHA)
        return not any(values.any() for values in rest)

    def _shoulder(self, wrist: FloatArray, back: int) -> tuple[FloatArray, FloatArray]:
        """theta_1 and the wrist's distance from the second axis in the arm's plane: facing the wrist, or turned away from it."""
        q1, out = np.arctan2(wrist[:, 1], wrist[:, 0]), np.hypot(wrist[:, 0], wrist[:, 1])
        return (q1 + math.pi, -out - self.links[0, A]) if back else (q1, out - self.links[0, A])

    def _elbow(self, out: FloatArray, up: FloatArray, other: int) -> tuple[FloatArray, FloatArray]:
        """theta_2 and theta_3: two sides of a triangle reach the wrist. The second side runs from the elbow to the wrist's centre."""
        upper, offset, fore = self.links[1, A], self.links[2, A], self.links[3, D]
        lower, bend = math.hypot(offset, fore), math.atan2(fore, offset)
        cosine = (out**2 + up**2 - upper**2 - lower**2) / (2.0 * upper * lower)
        cosine = np.where(np.abs(cosine) <= 1.0 + _ROUNDING, np.clip(cosine, -1.0, 1.0), np.nan)
        knee = np.arccos(cosine) if other else -np.arccos(cosine)
        # alpha_1 = -90 degrees: y of the plane points down
        q2 = np.arctan2(-up, out) - np.arctan2(lower * np.sin(knee), upper + lower * np.cos(knee))
        return q2, knee - bend

    def follow(self, poses: FloatArray, start: FloatArray) -> FloatArray:
        """(n, 6) joint angles along (n, 7) poses of a path, on the way that begins nearest to `start` (6,), without a jump of a whole turn.

        RobotError names the first sample that cannot be reached, or where the way jumps: the path runs through a singular pose.
        """
        ways = self.ways(poses[0])
        if np.isnan(ways).all():
            raise RobotError(message("error.sample_0_the_arm", shown=_shown(poses[0])), 0)
        joints = self._way(poses, int(np.nanargmin(np.abs(_turns(ways - start)).max(axis=1))))
        lost = np.isnan(joints).any(axis=1)
        if lost.any():
            sample = int(np.argmax(lost))
            raise RobotError(message("error.sample_the_arm_cannot", sample=sample, shown=_shown(poses[sample])), sample)
        steps = _turns(np.diff(joints, axis=0))
        if len(steps) and np.abs(steps).max() > MAX_STEP_RAD:
            sample = int(np.argmax(np.abs(steps).max(axis=1) > MAX_STEP_RAD)) + 1
            raise RobotError(message("error.sample_a_joint_jumps", sample=sample, shown=_shown(poses[sample])), sample)
        return np.concatenate([joints[:1], joints[:1] + np.cumsum(steps, axis=0)])

    def deflection(self, joints: FloatArray, stiffness: FloatArray, force: FloatArray, points: FloatArray) -> FloatArray:
        """Return (n, 6) angles [rad] by which forces (n, 3) [N] at points (n, 3) [mm] turn joints of the given stiffness (6,) [N
        mm/rad]."""
        on, along = self.axes(joints)
        torque = np.einsum("nik,nik->ni", along, np.cross(points[:, None] - on, force[:, None]))
        torque = torque if self.coupling is None else torque @ self.coupling.matrix
        return np.asarray(torque / stiffness)


def _wrist(q1: FloatArray, q23: FloatArray, turn: FloatArray, flipped: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """theta_4, theta_5, theta_6 of R_36 = Rz(theta_4) Ry(-theta_5) Rz(theta_6), from R_06 and the first three angles."""
    c1, s1, c, s = np.cos(q1), np.sin(q1), np.cos(q23), np.sin(q23)
    # columns of R_03 = Rz(q1) Rx(-90) Rz(q2 + q3) Rx(-90)
    x = np.stack([c1 * c, s1 * c, -s], axis=-1)
    y = np.stack([s1, -c1, np.zeros_like(c)], axis=-1)
    z = np.stack([-c1 * s, -s1 * s, -c], axis=-1)
    m = np.stack([x, y, z], axis=-2) @ turn
    q4 = np.arctan2(m[:, 1, 2], m[:, 0, 2]) + (math.pi if flipped else 0.0)
    # the others follow from theta_4, so that a nearly straight wrist, where it is ill-determined, still gives the pose
    c4, s4 = np.cos(q4), np.sin(q4)
    q5 = -np.arctan2(c4 * m[:, 0, 2] + s4 * m[:, 1, 2], m[:, 2, 2])
    q6 = np.arctan2(c4 * m[:, 1, 0] - s4 * m[:, 0, 0], c4 * m[:, 1, 1] - s4 * m[:, 0, 1])
    return q4, q5, q6


def _turns(angles: FloatArray) -> FloatArray:
    """Angles brought to (-pi, pi]."""
    return np.asarray(math.pi - np.mod(math.pi - angles, 2.0 * math.pi))


def _turned(first: FloatArray, second: FloatArray, angle: FloatArray | float) -> tuple[FloatArray, FloatArray]:
    """Two of a frame's axes (..., 3) after a turn about the third, from the first towards the second."""
    c, s = np.cos(angle), np.sin(angle)
    return c * first + s * second, c * second - s * first


def _shown(pose: FloatArray) -> str:
    return "x {:.1f}, y {:.1f}, z {:.1f} mm".format(*pose[:3])


STARTS = 256
STEPS = 60
SAME = 1e-5
"""Rad, or parts of the arm's reach: solutions nearer than this are one."""
REACHED = 1e-10
"""Largest error of a pose that is reached, rad and parts of the arm's reach."""
LONGEST_STEP = 0.5


def solutions(arm: SerialArm, pose: FloatArray, seed: int = 0) -> FloatArray:
    """(k, n) joint values within the limits that take the tool to the pose (7,), in order of the first joint; k is 0 where none do."""
    pose = np.asarray(pose, dtype=np.float64)
    found = arm.ways(pose) if arm.is_elbow else _newton(arm, pose, seed)
    found = found[~np.isnan(found).any(axis=1)]
    found = _different(arm, _wrapped(arm, found))
    inside = ((found >= arm.low) & (found <= arm.high)).all(axis=1)
    found = found[inside]
    return np.asarray(found[np.lexsort(found.T[::-1])])


def reach_mm(arm: SerialArm) -> float:
    """The farthest that links and tool can stretch [mm], sliding joints half-way out."""
    ends = np.linalg.norm(arm.tool[:3]) + (0.0 if arm.seat is None else np.linalg.norm(arm.seat[:3]))
    links = np.hypot(arm.links[:, 1], arm.links[:, 2]).sum() + ends
    out = np.abs(arm.link_values(0.5 * (arm.low + arm.high)))[arm.slides].sum()
    return max(float(links + out), 1.0)


def _newton(arm: SerialArm, pose: FloatArray, seed: int) -> FloatArray:
    """(k, n) where damped Newton steps from many starts have arrived, some of them twice."""
    scale = np.array([1.0, 1.0, 1.0, *(1.0 / reach_mm(arm),) * 3])
    unit = np.where(arm.sliding, reach_mm(arm), 1.0)
    starts = scipy.stats.qmc.Sobol(arm.axes_count, rng=np.random.default_rng(seed)).random(STARTS)
    low = np.where(arm.sliding, arm.low, np.maximum(arm.low, -math.pi))
    high = np.where(arm.sliding, arm.high, np.minimum(arm.high, math.pi))
    joints = low + starts * (high - low)
    flange = se3.compose(pose, se3.inverse(arm.tool))
    for _ in range(STEPS):
        poses, links = arm.twists(joints)
        # the twist that takes each flange to where it should be, at the flange's own origin and in base axes
        off = se3.displacement(flange, poses) * scale
        if (np.abs(off).max(axis=1) < REACHED).all():
            break
        at_flange = se3.at_points(poses[:, :3]) @ np.swapaxes(arm.joint_twists(links), 1, 2)
        jacobian = scale[:, None] * at_flange * unit
        damping = 1e-3 * np.minimum(np.abs(off).max(axis=1), 0.1)  # goes with the error: quadratic in the end
        square = np.swapaxes(jacobian, 1, 2) @ jacobian + damping[:, None, None] * np.eye(arm.axes_count)
        # to the last digits where the pose does not bind every joint
        square += 1e-14 * np.eye(arm.axes_count)
        step = np.linalg.solve(square, np.swapaxes(jacobian, 1, 2) @ off[..., None])[..., 0]
        step *= np.minimum(1.0, LONGEST_STEP / np.maximum(np.abs(step).max(axis=1), 1e-300))[:, None]
        joints = joints + step * unit
    poses, _ = arm.twists(joints)
    off = np.abs(se3.displacement(flange, poses) * scale).max(axis=1)
    return np.asarray(joints[off < 1e3 * REACHED])


def _wrapped(arm: SerialArm, joints: FloatArray) -> FloatArray:
    """Joint values with the whole turns that bring them nearest to the middle of their limits."""
    return nearest_turns(joints, 0.5 * (arm.low + arm.high), arm.sliding)


def _different(arm: SerialArm, joints: FloatArray) -> FloatArray:
    """The rows that are not the same as an earlier one."""
    unit = np.where(arm.sliding, reach_mm(arm), 1.0)
    kept: list[FloatArray] = []
    for row in joints:
        gap = [np.where(arm.sliding, (row - k) / unit, np.abs(np.mod(row - k + math.pi, 2.0 * math.pi) - math.pi)) for k in kept]
        if not any(np.abs(g).max() < SAME for g in gap):
            kept.append(row)
    return np.array(kept).reshape(-1, arm.axes_count)


GRAVITY_M_S2 = 9.80665
TERMS = SCALE, SIN1, COS1, SIN2, COS2, COMPLIANCE, PLAY = range(7)
HARMONICS = (SIN1, COS1, SIN2, COS2)
NEARLY_PARALLEL = math.sin(math.radians(10.0))
"""Sine of the angle between neighbouring axes under which Hayati's beta is one of the robot's parameters."""
LENGTH_WIDTH_MM, ANGLE_WIDTH_DEG = 3.0, 0.5
"""Priors of nominal lengths and angles: wider than those of any real robot, so that they decide only values that the data do not
determine."""
_DEG = math.radians(1.0)
# of compliance: a joint of 1000 N m per radian, softer than those of the lightest arms
_LINKS = (("theta_deg", OFFSET), ("d_mm", D), ("a_mm", A), ("alpha_deg", ALPHA), ("beta_deg", BETA))
_TURNING, _SLIDING = (
    (
        ("scale", "", 1.0, 0.003),
        *((f"{key}_{unit}", unit, size, width) for key in ("sin1", "cos1", "sin2", "cos2")),
        compliance,
        (f"backlash_{unit}", unit, size, width),
    )
    for unit, size, width, compliance in (
        ("deg", _DEG, 0.1, ("compliance_deg_per_nm", "deg/(N m)", _DEG / 1e3, math.degrees(1e-3))),
        ("mm", 1.0, 0.3, ("compliance_mm_per_n", "mm/N", 1.0, 1e-2)),
    )
)
"""Terms of turning and of sliding joints, in the order of `TERMS`: key, unit, size and width as in `Parameter`."""


@dataclass(frozen=True)
class SerialRobot:
    """A serial arm as `RobotModel`.

    link_names (m,): as many as joints, and more where some follow others; arm: its geometry, the foot standing in the robot's base frame;
    terms (n, 7): see `TERMS`, the scale as its difference from 1;
    turn (n,): radians of a joint's periodic errors per unit of its value, 1 where it turns, 2 pi over the pitch of a screw, NaN where a
    sliding joint has none; load_n (3,) [N, base frame] pulls at load_mm (3,) [flange frame].
    """

    name: str
    joint_names: tuple[str, ...]
    link_names: tuple[str, ...]
    arm: SerialArm
    terms: FloatArray
    turn: FloatArray
    load_n: FloatArray
    load_mm: FloatArray
    drawn: SerialArm
    """Arm whose lengths give the payload's torques."""

    @property
    def sliding(self) -> BoolArray:
        return self.arm.sliding

    @property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        return self.arm.low, self.arm.high

    @property
    def reach_mm(self) -> float:
        return reach_mm(replace(self.arm, tool=_HERE)) + float(np.linalg.norm(self.arm.foot[:3]))

    @property
    def parallel(self) -> BoolArray:
        """(m,) whether a link's axis and the next one are nearly parallel; never that of the last one."""
        links = self.drawn.links
        near = np.abs(np.sin(links[:, ALPHA])) < NEARLY_PARALLEL
        near[-1] = False
        return np.asarray(near)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        out = []
        for i, column in self._links:
            key = next(k for k, c in _LINKS if c == column)
            size, width, unit = (_DEG, ANGLE_WIDTH_DEG, "deg") if key.endswith("_deg") else (1.0, LENGTH_WIDTH_MM, "mm")
            out.append(Parameter(f"{self.link_names[i]}.{key}", unit, float(self.arm.links[i, column]) / size, size, width))
        for i, term in self._terms:
            key, unit, size, width = (_SLIDING if self.sliding[i] else _TURNING)[term]
            value = float(self.terms[i, term]) / size + (term == SCALE)
            out.append(Parameter(f"{self.joint_names[i]}.{key}", unit, value, size, width))
        return tuple(out)

    def moved(self, change: FloatArray) -> Self:
        links, terms = self.arm.links.copy(), self.terms.copy()
        first = len(self._links)
        links[tuple(np.array(self._links).T)] += change[:first]
        terms[tuple(np.array(self._terms).T)] += change[first:]
        return replace(self, arm=replace(self.arm, links=links), terms=terms)

    def forward(self, joints: FloatArray, side: FloatArray | None = None) -> FloatArray:
        return replace(self.arm, tool=_HERE).forward(self._effective(joints, self._basis(joints, side)))

    def derivatives(
        self, joints: FloatArray, side: FloatArray | None = None, of: IntArray | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        basis = self._basis(joints, side)
        poses, of_links = self.arm.twists(self._effective(joints, basis))
        of_joints = self.arm.joint_twists(of_links)
        links, terms = np.array(self._links), np.array(self._terms)
        if of is not None:
            links, terms = links[of[of < len(links)]], terms[of[of >= len(links)] - len(links)]
        (i, column), (j, term) = links.reshape(-1, 2).T, terms.reshape(-1, 2).T
        of_terms = of_joints[:, j] * basis[:, j, term, None]
        by_parameters = np.concatenate([of_links[:, i, column], of_terms], axis=1)
        return poses, of_joints * self._gain(joints)[..., None], by_parameters

    def inverse(self, pose: FloatArray, seed: int = 0) -> FloatArray:
        gain = 1.0 + self.terms[:, SCALE]
        ends = np.sort([gain * self.arm.low, gain * self.arm.high], axis=0)
        slack = np.where(self.sliding, _SLACK_MM, _SLACK_RAD)
        effective = solutions(replace(self.arm, tool=_HERE, low=ends[0] - slack, high=ends[1] + slack), pose, seed)
        joints = effective / gain
        for _ in range(_ROUNDS):  # the other terms are small, so each round reduces the error by the same factor
            joints += (effective - self._effective(joints, self._basis(joints, None))) / gain
        inside = ((joints >= self.arm.low) & (joints <= self.arm.high)).all(axis=1)
        return np.asarray(joints[inside])

    @property
    def _links(self) -> list[tuple[int, int]]:
        """Link and column of each parameter of the links."""
        parallel = self.parallel
        return [(i, c) for i in range(len(self.link_names)) for _, c in _LINKS if c != BETA or parallel[i]]

    @property
    def _terms(self) -> list[tuple[int, int]]:
        """Joint and term of each other parameter."""
        every = [(i, t) for i in range(len(self.joint_names)) for t in TERMS]
        return [(i, t) for i, t in every if t not in HARMONICS or not np.isnan(self.turn[i])]

    def _basis(self, joints: FloatArray, side: FloatArray | None) -> FloatArray:
        """Return (N, n, 7) factors of each term."""
        phase = joints * np.nan_to_num(self.turn)
        out = np.zeros((*joints.shape, len(TERMS)))
        out[..., SCALE] = joints
        out[..., SIN1], out[..., COS1] = np.sin(phase), np.cos(phase)
        out[..., SIN2], out[..., COS2] = np.sin(2.0 * phase), np.cos(2.0 * phase)
        if self.load_n.any():
            at, twists = self.drawn.twists(joints)
            of = self.drawn.joint_twists(twists)
            points = se3.apply(at, self.load_mm)
            out[..., COMPLIANCE] = (np.cross(of[..., :3], points[:, None]) + of[..., 3:]) @ self.load_n
        if side is not None:
            out[..., PLAY] = 0.5 * side
        return out

    def _effective(self, joints: FloatArray, basis: FloatArray) -> FloatArray:
        return np.asarray(joints + np.einsum("njt,jt->nj", basis, self.terms))

    def _gain(self, joints: FloatArray) -> FloatArray:
        """Return the (N, n) derivative of a joint's effective value by its value. The change of the payload's torques is omitted: it is as
        small as the angle by which the payload turns the joint."""
        turn = np.nan_to_num(self.turn)
        phase, t = joints * turn, self.terms
        once = t[:, SIN1] * np.cos(phase) - t[:, COS1] * np.sin(phase)
        twice = t[:, SIN2] * np.cos(2.0 * phase) - t[:, COS2] * np.sin(2.0 * phase)
        return np.asarray(1.0 + t[:, SCALE] + turn * (once + 2.0 * twice))


_HERE = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
_SLACK_RAD, _SLACK_MM = 0.05, 5.0  # beyond the limits, for terms to bring back
_ROUNDS = 8
