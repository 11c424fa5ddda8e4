"""Cable schemes: what a rig's cables measure, and what of the tool's motion is held by a constraint."""

from dataclasses import dataclass

import numpy as np

from lmeasure.core import FloatArray, IntArray, RigError, se3
from lmeasure.kernels import ATTACHMENT_XYZ, KIND, span_rows
from lmeasure.rig import Rig

FREEDOMS = ("rx", "ry", "rz", "x", "y", "z")
"""Components of the twist (omega; v) in base axes, v at the tool origin."""

CONSTRAINTS = {"planar": ("rz", "x", "y"), "vertical-axis": ("rz", "x", "y", "z")}
"""What remains free under each constraint of a rig: a stage in the base XY plane, a tool whose axis stays vertical (SCARA)."""

CABLES_FOR_A_POINT = 3


@dataclass(frozen=True)
class Scheme:
    """What is solved for.

    rows (m, columns) of the kernels, of all channels (`Rig.observed`); free: the components of the twist that can change; point: the one
    attachment point whose position is measured when orientation is not, else None; held: the freedoms that a constraint keeps.
    """

    rows: FloatArray
    free: tuple[str, ...]
    point: str | None = None
    held: str = ""
    constraint: str = ""
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Of that point in the tool frame."""

    @property
    def six(self) -> bool:
        """Six cables to a free body and nothing else: as many equations as unknowns, the screw method proper."""
        return len(self.rows) == len(self.free) == len(FREEDOMS) and not self.rows[:, KIND].any()

    @property
    def free_index(self) -> IntArray:
        """(f,) indices of the free components."""
        return np.array([FREEDOMS.index(name) for name in self.free], dtype=np.int64)

    def start_of(self, start: FloatArray) -> FloatArray:
        """The start pose (7,); of the attachment point where only that is measured."""
        if self.point is None:
            return start
        place = se3.apply(start, self.place)
        return np.concatenate([place, [0.0, 0.0, 0.0, 1.0]])

    @property
    def redundancy(self) -> int:
        """Channels beyond the least number."""
        return len(self.rows) - len(self.free)


def scheme_of(rig: Rig, start: FloatArray, constraint: str | None = None) -> Scheme:
    """The scheme of a rig; a constraint given here replaces the rig's. start (7,) says which freedoms too few cables leave unmeasured.

    RigError when the cables cannot tell the pose: too few, naming the freedoms, or to attachment points on one line.
    """
    held = constraint or rig.constraint
    rows, used = rig.cable_rows(rig.observed), sorted({c.to_point for c in rig.observed if c.to_point})
    m = len(rows)
    channels = "cables" if m == len(rig.cable) else "channels"
    if held is not None:
        if held not in CONSTRAINTS:
            raise RigError(f"constraint = {held!r} is not one of {', '.join(CONSTRAINTS)}")
        free = CONSTRAINTS[held]
        if m < len(free):
            raise RigError(f"rig {rig.name!r}: has {m} {channels}; constraint = {held!r} leaves {len(free)} freedoms, {', '.join(free)}")
        return Scheme(rows, free, held=", ".join(f for f in FREEDOMS if f not in free), constraint=held)
    if len(used) == 1 and not rig.measures_turns:
        if m < CABLES_FOR_A_POINT:
            raise RigError(f"rig {rig.name!r}: has {m} {channels} to {used[0]}; its position needs at least {CABLES_FOR_A_POINT}")
        rows[:, ATTACHMENT_XYZ] = 0.0
        return Scheme(rows, FREEDOMS[3:], point=used[0], place=rig.tool[used[0]])
    if m < len(FREEDOMS):
        raise RigError(
            f"rig {rig.name!r}: has {m} {channels} and leaves {len(FREEDOMS) - m} of six freedoms unmeasured, at the start "
            f"{_unmeasured(rows, start)}; hold them by constraint = {' or '.join(repr(c) for c in CONSTRAINTS)}, or add cables or a pass"
        )
    if not rig.measures_turns:
        rig.require_spread()
    return Scheme(rows, FREEDOMS)


def _unmeasured(rows: FloatArray, start: FloatArray) -> str:
    """The twists that no cable sees, as turns about an axis or shifts along it, tool origin taken as the place of the axis."""
    J = span_rows(rows, start)
    size = max(float(np.linalg.norm(rows[:, ATTACHMENT_XYZ], axis=1).max()), 1.0)
    _, _, V = np.linalg.svd(J * np.repeat([1.0 / size, 1.0], 3))
    texts = []
    for twist in V[len(rows) :]:
        # in units of the platform: a turn of 1/size rad moves its rim by 1 mm
        k = int(np.argmax([np.linalg.norm(twist[:3]), np.linalg.norm(twist[3:])]))
        axis = twist[3 * k : 3 * k + 3] / np.linalg.norm(twist[3 * k : 3 * k + 3])
        axis = axis if axis[np.argmax(np.abs(axis))] > 0 else -axis
        kind = "a turn about" if k == 0 else "a shift along"
        texts.append(f"{kind} ({', '.join(f'{a:.2f}' for a in axis)})")
    return " and ".join(texts)
