"""A calibration campaign: a nominal rig, reference poses of the robot, and the counts recorded there."""

import itertools
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np

from lmeasure.core import BoolArray, CalibrationError, DataFrame, FloatArray, IntArray, Shown
from lmeasure.recording import Poses, joined
from lmeasure.rig import Cable, Input, Observed, Rig, cables_among
from lmeasure.sensors import Channels, zeroed_exactly
from lmeasure.text import message

Source = Literal["tracker", "robot", "unknown"]
"""Possible sources of reference poses."""


class Break(NamedTuple):
    """A lasting change of one cable during a campaign: its counter slipped, or its observation point moved, before this pose."""

    channel: str
    pose: str


@dataclass(frozen=True, repr=False)
class Campaign(Shown):
    """Counts of m channels at n reference poses, input of a calibration.

    Examples
    --------
    >>> campaign = lm.read_campaign(Path("campaign"))
    >>> len(campaign.poses), campaign.counts.shape
    (12, (12, 6))
    """

    rig: Rig
    """Nominal rig."""
    poses: Poses
    """Reference poses, n."""
    cables: tuple[Observed, ...]
    """Measured channels, m: cables, followed by other sensors."""
    counts: FloatArray
    """(n, m) decoded counts k, with the nominal sign and scale; NaN: not counted."""
    zero: IntArray
    """(m,) index of the pose at which each counter was zeroed; not used for absolute sensors."""
    inputs: tuple[Input, ...] = ()
    """Input files with their SHA-256 digests."""
    notes: tuple[str, ...] = ()
    """Notes for the user."""
    temperature_c: FloatArray | None = None
    """(n, m) temperature of each cable [°C]; None: reference temperature of the rig."""
    dwell_variance: FloatArray | None = None
    """(n, m) variances of means over dwells [recorded counts²]; None: single readings."""
    zero_variance: FloatArray | None = None
    """(m,) variances of the readings at the zero poses [recorded counts²]; None: single readings. See `zero_variances`."""
    reference: IntArray | None = None
    """(n,) index of the reference pose of each visit. Visits share its error. None: one visit each."""
    u_visit: FloatArray | None = None
    """(n, 6) standard uncertainties of a visit about its reference pose (rotation [rad]; position [mm]), base frame; or None."""

    source: Source = "unknown"
    """Source of the reference poses. The errors of a robot vary smoothly with the pose."""
    free_of_play: bool = False
    """Whether the stated play of the rig is already removed from the counts."""
    counted: IntArray | None = None
    """(n, m) order of counting: rows of the counts file; None: the order of the poses."""
    angles: FloatArray | None = None
    """(n, 3) angles of the poses as in their file; None: quaternions, or not recorded."""
    breaks: tuple[Break, ...] = ()
    """Found changes during the campaign, which are solved for."""

    def __post_init__(self) -> None:
        drums = self.drums
        zero = self.zero[: len(drums)]
        begun = np.nan_to_num(self.counts[zero, np.arange(len(drums))])
        object.__setattr__(self, "rig", self.rig.zeroed_at(self.poses.rows[zero], begun, drums))

    def about(self) -> dict[str, str]:
        """Return the rig, the numbers of poses and counts, and how well the poses are known."""
        poses = self.poses.about()
        read = int(np.isfinite(self.counts).sum())
        return {
            "rig": self.rig.name,
            "channels": ", ".join(c.name for c in self.cables),
            "counts": f"{read} of {self.counts.size}",
            **poses,
        }

    def to_frame(self) -> DataFrame:
        """The poses, with the counts of each."""
        return self.poses.to_frame().assign(**{c.name: self.counts[:, j] for j, c in enumerate(self.cables)})

    @property
    def reference_of(self) -> IntArray:
        """(n,) index of the reference pose of each pose, its own where it is not a later visit."""
        return np.arange(len(self.poses)) if self.reference is None else self.reference

    @property
    def drums(self) -> tuple[Cable, ...]:
        """The cables alone: the first channels."""
        return cables_among(self.cables)

    @cached_property
    def channels(self) -> Channels:
        """The measured channels as arrays."""
        return Channels.of_rig(self.rig, channels=self.cables, covariance=False)

    @property
    def from_zero(self) -> BoolArray:
        """(m,) whether a channel counts from its zero pose; absolute sensors do not."""
        return ~self.channels.absolute

    @property
    def mm_per_unit(self) -> FloatArray:
        """Return (m,) factors that make residuals of all channels millimetres; angles count as their way at `ARM_MM`."""
        return self.channels.per_unit

    @property
    def zero_variances(self) -> FloatArray:
        """Return the (m,) variances of the zero poses' readings [recorded counts^2].

        A counter zeroed at its zero pose is anywhere within its count there, unless that zero is exact. Every later count has this offset.
        If it was not zeroed there and its count is not 0, the offset cancels, but its reading there is rounded. Either error is uniform
        within half a count, and both never occur together. The mean of several readings of a dwell measures the offset as well as any
        length: the error of a mean of rounded readings remains (`calibration.campaign.dwells`).
        """
        if self.zero_variance is not None:
            return self.zero_variance
        known = zeroed_exactly(self.rig, self.cables) & (self._at_zero == 0.0)
        return np.where(~self.from_zero, 0.0, np.where(known, 0.0, 1.0 / 12.0) + self.channels.noise_counts**2)

    @property
    def travel(self) -> FloatArray:
        """(n, m) which way each cable came to a pose, if it went straight there from where it was counted before: 1 paid out, -1 wound in,
        0 where it was counted first, and of counts that are free of play."""
        out = np.zeros(self.counts.shape)
        for j in range(0 if self.free_of_play else len(self.cables)):
            own = np.flatnonzero(np.isfinite(self.counts[:, j]))
            order = own if self.counted is None else own[np.argsort(self.counted[own, j], kind="stable")]
            way = 0.0
            for before, i in itertools.pairwise(order):
                way = np.sign(self.counts[i, j] - self.counts[before, j]) or way
                out[i, j] = way
        return out

    def counted_at(self, j: int) -> IntArray:
        """Return (n,) when the poses were counted by a channel, as numbers in their order."""
        return np.arange(len(self.poses)) if self.counted is None else self.counted[:, j]

    @property
    def zero_readings(self) -> IntArray:
        """(m,) numbers of the errors that the cables' zero readings have: one for cables of several passes that were counted from one
        zeroing (`Rig.zeroings`), each its own for counters that were not zeroed at their zero pose."""
        of = self.channels.zeroing
        m = len(of)
        return np.where(self._at_zero == 0.0, of, m + np.arange(m))

    @property
    def _at_zero(self) -> FloatArray:
        return np.asarray(self.counts[self.zero, np.arange(len(self.cables))])

    @property
    def used(self) -> BoolArray:
        """(n, m) True where a count gives an equation: counted, and not the cable's own zero pose."""
        mask, since = np.isfinite(self.counts), np.flatnonzero(self.from_zero)
        mask[self.zero[since], since] = False
        return mask


