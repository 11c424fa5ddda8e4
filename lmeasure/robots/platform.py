"""Platforms on legs or cables of changing length: a Gough hexapod, a platform suspended on six cables or more.

Leg i runs straight from a_i of the base to b_i of the platform; its length is scale_i q_i + offset_i. For a pose p, R the length is
|p + R b_i - a_i| and its rate that of the leg's Pluecker row times the twist (lcoordinate), so that all derivatives follow from the rows:

    rows . twist = d(scale q + offset) + e . da - (R^T e) . db

A leg may end at a rod that goes through a point of the other body (`linkages.RodLinks`): then rows and rates are those of the rod's end.

The pose of given lengths is the one that is reached from the home pose by changing them steadily, as a platform is driven: no other
assembly. Cables are straight, held by the platform's weight; a sagging cable is no robot of this kind.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from lmeasure.core import BoolArray, FloatArray, IntArray, se3
from lmeasure.io import Name, Strict, of_key
from lmeasure.linkages import SINGULAR, End, RodLinks, driven, pluecker_rows
from lmeasure.robots.model import Length, Parameter, Place, legs_with, named_once
from lmeasure.text import message

LEGS = 6
CLOSES_MM = 1e-7
"""Largest error of a pose's lengths."""
POINT_MM, OFFSET_MM, SCALE = 3.0, 3.0, 0.003
"""Errors of joints and lengths, as standard uncertainties: wider than those of any real platform."""
_AXES = ("x_mm", "y_mm", "z_mm")
Point = tuple[Length, Length, Length]


@dataclass(frozen=True)
class Rods:
    """Rods of a platform: base, platform (r, 3) [mm] points on their axes in the frames of base and flange, length_mm (r,); carried (r,):
    whether a rod begins at the platform; between (r,): whether it ends between both points; legs (m,): the rod of each leg, -1 for none."""

    base: FloatArray
    platform: FloatArray
    length_mm: FloatArray
    carried: BoolArray
    between: BoolArray
    legs: IntArray
    names: tuple[str, ...] = ()


NO_RODS = Rods(*(np.empty((0, 3)),) * 2, np.empty(0), *(np.empty(0, np.bool_),) * 2, np.empty(0, np.int64))


