"""The number of the way in which figures are computed.

1: certificates that state none. 2: vibration within dwells as one signal, the largest of many samples behind a corner, the unknown phase of
counters, what a rig does not state, verdicts of components alone, counts that were lost or do not close. 3: channels that stepped or
stood, and redundant cables that contradict each other, are not used.
"""

from collections.abc import Mapping
from typing import Any

METHOD = 3
"""Raised whenever the same inputs give other figures, or the same figures another verdict."""


def method_of(certificate: Mapping[str, Any]) -> int:
    """The method by which a certificate was made."""
    return int(certificate.get("method", 1))
