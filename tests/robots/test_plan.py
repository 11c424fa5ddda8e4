"""Planned poses of a robot leave less uncertainty than random ones, by covariances worked out the long way."""

import numpy as np

from lmeasure.robots.frame_start import Frames
from lmeasure.robots.identify import freed
from lmeasure.robots.measurements import POSITION, measured
from lmeasure.robots.plan import chosen
from lmeasure.robots.robot import shipped
from lmeasure.robots.unknowns import Unknowns


def test_planned_poses_are_better_than_random_ones() -> None:
    rng = np.random.default_rng(7)
    robot = shipped("generic6").model
    joints, zone = rng.uniform(-2, 2, (150, 6)), rng.uniform(-2, 2, (40, 6))
    here = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    tool = here + [50.0, 20.0, 90.0, 0.0, 0.0, 0.0, 0.0]
    rows = measured(joints, np.zeros((150, 3)))
    unknowns = Unknowns(robot, freed(robot, ("links",)), Frames(here[0], tool, np.zeros((0, 3)), 0.0, np.ones(150, bool)), rows)

    def mean_variance(of: np.typing.NDArray[np.int64]) -> float:
        J = unknowns.linearised(np.zeros(len(unknowns)))[1][of][:, POSITION].reshape(-1, len(unknowns)) / 0.05
        C = np.linalg.inv(J.T @ J + np.diag(1.0 / unknowns.width**2))
        over = unknowns.linearised(np.zeros(len(unknowns)), measured(zone, np.zeros((40, 3))))[1][:, POSITION]
        return float(np.einsum("nip,pq,niq->", over, C, over) / len(zone))

    plan = chosen(unknowns, joints, zone, 15, 0.05)
    assert len(set(plan.tolist())) == 15
    random = [mean_variance(rng.permutation(150)[:15]) for _ in range(20)]
    assert mean_variance(plan) < 0.9 * min(random)
