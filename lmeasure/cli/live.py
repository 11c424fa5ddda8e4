"""The terminal view of a recording: counts, rates, faults, latency."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from lmeasure.acquisition.recorder import Progress

REFRESH_S = 0.1


@contextmanager
def live_table() -> Iterator[Callable[[Progress], None]]:
    """A table on stderr that the returned function renews, at most ten times a second; the last state stays."""
    with Live(console=Console(stderr=True), auto_refresh=False) as live:
        shown = 0.0

        def show(progress: Progress) -> None:
            nonlocal shown
            refresh = time.monotonic() - shown >= REFRESH_S
            if refresh:
                shown = time.monotonic()
            live.update(render(progress), refresh=refresh)

        yield show


def render(progress: Progress) -> Group:
    """One line on the whole, one row per channel, one line of faults."""
    rate = progress.samples / progress.seconds if progress.seconds > 0 else 0.0
    head = f"{progress.seconds:8.1f} s  {progress.samples} samples ({rate:.0f}/s)  {progress.frames} frames"
    if progress.latency_s is not None:
        head += f"  latency {1e3 * progress.latency_s:.1f} ms"
    table = Table("channel", "count", "counts/s", "mm/s", box=None)
    for column in table.columns[1:]:
        column.justify = "right"
    for channel, count, speed, mm in zip(progress.channels, progress.counts, progress.rates, progress.speeds_mm_s, strict=True):
        cells = ("-" if value != value else f"{value:+.0f}" for value in (count, speed, mm))
        table.add_row(channel, *cells)
    faults = ", ".join(f"{n} {kind}" for kind, n in sorted(progress.faults.items())) or "no faults"
    return Group(Text(head), table, Text(faults, style="red" if progress.faults else "green"))
