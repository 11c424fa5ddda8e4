"""`lmeasure check`: the self-test of a wired rig."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from lmeasure.acquisition.check import Check


def check(
    rig: Annotated[Path, typer.Option("--rig", help="rig.toml; its [can] table says which frames carry the counters.")],
    bus: Annotated[str, typer.Option("--bus", metavar="INTERFACE:CHANNEL", help="socketcan:can0, slcan:/dev/ttyACM0, ...")],
    passage: Annotated[int, typer.Option("--pass", min=1, help="Which pass's cables.")] = 1,
    option: Annotated[
        list[str] | None, typer.Option("--bus-option", metavar="KEY=VALUE", help="Handed to the interface, such as host=... and port=...")
    ] = None,
    turns: Annotated[bool, typer.Option("--turns/--no-turns", help="Count a turn of each drum too.")] = True,
) -> None:
    """Walk through the self-test: which channel is which cable, direction, counts per turn, stroke and slack."""
    from lmeasure.acquisition.check import check as stage
    from lmeasure.acquisition.session import connect, options_from_text
    from lmeasure.errors import AcquisitionError
    from lmeasure.rig import read_rig

    def ask(text: str) -> None:
        typer.prompt(f"{text}, then press Enter", default="", show_default=False, prompt_suffix=" ")

    asked = read_rig(rig)
    link = connect(asked, rig.parent, bus, passage=passage, options=options_from_text(option or []))
    try:
        for device in link.devices:
            typer.echo(", ".join(f"{k} {v}" for k, v in device.identity().items()))
        result = stage(asked, link, ask, passage=passage, turns=turns)
    finally:
        link.source.close()
    _print(result)
    faults = result.all_faults
    if faults:
        raise AcquisitionError(f"{rig}: {len(faults)} fault(s), the first: {faults[0]}")


def _print(result: "Check") -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table("cable", "channel", "moved", "direction", "stroke mm", "slack mm", "counts/turn", "verdict", box=None)
    for c in result.cables:
        numbers = [
            "-" if c.direction is None else f"{c.direction:+d}",
            *("-" if value is None else form.format(value) for value, form in ((c.stroke_mm, "{:.1f}"), (c.slack_mm, "{:+.3f}"))),
            "-" if c.counts_per_turn is None else f"{c.counts_per_turn:.0f} of {c.expected_per_turn:g}",
        ]
        table.add_row(c.cable, c.channel, c.moved or "-", *numbers, "; ".join(c.faults) or "ok")
    console = Console()
    console.print(table)
    console.print(f"{result.rate_hz:.1f} samples/s; at rest the counters move by at most {max(result.spread.values()):g} counts")
    for fault in result.faults:
        console.print(f"fault: {fault}", style="red")
