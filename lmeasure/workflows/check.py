"""The self-test of a wired rig."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from lmeasure.core import LMeasureError
from lmeasure.text import joined, message
from lmeasure.workflows.flow import Progress, Result, present, silent, workflow
from lmeasure.workflows.settings import RERUN, RIG, Paths, Recording, Writing, option, then

if TYPE_CHECKING:
    from lmeasure.acquisition import Ask, Check


class Settings(Writing):
    """Settings of `lmeasure check`."""

    rig: Annotated[Path, RIG]
    bus: Annotated[str, option("socketcan:can0, slcan:/dev/ttyACM0, ...", metavar="INTERFACE:CHANNEL")]
    passage: Annotated[int, option("Number of the pass whose cables are connected.", flag="--pass", ge=1)] = 1
    bus_option: Annotated[tuple[str, ...], option("Option for the bus interface, such as host=... and port=...", metavar="KEY=VALUE")] = ()
    turns: Annotated[bool, option("Also count one turn of each drum.", flag="--turns/--no-turns")] = True
    write: Annotated[
        Path | None, option("Rig to write, with channels and signs as they are.", flag="--out", metavar="RIG.toml", also=("--write",))
    ] = None
    rerun: Annotated[Recording | None, RERUN] = None

    def following(self) -> str:
        """Return the command that plans reference poses."""
        return then("plan-poses {rig} --poses 12 --box=-300:300,-300:300,-300:300 --out planned.csv", rig=self.write or self.rig)

    def paths(self) -> Paths:
        """A corrected rig, of a rig."""
        return Paths(present(self.write, self.rerun), (self.rig,))


@workflow
def run(settings: Settings, progress: Progress = silent, *, ask: "Ask") -> "Result[Check]":
    """Walk through the self-test: ask tells a person what to do and comes back when it is done;
    progress names the devices that were found. Faults are a failure."""
    from lmeasure.acquisition import connect, corrected, not_corrected, options_from_text, range_notes, self_test
    from lmeasure.io import files
    from lmeasure.rig import rig_from_dict

    document = files.read_toml(settings.rig)
    rig = rig_from_dict(document, str(settings.rig))
    link = connect(rig, settings.rig.parent, settings.bus, passage=settings.passage, options=options_from_text(settings.bus_option))
    try:
        for note in range_notes(rig, link.fields, settings.passage):
            progress(0.0, note)
        for device in link.devices:
            progress(0.0, ", ".join(f"{k} {v}" for k, v in device.identity().items()))
        result = self_test(rig, link, ask, passage=settings.passage, turns=settings.turns)
    finally:
        link.source.close()
    faults = result.all_faults
    if settings.rerun is not None:
        import numpy as np

        from lmeasure.view import Series, write_scene

        strokes = {c.cable: np.array([c.stroke_mm, c.slack_mm], dtype=np.float64) for c in result.cables}
        series = {(group, name): Series(v[i : i + 1]) for name, v in strokes.items() for i, group in enumerate(("stroke_mm", "slack_mm"))}
        write_scene(settings.rerun, rig.name, rig=rig, series=series, notes=[*faults, *result.notes])
    failure = message("workflow.faults", rig=settings.rig, count=len(faults), first=faults[0]) if faults else ""
    data, reported = corrected(document, result)
    left = () if settings.write is None else not_corrected(result)
    if settings.write is None:
        hint = (message("workflows.write_file_writes_rig", count=len(reported), what=joined(reported)),) if reported else ()
        return Result(result, (*result.notes, *hint), _figures(result), tuple(faults), failure=failure)
    content = document.holding(data)
    rig_from_dict(content, str(settings.write))
    try:
        files.rewrite_toml(settings.write, content)
    except LMeasureError as error:  # a person has walked through all of it: what it showed is not lost
        return Result(result, (*result.notes, *reported, *left), _figures(result), tuple(faults), failure=str(error))
    code = "workflow.checked_again" if reported or left else "workflow.checked_nothing"
    lines = (*result.notes, *reported, *left, message(code, file=settings.write))
    return Result(result, lines, _figures(result), tuple(faults), failure=failure)


def _figures(result: "Check") -> dict[str, float]:
    """Return the numbers of the whole and of each cable."""
    found = {"rate_hz": result.rate_hz, "faults": float(len(result.all_faults))}
    for c in result.cables:
        shown = {"stroke_mm": c.stroke_mm, "slack_mm": c.slack_mm, "counts_per_turn": c.counts_per_turn}
        found |= {f"{c.cable}.{name}": value for name, value in shown.items() if value is not None}
    return found
