"""Recordings of simulators that drew no phase, at poses that are exact: neither is said in their files."""

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


def exact_poses(campaign: Recording) -> Recording:
    """A campaign whose reference poses are exact, which its file does not say."""
    changed: Recording = replace(campaign, poses=campaign.poses.with_uncertainty(0.0, 0.0))
    return changed
