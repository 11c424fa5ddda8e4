"""Vibration in a trajectory: the bias of local cubics that smooth it, and the frequencies and amplitudes that the samples show.

A smoother with the response H_a(f) for the derivative of order a changes a vibration of frequency f by (2 pi i f)^a - H_a(f), and leaves
1 - H_0(f) of it in the residuals. The bias of each derivative is therefore the residual through the filter

    G_a(f) = ((2 pi i f)^a - H_a(f)) / (1 - H_0(f)),

and its mean square is the residuals' power spectrum times |G_a|^2, where that spectrum exceeds the samples' own noise. Short blocks show
where a vibration is; longer blocks show weaker ones. This is an upper bound on the bias, not a correction of it.

Frequencies are those of peaks above the neighbouring spectrum (Welch; Hann's window), up to `HIGHEST` times the sampling rate.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from lmeasure.core import BoolArray, FloatArray
from lmeasure.kernels import TERMS

HIGHEST = 0.35  # Times the sampling rate: the highest frequency at which statements are made
SHORTEST = 32  # Samples of the shortest block at least
LONGER = 8  # Times as many samples as the block before, for blocks that show weaker vibration
SCALES = 4
LASTING = 0.2  # Part of a block: vibration in so many shorter blocks counts for the whole block
AXES = 3
LEAST_POWER = 1e-18  # mm^2 or rad^2: less is nothing
CHANCE = 1e-2  # Probability of false vibration from noise alone, in a record and in blocks of one size
LEAST_LEFT = 1e-3  # Of a vibration, in the residuals: below it |G| is continued as it is there
LINE_S = 4.0  # Length of the blocks for the search of frequencies
PADDED = 4
LINES = 4  # Frequencies per axis at most
LEAST_PERIODS = 6.0  # Least periods of a vibration in a block: slower ones count as motion
ABOUT_BINS = 24  # Bins on either side, whose median is the spectrum next to a peak
NORMAL_95 = 1.959963984540054


@dataclass(frozen=True)
class Vibration:
    """A vibration of the tool origin along one base axis: frequency [Hz] and amplitude [mm], mean over the record, with U95."""

    axis: str
    frequency_hz: float
    u95_frequency_hz: float
    amplitude_mm: float
    u95_amplitude_mm: float

    @property
    def speed_mm_s(self) -> float:
        """Amplitude of the velocity."""
        return 2.0 * math.pi * self.frequency_hz * self.amplitude_mm

    @property
    def u95_speed_mm_s(self) -> float:
        """U95 of the velocity's amplitude."""
        apart = self.frequency_hz * self.u95_amplitude_mm, self.amplitude_mm * self.u95_frequency_hz
        return 2.0 * math.pi * math.hypot(*apart)

    def values(self) -> dict[str, float]:
        """Return names with units, and values."""
        return {
            "frequency_hz": self.frequency_hz,
            "u95_frequency_hz": self.u95_frequency_hz,
            "amplitude_mm": self.amplitude_mm,
            "u95_amplitude_mm": self.u95_amplitude_mm,
            "speed_mm_s": self.speed_mm_s,
            "u95_speed_mm_s": self.u95_speed_mm_s,
        }


def response(half_width_s: float, step_s: float, hz: FloatArray) -> np.ndarray:
    """(4, F) response of local cubics and of their derivatives (`kernels.motion.local_cubics`) to vibration of frequencies hz (F,)."""
    k = int(half_width_s / step_s + 1e-9)
    tau = np.arange(-k, k + 1) * step_s / half_width_s
    weight = np.maximum(1.0 - tau**2, 1e-3)
    powers = tau[:, None] ** np.arange(TERMS)
    fit = np.linalg.solve(powers.T @ (weight[:, None] * powers), powers.T * weight)
    scale = np.array([math.factorial(a) / half_width_s**a for a in range(TERMS)])
    return np.asarray((scale[:, None] * fit) @ np.exp(2j * np.pi * np.outer(tau * half_width_s, hz)))


