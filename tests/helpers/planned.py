"""What the tests of plans share: a cell, its region, poses drawn in it."""

import numpy as np

from lmeasure.calibration import Region
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.simulation import cell_rig

IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])
CELL = Region(np.full(3, -300.0), np.full(3, 300.0), 0.3, IDENTITY)
RIG = cell_rig(0)


def two_drums() -> Rig:
    """The cell with its first two cables only: ten unknowns."""
    data = RIG.to_dict()
    data["observation_point"] = data["observation_point"][:2]
    data["cable"] = data["cable"][:2]
    return rig_from_dict(data)


def random_rows(count: int, seed: int) -> np.ndarray:
    return CELL.rows(np.random.default_rng(seed).uniform(0.0, 1.0, (count, 6)))
