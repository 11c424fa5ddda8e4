"""Compile the kernels in advance, so that later commands start at full speed."""

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar

from lmeasure.text import message
from lmeasure.workflows.flow import Progress, Result, silent, workflow
from lmeasure.workflows.registry import load
from lmeasure.workflows.settings import Asked


class Settings(Asked):
    """Settings of `lmeasure warm`."""

    NEXT: ClassVar[str] = "demo"


JOBS = (
    ("simulate", {"scenario": "scenario.toml", "out": "run"}),
    ("calibrate", {"folder": "run/calibration", "out": "calibration"}),
    ("reconstruct", {"run": "run", "out": "trajectory.parquet"}),
    ("zone", {"rig": "run/rig.toml", "out": "zone.nc"}),
)
GRID = dict.fromkeys(("x", "y", "z"), "-50:50:50")


@workflow
def run(settings: Settings, progress: Progress = silent) -> Result[int]:
    """Do the demo's work, and that of a rig of each template, in a folder that is not kept; compile each kernel that is used."""
    from lmeasure.demo import demo
    from lmeasure.kernels import compilation, compiled_at_once
    from lmeasure.templates import TEMPLATES

    before, since = len(compilation.names), compilation.seconds
    with compiled_at_once(), tempfile.TemporaryDirectory() as folder:
        demo(Path(folder) / "demo", lambda stage, done, of: progress(done / of if of else 0.0, stage), 0)
        for template in TEMPLATES:
            here = Path(folder) / template
            _do("init", {"out": here, "template": template})
            for name, paths in JOBS:
                progress(0.0, name)
                _do(name, {**{key: here / path for key, path in paths.items()}, **(GRID if name == "zone" else {})})
    count, seconds = len(compilation.names) - before, compilation.seconds - since
    said = message("workflow.warm.done", count=count, seconds=seconds) if count else message("workflow.warm.nothing")
    return Result(count, (said,), {"kernels": float(count), "compiling_s": seconds})


def _do(name: str, values: Mapping[str, object]) -> None:
    job = load(name)
    job.run(job.settings.model_validate(values))
