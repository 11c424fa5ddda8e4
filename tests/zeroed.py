"""Rigs whose counters were zeroed exactly: recordings of simulators that drew no phase do not say so in their files."""

from dataclasses import replace
from typing import Any, TypeVar

from lmeasure.rig import Rig

Recording = TypeVar("Recording", bound=Any)


def exactly(rig: Rig) -> Rig:
    """The rig with `zero_exact` on every drum."""
    points = tuple(p.model_copy(update={"drum": p.drum.model_copy(update={"zero_exact": True})}) for p in rig.observation_point)
    return rig.model_copy(update={"observation_point": points})


def zeroed_exactly(recording: Recording) -> Recording:
    """A run, or a campaign, of such a rig."""
    changed: Recording = replace(recording, rig=exactly(recording.rig))
    return changed
