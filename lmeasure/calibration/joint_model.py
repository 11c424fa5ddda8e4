"""The unknowns of a campaign whose poses are unknown too: those of the rig, and behind them rotations and shifts of the poses."""

import math
from dataclasses import replace
from functools import cached_property
from typing import Literal

import numpy as np

from lmeasure import se3
from lmeasure.arrays import FloatArray, IntArray
from lmeasure.calibration.campaign import Campaign
from lmeasure.calibration.refine import Noise
from lmeasure.calibration.unknowns import Model, Unknowns
from lmeasure.poses import Poses

Frame = Literal["rig", "poses"]

COMPONENTS = ("rx_deg", "ry_deg", "rz_deg", "x_mm", "y_mm", "z_mm")
ROTATIONS = (0, 1, 2)


class JointModel(Model):
    """A campaign whose counted poses, at, have unknowns of their own behind those of the rig.

    These are rotations and shifts from the stated poses, base axes, R = Exp(rotation) R_stated; free: which of `COMPONENTS`. Nothing is
    known of them beforehand, and what the file states about them, or about how they vary from visit to visit, takes no part: every visit
    of a pose has unknowns of its own. frame: what chooses the place of the whole, None where positions hold it.
    """

    def __init__(self, campaign: Campaign, rig: Unknowns, free: tuple[int, ...], frame: Frame | None) -> None:
        self.free, self.frame = np.array(free, dtype=np.int64), frame
        self.at = np.flatnonzero(np.isfinite(campaign.counts).any(axis=1))
        names = tuple(f"pose {campaign.poses.names[i]}.{COMPONENTS[c]}" for i in self.at for c in free)
        none = np.full(len(names), np.inf)
        every = Unknowns((*rig.names, *names), np.r_[rig.nominal, np.zeros(len(names))], np.r_[rig.width, none])
        if not self.places_known:
            campaign = replace(campaign, reference=None)
        if campaign.u_visit is not None:
            own = campaign.u_visit.copy()
            own[:, self._untold] = 0.0
            campaign = replace(campaign, u_visit=own if own.any() else None)
        super().__init__(campaign, every)
        self.rig = rig

    @property
    def pose_unknowns(self) -> int:
        """How many unknowns each pose has of its own."""
        return len(self.free)

    @cached_property
    def alike(self) -> list[tuple[IntArray, IntArray]]:
        """Poses other than zero poses, in groups counted on as many cables: their numbers (k,) among `at`, and their equations (k, m)."""
        others = [(k, np.flatnonzero(self.pose_index == i)) for k, i in enumerate(self.at) if i not in self.campaign.zero]
        sizes = sorted({len(rows) for _, rows in others} - {0})
        groups = [[(k, rows) for k, rows in others if len(rows) == size] for size in sizes]
        return [(np.array([k for k, _ in group]), np.array([rows for _, rows in group])) for group in groups]

    @property
    def places_known(self) -> bool:
        """Whether positions of the poses are taken from the file, with the uncertainty stated there."""
        return 3 not in self.free

    @property
    def _untold(self) -> list[int]:
        """Components of a pose about which nothing stated counts: the free ones, and the rotation of a tool that is but one free point."""
        return list(range(6)) if 3 in self.free else list(ROTATIONS)

    def noise(self, poses: Poses) -> Noise:
        """What the poses' file states about that which is not unknown."""
        stated = Noise.of(poses)
        place, turn = stated.u_position_mm.copy(), np.zeros(len(poses))
        covariance = None if stated.covariance is None else stated.covariance.copy()
        if covariance is not None:
            covariance[:, self._untold] = 0.0
            covariance[:, :, self._untold] = 0.0
        if not self.places_known:
            place, covariance = np.zeros(len(poses)), None
        # an assumed size of what is unknown anyway takes no part
        absent = tuple(name for name in stated.absent if name == "position" and self.places_known)
        return Noise(place, turn, covariance, absent=absent)

    def shifts(self, theta: FloatArray) -> FloatArray:
        """(n, 6) rotation [rad] and shift [mm] of each pose from the stated one."""
        out = np.zeros((len(self.campaign.poses), 6))
        own = theta[self.own :].reshape(len(self.at), len(self.free))
        out[np.ix_(self.at, self.free)] = np.where(self.free < 3, np.radians(own), own)
        return out

    @property
    def arms(self) -> FloatArray:
        """(n, 3) from the origin of a pose to the point that a motion of the whole carries along [mm, base frame]: the one attachment
        point, where the tool itself does not turn."""
        if 0 in self.free:
            return np.zeros((len(self.campaign.poses), 3))
        tool = self.campaign.rig.tool[self.campaign.cables[0].to_point]
        return self.campaign.poses.rotation.apply(np.array(tool))

    def poses(self, theta: FloatArray) -> FloatArray:
        """(n, 7) the stated poses, shifted."""
        return se3.displaced(self.campaign.poses.rows, self.shifts(theta))

    def found_poses(self, theta: FloatArray, covariance: FloatArray) -> Poses:
        """The poses at theta, with the uncertainty that the covariance (P, P) of the unknowns states where they were unknown, and the file
        where they were not."""
        stated, own = self.campaign.poses, self.noise(self.campaign.poses)
        both = np.zeros((len(stated), 6, 6)) if own.covariance is None else own.covariance.copy()
        if own.covariance is None:
            both[:, [3, 4, 5], [3, 4, 5]] = own.u_position_mm[:, None] ** 2
        unit, d = np.where(self.free < 3, math.radians(1.0), 1.0), len(self.free)
        turns = se3.left_jacobians(self.shifts(theta)[:, :3])
        for k, i in enumerate(self.at):
            rows = self.own + d * k + np.arange(d)
            to_pose = np.eye(6)
            to_pose[:3, :3] = turns[i]
            to_pose = to_pose[:, self.free] * unit
            both[i] += to_pose @ covariance[np.ix_(rows, rows)] @ to_pose.T
        variance = np.einsum("nii->ni", both)
        place, turn = np.sqrt(variance[:, 3:].mean(axis=1)), np.sqrt(variance[:, :3].mean(axis=1))
        return Poses(stated.names, self.poses(theta), place, turn, both, stated.oriented)

    def jacobian(self, theta: FloatArray) -> FloatArray:
        """(e, p) as `Model.jacobian`, the poses' unknowns behind."""
        J = super().jacobian(theta)
        by_pose = self.pose_jacobian(theta)
        by_pose[:, :, :3] = np.einsum("eni,nij->enj", by_pose[:, :, :3], se3.left_jacobians(self.shifts(theta)[:, :3]))
        by_pose = np.where(np.isfinite(by_pose), by_pose, 0.0)[:, self.at[:, None], self.free] * np.where(
            self.free < 3, math.radians(1.0), 1.0
        )
        J[:, self.own :] = by_pose.reshape(len(J), -1)
        return J
