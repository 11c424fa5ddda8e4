"""Drift of a result between its calibrations, and when the next one is due (ILAC-G24:2022, methods by control chart and by drift).

x_i of standard uncertainty u_i at times t_i [days] is x_0 + r (t - t_0) + w(t) + error: a line of unknown height and slope, a random walk w
of variance q per day, and the measurements' errors. By the restricted likelihood of q the forecast is averaged over walks that have between
a tenth and ten times the measurements' uncertainty from one calibration to the next, all sizes alike (log-uniform): few calibrations do
not determine q, and that widens the forecast. At a later time the value is a mixture of normal laws.

With m and s of the first values (the baseline) and z = (x - m) / s:

    Shewhart    |z| > 3                                                              average run length 370 without a change
    EWMA        e = 0.2 z + 0.8 e,  |e| > 2.86 sqrt(0.2 / 1.8 (1 - 0.8^2i))          370    (Lucas, Saccucci, Technometrics 32 (1990))
    CUSUM       c+ = max(0, c+ + z - 0.5), c- = max(0, c- - z - 0.5), either > 4.774 370    (Hawkins, Olwell, Cumulative Sum Charts, 1998)

A shift by one s is found after 44, 9 and 10 values on average, if m and s are known. From a short baseline both are uncertain, so the
limits are wider: as many sound instruments signal within 20 values as with known m and s (5 %, 6 % and 4 %). `CHART_LIMITS` was
simulated with 400,000 instruments for each baseline (Quesenberry, Journal of Quality Technology 25 (1993), shows why the usual limits
are too narrow).
"""

import datetime
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import scipy.optimize
from pydantic import Field, model_validator
from scipy.special import ndtr

from lmeasure.core import CertificationError, FileFormatError, FloatArray
from lmeasure.io import Strict, checked, files, of_key
from lmeasure.register.register import Register
from lmeasure.text import Message, message

LEAST = 3
"""Calibrations from which a drift is estimated."""
WALKS, GRID = (1e-2, 1e2), 25
"""Variances of the walk between calibrations over that of a measurement, and how many of them."""
PROBABILITY = 0.95
SEARCHED, HALVINGS = 30, 30
"""Times at which a risk is looked for, and halvings of the step in which it is reached."""


@dataclass(frozen=True)
class Forecast:
    """Values at later times of one series or of many (leading axes ...), by walks of k variances.

    weights: (..., k) probabilities of the walks; mean, variance: (2, ..., k) and (3, ..., k) coefficients of powers of the days since the
    last calibration, whose time is last (...); drift, u_drift: slope of the line [unit/day] (...); walk: weighted standard deviation of
    the random walk [unit/sqrt(day)] (...).
    """

    weights: FloatArray
    mean: FloatArray
    variance: FloatArray
    last: FloatArray
    drift: FloatArray
    u_drift: FloatArray
    walk: FloatArray

    def at(self, time: FloatArray | float) -> tuple[FloatArray, FloatArray]:
        """Return mean and standard deviation by each walk, (..., k), at times (...) [days] not before the last calibration."""
        days = np.asarray(time - self.last)[..., None]
        mean = self.mean[0] + days * self.mean[1]
        variance = self.variance[0] + days * (self.variance[1] + days * self.variance[2])
        return mean, np.maximum(np.sqrt(np.maximum(variance, 0.0)), 1e-12 * (1.0 + np.abs(mean)))

    def risk(self, time: FloatArray | float, lower: FloatArray | float, upper: FloatArray | float) -> FloatArray:
        """Return the probability (...) that the value is beyond limits at a time."""
        mean, sigma = self.at(time)
        low, high = np.asarray(lower)[..., None], np.asarray(upper)[..., None]
        return np.asarray((self.weights * (ndtr((mean - high) / sigma) + ndtr((low - mean) / sigma))).sum(axis=-1))

    def interval(self, time: float, probability: float = PROBABILITY) -> tuple[float, float]:
        """Return the interval that holds the value of one series at a time with a probability, its tails alike."""
        mean, sigma = self.at(time)
        low, high = float((mean - 12.0 * sigma).min()), float((mean + 12.0 * sigma).max())

        def quantile(q: float) -> float:
            return float(scipy.optimize.brentq(lambda x: self.weights @ ndtr((x - mean) / sigma) - q, low, high))

        tail = 0.5 * (1.0 - probability)
        return quantile(tail), quantile(1.0 - tail)

    def due(
        self, lower: FloatArray | float, upper: FloatArray | float, risk: FloatArray | float = 0.05, longest: FloatArray | float = 3650.0
    ) -> FloatArray:
        """Return the first time (...) [days] at which the value is beyond its limits with more than this risk; at most so long after the
        last calibration, and the time of that if the risk is exceeded there."""
        end = self.last + longest
        good, bad, found = self.last, end, np.zeros(self.last.shape, dtype=bool)
        for part in np.linspace(0.0, 1.0, SEARCHED):
            time = self.last + part * longest
            over = ~found & (self.risk(time, lower, upper) > risk)
            found, bad = found | over, np.where(over, time, bad)
            good = np.where(found, good, time)
        for _ in range(HALVINGS):
            middle = 0.5 * (good + bad)
            over = self.risk(middle, lower, upper) > risk
            good, bad = np.where(over, good, middle), np.where(over, middle, bad)
        return np.where(found, bad, end)


