"""Live display of a recording in a terminal. Loaded only by commands that read a bus."""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from lmeasure.acquisition import STALE_S, Progress
from lmeasure.cli.text import rendered, word
from lmeasure.core import WORDS
from lmeasure.text import composed, count_of, message

if TYPE_CHECKING:
    from lmeasure.trajectory import PoseWatch

LIVE_REFRESH_S = 0.1


@contextmanager
def live_table() -> Iterator[Callable[[Progress, "PoseWatch | str"], None]]:
    """A table on stderr that the returned function renews, at most ten times a second; the last state stays. It is given where the poses
    are, or why there are none."""
    with Live(console=Console(stderr=True), auto_refresh=False) as live:
        shown = 0.0

        def show(progress: Progress, pose: "PoseWatch | str") -> None:
            nonlocal shown
            refresh = time.monotonic() - shown >= LIVE_REFRESH_S
            if refresh:
                shown = time.monotonic()
            if not isinstance(pose, str):
                pose.refresh()
            live.update(render(progress, pose), refresh=refresh)

        yield show


def render(progress: Progress, pose: "PoseWatch | str" = "") -> Group:
    """One line on the whole, one row per channel, the pose and that of the curve, one line of faults."""
    rate = progress.samples / progress.seconds if progress.seconds > 0 else 0.0
    counted = {"seconds": progress.seconds, "samples": progress.samples, "rate": rate, "frames": progress.frames}
    latency = "" if progress.latency_s is None else message("cli.latency_ms", latency_s=1000.0 * progress.latency_s)
    head = message("cli.s_samples_s_frames", latency=latency, **counted)
    table = Table(*(word(f"cli.column.{name}") for name in ("channel", "count", "counts_s", "mm_s")), box=None)
    for column in table.columns[1:]:
        column.justify = "right"
    for channel, count, speed, mm in zip(progress.channels, progress.counts, progress.rates, progress.speeds_mm_s, strict=True):
        cells = ("-" if value != value else f"{value:+.0f}" for value in (count, speed, mm))
        table.add_row(channel, *cells)
    faults = ", ".join(rendered(count_of(kind, n)) for kind, n in sorted(progress.faults.items())) or message("acquisition.no_faults")
    where = message("cli.pose", what="-") if stale(progress) else pose if isinstance(pose, str) else _pose_line(pose, progress.origin_s)
    smooth = "" if isinstance(pose, str) or stale(progress) else _curve_line(pose)
    lines = [Text(rendered(line)) for line in (where, smooth) if line]
    return Group(Text(rendered(head)), table, *lines, Text(rendered(faults), style="red" if progress.faults else "green"))


def stale(progress: Progress) -> bool:
    """Return whether no channel has a current count."""
    return progress.seconds > STALE_S and all(value != value for value in progress.counts)


def u95_mm(watch: "PoseWatch") -> float | None:
    """Radius of the sphere that holds the tool's origin with 95 %; None where there is no pose or no orientation to state one by."""
    from lmeasure.accuracy import stated_radii_95

    covariance = watch.covariance()
    radius = float("nan") if covariance is None else float(stated_radii_95(covariance[None, 3:, 3:])[0])
    return radius if math.isfinite(radius) else None


def curve_values(watch: "PoseWatch") -> dict[str, Any] | None:
    """Return the last pose of the curve: seconds behind the last sample, place and its U95 [mm], speed [mm/s]; None where there is none."""
    from lmeasure.accuracy import stated_radii_95

    there = watch.smooth
    if there is None or isinstance(there, str) or not math.isfinite(there.poses[-1, 0]):
        return None
    covariance = (there.random + there.systematic)[-1, 0, 3:, 3:]
    speed = math.hypot(*there.rates[-1, 1, 3:])
    place, u95 = tuple(there.poses[-1, :3].tolist()), float(stated_radii_95(covariance[None])[0])
    return {"behind_s": watch.time_s - float(there.time_s[-1]), "position_mm": place, "u95_mm": u95, "speed_mm_s": speed}


def _curve_line(watch: "PoseWatch") -> str:
    """The last pose of the curve, or the reason why there is none."""
    values = curve_values(watch)
    if values is not None:
        return message("cli.curve", **values)
    return watch.smooth if isinstance(watch.smooth, str) else ""


def _pose_line(watch: "PoseWatch", origin_s: float | None) -> str:
    """The pose of the last sample, or its status, and its latency."""
    latest = watch.latest
    if latest is None:
        return message("cli.pose", what="-")
    if latest.status != "ok":
        known = latest.status in WORDS
        status = message(f"trajectory.status.{latest.status}") if known else message("cli.start_unknown")
        return message("cli.pose", what=composed("{status}: {why}", status=status, why=watch.why) if watch.why else status)
    place, turn = (tuple(map(float, part)) for part in (latest.pose[:3], latest.pose[3:]))
    u95 = u95_mm(watch)
    within = "" if u95 is None else message("cli.pose_within", u95=u95)
    values = {"place": place, "turn": turn, "within": within, "angle": latest.worst_pressure_angle_deg}
    text = message("cli.pose", what=message("cli.pose_place", **values))
    latency = watch.latency_s(origin_s)
    return text if latency is None else message("cli.frame_pose_ms", v1=text, latency=1000.0 * latency)
