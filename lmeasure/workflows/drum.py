"""From what a mechanic measures on the drums to the rig file."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from lmeasure.workflows.flow import Progress, Result, silent, workflow
from lmeasure.workflows.settings import Asked, Paths, option

if TYPE_CHECKING:
    from lmeasure.rig import Rig


class Settings(Asked):
    """What `lmeasure drum` is asked."""

    measurements: Annotated[
        Path,
        option("What was measured, a drum table per observation point (docs/drum.md).", metavar="MEASUREMENTS.toml", positional=True),
    ]
    rig: Annotated[Path, option("The rig whose drums these are.")]
    out: Annotated[Path, option("Rig file to write.")]
    point: Annotated[tuple[str, ...], option("Only this observation point; may be repeated.")] = ()

    def paths(self) -> Paths:
        """A rig from a rig and measurements."""
        return Paths((self.out,), (self.measurements, self.rig))


@workflow("drum")
def run(settings: Settings, progress: Progress = silent) -> "Result[Rig]":
    """Write the rig with its drums."""
    from lmeasure.drum import choose, drum_summary, read_drums, with_drums
    from lmeasure.rig import read_rig, write_rig

    before = read_rig(settings.rig)
    measured = choose(read_drums(settings.measurements), list(settings.point), str(settings.measurements))
    rig = with_drums(before, measured)
    progress(1.0, "drums")
    write_rig(settings.out, rig)
    dropped = f"note: the link to {before.calibration} is dropped: it was made with the drums as they were; calibrate again"
    notes = () if before.calibration is None else (dropped,)
    return Result(rig, (*map(drum_summary, measured), *notes), warnings=notes)
