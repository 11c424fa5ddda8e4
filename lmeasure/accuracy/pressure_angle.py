"""The analogue of the pressure angle and the accuracy it stands for (thesis Rashoyan 2021, 5.7)."""

import math

from lmeasure.core import AccuracyError


def limit_from_accuracy(length_mm: float, position_mm: float) -> float:
    """Largest pressure-angle analogue [deg] at which lengths good to `length_mm` give positions good to `position_mm`.

    arccos(delta_l / delta_r), thesis 5.7. delta_l is the full width of a reading: +-0.0125 mm is 0.025 mm, which with 0.05 mm gives the
    thesis' 60 degrees. AccuracyError when the position is asked to be better than the lengths.
    """
    if not 0.0 < length_mm <= position_mm < math.inf:
        raise AccuracyError(
            f"an accuracy of {position_mm:g} mm cannot be asked of lengths good to {length_mm:g} mm: it must be the larger of the two"
        )
    return math.degrees(math.acos(length_mm / position_mm))