def all_visits(campaign: Campaign, names: tuple[str, ...]) -> tuple[str, ...]:
    """The named poses with all visits of their reference poses, in the campaign's order; CalibrationError for one that it has not."""
    for name in names:
        if name not in campaign.poses.names:
            raise CalibrationError(message("error.pose_to_hold_out", name=name))
    requested = np.array([name in names for name in campaign.poses.names])
    requested = np.isin(campaign.reference_of, campaign.reference_of[requested])
    return tuple(name for name, each in zip(campaign.poses.names, requested, strict=True) if each)


def without_poses(campaign: Campaign, names: tuple[str, ...]) -> Campaign:
    """The campaign without the counts of the named poses; CalibrationError for one that it cannot do without."""
    counts = campaign.counts.copy()
    for name in names:
        pose = campaign.poses.names.index(name)
        if (campaign.zero == pose).any():
            raise CalibrationError(message("error.pose_to_hold_out_the", name=name))
        counts[pose] = np.nan
    return replace(campaign, counts=counts)


def with_counts_of(campaign: Campaign, whole: Campaign, names: tuple[str, ...]) -> Campaign:
    """Return the campaign with the counts of the named poses of another one, whose channels it may decode in another way."""
    counts, rows = campaign.counts.copy(), np.isin(campaign.poses.names, names)
    by_channel = {c.channel: j for j, c in enumerate(whole.cables)}
    place = {(c.channel, c.passage): j for j, c in enumerate(whole.cables)}
    for j, c in enumerate(campaign.cables):
        # a campaign that was read as one of another pass has each channel once
        i = place.get((c.channel, c.passage), by_channel[c.channel])
        before, now = whole.rig.counter(whole.cables[i]), campaign.rig.counter(c)
        decoded = (now.count_sign / now.scale) / (before.count_sign / before.scale)
        counts[rows, j] = whole.counts[rows, i] * (1.0 if decoded == 1.0 else decoded)
    return replace(campaign, counts=counts)


def of_cables(campaign: Campaign, keep: list[int]) -> Campaign:
    """The campaign with some of its cables only."""

    def kept(values: Any) -> Any:
        return None if values is None else np.ascontiguousarray(values[:, keep])

    return replace(
        campaign,
        cables=tuple(campaign.cables[j] for j in keep),
        counts=kept(campaign.counts),
        zero=campaign.zero[keep],
        temperature_c=kept(campaign.temperature_c),
        dwell_variance=kept(campaign.dwell_variance),
        zero_variance=None if campaign.zero_variance is None else campaign.zero_variance[keep],
        counted=kept(campaign.counted),
    )


def extended(
    campaign: Campaign, more: Poses, counts: FloatArray, u_visit: FloatArray | None = None, *, reading: float = 1.0 / 12.0
) -> Campaign:
    """Return the campaign with k further poses, each visited once, and their counts (k, m).

    u_visit (k, 6): as in `Campaign`, exact by default; reading: variance of one reading [recorded counts^2]. Temperatures are not extended.
    """
    n, k, m = len(campaign.poses), len(more), len(campaign.cables)
    before = np.full((n, m), 1.0 / 12.0) if campaign.dwell_variance is None else campaign.dwell_variance
    visits = [np.zeros((size, 6)) if u is None else u for size, u in ((n, campaign.u_visit), (k, u_visit))]
    return replace(
        campaign,
        poses=joined(campaign.poses, more),
        counts=np.vstack([campaign.counts, counts]),
        temperature_c=None,
        dwell_variance=np.vstack([before, np.full((k, m), reading)]),
        zero_variance=campaign.zero_variances,
        reference=np.concatenate([campaign.reference_of, n + np.arange(k)]),
        u_visit=np.vstack(visits),
        counted=None,
        angles=None,
    )
