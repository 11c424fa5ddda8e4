"""The number of the way in which figures are computed.

1: certificates that state none. 2: vibration within dwells as one signal, the largest of many samples behind a corner, the unknown phase of
counters, what a rig does not state, verdicts of components alone, counts that were lost or do not close. 3: channels that stepped or
stood, and redundant cables that contradict each other, are not used. 4: later passes are read between their samples by cubics; of one pass,
and of poses without a run, the figures are those of 3. 5: what is drawn of a linked calibration does not depend on
the signs of eigenvectors, which each build of LAPACK chooses; without a linked calibration the figures are those of 4. 6: what a counter
lost is taken off its counts, not its lengths, and more of what redundant channels say of one that errs is used; where none contradicts the
others the figures are those of 5. 7: readings of encoders whose zeros are not known well weigh as they are known until a run tells them,
and where it does not, poses err by them beyond first order; what a counter lost by and by is taken off its counts too; of other rigs and
runs the figures are those of 6. 8: where just as many channels count as there are unknowns, but not six drums, a run is lost at a singular
pose as six drums lose it; of runs that are not lost the figures are those of 7. 9: a cable that turns back under late stamps is kept;
where stamps come evenly, or miss whole samples, the figures are those of 8.
"""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from lmeasure.arrays import IntArray
from lmeasure.findings import Finding
from lmeasure.rig import Rig
from lmeasure.run import Run
from lmeasure.status import Status
from lmeasure.trajectory.prepared import OF_CONTRADICTIONS
from lmeasure.trajectory.steps import off_usual_s

METHOD = 9
"""Raised whenever the same inputs give other figures, or the same figures another verdict."""
SINCE = {"late": 9, "lost": 8, "rough": 7, "contradicted": 7, "linked": 5, "passes": 4}
"""From which methods give the same figures of runs whose samples are stamped late, that others than six drums lost at a singular pose,
where zeros of encoders are not known well, where redundant channels contradict each other, where a calibration is linked, and of several
passes."""
SAME_FOR_ONE_PASS = 3
"""From which of all others."""


def method_of(certificate: Mapping[str, Any]) -> int:
    """The method by which a certificate was made."""
    return int(certificate.get("method", 1))


def contradicted(notes: Iterable[Finding | str]) -> bool:
    """Whether the channels of a run contradict each other, by what is said of it."""
    return any(isinstance(note, Finding) and note.code in OF_CONTRADICTIONS for note in notes)


def lost(rig: Rig, status: IntArray) -> bool:
    """Whether others than six drums, to a body, lost a run at a singular pose, by the status (n,) of its samples."""
    six = len(rig.observed) == len(rig.cable) == 6 and len({c.to_point for c in rig.cable}) > 1
    return not six and bool(np.isin(status, (Status.SINGULAR, Status.OTHER_ASSEMBLY)).any())


def late(run: Run) -> bool:
    """Whether samples of a run are stamped unevenly."""
    return any(off_usual_s(p.time_s, float(np.median(np.diff(p.time_s)))).any() for p in run.passes if len(p.time_s) > 1)


def same_figures(method: int, *, passes: bool, linked: bool, rough: bool, contradicted: bool, lost: bool, late: bool) -> bool:
    """Whether a method gives today's figures for a run, or for poses without one, by what is so of it: several passes, a linked
    calibration, zeros of encoders that are not known well, channels that contradict each other, samples lost at a singular pose, or stamped
    late."""
    so = {"passes": passes, "linked": linked, "rough": rough, "contradicted": contradicted, "lost": lost, "late": late}
    return max([SAME_FOR_ONE_PASS, *(since for name, since in SINCE.items() if so[name])]) <= method <= METHOD
