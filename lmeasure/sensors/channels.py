"""The channels of an instrument as arrays, built once from a rig and its calibration record."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from lmeasure.core import BoolArray, DataFrame, FloatArray, IntArray, Shown, covariance_root, framed
from lmeasure.kernels import CABLE, KIND
from lmeasure.rig import CalibrationRecord, Observed, Rig, parameter_names
from lmeasure.sensors.lengths import count_variance, rounding_variance
from lmeasure.sensors.rejected_samples import ARM_MM
from lmeasure.sensors.stated_errors import cable_covariance


@dataclass(frozen=True, repr=False)
class Channels(Shown):
    """The m channels of an instrument, cables first: lengths [mm] and angles [rad].

    Every array has an entry for each channel. Every property of a kind of sensor that a stage uses is a column here.
    """

    names: tuple[str, ...]
    """Names in results."""
    columns: tuple[str, ...]
    """Their columns in counts files."""
    kinds: tuple[str, ...]
    """Their tables in rig.toml."""
    rows: FloatArray
    """(m, columns) rows of the kernels."""
    scale: FloatArray
    """(m,) decoding factors of counts."""
    per_count: FloatArray
    """(m,) reading of a true count [mm or rad]."""
    variance: FloatArray
    """(m,) of one reading [mm^2 or rad^2]: rounding of the count, and noise."""
    rounding: FloatArray
    """(m,) the part of the rounding."""
    absolute: BoolArray
    """(m,) whether a channel knows its reading at power-on; others count from where they were zeroed."""
    zeroing: IntArray
    """(m,) number of the zeroing that a channel counts from (`Rig.zeroings`)."""
    passage: IntArray
    """(m,) pass of the motion in which a channel is read."""
    parameters: tuple[tuple[str, ...], ...]
    """Names of the kernels' 13 parameters in a calibration record, empty where a channel does not have one."""
    root: FloatArray
    """(13 m, r) square root of the parameters' covariance [mm, rad], from the record and from the rig's other statements."""

    @classmethod
    def of_rig(
        cls, rig: Rig, record: CalibrationRecord | None = None, channels: tuple[Observed, ...] | None = None, *, covariance: bool = True
    ) -> "Channels":
        """Return the channels of a rig, all by default.

        Parameters
        ----------
        rig
            The instrument.
        record
            Its calibration, if there is one.
        channels
            Some of `Rig.observed`.
        covariance
            Whether the root of the parameters' covariance is wanted; without it there are no columns.
        """
        chosen = rig.observed if channels is None else channels
        counters, names = [rig.counter(o) for o in chosen], parameter_names(rig, chosen)
        root = np.zeros((sum(map(len, names)), 0))
        if covariance:
            C = cable_covariance(rig, record, chosen)
            root = covariance_root(C, np.sqrt(np.diag(C)))
        return cls(
            names=tuple(o.name for o in chosen),
            columns=tuple(o.channel for o in chosen),
            kinds=tuple(o.kind for o in chosen),
            rows=rig.cable_rows(chosen),
            scale=rig.scales(chosen),
            per_count=np.array([c.per_count for c in counters]),
            variance=count_variance(rig, chosen),
            rounding=rounding_variance(rig, chosen),
            absolute=np.array([c.absolute for c in counters], dtype=np.bool_),
            zeroing=rig.zeroings(chosen),
            passage=np.array([o.passage for o in chosen], dtype=np.int64),
            parameters=tuple(map(tuple, names)),
            root=root,
        )

    def __len__(self) -> int:
        return len(self.names)

    @property
    def cables(self) -> int:
        """Return how many are cables: the first ones."""
        return self.kinds.count("cable")

    @property
    def angular(self) -> BoolArray:
        """(m,) whether a reading is an angle."""
        return np.asarray(self.rows[:, KIND] > CABLE)

    @property
    def period(self) -> FloatArray:
        """(m,) by how much readings differ that are the same: a turn of angles, else infinite."""
        return np.where(self.angular, 2.0 * np.pi, np.inf)

    @property
    def per_unit(self) -> FloatArray:
        """(m,) millimetres per unit of a reading: of angles those at `ARM_MM`."""
        return np.where(self.angular, ARM_MM, 1.0)

    @property
    def noise_counts(self) -> FloatArray:
        """(m,) standard deviations of single readings besides their rounding [recorded counts]."""
        return np.sqrt(np.maximum(self.variance - self.rounding, 0.0)) / self.per_count * self.scale

    def about(self) -> dict[str, str]:
        """Return how many channels of each kind there are."""
        return {kind: ", ".join(n for n, k in zip(self.names, self.kinds, strict=True) if k == kind) for kind in dict.fromkeys(self.kinds)}

    def to_frame(self) -> DataFrame:
        """Return a row for each channel."""
        shown: dict[str, Any] = {"channel": self.names, "kind": self.kinds, "column": self.columns, "pass": self.passage}
        unit = np.where(self.angular, np.degrees(1.0), 1.0)
        shown |= {"unit": np.where(self.angular, "deg", "mm"), "per_count": self.per_count * unit}
        return framed(shown | {"u_reading": np.sqrt(self.variance) * unit, "absolute": self.absolute, "zeroing": self.zeroing})

    def __str__(self) -> str:
        return str(self.to_frame().to_string(index=False))

    def arrays(self) -> dict[str, FloatArray]:
        """Return its arrays by name, for a digest."""
        return {f"channels.{f.name}": np.asarray(value) for f in fields(self) if isinstance(value := getattr(self, f.name), np.ndarray)}
