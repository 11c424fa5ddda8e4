"""From when and until when a cable is in doubt, against the definition written out epoch by epoch, and by hand."""

import numpy as np

from lmeasure.core import FloatArray, IntArray
from lmeasure.trajectory.faults.consistency import spans


def by_definition(time_s: FloatArray, alarms: list[int], error: FloatArray, u: FloatArray) -> list[tuple[int, int]]:
    n, q = error.shape
    known = [[abs(error[a, j]) if np.isfinite(u[a, j]) else 0.0 for a in alarms] for j in range(q)]
    size = [float(np.quantile(of_cable, 0.9)) for of_cable in known]
    # an epoch speaks against an error only where it would have been seen: half of it, but at least 3 and at most 30 standard uncertainties
    times = [min(max(max(e / (2.0 * u[a, j]) for a, e in zip(alarms, known[j], strict=True)), 3.0), 30.0) for j in range(q)]
    agrees = [all(abs(error[i, j]) <= 2.0 * u[i, j] and times[j] * u[i, j] <= size[j] for j in range(q)) for i in range(n)]
    out: list[tuple[int, int]] = []
    for alarm in alarms:
        if any(alarm <= last for _, last in out):
            continue
        first = alarm
        while first > 0 and not agrees[first - 1]:
            first -= 1
        last = n - 1
        for i in range(alarm, n):
            # a tenth of a second and five epochs, of which four of five agree
            later = [k for k in range(i, n) if k < i + 5 or time_s[k - 1] < time_s[i] + 0.1]
            if agrees[i] and sum(agrees[k] for k in later) >= 0.8 * len(later):
                last = max(i - 1, alarm)
                break
        out.append((first, last))
    return out


def drawn(seed: int) -> tuple[FloatArray, IntArray, FloatArray, FloatArray]:
    """Errors that come and go, seen well or hardly, at a rate that changes; now and then nothing controls a cable."""
    rng = np.random.default_rng(seed)
    n, q = int(rng.integers(30, 160)), int(rng.integers(1, 3))
    time_s = np.cumsum(rng.choice([0.004, 0.011, 0.05], n))
    u = np.exp(rng.normal(np.log(0.01), 0.3, (n, q))) * np.where(rng.random((n, 1)) < 0.2, 8.0, 1.0)
    wrong = np.zeros((n, q))
    for _ in range(2):
        begin = int(rng.integers(n - 10))
        wrong[begin : begin + int(rng.integers(5, 50)), int(rng.integers(q))] += rng.uniform(0.08, 1.0)
    error = wrong + u * rng.normal(size=(n, q))
    alarms = np.flatnonzero((np.abs(error) > 5.0 * u).any(axis=1) & (rng.random(n) < 0.4))
    u[rng.random((n, q)) < 0.05] = np.inf
    return time_s, alarms if len(alarms) else np.array([n // 2]), error, u


def test_doubts_end_where_the_definition_says() -> None:
    several = 0
    for seed in range(60):
        time_s, alarms, error, u = drawn(seed)
        found = spans(time_s, alarms, error, u)
        assert found == by_definition(time_s, alarms.tolist(), error, u), seed
        several += len(found) > 1
    assert several > 10
