"""Platforms on legs or cables of changing length: a Gough hexapod, a platform suspended on six cables or more.

Leg i runs straight from a_i of the base to b_i of the platform; its length is scale_i q_i + offset_i. For a pose p, R the length is
|p + R b_i - a_i| and its rate that of the leg's Pluecker row times the twist (lcoordinate), so that all derivatives follow from the rows:

    rows . twist = d(scale q + offset) + e . da - (R^T e) . db

The pose of given lengths is the one that is reached from the home pose by changing them steadily, as a platform is driven: no other
assembly. Cables are straight, held by the platform's weight; a sagging cable is no robot of this kind.
"""

from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from lmeasure.core import BoolArray, FloatArray, IntArray, se3
from lmeasure.io import Name, Strict, of_key
from lmeasure.linkages import pluecker_rows
from lmeasure.robots.file_fields import Length, Place, legs_with, named_once
from lmeasure.robots.model import Parameter
from lmeasure.text import message

LEGS = 6
WAY, STEPS = 12, 8
"""Parts in which lengths are changed from those of the home pose, and Newton's steps after the last of them."""
CLOSES_MM = 1e-7
"""By which a pose may miss its lengths."""
SINGULAR = 1e-9
"""Least singular value of the rows, lengths in parts of the platform's size, at which a pose is lost."""
POINT_MM, OFFSET_MM, SCALE = 3.0, 3.0, 0.003
"""What joints and lengths may be off by, as standard uncertainties: wider than those of any platform that is built."""
_AXES = ("x_mm", "y_mm", "z_mm")


