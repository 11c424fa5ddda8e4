"""A register at its limits: 10^5 certificates queried, and control charts and forecasts over 10^4 simulated instruments.

python benchmarks/register.py queries
python benchmarks/register.py charts
python benchmarks/register.py forecasts
"""

import datetime
import sys
import tempfile
import time
import timeit
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from lmeasure.register import FILE, Entry, Register, Result, charts_of, control_charts, due, forecast, read_limits

RESULTS = Path(__file__).with_name("results") / "register.md"
CERTIFICATES, ROBOTS, EACH = 100_000, 1000, 10
INSTRUMENTS = 10_000
LONGEST, SOON = 500, 20


def queries() -> Iterator[str]:
    """Yield rows: seconds, best of five, of each question to a register of 10^5 certificates of 10 results."""
    names = [f"AP_p P{i}" for i in range(EACH)]
    day = datetime.date(1990, 1, 1)
    yield f"| question to {CERTIFICATES:,} certificates of {EACH} results, {ROBOTS:,} robots | seconds, best of five |"
    yield "|---|---|"
    with tempfile.TemporaryDirectory() as folder:
        limits = (f'[[limit]]\nsubject = "R-{i}"\nresult = "AP_p P1"\nupper = 0.9\n' for i in range(ROBOTS))
        (Path(folder) / "limits.toml").write_text('schema = "lmeasure.limits/1"\n' + "".join(limits))
        register = Register(Path(folder))
        rng = np.random.default_rng(1)

        def entries() -> Iterator[Entry]:
            for n in range(CERTIFICATES):
                results = {name: Result(float(v), 0.01, "mm") for name, v in zip(names, 0.5 + 0.01 * rng.normal(size=EACH), strict=True)}
                made = day + datetime.timedelta(days=n // 10)
                yield Entry("certificate", f"{n:064x}", f"/c/{n}", f"R-{n % ROBOTS}", made, results, (f"{n // 100:064x}" + "c",))

        begin = time.perf_counter()
        register.add(entries(), "A")
        yield f"| adding all of them | {time.perf_counter() - begin:.0f} |"
        size = (Path(folder) / FILE).stat().st_size / 1e6
        options: dict[str, Callable[[], object]] = {
            "subjects with counts": register.subjects,
            "a result of a robot over time": lambda: register.series("R-7", "AP_p P1"),
            "all certificates of a robot": lambda: register.entries("certificate", "R-7"),
            "recall of a calibration (100 certificates)": lambda: register.recall(f"{5:064x}" + "c"),
            f"what is due: {ROBOTS:,} limits, one of each robot": lambda: due(register, read_limits(Path(folder))),
        }
        for what, question in options.items():
            yield f"| {what} | {min(timeit.repeat(question, number=1, repeat=5)):.3f} |"
        begin = time.perf_counter()
        assert register.faults() == ()
        yield f"| `--verify`: the whole chain | {time.perf_counter() - begin:.0f} |"
        yield f"\nThe file has {size:.0f} MB."
        register.close()


def charts() -> Iterator[str]:
    """Yield rows: run lengths over 10^4 instruments, without and with a shift, of a known and of an estimated baseline."""
    yield "| baseline | shift, standard deviations | Shewhart | EWMA | CUSUM |"
    yield "|---|---|---|---|---|"
    for baseline in (0, 5, 10, 30):
        for shift in (0.0, 1.0, 2.0, 3.0):
            rng = np.random.default_rng([baseline, int(10 * shift)])
            lengths: dict[str, list[int]] = {}
            for _ in range(INSTRUMENTS):
                for name, length in _run_lengths(rng, shift, baseline).items():
                    lengths.setdefault(name, []).append(length)
            cells = (f"{100.0 * np.mean(np.array(v) <= SOON):.1f} %, {np.median(v):.0f}" for v in lengths.values())
            yield f"| {baseline or 'known'} | {shift:g} | {' | '.join(cells)} |"
    yield f"\nOf {INSTRUMENTS:,} simulated instruments: share that signals within {SOON} values, and median of the first signals."


def _run_lengths(rng: np.random.Generator, shift: float, baseline: int) -> dict[str, int]:
    """Values after the shift until each chart signals; charts are drawn anew over twice as many until all have."""
    first, values, size = rng.normal(size=baseline), np.empty(0), 64
    while True:
        values = np.append(values, rng.normal(size=size) + shift)
        found = control_charts(np.append(first, values), baseline) if baseline else charts_of(values)
        later = {c.name: next((i - baseline + 1 for i in c.signals if i >= baseline), 0) for c in found}
        if all(later.values()) or len(values) >= LONGEST:
            return {name: length or len(values) for name, length in later.items()}
        size = len(values)


def forecasts() -> Iterator[str]:
    """Yield rows: how often the value at a later time is in the 95 % interval, by the number of calibrations."""
    yield f"| calibrations | values within the 95 % interval ({INSTRUMENTS:,} instruments in all) |"
    yield "|---|---|"
    rng = np.random.default_rng(11)
    for n in (3, 4, 6, 10):
        held, count = 0, INSTRUMENTS // 4
        for _ in range(count):
            u = 10.0 ** rng.uniform(-3, 0)
            t = np.concatenate([[0.0], np.sort(rng.uniform(30, 400 * n, n - 1))])
            t = np.append(t, t[-1] + rng.uniform(30, 500))
            walk = 10.0 ** rng.uniform(-1, 1) * u / np.sqrt(np.mean(np.diff(t[:-1])))
            drift = 0.01 * u * rng.normal() * t
            true = 5.0 + drift + np.concatenate([[0.0], np.cumsum(walk * np.sqrt(np.diff(t)) * rng.normal(size=n))])
            low, high = forecast(t[:-1], true[:-1] + u * rng.normal(size=n), np.full(n, u)).interval(t[-1])
            held += bool(low <= true[-1] <= high)
        yield f"| {n} | {100.0 * held / count:.1f} % |"


PARTS: dict[str, Callable[[], Iterator[str]]] = {"queries": queries, "charts": charts, "forecasts": forecasts}
HEADING = "# Register\n\nBy `python benchmarks/register.py PART`, each part by itself.\n"


def main(part: str) -> None:
    """Measure a part and put its table into the page of results."""
    text = RESULTS.read_text(encoding="utf-8") if RESULTS.is_file() else HEADING
    sections = {s.split("\n", 1)[0]: s.split("\n", 1)[1].strip("\n") for s in text.split("\n## ")[1:]}
    sections[part] = "\n".join(PARTS[part]())
    body = "".join(f"\n## {name}\n\n{sections[name]}\n" for name in PARTS if name in sections)
    RESULTS.write_text(HEADING + body, encoding="utf-8")
    print(sections[part])


if __name__ == "__main__":
    main(sys.argv[1])