@dataclass(frozen=True)
class Platform:
    """`RobotModel` of m legs: base, platform (m, 3) [mm] their ends in the base's and the flange's frame; offset, scale (m,); low,
    high (m,) limits of joint values [mm]; home (7,): base_from_flange near which it works; rods at which legs end."""

    name: str
    joint_names: tuple[str, ...]
    base: FloatArray
    platform: FloatArray
    offset: FloatArray
    scale: FloatArray
    low: FloatArray
    high: FloatArray
    home: FloatArray
    rods: Rods = NO_RODS

    @property
    def sliding(self) -> BoolArray:
        return np.ones(len(self.base), np.bool_)

    @property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        return self.low, self.high

    @cached_property
    def links(self) -> RodLinks | None:
        """The legs where some end at rods."""
        own = self.rods
        if not len(own.base):
            return None
        ends = []
        for leg, (b, p) in enumerate(zip(self.base.tolist(), self.platform.tolist(), strict=True)):
            pair = [End(False, tuple(b)), End(True, tuple(p))]
            if (r := int(own.legs[leg])) >= 0:
                at = [tuple(own.base[r].tolist()), tuple(own.platform[r].tolist())]
                carried = bool(own.carried[r])
                free = int(np.isnan(self.platform[leg, 0]))  # the end that the leg does not state
                pair[free] = End(carried, at[carried], at[not carried], float(own.length_mm[r]), bool(own.between[r]))
            ends.append((pair[0], pair[1]))
        return RodLinks(ends)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        out = []
        for i, leg in enumerate(self.joint_names):
            out += self._points(leg, self.base[i], self.platform[i])
            out.append(Parameter(f"{leg}.offset_mm", "mm", float(self.offset[i]), 1.0, OFFSET_MM))
        out += [Parameter(f"{leg}.scale", "", float(s), 1.0, SCALE) for leg, s in zip(self.joint_names, self.scale, strict=True)]
        for i, rod in enumerate(self.rods.names):
            out += self._points(rod, self.rods.base[i], self.rods.platform[i])
            out.append(Parameter(f"{rod}.length_mm", "mm", float(self.rods.length_mm[i]), 1.0, OFFSET_MM))
        return tuple(p for p, own in zip(out, self._own, strict=True) if own)

    def _points(self, name: str, base: FloatArray, platform: FloatArray) -> list[Parameter]:
        ends = (("base", base), ("platform", platform))
        return [Parameter(f"{name}.{end}_{axis}", "mm", float(p[k]), 1.0, POINT_MM) for end, p in ends for k, axis in enumerate(_AXES)]

    @cached_property
    def _own(self) -> BoolArray:
        """(8 m + 7 r,) which parameters there are: a leg that ends at a rod has no point there."""
        legs = np.column_stack([~np.isnan(self.base), ~np.isnan(self.platform), np.ones(len(self.base), np.bool_)])
        return np.concatenate([legs.ravel(), np.ones(len(self.base) + 7 * len(self.rods.base), np.bool_)])

    @property
    def reach_mm(self) -> float:
        return float("inf")

    def moved(self, change: FloatArray) -> Self:
        m, whole = len(self.base), np.zeros(len(self._own))
        whole[self._own] = change
        own, rods = whole[: 7 * m].reshape(m, 7), whole[8 * m :].reshape(-1, 7)
        moved = replace(
            self.rods,
            base=self.rods.base + rods[:, :3],
            platform=self.rods.platform + rods[:, 3:6],
            length_mm=self.rods.length_mm + rods[:, 6],
        )
        return replace(
            self,
            base=self.base + own[:, :3],
            platform=self.platform + own[:, 3:6],
            offset=self.offset + own[:, 6],
            scale=self.scale + whole[7 * m : 8 * m],
            rods=moved,
        )

    def lengths(self, poses: FloatArray) -> FloatArray:
        """(N, m) lengths of the legs at poses (N, 7)."""
        return self.rows(poses)[1]

    def forward(self, joints: FloatArray, side: FloatArray | None = None) -> FloatArray:
        wanted = self.scale * np.asarray(joints, dtype=np.float64) + self.offset
        poses, good = driven(self.rows, np.tile(self.home, (len(wanted), 1)), wanted, self.size_mm)
        if len(self.base) == LEGS:
            with np.errstate(invalid="ignore"):
                good &= np.abs(self.lengths(poses) - wanted).max(axis=1) < CLOSES_MM
        return np.where((good & self.assembled(poses))[:, None], poses, np.nan)

    def assembled(self, poses: FloatArray) -> BoolArray:
        """(N,) whether the rods end on their side of the points that they go through, at poses (N, 7)."""
        return np.ones(len(poses), np.bool_) if self.links is None else np.asarray((self.links.margins(poses) > 0.0).all(axis=1))

    def derivatives(
        self, joints: FloatArray, side: FloatArray | None = None, of: IntArray | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        poses = self.forward(joints)
        back = np.full((len(poses), 6, len(self.base)), np.nan)
        known = ~np.isnan(poses[:, 0])
        back[known] = np.linalg.pinv(self.rows(poses[known])[0])
        by_length = np.swapaxes(back, 1, 2)
        weights = np.full((len(poses), len(self._own), len(self.base)), np.nan)
        weights[known] = self._length_rates(poses[known], np.asarray(joints)[known])
        chosen = np.flatnonzero(self._own) if of is None else np.flatnonzero(self._own)[of]
        return poses, self.scale[:, None] * by_length, weights[:, chosen] @ by_length

    def _length_rates(self, poses: FloatArray, joints: FloatArray) -> FloatArray:
        """(N, 8 m + 7 r, m) by how much a change of each parameter lengthens the legs' lack: minus the rates of lengths by points, and the
        rates of the joints' lengths."""
        n, m = joints.shape
        out = np.zeros((n, len(self._own), m))
        legs, of_leg = out[:, : 7 * m].reshape(n, m, 7, m), range(m)
        legs[:, of_leg, 6, of_leg] = 1.0
        out[:, range(7 * m, 8 * m), of_leg] = joints
        if self.links is None:
            along = self._along(poses)[1]
            turned = np.einsum("nji,nmj->nmi", se3.matrices(poses), along)
            legs[:, of_leg, :6, of_leg] = np.swapaxes(np.concatenate([along, -turned], axis=2), 0, 1)
            return out
        by_J, by_T, by_L = self.links.point_rates(poses)
        rods = out[:, 8 * m :].reshape(n, -1, 7, m)
        for leg in of_leg:
            for end in (0, 1):
                rod = int(self.rods.legs[leg])
                if rod < 0 or not np.isnan((self.base, self.platform)[end][leg, 0]):
                    legs[:, leg, 3 * end : 3 * end + 3, leg] = -by_J[:, leg, end]
                    continue
                begin = 3 * int(self.rods.carried[rod])
                rods[:, rod, begin : begin + 3, leg] = -by_J[:, leg, end]
                rods[:, rod, 3 - begin : 6 - begin, leg] = -by_T[:, leg, end]
                rods[:, rod, 6, leg] = -by_L[:, leg, end]
        return out

    def inverse(self, pose: FloatArray, seed: int = 0) -> FloatArray:
        joints = (self.lengths(pose[None]) - self.offset) / self.scale
        return joints[((joints >= self.low) & (joints <= self.high)).all(axis=1) & self.assembled(pose[None])]

    @property
    def size_mm(self) -> float:
        """Return the size of the platform [mm], the lever arm of a radian."""
        points = np.concatenate([self.platform[~np.isnan(self.platform[:, 0])], self.rods.platform])
        return max(float(np.linalg.norm(points - points.mean(axis=0), axis=1).max()), 1.0)

    def _along(self, poses: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(N, m) lengths, (N, m, 3) unit directions of legs without rods, and (N, m, 3) their upper ends; NaN at poses that are NaN."""
        ends = np.full((len(poses), *self.platform.shape), np.nan)
        known = ~np.isnan(poses[:, 0])
        ends[known] = poses[known, None, :3] + np.einsum("nij,mj->nmi", se3.matrices(poses[known]), self.platform)
        spans = ends - self.base
        lengths = np.linalg.norm(spans, axis=2)
        return lengths, spans / lengths[..., None], ends

    def rows(self, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N, m, 6) rates of lengths by twists (omega; v at the base's origin), and (N, m) lengths."""
        if self.links is None:
            lengths, along, ends = self._along(poses)
            return pluecker_rows(ends, along), lengths
        m, known = len(self.base), ~np.isnan(poses[:, 0])
        rows, lengths = np.full((len(poses), m, 6), np.nan), np.full((len(poses), m), np.nan)
        found = self.links.placed(poses[known])
        rows[known], lengths[known] = found.rows, found.lengths
        return rows, lengths


class Leg(Strict):
    """Leg or cable from base to platform, or between one of them and a rod. Its length is scale * joint value + offset."""

    name: Name
    """Name of the leg and its joint; `measurements.csv` has the joint's values in `NAME_mm`."""
    base_mm: Point | None = None
    """Lower end, in the base's frame."""
    platform_mm: Point | None = None
    """Upper end, in the flange's frame."""
    rod: Name | None = None
    """Rod at whose end the leg ends, in place of `base_mm` or `platform_mm`."""
    offset_mm: Length = 0.0
    """Length at joint value 0."""
    scale: Annotated[float, Field(ge=0.1, le=10.0)] = 1.0
    """Change of length per joint value."""
    min_mm: Length
    """Smallest joint value."""
    max_mm: Length
    """Largest joint value."""


class Rod(Strict):
    """Rod that carries drives out of the work zone: legs end at its far end."""

    name: Name
    """Name for `rod` of legs."""
    base_mm: Point
    """Point of the base on the rod's axis, in the base's frame."""
    platform_mm: Point
    """Point of the platform on the rod's axis, in the flange's frame."""
    joint: Literal["base", "platform"]
    """Body at whose point the rod begins; its axis goes through the other point."""
    length_mm: Annotated[Length, Field(gt=0.0)]
    """Length from the joint to the end."""
    end: Literal["beyond", "between"] = "beyond"
    """End of the rod: beyond the other point, through which it slides, or between both points, on a neighbouring leg."""


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
    rod: tuple[Rod, ...] = ()
    """Rods, one table `[[rod]]` each."""

    @model_validator(mode="after")
    def _holds_together(self) -> Self:
        named_once("leg", [leg.name for leg in self.leg])
        if self.kind == "hexapod" and len(self.leg) != LEGS:
            raise of_key("leg", message("error.a_hexapod_has_kind", legs=LEGS))
        for leg in self.leg:
            if not leg.min_mm < leg.max_mm:
                raise ValueError(message("error.leg_min_mm_is", name=leg.name, min_mm=leg.min_mm, max_mm=leg.max_mm))
        self._rods_hold_together()
        found = self.model
        rows = found.rows(found.home[None])[0]
        if not found.assembled(found.home[None])[0]:
            raise of_key("home", message("error.home_rod_on_the_wrong_side"))
        if not np.isfinite(rows).all() or np.linalg.svd(rows[0] / [*(found.size_mm,) * 3, 1, 1, 1])[1][-1] <= SINGULAR:
            raise of_key("home", message("error.is_a_singular_pose"))
        return self

    def _rods_hold_together(self) -> None:
        """ValueError for a leg without two ends, and for a rod without a leg."""
        names = [rod.name for rod in self.rod]
        named_once("rod", [*names, *(leg.name for leg in self.leg)])
        for leg in self.leg:
            if (leg.base_mm, leg.platform_mm, leg.rod).count(None) != 1:
                raise ValueError(message("error.leg_needs_two_ends", name=leg.name))
            if leg.rod is not None and leg.rod not in names:
                raise ValueError(message("error.leg_ends_at_no_rod", name=leg.name, rod=leg.rod, rods=", ".join(names) or "-"))
        unused = next((name for name in names if all(leg.rod != name for leg in self.leg)), None)
        if unused is not None:
            raise of_key("rod", message("error.rod_has_no_leg", name=unused))
        if self.rod and len(self.leg) != LEGS:
            raise of_key("rod", message("error.rods_go_with_six_legs", n=len(self.leg)))

    @property
    def model(self) -> Platform:
        """The robot that computes."""
        keys = ("offset_mm", "scale", "min_mm", "max_mm")
        offset, scale, low, high = (np.array([getattr(leg, key) for leg in self.leg]) for key in keys)
        base, platform = (np.array([getattr(leg, key) or (np.nan,) * 3 for leg in self.leg]) for key in ("base_mm", "platform_mm"))
        names = [rod.name for rod in self.rod]
        rods = NO_RODS
        if names:
            base_mm, platform_mm, length = (
                np.array([getattr(rod, k) for rod in self.rod]) for k in ("base_mm", "platform_mm", "length_mm")
            )
            carried, between = (
                np.array([getattr(rod, k) == v for rod in self.rod]) for k, v in (("joint", "platform"), ("end", "between"))
            )
            legs = np.array([names.index(leg.rod) if leg.rod else -1 for leg in self.leg])
            rods = Rods(base_mm, platform_mm, length, carried, between, legs, tuple(names))
        return Platform(self.name, tuple(leg.name for leg in self.leg), base, platform, offset, scale, low, high, self.home.row, rods)

    @property
    def tool_pose(self) -> FloatArray:
        """(7,) flange from tool, the flange itself where none is stated."""
        return (self.tool or Place()).row

    def to_dict(self) -> dict[str, Any]:
        """The content of robot.toml."""
        data = self.model_dump(by_alias=True, exclude_none=True, mode="json")
        if not self.rod:
            del data["rod"]
        return data

    def with_values(self, values: dict[str, float]) -> Self:
        """Return it with values of its parameters by name, such as `leg_1.base_x_mm`."""
        return self.model_copy(update={"leg": legs_with(self.leg, values), "rod": legs_with(self.rod, values)})