@dataclass(frozen=True)
class Platform:
    """`RobotModel` of m legs: base, platform (m, 3) [mm] their ends in the base's and the flange's frame; offset, scale (m,); low,
    high (m,) limits of joint values [mm]; home (7,): base_from_flange near which it works."""

    name: str
    joint_names: tuple[str, ...]
    base: FloatArray
    platform: FloatArray
    offset: FloatArray
    scale: FloatArray
    low: FloatArray
    high: FloatArray
    home: FloatArray

    @property
    def sliding(self) -> BoolArray:
        """(m,) all of them."""
        return np.ones(len(self.base), np.bool_)

    @property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        """(m,) least and largest joint values."""
        return self.low, self.high

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Leg by leg its base point, platform point and offset; then the scales."""
        out = []
        for i, leg in enumerate(self.joint_names):
            for end, points in (("base", self.base), ("platform", self.platform)):
                out += [Parameter(f"{leg}.{end}_{axis}", "mm", float(points[i, k]), 1.0, POINT_MM) for k, axis in enumerate(_AXES)]
            out.append(Parameter(f"{leg}.offset_mm", "mm", float(self.offset[i]), 1.0, OFFSET_MM))
        return (*out, *(Parameter(f"{leg}.scale", "", float(s), 1.0, SCALE) for leg, s in zip(self.joint_names, self.scale, strict=True)))

    @property
    def reach_mm(self) -> float:
        """Not bounded: lengths that no pose has are determined by `forward`."""
        return float("inf")

    def moved(self, change: FloatArray) -> Self:
        """The platform with (8 m,) added to its parameters."""
        m = len(self.base)
        own = change[: 7 * m].reshape(m, 7)
        return replace(
            self,
            base=self.base + own[:, :3],
            platform=self.platform + own[:, 3:6],
            offset=self.offset + own[:, 6],
            scale=self.scale + change[7 * m :],
        )

    def lengths(self, poses: FloatArray) -> FloatArray:
        """(N, m) lengths of the legs at poses (N, 7)."""
        return np.asarray(np.linalg.norm(self._spans(poses)[0], axis=2))

    def forward(self, joints: FloatArray, side: FloatArray | None = None) -> FloatArray:
        """(N, 7) base_from_flange at joint values (N, m); NaN where no pose has these lengths."""
        wanted = self.scale * np.asarray(joints, dtype=np.float64) + self.offset
        poses = np.tile(self.home, (len(wanted), 1))
        begun = self.lengths(poses)
        good = np.ones(len(wanted), np.bool_)
        for step in range(1, WAY + STEPS):
            part = min(step / WAY, 1.0)
            rows, lengths, _ = self.rows(poses)
            size = np.array([*(self.size_mm,) * 3, 1.0, 1.0, 1.0])
            u, s, vt = np.linalg.svd(rows / size, full_matrices=False)
            good &= s[:, -1] > SINGULAR
            off = begun + part * (wanted - begun) - lengths
            twist = np.einsum("nji,nj->ni", vt, np.einsum("nji,nj->ni", u, off) / np.maximum(s, SINGULAR)) / size
            # a lost platform must not run away from the others' numbers
            twist *= np.minimum(1.0, 0.5 * self.size_mm / np.maximum(np.abs(twist * size).max(axis=1), 1e-300))[:, None]
            poses = se3.displaced(poses, self._at_flange(poses, twist))
        if len(self.base) == LEGS:
            good &= np.abs(self.lengths(poses) - wanted).max(axis=1) < CLOSES_MM
        return np.where(good[:, None], poses, np.nan)

    def derivatives(
        self, joints: FloatArray, side: FloatArray | None = None, of: IntArray | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """base_from_flange (N, 7), and twists (omega; v) at the base's origin: (N, m, 6) by joint values and (N, p, 6) by the parameters of
        these indices, by default all."""
        poses = self.forward(joints)
        rows, _, along = self.rows(poses)
        back = np.full((len(poses), 6, len(self.base)), np.nan)
        known = ~np.isnan(poses[:, 0])
        back[known] = np.linalg.pinv(rows[known])
        by_length = np.swapaxes(back, 1, 2)
        turned = np.einsum("nji,nmj->nmi", se3.matrices(poses), along) if known.all() else np.full_like(along, np.nan)
        if not known.all():
            turned[known] = np.einsum("nji,nmj->nmi", se3.matrices(poses[known]), along[known])
        weights = np.concatenate([along, -turned, np.ones((*along.shape[:2], 1))], axis=2)
        own = (weights[..., None] * by_length[:, :, None]).reshape(len(poses), -1, 6)
        every = np.concatenate([own, np.asarray(joints)[..., None] * by_length], axis=1)
        return poses, self.scale[:, None] * by_length, every if of is None else every[:, of]

    def inverse(self, pose: FloatArray, seed: int = 0) -> FloatArray:
        """(1 or 0, m) joint values that take the flange to the pose (7,): there are no others."""
        joints = (self.lengths(pose[None]) - self.offset) / self.scale
        return joints[((joints >= self.low) & (joints <= self.high)).all(axis=1)]

    @property
    def size_mm(self) -> float:
        """Of the platform [mm]: what a turn by a radian moves."""
        return max(float(np.linalg.norm(self.platform - self.platform.mean(axis=0), axis=1).max()), 1.0)

    def _spans(self, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N, m, 3) legs from base to platform, and places of their ends at the platform, base frame."""
        ends = np.full((len(poses), *self.platform.shape), np.nan)
        known = ~np.isnan(poses[:, 0])
        ends[known] = poses[known, None, :3] + np.einsum("nij,mj->nmi", se3.matrices(poses[known]), self.platform)
        return ends - self.base, ends

    def rows(self, poses: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(N, m, 6) Pluecker rows at the base's origin, (N, m) lengths, (N, m, 3) unit directions."""
        spans, ends = self._spans(poses)
        lengths = np.linalg.norm(spans, axis=2)
        along = spans / lengths[..., None]
        return pluecker_rows(ends, along), lengths, along

    def _at_flange(self, poses: FloatArray, twist: FloatArray) -> FloatArray:
        """(N, 6) twists at the base's origin, said at the flange's own."""
        return np.concatenate([twist[:, :3], twist[:, 3:] + np.cross(twist[:, :3], poses[:, :3])], axis=1)


class Leg(Strict):
    """Leg or cable from base to platform. Its length is scale * joint value + offset."""

    name: Name
    """Name of the leg and its joint; `measurements.csv` has the joint's values in `NAME_mm`."""
    base_mm: tuple[Length, Length, Length]
    """Lower end, in the base's frame."""
    platform_mm: tuple[Length, Length, Length]
    """Upper end, in the flange's frame."""
    offset_mm: Length = 0.0
    """Length at joint value 0."""
    scale: Annotated[float, Field(ge=0.1, le=10.0)] = 1.0
    """Change of length per joint value."""
    min_mm: Length
    """Smallest joint value."""
    max_mm: Length
    """Largest joint value."""


class PlatformFile(Strict):
    """Platform on legs or cables of variable length."""

    schema_: Annotated[Literal["lmeasure.robot/1"], Field(alias="schema")] = "lmeasure.robot/1"
    """Kind and version of the file."""
    name: Name
    """Name of the robot."""
    kind: Literal["hexapod", "cables"]
    """Platform on six legs of variable length, or suspended on six or more straight cables."""
    home: Place
    """Pose of the flange in the base's frame, near which the robot works. It selects the assembly mode."""
    tool: Place | None = None
    """Pose of the tool on the flange; default: the flange itself."""
    leg: Annotated[tuple[Leg, ...], Field(min_length=LEGS, max_length=32)]
    """Legs or cables, one table `[[leg]]` each."""

    @model_validator(mode="after")
    def _holds_together(self) -> Self:
        named_once("leg", [leg.name for leg in self.leg])
        if self.kind == "hexapod" and len(self.leg) != LEGS:
            raise of_key("leg", message("error.a_hexapod_has_kind", legs=LEGS))
        for leg in self.leg:
            if not leg.min_mm < leg.max_mm:
                raise ValueError(message("error.leg_min_mm_is", name=leg.name, min_mm=leg.min_mm, max_mm=leg.max_mm))
        found = self.model
        rows = found.rows(found.home[None])[0]
        if not np.isfinite(rows).all() or np.linalg.svd(rows[0] / [*(found.size_mm,) * 3, 1, 1, 1])[1][-1] <= SINGULAR:
            raise of_key("home", message("error.is_a_singular_pose"))
        return self

    @property
    def model(self) -> Platform:
        """The robot that computes."""
        keys = ("base_mm", "platform_mm", "offset_mm", "scale", "min_mm", "max_mm")
        base, platform, offset, scale, low, high = (np.array([getattr(leg, key) for leg in self.leg]) for key in keys)
        return Platform(self.name, tuple(leg.name for leg in self.leg), base, platform, offset, scale, low, high, self.home.row)

    @property
    def tool_pose(self) -> FloatArray:
        """(7,) flange from tool, the flange itself where none is stated."""
        return (self.tool or Place()).row

    def to_dict(self) -> dict[str, Any]:
        """The content of robot.toml."""
        return self.model_dump(by_alias=True, exclude_none=True, mode="json")

    def with_values(self, values: dict[str, float]) -> Self:
        """With values of its parameters by name, such as `leg_1.base_x_mm`."""
        return self.model_copy(update={"leg": legs_with(self.leg, values)})
