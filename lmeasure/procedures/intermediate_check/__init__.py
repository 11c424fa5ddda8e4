"""The interim check of an instrument between two calibrations: what must close and does, within what is stated, and what has moved if not.

`check_instrument` takes a run of minutes in which the robot goes to some places, comes back to them and ends where it began.
"""

from lmeasure.calibration import Distance
from lmeasure.procedures.intermediate_check.check import Checked, Limits, check_instrument
from lmeasure.procedures.intermediate_check.closures import Closure
from lmeasure.procedures.intermediate_check.moved_parts import Cause, Verdict

__all__ = ["Cause", "Checked", "Closure", "Distance", "Limits", "Verdict", "check_instrument"]
