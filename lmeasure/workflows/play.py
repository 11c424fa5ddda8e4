"""A simulated cell that speaks on a bus and does what it is given."""

import getpass
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from lmeasure.core import CancelledError, GeometryError, LMeasureError, SettingsError
from lmeasure.text import message
from lmeasure.workflows.capture import Keys
from lmeasure.workflows.flow import Progress, Result, silent, workflow
from lmeasure.workflows.settings import Asked, Names, Paths, Start, option

if TYPE_CHECKING:
    from lmeasure.demo import PlayedCell
    from lmeasure.rig import Rig

BUILT = "How the cell differs from its rig"
AT_ONCE_S = 0.02
"""Rows that are made at once, and how long a line waits at most."""
SILENT_S = 0.5
"""Time of silence required there before."""


def own_bus(folder: Path) -> str:
    """Return a bus of this machine for the simulated cell of a user's folder, so that two cells do not hear each other."""
    digest = hashlib.sha256(f"{getpass.getuser()}:{folder.resolve()}".encode()).digest()
    return f"udp_multicast:239.74.{1 + digest[0] % 250}.{1 + digest[1] % 250}"


class Settings(Asked):
    """Settings of `lmeasure play`."""

    NEXT: ClassVar[str] = "init my-cell"
    rig: Annotated[Path, option("rig.toml with the measured dimensions of the cell.", metavar="RIG", positional=True)]
    bus: Annotated[
        str | None, option("CAN bus of this machine to send on; default an own bus of this folder.", metavar="INTERFACE:CHANNEL")
    ] = None
    poses: Annotated[Path | None, option("Poses for the line `go POSE`.", metavar="planned.csv")] = None
    commands: Annotated[
        Path | None, option("Commands for the line `run`, as `program` writes them; default a motion of six stops.", metavar="commands.csv")
    ] = None
    at: Annotated[
        Start | None,
        option("Home pose of the robot, in the form of --start of `record`; default the base frame's origin.", metavar="X,Y,Z,O,A,T"),
    ] = None
    rate_hz: Annotated[float, option("Samples per second.", ge=1, le=2000, unit="Hz")] = 200.0
    passage: Annotated[int, option("Number of the pass whose cables are connected.", flag="--pass", ge=1)] = 1
    bus_option: Annotated[tuple[str, ...], option("Option for the bus interface, such as host=... and port=...", metavar="KEY=VALUE")] = ()
    off_mm: Annotated[
        float, option("Largest position error of the observation points relative to the rig file.", ge=0, le=500, panel=BUILT)
    ] = 5.0
    off_deg: Annotated[float, option("Largest angle error of the guides.", ge=0, le=20, panel=BUILT)] = 1.0
    u_position_mm: Annotated[float, option("Standard deviation of the robot's position, per coordinate.", ge=0, le=50, panel=BUILT)] = 0.02
    u_rotation_deg: Annotated[float, option("Standard deviation of its orientation, about each axis.", ge=0, le=10, panel=BUILT)] = 0.003
    exchange: Annotated[Names, option("Two channels with swapped encoders.", metavar="CHANNEL,CHANNEL", panel=BUILT)] = ()
    seed: Annotated[int, option("Seed of the simulated cell.", ge=0, panel=BUILT)] = 0

    def paths(self) -> Paths:
        """It writes nothing."""
        return Paths((), (self.rig,))


@workflow
def run(
    settings: Settings,
    progress: Progress = silent,
    *,
    say: Callable[[str], None] = print,
    keys: Keys | None = None,
    show: "Callable[[PlayedCell], None] | None" = None,
) -> Result[None]:
    """Play until nobody types any more, or without keys until Ctrl-C. say takes lines for a person, keys gives what the person types, show
    is given of the cell."""
    from lmeasure.acquisition import Pace, bus_opener, counter_fields, options_from_text, play
    from lmeasure.rig import read_rig

    rig, name = read_rig(settings.rig), settings.bus or own_bus(settings.rig.parent)
    cell = _cell(settings, rig, progress)
    fields = counter_fields(rig, settings.passage, settings.rig.parent)
    open_bus = bus_opener(name, rig.can_table.bit_rate, options_from_text(settings.bus_option))
    try:
        bus = open_bus()
    except Exception as error:  # each driver has its own way to say that there is no such device
        raise LMeasureError(
            message("error.cannot_be_opened", where=name, error=" ".join(str(error).split()) or type(error).__name__)
        ) from error
    if bus.recv(SILENT_S) is not None:
        bus.shutdown()
        raise LMeasureError(message("error.somebody_speaks_there_already", where=name))
    rows, pace = 0, Pace(settings.rate_hz)
    at_once = max(1, round(AT_ONCE_S * settings.rate_hz))
    say(message("workflows.speaks_samples_s", rig=rig.name, bus=name, rate=settings.rate_hz, channels=tuple(f.channel for f in fields)))
    try:
        while not (keys is not None and keys.gone):
            for line in keys.typed() if keys is not None else ():
                _do(cell, line, say)
            if show is not None:
                show(cell)
            try:
                progress(0.0, "playing")
            except CancelledError:
                break
            play(cell.take(at_once), fields, rig.can_table.sync_id, bus, pace=pace)
            rows += at_once
    finally:
        bus.shutdown()
    return Result(None, (message("workflows.samples_were_sent", rows=rows),), {"samples": float(rows)})


def _do(cell: "PlayedCell", line: str, say: Callable[[str], None]) -> None:
    if line.strip():
        try:
            say(cell.do(line))
        except LMeasureError as error:
            say(message("workflows.not_done", why=error))


def _cell(settings: Settings, rig: "Rig", progress: Progress) -> "PlayedCell":
    import numpy as np

    from lmeasure.demo import Built, PlayedCell
    from lmeasure.recording import read_poses, start_from_text

    if settings.passage > rig.passes:
        raise SettingsError("passage", message("error.the_rig_has", where=settings.passage, passes=rig.passes))
    home = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]) if settings.at is None else start_from_text(settings.at, rig)
    try:
        return PlayedCell(
            rig,
            home,
            settings.rate_hz,
            how=Built(settings.off_mm, settings.off_deg, settings.u_position_mm, settings.u_rotation_deg, settings.exchange),
            passage=settings.passage,
            poses=None if settings.poses is None else read_poses(settings.poses, rig.angles, positions_alone=True),
            commands=settings.commands,
            seed=settings.seed,
            progress=lambda done, of: progress(done / of, message("demo.runs_program")),
        )
    except GeometryError as error:
        raise LMeasureError(message("error.the_cell_cannot_be", where=settings.rig, error=error)) from error
