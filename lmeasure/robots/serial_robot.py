"""A serial arm with what its joints do besides turning as they are commanded: scale, harmonics, compliance under a payload, play.

Each joint's effective value is q + sum of terms: scale_error q, sin1 sin q + cos1 cos q + sin2 sin 2q + cos2 cos 2q (an encoder off
its axis errs once per turn, an oval one twice), compliance times the torque of the stated payload about the joint, and half the play on
the side that the joint was come from. Torques are those of the arm as it was read: identified lengths change them by a thousandth.
"""

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from lmeasure.core import BoolArray, FloatArray, IntArray, se3
from lmeasure.robots.model import Parameter
from lmeasure.robots.serial import ALPHA, BETA, OFFSET, A, D, SerialArm, reach_mm, solutions

GRAVITY_M_S2 = 9.80665
TERMS = SCALE, SIN1, COS1, SIN2, COS2, COMPLIANCE, PLAY = range(7)
HARMONICS = (SIN1, COS1, SIN2, COS2)
NEARLY_PARALLEL = math.sin(math.radians(10.0))
"""Sine of the angle between neighbouring axes under which Hayati's beta is one of the robot's parameters."""
LENGTH_WIDTH_MM, ANGLE_WIDTH_DEG = 3.0, 0.5
"""Of nominal lengths and angles: wider than those of any robot that is built, so that only what data do not tell is held by them."""
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
"""Of the terms of turning and of sliding joints, in the order of `TERMS`: key, unit, size and width as of `Parameter`."""


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
    """By whose lengths the payload's torques are reckoned."""

    @property
    def sliding(self) -> BoolArray:
        """(n,) whether a joint's value is a length."""
        return self.arm.sliding

    @property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        """(n,) least and largest joint values."""
        return self.arm.low, self.arm.high

    @property
    def reach_mm(self) -> float:
        """Return how far from its base the flange can be [mm]."""
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
        """Links first, joint by joint, beta at nearly parallel axes alone; then the terms, joint by joint."""
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
        """The robot with (p,) added to its parameters, rad and mm."""
        links, terms = self.arm.links.copy(), self.terms.copy()
        first = len(self._links)
        links[tuple(np.array(self._links).T)] += change[:first]
        terms[tuple(np.array(self._terms).T)] += change[first:]
        return replace(self, arm=replace(self.arm, links=links), terms=terms)

    def forward(self, joints: FloatArray, side: FloatArray | None = None) -> FloatArray:
        """(N, 7) base_from_flange at joint values (N, n)."""
        return replace(self.arm, tool=_HERE).forward(self._effective(joints, self._basis(joints, side)))

    def derivatives(
        self, joints: FloatArray, side: FloatArray | None = None, of: IntArray | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """base_from_flange (N, 7), and twists (omega; v) at the base's origin: (N, n, 6) by joint values and (N, p, 6) by the parameters of
        these indices, by default all."""
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
        """(k, n) joint values within the limits that take the flange to the pose (7,); see `serial.solutions`."""
        gain = 1.0 + self.terms[:, SCALE]
        ends = np.sort([gain * self.arm.low, gain * self.arm.high], axis=0)
        slack = np.where(self.sliding, _SLACK_MM, _SLACK_RAD)
        effective = solutions(replace(self.arm, tool=_HERE, low=ends[0] - slack, high=ends[1] + slack), pose, seed)
        joints = effective / gain
        for _ in range(_ROUNDS):  # the other terms are small: each round leaves a part as small of what the one before left
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
        """(N, n, 7) what each term is multiplied with."""
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
        """(N, n) derivative of a joint's effective value by its value. The change of the payload's torques is left out: it is as
        small as the angle by which the payload turns the joint."""
        turn = np.nan_to_num(self.turn)
        phase, t = joints * turn, self.terms
        once = t[:, SIN1] * np.cos(phase) - t[:, COS1] * np.sin(phase)
        twice = t[:, SIN2] * np.cos(2.0 * phase) - t[:, COS2] * np.sin(2.0 * phase)
        return np.asarray(1.0 + t[:, SCALE] + turn * (once + 2.0 * twice))


_HERE = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
_SLACK_RAD, _SLACK_MM = 0.05, 5.0  # beyond the limits, for terms to bring back
_ROUNDS = 8
