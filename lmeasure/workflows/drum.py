"""From what a mechanic measures on the drums to the rig file."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from lmeasure.text import message
from lmeasure.workflows.flow import Progress, Result, silent, workflow
from lmeasure.workflows.settings import Paths, Writing, option

if TYPE_CHECKING:
    from lmeasure.rig import Rig


class Settings(Writing):
    """Settings of `lmeasure drum`."""

    NEXT: ClassVar[str] = "scan"
    OUT_FILE: ClassVar[str] = "measured.toml"
    measurements: Annotated[
        Path, option("Measurements, one drum table per observation point (docs/drum.md).", metavar="MEASUREMENTS.toml", positional=True)
    ]
    rig: Annotated[Path, option("Rig with these drums.")]
    out: Annotated[Path, option("Rig file to write.")]
    point: Annotated[tuple[str, ...], option("Fill only this observation point; may be repeated.")] = ()

    def paths(self) -> Paths:
        """A rig from a rig and measurements."""
        return Paths((self.out,), (self.measurements, self.rig))


WRITTEN = ("tangent_length_mm", "axial_offset_mm", "count_length_mm")


@workflow
def run(settings: Settings, progress: Progress = silent) -> "Result[Rig]":
    """Write the rig with its drums."""
    from lmeasure.io import files
    from lmeasure.rig import choose, drum_geometry, drum_summary, drums_into, read_drums, rig_from_dict

    before = files.read_toml(settings.rig)
    measured = choose(read_drums(settings.measurements), list(settings.point), str(settings.measurements))
    content = before.holding(drums_into(before, measured, str(settings.rig)))
    rig = rig_from_dict(content, str(settings.rig))
    progress(1.0, "drums")
    files.rewrite_toml(settings.out, content)
    linked = before.get("calibration")
    dropped = message("workflow.link_dropped", file=linked)
    notes = () if linked is None else (dropped,)
    found = {f"{m.point}.{name}": float(getattr(drum_geometry(m), name)) for m in measured for name in WRITTEN}
    return Result(rig, (*drum_summary(measured), *notes), found, notes)