def forecast(times: FloatArray, values: FloatArray, u: FloatArray) -> Forecast:
    """Return the forecast from n calibrations: times (n,) [days], values (n,), standard uncertainties (n,) independent of each other.

    Raises
    ------
    CertificationError
        If there are fewer than three calibrations at different times, or an uncertainty is not above zero.
    """
    if len(np.unique(times)) < LEAST:
        raise CertificationError(message("error.calibrations_at_different_times", n_unique=len(np.unique(times)), least=LEAST))
    if not (u > 0.0).all():
        raise CertificationError(message("error.a_drift_is_estimated"))
    order = np.argsort(times, kind="stable")
    return _forecasts(times[order], values[order], u[order])


def _forecasts(t: FloatArray, x: FloatArray, u: FloatArray) -> Forecast:
    """Return the forecasts of series (..., n) in order of time; an infinite u pads a short series.

    For each variance of the walk a Kalman filter of the walk alone whitens the columns 1, t and x. Their products are those of generalised
    least squares, and the filtered columns give the walk after the last value.
    """
    weight, s = u**-2.0, t - t[..., :1]
    # subtract a plain line first, so that values much larger than their scatter keep their digits
    middle = [(weight * y).sum(axis=-1, keepdims=True) / weight.sum(axis=-1, keepdims=True) for y in (s, x)]
    away = s - middle[0]
    slope = (weight * away * (x - middle[1])).sum(axis=-1, keepdims=True) / (weight * away**2).sum(axis=-1, keepdims=True)
    columns = np.stack([np.ones_like(s), s, x - middle[1] - slope * away], axis=-1)
    # between calibrations the walk has between a tenth and ten times the measurements' uncertainty
    stated, steps = np.isfinite(u), np.diff(s, prepend=0.0)
    typical = np.where(stated, u, 0.0) ** 2.0
    gap = s[..., -1] / (steps > 0.0).sum(axis=-1)
    walks = (typical.sum(axis=-1) / stated.sum(axis=-1) / gap)[..., None] * np.geomspace(*WALKS, GRID)
    P, w = np.zeros(walks.shape), np.zeros((*walks.shape, 3))
    logs, products = np.zeros(walks.shape), np.zeros((*walks.shape, 3, 3))
    for i in range(t.shape[-1]):
        P = P + walks * steps[..., i, None]
        F = P + u[..., i, None] ** 2.0
        v, gain = columns[..., None, i, :] - w, P / F
        w, P = w + gain[..., None] * v, P * (1.0 - gain)
        logs += np.log(F, where=stated[..., i, None], out=np.zeros(F.shape))
        products += v[..., :, None] * (v / F[..., None])[..., None, :]
    information, right = products[..., :2, :2], products[..., :2, 2]
    C = np.linalg.inv(information)
    line = (C @ right[..., None])[..., 0]
    logs = -0.5 * (logs + np.linalg.slogdet(information)[1] + products[..., 2, 2] - (right * line).sum(axis=-1))
    weights = np.exp(logs - logs.max(axis=-1, keepdims=True))
    weights /= weights.sum(axis=-1, keepdims=True)
    # height and slope of the line at the last value, where the walk is not predicted by it
    r = np.stack([1.0 - w[..., 0], s[..., -1:] - w[..., 1]], axis=-1)
    Cr = (C @ r[..., None])[..., 0]
    slopes = slope + line[..., 1]
    mean = middle[1] + slope * (s[..., -1:] - middle[0]) + w[..., 2] + (r * line).sum(axis=-1)
    drift = (weights * slopes).sum(axis=-1)
    u_drift = np.sqrt((weights * (C[..., 1, 1] + (slopes - drift[..., None]) ** 2)).sum(axis=-1))
    variance = np.stack([P + (r * Cr).sum(axis=-1), walks + 2.0 * Cr[..., 1], C[..., 1, 1]])
    return Forecast(weights, np.stack([mean, slopes]), variance, t[..., -1], drift, u_drift, np.sqrt((weights * walks).sum(axis=-1)))


LIMITS = "limits.toml"
EPOCH = datetime.date(1970, 1, 1)


