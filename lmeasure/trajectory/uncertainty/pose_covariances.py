"""Errors of the poses of a run: what is new at every sample, and what all samples share."""

from dataclasses import dataclass

import numpy as np

from lmeasure.core import DataFrame, FloatArray, Shown, framed


@dataclass(frozen=True, repr=False)
class PoseCovariances(Shown):
    """Errors of poses, delta = (rotation [rad]; tool origin [mm]), R_true = Exp(delta_rotation) R, base axes; NaN where there is no pose.

    own (n, 6, m): the random error is own @ u, with u (m,) of unit variance for the counts of the m cables, new at every sample.
    factors (n, 6, K): the systematic error is factors @ z with one z (K,) of independent variables of unit variance for the whole run, so
    that factors[i] @ factors[j].T is its covariance between the samples i and j. sources (K,): what each stands for: "calibration",
    "dimensions as stated", "start pose", "zero phase", "clock of pass 2", "place of pass 2", "temperature, stretch and sag", "run-out of
    drums", "eccentric pulleys", "play of drums", "lengths of their own". uniform (K,): whether the variable is uniform, or normal; none is
    by default.
    """

    own: FloatArray
    factors: FloatArray
    sources: tuple[str, ...]
    uniform: tuple[bool, ...] = ()

    def about(self) -> dict[str, str]:
        """How many poses, how large the errors are at most, and what poses share."""
        random, shared = (np.sqrt(np.einsum("nii->ni", c)) for c in (self.random, self.systematic))
        largest = {name: np.nanmax(u[:, 3:], initial=0.0) for name, u in (("random u", random), ("shared u", shared))}
        sources = {source: self.sources.count(source) for source in self.sources}
        return {
            "poses": str(len(self.own)),
            **{f"largest {name}": f"{value:.3g} mm" for name, value in largest.items()},
            "shared by": ", ".join(f"{source} ({n})" for source, n in sources.items()) or "nothing",
        }

    def to_frame(self) -> DataFrame:
        """Standard uncertainties of each pose, base axes: of what is its own, and of what all share."""
        names = ("rx_rad", "ry_rad", "rz_rad", "x_mm", "y_mm", "z_mm")
        parts = (("u", self.random), ("u_systematic", self.systematic))
        return framed({f"{part}_{name}": np.sqrt(c[:, i, i]) for part, c in parts for i, name in enumerate(names)})

    @property
    def random(self) -> FloatArray:
        """(n, 6, 6) covariance of what is independent from sample to sample."""
        return np.asarray(self.own @ np.swapaxes(self.own, 1, 2))

    @property
    def systematic(self) -> FloatArray:
        """(n, 6, 6) covariance of the systematic error at each sample."""
        return np.asarray(self.factors @ np.swapaxes(self.factors, 1, 2))
