"""What of a rig a run takes as exact, as nobody stated it and nothing has solved it, and what its usual size would add to the poses."""

from collections.abc import Callable

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.rig import CalibrationRecord, Rig
from lmeasure.sensors import ATTACHMENT, CALIBRATION, REFERENCE_C, RIG, Lengths, Taken, Warmth, Zero, effects_of, exact, taken_as_exact
from lmeasure.trajectory.reconstruction.scheme import Scheme

SAMPLED = 64
"""Poses of a piece at which it is looked at."""


class Exact:
    """Of runs of a rig, whose counters begin at begun; temperature_c: at the start, None where nobody stated it."""

    def __init__(
        self, rig: Rig, scheme: Scheme, calibration: CalibrationRecord | None, *, temperature_c: float | None, begun: Zero
    ) -> None:
        self._rig, self._scheme, self._calibration = rig, scheme, calibration
        self._temperature_c, self._begun = temperature_c, begun
        # where the point itself is measured its place in the tool frame does not enter
        self._variables = [
            v
            for v in exact(rig, None, () if calibration is None else calibration.names)
            if scheme.point is None or v.kind is not ATTACHMENT
        ]

    def at(self, poses: FloatArray, lengths: Lengths, twists: Callable[[FloatArray, FloatArray], FloatArray]) -> tuple[Taken, ...]:
        """At some of the (n, 7) poses of a piece of a run; twists (k, 6, m) of poses (k, 7) and true counts (k, m), per mm of each
        length."""
        known = np.flatnonzero(~np.isnan(poses[:, 0]))
        if not len(known):
            return ()
        some = known[:: -(-len(known) // SAMPLED)]
        few = np.ascontiguousarray(poses[some])
        if self._scheme.point is not None:
            few[:, 3:] = (0.0, 0.0, 0.0, 1.0)
        counts, drawn = lengths.counts[some], slice(0, len(self._rig.cable))
        return taken_as_exact(
            self._rig,
            self._variables,
            self._scheme.rows[drawn],
            self._begun,
            poses=few,
            counts=counts[:, drawn],
            twists=twists(few, counts)[:, :, drawn],
            warmth=self._warmth(lengths),
        )

    def _warmth(self, lengths: Lengths) -> Warmth:
        """What is known of the run's temperature: at its start and at these samples."""
        rig, record = self._rig, self._calibration
        at_start = np.nan if self._temperature_c is None else self._temperature_c
        seen = np.append(at_start, () if lengths.temperature_c is None else lengths.temperature_c)
        seen = seen[np.isfinite(seen)]
        of_rig = REFERENCE_C if rig.reference_temperature_c is None else rig.reference_temperature_c
        reference = of_rig if record is None else record.temperature_c
        effects = effects_of(rig)
        low, high = (float(seen.min()), float(seen.max())) if len(seen) else (None, None)
        return Warmth(reference, low, high, effects is not None and effects.thermal, RIG if record is None else CALIBRATION)