def smoothing_bias(left: FloatArray, u: FloatArray, step_s: float, half_width_s: float) -> FloatArray:
    """Return the (n, 4, c) standard uncertainty of local cubics and their derivatives by smoothing. left (n, c): residuals of samples at
    even steps step_s, whose noise is known to u (n, c)."""
    n, c = left.shape
    square = np.zeros((n, TERMS, c))
    if n < SHORTEST or half_width_s < 1.5 * step_s:
        return square
    size = min(max(SHORTEST, 2 * int(half_width_s / step_s)), n)
    for _ in range(SCALES):
        starts = np.unique([*range(0, n - size + 1, max(size // 2, 1)), n - size])
        found = _excess(left, u, starts, size, step_s, half_width_s)
        weaker = np.zeros_like(square)
        for start, own in zip(starts.tolist(), found, strict=True):
            if own.any():
                part = slice(start, start + size)
                # vibration that shorter blocks show is where they show it, unless they show it in much of the block
                shown = square[part]
                lasting = shown.any(axis=(1, 2)).mean() > LASTING
                weaker[part] = np.maximum(weaker[part], np.maximum(own - (shown if lasting else shown.mean(axis=0)), 0.0))
        square += weaker
        if size == n:
            break
        size = min(LONGER * size, n)
    return np.sqrt(square)


def _excess(left: FloatArray, u: FloatArray, starts: np.ndarray, size: int, step_s: float, half_width_s: float) -> FloatArray:
    """(b, 4, c) mean squares of the bias in blocks of so many samples from each start (b,)."""
    window = scipy.signal.get_window("hann", size)
    hz = np.asarray(np.fft.rfftfreq(size, step_s), dtype=np.float64)
    gain, lost = _gain(half_width_s, step_s, hz)
    # the window spreads each frequency over its neighbours
    lost = np.sqrt(scipy.ndimage.convolve1d(lost**2, [1 / 6, 2 / 3, 1 / 6], mode="mirror"))
    double = np.where((hz == 0.0) | (2 * np.arange(len(hz)) == size), 1.0, 2.0)
    out = np.zeros((len(starts), TERMS, left.shape[1]))
    at_once = max(1, 2**20 // size)
    # the axes of one vibration share its frequency
    limit = float(scipy.stats.gamma.isf(CHANCE / (len(hz) * len(starts)), AXES))
    for first in range(0, len(starts), at_once):
        rows = starts[first : first + at_once, None] + np.arange(size)
        power = np.abs(np.fft.rfft(left[rows] * window[:, None], axis=1)) ** 2 * (double / (size * (window**2).sum()))[:, None]
        noise = (u[rows] ** 2).mean(axis=1)[:, None, :] * (double * lost**2 / size)[:, None]
        together = (power / (noise + LEAST_POWER)).reshape(*power.shape[:2], -1, AXES).sum(axis=3) > limit
        over = np.repeat(scipy.ndimage.binary_dilation(together, np.ones((1, 5, 1), np.bool_)), AXES, axis=2)
        # along an axis that swings little, noise hides how much: all of the power there counts
        excess = np.where(over, power, 0.0)
        # noise that is not white, as of a slow cable, has lines too, and less power beside them
        rest, expected = (_of_axes(np.where(over, 0.0, each).sum(axis=1)) for each in (power, noise))
        bins = np.maximum(_of_axes((~over).sum(axis=1)), 1.0)
        missing = np.maximum(1.0 - rest / np.maximum(expected, LEAST_POWER) - 1.0 / np.sqrt(bins), 0.0) * _of_axes(noise.sum(axis=1))
        lines = np.maximum(_of_axes(excess.sum(axis=1)), LEAST_POWER)
        excess *= np.repeat(np.maximum(1.0 - missing / lines, 0.0), AXES, axis=1)[:, None, :]
        out[first : first + at_once] = np.einsum("bfc,af->bac", excess, gain**2)
    return out


def _of_axes(power: FloatArray) -> FloatArray:
    """(b, c / 3) sums of powers (b, c) over the axes of rotation, and of position."""
    return power.reshape(len(power), -1, AXES).sum(axis=2)


def _gain(half_width_s: float, step_s: float, hz: FloatArray) -> tuple[FloatArray, FloatArray]:
    """|G| (4, F), and how much of a vibration stays in the residuals (F,)."""
    fine = np.linspace(0.0, 0.5 / step_s, 2001)
    lost = np.abs(1.0 - response(half_width_s, step_s, fine)[0])
    least = fine[int(np.argmax(lost > LEAST_LEFT))]
    used = np.maximum(hz, least)
    of = response(half_width_s, step_s, used)
    remains = np.abs(1.0 - of[0])
    true = (2j * np.pi * used) ** np.arange(TERMS)[:, None]
    return np.abs(true - of) / np.maximum(remains, LEAST_LEFT), np.abs(1.0 - response(half_width_s, step_s, hz)[0])


def vibrations(time_s: FloatArray, positions: FloatArray, stretches: Sequence[slice]) -> tuple[Vibration, ...]:
    """The vibration of positions (n, 3) [mm] along each axis, strongest first; stretches: the parts without gaps."""
    if not stretches:
        return ()
    longest = max(s.stop - s.start for s in stretches)
    if longest < 2 * SHORTEST:
        return ()
    step_s = float(np.median([float(np.median(np.diff(time_s[s]))) for s in stretches if s.stop - s.start > 1]))
    if not step_s > 0.0:
        return ()
    size = int(min(longest, max(2 * SHORTEST, round(LINE_S / step_s))))
    blocks = [positions[start : start + size] for s in stretches for start in range(s.start, s.stop - size + 1, size)]
    hz = np.asarray(np.fft.rfftfreq(PADDED * size, step_s), dtype=np.float64)
    window = scipy.signal.get_window("hann", size)
    powers = np.linspace(-1.0, 1.0, size)[:, None] ** np.arange(4)
    trend = np.linalg.qr(powers)[0]
    even = [(b - trend @ (trend.T @ b)) * window[:, None] for b in blocks]
    spectra = np.array([np.abs(np.fft.rfft(b, PADDED * size, axis=0)) ** 2 * (2.0 / window.sum()) ** 2 for b in even])
    inside = (hz >= LEAST_PERIODS / (size * step_s)) & (hz <= HIGHEST / step_s)
    found = [line for i, axis in enumerate("xyz") for line in _lines(axis, hz, spectra[:, :, i], inside, size * step_s)]
    return tuple(sorted(found, key=lambda line: -line.speed_mm_s))


def _lines(axis: str, hz: FloatArray, spectra: FloatArray, inside: BoolArray, lasts_s: float) -> list[Vibration]:
    """The peaks of squares of amplitudes (b, F) of blocks that last lasts_s."""
    mean, blocks = spectra.mean(axis=0), len(spectra)
    number = max(int(inside.sum()) // PADDED, 1)
    of_median = scipy.stats.gamma.ppf(0.5, blocks) / blocks
    near = scipy.ndimage.median_filter(mean, 2 * ABOUT_BINS * PADDED + 1, mode="nearest") / of_median
    limit = scipy.stats.gamma.isf(CHANCE / number, blocks) / blocks
    free = inside.copy()
    out = list[Vibration]()
    for _ in range(LINES):
        i = int(np.argmax(np.where(free & (mean > 2.0 * limit * near), mean, 0.0)))
        if not free[i] or mean[i] <= 2.0 * limit * near[i] or mean[i] < LEAST_POWER:
            break
        free &= np.abs(hz - hz[i]) > 4.0 / lasts_s
        if not mean[i] > max(mean[i - 1], mean[min(i + 1, len(mean) - 1)]):
            continue
        before, at, behind = np.log(mean[i - 1 : i + 2])
        part = 0.5 * (before - behind) / (before - 2.0 * at + behind)
        square = float(np.exp(at - 0.25 * (before - behind) * part))
        noise = float(near[i])
        amplitude = math.sqrt(max(square - noise, 0.0))
        scatter = float(np.sqrt(spectra[:, i]).std(ddof=1)) if blocks > 1 else 0.0
        u = math.hypot(math.sqrt(noise / 2.0), scatter) / math.sqrt(blocks)
        u_hz = 0.5 / lasts_s * math.sqrt(noise / square / blocks)
        frequency = float(hz[i] + part * (hz[1] - hz[0]))
        out.append(Vibration(axis, frequency, NORMAL_95 * u_hz, amplitude, NORMAL_95 * u))
    return out
