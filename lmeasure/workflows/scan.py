"""Adapters of this machine, and who speaks on a bus."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any

from lmeasure.core import SettingsError
from lmeasure.text import message
from lmeasure.workflows.flow import Ending, Progress, Result, silent, workflow
from lmeasure.workflows.settings import Asked, Paths, option, then

if TYPE_CHECKING:
    from lmeasure.acquisition import Spoken


class Settings(Asked):
    """Settings of `lmeasure scan`."""

    bus: Annotated[str | None, option("Listen to this bus; without it, `scan` lists the adapters.", metavar="INTERFACE:CHANNEL")] = None
    seconds: Annotated[float, option("Listening time.", ge=0.1, le=3600, unit="s")] = 5.0
    bit_rate: Annotated[int | None, option("Bit rate of the bus, if the adapter needs it.", ge=1, unit="bit/s")] = None
    bus_option: Annotated[tuple[str, ...], option("Option for the bus interface, such as host=... and port=...", metavar="KEY=VALUE")] = ()

    def following(self) -> str:
        """Return the command that tests what was heard, or listens."""
        return then("scan --bus socketcan:can0") if self.bus is None else then("check rig.toml --bus {bus}", bus=self.bus)

    def paths(self) -> Paths:
        """It writes nothing."""
        return Paths((), ())


@workflow
def run(
    settings: Settings, progress: Progress = silent, *, show: "Callable[[float, tuple[Spoken, ...]], None] | None" = None
) -> Result[Any]:
    """List adapters, or listen; show is given who speaks all the while."""
    from lmeasure.acquisition import adapters, listen, open_source, options_from_text

    if settings.bus is None:
        if settings.bus_option or settings.bit_rate is not None:
            raise SettingsError("bus", message("error.is_missing_which_bus"))
        progress(0.0, "looking for adapters")
        found, unanswered = adapters()
        notes = tuple(message("workflows.driver_did_not_answer", name=name) for name in unanswered)
        lines = tuple(one.line() for one in found) or (message("workflow.no_adapter_found_interfaces"),)
        made = [{"bus": one.bus, "options": list(one.options), "about": one.about} for one in found]
        following = then("scan --bus {bus}", bus=found[0].bus) if found else ""
        return Result(made, (*lines, *notes), {"adapters": float(len(found))}, notes, next=following)
    ending = Ending(progress)

    def reported(seconds: float, spoken: "tuple[Spoken, ...]") -> None:
        if show is not None:
            show(seconds, spoken)
        ending(seconds, settings.seconds, "listening")

    source = open_source(settings.bus, settings.bit_rate, options_from_text(settings.bus_option))
    try:
        found_there = listen(source, settings.seconds, show=reported, stop=lambda: ending.asked)
    finally:
        source.close()
    heard: list[dict[str, Any]] = [
        {"identifier": c.name, "frames": c.frames, "rate_hz": c.rate_hz, "moves": [*(f.text for f in c.counters), *c.others]}
        for c in found_there.carried
    ]
    figures = {"identifiers": float(len(found_there.carried)), "counters": float(sum(len(c.counters) for c in found_there.carried))}
    return Result(heard, tuple(found_there.lines()), figures)
