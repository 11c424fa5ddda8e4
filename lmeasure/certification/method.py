"""The number of the way in which figures are computed.

1: certificates that state none. 2: vibration within dwells as one signal, the largest of many samples behind a corner, the unknown phase of
counters, what a rig does not state, verdicts of components alone, counts that were lost or do not close. 3: channels that stepped or
stood, and redundant cables that contradict each other, are not used. 4: later passes are read between their samples by cubics; of one pass,
and of poses without a run, the figures are those of 3. 5: what is drawn of a linked calibration does not depend on
the signs of eigenvectors, which each build of LAPACK chooses; without a linked calibration the figures are those of 4.
"""

from collections.abc import Mapping
from typing import Any

METHOD = 5
"""Raised whenever the same inputs give other figures, or the same figures another verdict."""
SAME_UNLINKED = 4
"""From which methods differ where a calibration is linked only."""
SAME_FOR_ONE_PASS = 3
"""From which they differ in runs of several passes only, besides."""


def method_of(certificate: Mapping[str, Any]) -> int:
    """The method by which a certificate was made."""
    return int(certificate.get("method", 1))


def same_figures(method: int, passes: int, linked: bool) -> bool:
    """Whether a method gives today's figures for a run of so many passes, or for poses without a run, of one; linked: to a calibration."""
    since = METHOD if linked else SAME_FOR_ONE_PASS if passes == 1 else SAME_UNLINKED
    return since <= method <= METHOD
