"""Six-axis arms by Denavit and Hartenberg's parameters: forward kinematics of any arm, inverse of an elbow arm with a spherical wrist.

Link i turns about z by theta, moves along z by d, along the new x by a, turns about it by alpha, and about the new y by beta:
T_i = Rz(theta_i + offset_i) Tz(d_i) Tx(a_i) Rx(alpha_i) Ry(beta_i). The beta, zero in a nominal arm, is Hayati's: without it a small tilt
between parallel axes would need a distant d (Hayati and Mirmirani, J. Robotic Systems 2, 1985).
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure import se3
from lmeasure.arrays import FloatArray
from lmeasure.errors import RobotError

AXES = 6
LINK_COLUMNS = OFFSET, D, A, ALPHA, BETA = range(5)
"""Columns of a link table (6, 5): offset [rad], d [mm], a [mm], alpha [rad], beta [rad]."""
ELBOW_ALPHA = (-0.5 * math.pi, 0.0, -0.5 * math.pi, 0.5 * math.pi, -0.5 * math.pi, 0.0)
WAYS = 8
"""Ways in which an elbow arm with a spherical wrist reaches a pose."""
MAX_STEP_RAD = 0.2
"""Between samples of a path; a wrist that flips turns by far more."""
_ROUNDING = 1e-12


@dataclass(frozen=True)
class SerialArm:
    """A six-axis arm standing in the base frame of the commands.

    links (6, 5): see `LINK_COLUMNS`; foot (7,): base_from_foot; tool (7,): flange_from_tool; low, high (6,): joint limits [rad].
    """

    links: FloatArray
    foot: FloatArray
    tool: FloatArray
    low: FloatArray
    high: FloatArray

    def with_errors(self, errors: FloatArray) -> "SerialArm":
        """The same arm with (6, 5) errors added to its links: what was built, beside what its controller believes."""
        return replace(self, links=self.links + errors)

    def forward(self, joints: FloatArray, growth: FloatArray | float = 0.0) -> FloatArray:
        """(..., 7) poses base_from_tool, qw not negative, at (..., 6) joint angles [rad]; growth (...): relative growth of all d and a."""
        joints = np.asarray(joints, dtype=np.float64)
        at, turn = self.flange(joints, growth)
        at = at + np.einsum("...ij,j->...i", turn, self.tool[:3])
        rotation = se3.rotation(self.foot) * Rotation.from_matrix(turn.reshape(-1, 3, 3)) * se3.rotation(self.tool)
        place = se3.apply(self.foot, at.reshape(-1, 3))
        return np.concatenate([place, rotation.as_quat(canonical=True)], axis=1).reshape(*joints.shape[:-1], 7)

    def flange(self, joints: FloatArray, growth: FloatArray | float = 0.0) -> tuple[FloatArray, FloatArray]:
        """(..., 3) positions [mm] and (..., 3, 3) rotations foot_from_flange."""
        at, turn = np.zeros((*joints.shape[:-1], 3)), np.broadcast_to(np.eye(3), (*joints.shape[:-1], 3, 3))
        for i in range(AXES):
            at, turn = self._past(i, joints[..., i], at, turn, growth)
        return at, turn

    def axes(self, joints: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(..., 6, 3) points on the joint axes [mm] and their directions, in the base frame."""
        shape = joints.shape[:-1]
        at, turn = np.zeros((*shape, 3)), np.broadcast_to(np.eye(3), (*shape, 3, 3))
        points, directions = np.empty((*shape, AXES, 3)), np.empty((*shape, AXES, 3))
        stand = se3.matrices(self.foot)
        for i in range(AXES):
            points[..., i, :], directions[..., i, :] = self.foot[:3] + at @ stand.T, turn[..., 2] @ stand.T
            at, turn = self._past(i, joints[..., i], at, turn, 0.0)
        return points, directions

    def _past(
        self, i: int, angle: FloatArray, at: FloatArray, turn: FloatArray, growth: FloatArray | float
    ) -> tuple[FloatArray, FloatArray]:
        """The frame behind link i, of the frame before it."""
        offset, d, a, alpha, beta = self.links[i]
        theta = angle + offset
        c, s = np.cos(theta), np.sin(theta)
        x, y, z = turn[..., 0], turn[..., 1], turn[..., 2]
        out = c[..., None] * x + s[..., None] * y
        side = c[..., None] * y - s[..., None] * x
        stretch = np.asarray(1.0 + growth)[..., None]
        twist = (Rotation.from_rotvec([alpha, 0.0, 0.0]) * Rotation.from_rotvec([0.0, beta, 0.0])).as_matrix()
        return at + stretch * (d * z + a * out), np.stack([out, side, z], axis=-1) @ twist

    def inverse(self, poses: FloatArray) -> FloatArray:
        """(..., 8, 6) joint angles in (-pi, pi] that take the tool to (..., 7) poses, NaN where a way does not reach.

        The ways are shoulder (front, back) x elbow (two) x wrist (two), wrist fastest. A way beyond the joint limits is NaN. RobotError
        unless the links are those of an elbow arm with a spherical wrist.
        """
        poses = np.asarray(poses, dtype=np.float64)
        joints = np.stack([self._way(poses.reshape(-1, 7), way) for way in range(WAYS)], axis=1)
        return np.asarray(joints.reshape(*poses.shape[:-1], WAYS, AXES))

    def _way(self, rows: FloatArray, way: int) -> FloatArray:
        """(n, 6) joint angles of one way to (n, 7) poses."""
        self._require_elbow()
        stand, tool = se3.rotation(self.foot), se3.rotation(self.tool)
        turn = (stand.inv() * se3.rotation(rows) * tool.inv()).as_matrix()
        flange = stand.inv().apply(rows[:, :3] - self.foot[:3]) - turn @ self.tool[:3]
        wrist = flange - self.links[5, D] * turn[:, :, 2]
        q1, out = self._shoulder(wrist, way // 4)
        q2, q3 = self._elbow(out, wrist[:, 2] - self.links[0, D], way // 2 % 2)
        joints = np.column_stack([q1, q2, q3, *_wrist(q1, q2 + q3, turn, way % 2)]) - self.links[:, OFFSET]
        joints = _turns(joints)
        joints[~((joints >= self.low) & (joints <= self.high)).all(axis=1)] = np.nan
        return joints

    def _require_elbow(self) -> None:
        links = self.links
        rest = (links[[1, 2, 4], D], links[[3, 4, 5], A], links[:, BETA], links[:, ALPHA] - ELBOW_ALPHA)
        if any(values.any() for values in rest):
            raise RobotError("the closed inverse is that of an elbow arm with a spherical wrist; these links are none")

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
        ways = self.inverse(poses[0])
        if np.isnan(ways).all():
            raise RobotError(f"sample 0: the arm cannot reach {_shown(poses[0])}", 0)
        joints = self._way(poses, int(np.nanargmin(np.abs(_turns(ways - start)).max(axis=1))))
        lost = np.isnan(joints).any(axis=1)
        if lost.any():
            sample = int(np.argmax(lost))
            raise RobotError(f"sample {sample}: the arm cannot reach {_shown(poses[sample])} as it stands", sample)
        steps = _turns(np.diff(joints, axis=0))
        if len(steps) and np.abs(steps).max() > MAX_STEP_RAD:
            sample = int(np.argmax(np.abs(steps).max(axis=1) > MAX_STEP_RAD)) + 1
            raise RobotError(f"sample {sample}: a joint jumps at {_shown(poses[sample])}; the path passes a singular pose", sample)
        return np.concatenate([joints[:1], joints[:1] + np.cumsum(steps, axis=0)])

    def deflection(self, joints: FloatArray, stiffness: FloatArray, force: FloatArray, points: FloatArray) -> FloatArray:
        """(n, 6) angles [rad] by which forces (n, 3) [N] at points (n, 3) [mm] turn joints of the given stiffness (6,) [N mm/rad]."""
        on, along = self.axes(joints)
        torque = np.einsum("nik,nik->ni", along, np.cross(points[:, None] - on, force[:, None]))
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


def _shown(pose: FloatArray) -> str:
    return "x {:.1f}, y {:.1f}, z {:.1f} mm".format(*pose[:3])


def elbow_arm(
    *,
    shoulder_mm: tuple[float, float] = (450.0, 150.0),
    upper_mm: float = 800.0,
    elbow_mm: float = 120.0,
    fore_mm: float = 850.0,
    flange_mm: float = 100.0,
    foot: FloatArray | None = None,
    tool: FloatArray | None = None,
) -> SerialArm:
    """A common arm: shoulder_mm height and reach of the second axis, upper arm, elbow offset, forearm, wrist centre to flange.

    At zero the upper arm stands upright and the forearm runs straight ahead.
    """
    links = np.zeros((AXES, len(LINK_COLUMNS)))
    links[:, ALPHA] = ELBOW_ALPHA
    links[1, OFFSET] = -0.5 * math.pi
    links[[0, 3, 5], D] = shoulder_mm[0], fore_mm, flange_mm
    links[[0, 1, 2], A] = shoulder_mm[1], upper_mm, elbow_mm
    rest = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    limit = np.radians([185.0, 150.0, 180.0, 350.0, 130.0, 350.0])
    return SerialArm(links, rest if foot is None else foot, rest if tool is None else tool, -limit, limit)