class Limit(Strict):
    """Limits that a result must keep until the next calibration."""

    subject: Annotated[str, Field(min_length=1)]
    """Serial number of the robot, or name of the rig or reference instrument."""
    result: Annotated[str, Field(min_length=1)]
    """Name of the result, such as "AP_p P1"."""
    kind: Literal["certificate", "calibration", "check", "reference"] = "certificate"
    """Kind of the documents that state it."""
    lower: float | None = None
    """Lower limit, in the unit of the result."""
    upper: float | None = None
    """Upper limit, in the unit of the result."""
    risk_percent: Annotated[float, Field(gt=0, lt=50)] = 5.0
    """Accepted probability that the value is beyond a limit on the day of the next calibration."""
    longest_days: Annotated[float, Field(ge=1, le=36500)] = 730.0
    """Longest time between two calibrations, whatever the drift."""

    @model_validator(mode="after")
    def _limits_something(self) -> "Limit":
        if self.lower is None and self.upper is None:
            raise of_key("upper", message("error.state_upper_lower_or"))
        if self.lower is not None and self.upper is not None and self.lower >= self.upper:
            raise of_key("upper", message("error.must_be_above_lower"))
        return self

    @property
    def range(self) -> tuple[float, float]:
        """Lower and upper limit; infinite where none is stated."""
        return -np.inf if self.lower is None else self.lower, np.inf if self.upper is None else self.upper

    def excludes(self, value: float) -> bool:
        """Return whether a value is beyond the limits."""
        return not self.range[0] <= value <= self.range[1]


class Limits(Strict):
    """File limits.toml of a register."""

    schema_: Annotated[Literal["lmeasure.limits/1"], Field(alias="schema")] = "lmeasure.limits/1"
    """Kind and version of the file."""
    limit: tuple[Limit, ...] = ()
    """One table for each result with limits."""


@dataclass(frozen=True)
class Due:
    """Due date of a subject by a result. day: None without an entry; last: value of the last calibration; drift: per year, with its
    standard uncertainty, None with too few calibrations; beyond: whether the last value is beyond its limits."""

    limit: Limit
    unit: str
    day: datetime.date | None
    last: float | None = None
    drift: tuple[float, float] | None = None
    beyond: bool = False

    def overdue(self, today: datetime.date) -> bool:
        """Return whether the next calibration should have been made by today."""
        return self.beyond or (self.day is not None and self.day <= today)

    def said(self, today: datetime.date) -> Message:
        """Return the line of a list of due subjects."""
        about = {"subject": self.limit.subject, "result": self.limit.result, "unit": self.unit, "risk": self.limit.risk_percent}
        if self.day is None:
            return message("register.never", **about)
        code = "beyond" if self.beyond else "overdue" if self.day <= today else "due"
        return message(f"register.{code}", **about, day=self.day.isoformat(), last=self.last)


def read_limits(folder: Path) -> Limits:
    """Read limits.toml of a register's folder; without the file there are no limits."""
    path = folder / LIMITS
    if not path.is_file():
        return Limits()
    data = files.read_toml(path)
    if data.get("schema") != "lmeasure.limits/1":
        raise FileFormatError(message("error.schema_this_program_reads_lmeasure", where=path, stated=data.get("schema")))
    return checked(data, Limits, str(path))


def due(register: Register, limits: Limits) -> tuple[Due, ...]:
    """Return when each subject is due, the first first.

    Three calibrations or more determine a drift: the next calibration is due when the risk is reached. With fewer of them it is due after
    half the longest time.
    """
    series = register.series_of((limit.subject, limit.result, limit.kind) for limit in limits.limit)
    out, long = [], []
    for limit in limits.limit:
        days, values, u, unit = series[limit.subject, limit.result, limit.kind]
        if not len(days):
            out.append(Due(limit, unit, None))
        elif len(np.unique(days)) >= LEAST and (u > 0.0).all():
            long.append((limit, days, values, u, unit))
        else:
            beyond, wait = limit.excludes(values[-1]), limit.longest_days / (2.0 if len(days) < LEAST else 1.0)
            out.append(Due(limit, unit, _day(days[-1] + (0.0 if beyond else wait)), float(values[-1]), None, beyond))
    return tuple(sorted([*out, *_dues(long)], key=lambda d: d.day or datetime.date.min))


