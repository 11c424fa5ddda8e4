"""What a channel measures, said once for each kind of sensor, and poses from any number of channels of any kind.

`channel` says what is asked of a kind (`Observation`); `cable`, `swivel`, `inclination` and `distance` are the kinds, `parameters` the
numbers that they depend on. `solver` finds poses from readings and what the poses err by, `continuation` those of a run. Nothing here is
compiled: it is the reference, plain to read, that every compiled way is tested to equal.
"""

from lmeasure.observation.cable import CableLength
from lmeasure.observation.channel import Channels, Observation, arms, by_point, differences, predictions, row_of, rows, values, variances
from lmeasure.observation.continuation import follow
from lmeasure.observation.distance import Distance
from lmeasure.observation.inclination import Inclination
from lmeasure.observation.parameters import Parameter
from lmeasure.observation.solver import Solved, pressure_angles, shared_errors, solve_poses, twists
from lmeasure.observation.swivel import SwivelAngle

__all__ = [
    "CableLength",
    "Channels",
    "Distance",
    "Inclination",
    "Observation",
    "Parameter",
    "Solved",
    "SwivelAngle",
    "arms",
    "by_point",
    "differences",
    "follow",
    "predictions",
    "pressure_angles",
    "row_of",
    "rows",
    "shared_errors",
    "solve_poses",
    "twists",
    "values",
    "variances",
]
