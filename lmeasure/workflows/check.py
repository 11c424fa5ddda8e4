"""The self-test of a wired rig."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from lmeasure.workflows.flow import Progress, Result, silent, workflow
from lmeasure.workflows.settings import Asked, option

if TYPE_CHECKING:
    from lmeasure.acquisition.check import Check


class Settings(Asked):
    """What `lmeasure check` is asked."""

    rig: Annotated[Path, option("rig.toml; its [can] table says which frames carry the counters.")]
    bus: Annotated[str, option("socketcan:can0, slcan:/dev/ttyACM0, ...", metavar="INTERFACE:CHANNEL")]
    passage: Annotated[int, option("Which pass's cables.", flag="--pass", ge=1)] = 1
    bus_option: Annotated[tuple[str, ...], option("Handed to the interface, such as host=... and port=...", metavar="KEY=VALUE")] = ()
    turns: Annotated[bool, option("Count a turn of each drum too.", flag="--turns/--no-turns")] = True


@workflow("check")
def run(settings: Settings, progress: Progress = silent, *, ask: Callable[[str], None]) -> "Result[Check]":
    """Walk through the self-test: ask tells a person what to do and comes back when it is done;
    progress names the devices that were found. Faults are a failure."""
    from lmeasure.acquisition.check import check
    from lmeasure.acquisition.session import connect, options_from_text
    from lmeasure.rig import read_rig

    rig = read_rig(settings.rig)
    link = connect(rig, settings.rig.parent, settings.bus, passage=settings.passage, options=options_from_text(settings.bus_option))
    try:
        for device in link.devices:
            progress(0.0, ", ".join(f"{k} {v}" for k, v in device.identity().items()))
        result = check(rig, link, ask, passage=settings.passage, turns=settings.turns)
    finally:
        link.source.close()
    faults = result.all_faults
    failure = f"{settings.rig}: {len(faults)} fault(s), the first: {faults[0]}" if faults else ""
    return Result(result, (), warnings=tuple(faults), failure=failure)