def _dues(series: Sequence[tuple[Limit, FloatArray, FloatArray, FloatArray, str]]) -> Iterator[Due]:
    """Yield when subjects are due whose series determine a drift, all of them forecast at once."""
    if not series:
        return
    limits, days, values, us, units = zip(*series, strict=True)
    n = np.array([len(d) for d in days])
    # a short series is padded by its last value, of infinite u
    index = np.minimum(np.arange(n.max()), n[:, None] - 1) + (np.cumsum(n) - n)[:, None]
    t, x, u = (np.concatenate(column)[index] for column in (days, values, us))
    found = _forecasts(t, x, np.where(np.arange(n.max()) < n[:, None], u, np.inf))
    lower, upper = np.array([limit.range for limit in limits]).T
    at = found.due(
        lower, upper, np.array([0.01 * limit.risk_percent for limit in limits]), np.array([limit.longest_days for limit in limits])
    )
    for i, (limit, unit) in enumerate(zip(limits, units, strict=True)):
        beyond = limit.excludes(x[i, -1])
        drift = (365.25 * float(found.drift[i]), 365.25 * float(found.u_drift[i]))
        yield Due(limit, unit, _day(float(t[i, -1] if beyond else at[i])), float(x[i, -1]), drift, beyond)


def _day(days: float) -> datetime.date:
    return EPOCH + datetime.timedelta(days=int(days))


LEAST_VALUES = 5
"""Values of a baseline."""
WEIGHT, SLACK = 0.2, 0.5
KNOWN = (3.0, 2.86, 4.774)
"""Limits of the Shewhart, EWMA and CUSUM charts with a known baseline."""
BASELINES = (5, 6, 7, 8, 10, 12, 15, 20, 30, 50, 100)
CHART_LIMITS = (
    (5.781, 5.133, 4.694, 4.418, 4.073, 3.861, 3.667, 3.481, 3.311, 3.189, 3.097),
    (6.414, 5.621, 5.090, 4.776, 4.327, 4.052, 3.801, 3.553, 3.315, 3.131, 2.989),
    (22.68, 18.26, 15.37, 13.61, 11.27, 9.866, 8.623, 7.466, 6.449, 5.723, 5.216),
)
"""Limits of the three charts with a baseline of so many values."""


@dataclass(frozen=True)
class Chart:
    """A chart of n values: name, statistic (n,), limit (n,), and indices of the values at which it signals."""

    name: str
    statistic: FloatArray
    limit: FloatArray

    @property
    def signals(self) -> tuple[int, ...]:
        """Indices at which the statistic is beyond its limit."""
        return tuple(np.flatnonzero(np.abs(self.statistic) > self.limit).tolist())


def control_charts(values: FloatArray, baseline: int) -> tuple[Chart, ...]:
    """Return the Shewhart, EWMA and CUSUM charts of values (n,), oldest first, by their first `baseline`.

    EWMA and CUSUM begin anew after the baseline.

    Raises
    ------
    CertificationError
        If the baseline is shorter than 5, longer than the values, or does not vary.
    """
    if not LEAST_VALUES <= baseline <= len(values):
        raise CertificationError(message("error.control_charts_need_a", least=LEAST_VALUES, n_values=len(values), baseline=baseline))
    mean, spread = float(values[:baseline].mean()), float(values[:baseline].std(ddof=1))
    if not spread > 0.0:
        raise CertificationError(message("error.the_first_values_are", baseline=baseline))
    z, limits = (values - mean) / spread, limits_after(baseline)
    parts = zip(charts_of(z[:baseline], limits), charts_of(z[baseline:], limits), strict=True)
    return tuple(Chart(a.name, np.append(a.statistic, b.statistic), np.append(a.limit, b.limit)) for a, b in parts)


def limits_after(baseline: int) -> tuple[float, ...]:
    """Return the limits of the three charts after a baseline of so many values: between those of `CHART_LIMITS`, by its inverse."""
    inverse = [0.0, *(1.0 / m for m in reversed(BASELINES))]
    wider = ([0.0, *np.log(np.array(row[::-1]) / known)] for row, known in zip(CHART_LIMITS, KNOWN, strict=True))
    return tuple(known * float(np.exp(np.interp(1.0 / baseline, inverse, by))) for known, by in zip(KNOWN, wider, strict=True))


def charts_of(z: FloatArray, limits: tuple[float, ...] = KNOWN) -> tuple[Chart, ...]:
    """Return the three charts of standardised values (n,) with their limits."""
    n, (shewhart, ewma, cusum) = len(z), limits
    smooth, sums = np.zeros(n), np.zeros(n)
    e = high = low = 0.0
    for i, value in enumerate(z.tolist()):
        e = WEIGHT * value + (1.0 - WEIGHT) * e
        high, low = max(0.0, high + value - SLACK), max(0.0, low - value - SLACK)
        smooth[i], sums[i] = e, high if high >= low else -low
    width = ewma * np.sqrt(WEIGHT / (2.0 - WEIGHT) * (1.0 - (1.0 - WEIGHT) ** (2.0 * np.arange(1, n + 1))))
    return Chart("Shewhart", z, np.full(n, shewhart)), Chart("EWMA", smooth, width), Chart("CUSUM", sums, np.full(n, cusum))
