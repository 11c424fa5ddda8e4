"""An identified robot read back from its folder: nominal and found values, where it stands, and how well its places are known.

It can be seen from frames that others state: the position of its base, and of its tool.
"""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np
from scipy.stats import norm, t

from lmeasure.accuracy import radii_95
from lmeasure.core import BoolArray, FileFormatError, FloatArray, IntArray, se3
from lmeasure.io import files
from lmeasure.robots.identification.extrapolation import NOWHERE, Beyond
from lmeasure.robots.model import Parameter, RobotModel
from lmeasure.robots.robot import AnyRobot, read_robot
from lmeasure.text import message


@dataclass(frozen=True)
class Placed:
    """`RobotModel` of a robot whose own base is at `stand` (7,) of the base that is stated, and the stated flange at `seat` (7,) of its
    own: forward is stand, the robot's own forward, seat, one after the other."""

    robot: RobotModel
    stand: FloatArray
    seat: FloatArray

    @property
    def name(self) -> str:
        """The robot's."""
        return self.robot.name

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The robot's."""
        return self.robot.joint_names

    @property
    def sliding(self) -> BoolArray:
        """(n,) the robot's."""
        return self.robot.sliding

    @property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        """(n,) the robot's."""
        return self.robot.limits

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The robot's."""
        return self.robot.parameters

    @property
    def reach_mm(self) -> float:
        """Return how far from the stated base the stated flange can be [mm]."""
        return self.robot.reach_mm + float(np.linalg.norm(self.stand[:3]) + np.linalg.norm(self.seat[:3]))

    def moved(self, change: FloatArray) -> Self:
        """With (p,) added to the robot's parameters."""
        return replace(self, robot=self.robot.moved(change))

    def forward(self, joints: FloatArray, side: FloatArray | None = None) -> FloatArray:
        """(N, 7) stated base from stated flange at joint values (N, n)."""
        return self._seen(self.robot.forward(joints, side))

    def derivatives(
        self, joints: FloatArray, side: FloatArray | None = None, of: IntArray | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """As `RobotModel.derivatives`, twists at the stated base's origin in its axes."""
        poses, by_joints, by_parameters = self.robot.derivatives(joints, side, of)
        carried = se3.adjoint(self.stand).T
        return self._seen(poses), by_joints @ carried, by_parameters @ carried

    def inverse(self, pose: FloatArray, seed: int = 0) -> FloatArray:
        """(k, n) joint values that take the stated flange to the pose (7,)."""
        return self.robot.inverse(se3.compose(se3.compose(se3.inverse(self.stand), pose), se3.inverse(self.seat)), seed)

    def _seen(self, poses: FloatArray) -> FloatArray:
        known = ~np.isnan(poses).any(axis=1)
        out = np.full_like(poses, np.nan)
        out[known] = se3.compose(se3.compose(self.stand, poses[known]), self.seat)
        return out


WIDE = 1e5
"""Prior of frames, in degrees or millimetres."""
TURNS, PLACES = ("rx_deg", "ry_deg", "rz_deg"), ("x_mm", "y_mm", "z_mm")


@dataclass(frozen=True)
class IdentifiedRobot:
    """nominal and found: models; base, tool (7,): instrument_from_base, flange_from_target; names (p,) of the unknowns, covariance
    (p, p) in the units of the names; noise_mm of the robot in each coordinate, NaN where it could not be determined; freedom of that;
    misfit: factor by which held-out rows lay farther off than stated; turned: whether the target's orientation was measured; seen: the
    found robot as the program's frames see it, itself where nothing else is stated of these (`stated`); beyond: how places far from the
    measured poses are widened."""

    nominal: RobotModel
    found: RobotModel
    base: FloatArray
    tool: FloatArray
    names: tuple[str, ...]
    covariance: FloatArray
    noise_mm: float
    freedom: float
    misfit: float
    turned: bool
    seen: RobotModel
    beyond: Beyond = NOWHERE

    def stated(self, base: FloatArray | None, tool: FloatArray | None) -> "IdentifiedRobot":
        """With where the program's base stands in the instrument's frame, and where the measured target is meant to sit on the flange (7,);
        None leaves both where they were found. The found robot is then right in the instrument's frame, not only in its own."""
        here = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
        stand = here if base is None else se3.compose(se3.inverse(base), self.base)
        seat = here
        if tool is not None:
            sits = self.tool if self.turned else np.concatenate([self.tool[:3], tool[3:]])
            seat = se3.compose(sits, se3.inverse(tool))
        return replace(self, seen=Placed(self.found, stand, seat))

    def u_mm(self, joints: FloatArray) -> FloatArray:
        """(N,) [mm] standard uncertainty of the target's place by identification alone, all coordinates together."""
        rows = self._rows(joints)
        spread = self.misfit**2 * self.beyond.places(rows, self.covariance)
        return np.asarray(np.sqrt(np.einsum("nii->n", spread)))

    def u95_mm(self, joints: FloatArray) -> FloatArray:
        """(N,) [mm] radius that holds 95 % of where the target is from where it is predicted at joint values (N, n): by identification and
        the robot itself, without the instrument. NaN where the robot's own part could not be determined."""
        rows = self._rows(joints)
        own = self.noise_mm**2 * np.eye(3)
        spread = self.misfit**2 * (self.beyond.places(rows, self.covariance) + own)
        if np.isnan(self.noise_mm):
            return np.full(len(joints), np.nan)
        return np.asarray(float(t.ppf(0.975, self.freedom) / norm.ppf(0.975)) * radii_95(spread))

    def _rows(self, joints: FloatArray) -> FloatArray:
        """(N, 3, p) derivatives of the target's place in the instrument's frame by the unknowns, in the units of their names."""
        own = {p.name: (i, p.size) for i, p in enumerate(self.found.parameters)}
        flange, _, twists = self.found.derivatives(joints)
        in_base = se3.apply(flange, self.tool[:3])
        turn = se3.matrices(self.base)
        out = np.zeros((len(joints), 3, len(self.names)))
        degree = np.radians(1.0)
        for k, name in enumerate(self.names):
            owner, _, key = name.rpartition(".")
            if name in own:
                i, size = own[name]
                out[:, :, k] = (twists[:, i, 3:] + np.cross(twists[:, i, :3], in_base)) @ turn.T * size
            elif owner == "base" and key in TURNS:
                out[:, :, k] = np.cross(np.eye(3)[TURNS.index(key)], in_base @ turn.T) * degree
            elif owner == "base":
                out[:, PLACES.index(key), k] = 1.0
            elif owner == self._first_target and key in PLACES:
                out[:, :, k] = (turn @ se3.matrices(flange))[:, :, PLACES.index(key)]
        return out

    @property
    def _first_target(self) -> str:
        return next((name.rpartition(".")[0] for name in self.names if name.startswith(("tool.", "target_"))), "")


def read_identified(folder: Path) -> IdentifiedRobot:
    """The robot of a folder that `lmeasure identify` wrote; FileFormatError where identified.json is not of it."""
    path = folder / "identified.json"
    robot = read_robot(folder / "robot.toml")
    try:
        data = json.loads(files.read_bytes(path))
        parameters = data["parameters"]
        nominal = {p["name"]: float(p["nominal"]) for p in parameters if p["nominal"] is not None}
        noise, held = data["noise"]["position_mm"], data["held_out"] or {}
        covariance = np.array(data["covariance"], dtype=np.float64)
        width = np.array([WIDE if p["prior_u"] is None else float(p["prior_u"]) for p in parameters])
        names = tuple(str(p["name"]) for p in parameters)
        base, tool = (np.array([*data[key]["position_mm"], *data[key]["quaternion_xyzw"]], dtype=np.float64) for key in ("base", "tool"))
        freedom = float(data["freedom"])
        scale, misfit = float("nan") if noise is None else float(noise), float(held.get("misfit", 1.0))
        beyond = Beyond(float(data["beyond"]["factor"]), float(data["beyond"]["from_mm2"]), width)
        turned = any(bool(t["oriented"]) for t in list(data.get("targets", {}).values())[:1])
    except (KeyError, TypeError, ValueError) as error:
        raise FileFormatError(message("error.not_what_lmeasure_identify", where=path, error=error)) from None
    if covariance.shape != (len(names), len(names)) or not np.isfinite(covariance).all():
        raise FileFormatError(message("error.the_covariance_is_not", where=path, n_names=len(names)))
    found = robot.model
    known = names, covariance, scale, max(freedom, 1.0), misfit
    return IdentifiedRobot(_nominal(robot, nominal, path), found, base, tool, *known, turned, found, beyond)


def _nominal(robot: AnyRobot, values: dict[str, float], path: Path) -> RobotModel:
    known = {p.name for p in robot.model.parameters}
    strange = sorted(set(values) - known)
    if strange:
        raise FileFormatError(message("error.is_no_parameter_of", where=path, strange=strange[0]))
    return robot.with_values(values).model
