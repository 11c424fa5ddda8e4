"""What six links make of a rig, before anything is built or measured."""

import json
import math
from pathlib import Path
from typing import Annotated, Any

from lmeasure.errors import SettingsError
from lmeasure.workflows.flow import Progress, Result, present, silent, workflow
from lmeasure.workflows.settings import Asked, Paths, Point, Quaternion, option


class Settings(Asked):
    """What `lmeasure structure` is asked."""

    file: Annotated[
        Path | None, option("rig.toml, or a table of points and links (docs/structures.md).", metavar="FILE", positional=True)
    ] = None
    out: Annotated[Path | None, option("Also write all of it.", metavar="FILE.json")] = None
    listed: Annotated[bool, option("All structures of six links instead of a file.", flag="--list")] = False
    position_mm: Annotated[Point | None, option("A position of the platform, for determinant and pressure angles.", metavar="X,Y,Z")] = None
    quaternion: Annotated[Quaternion | None, option("Its orientation there; default the base's.", metavar="X,Y,Z,W")] = None

    def paths(self) -> Paths:
        """A description from a rig or a table."""
        return Paths(present(self.out), present(self.file))


@workflow("structure")
def run(settings: Settings, progress: Progress = silent) -> Result[Any]:
    """Describe the links, and write it where that is asked for."""
    import numpy as np

    from lmeasure import files
    from lmeasure.linkage import all_structures, described, read_linkage, told, told_list
    from lmeasure.poses import UNIT_TOLERANCE, poses_from_rows

    if settings.listed == (settings.file is not None):
        raise SettingsError("file", "give a file, or --list")
    if settings.position_mm is None and settings.quaternion is not None:
        raise SettingsError("quaternion", "states an orientation without --position-mm")
    if settings.file is None:
        if settings.position_mm is not None:
            raise SettingsError("position_mm", "is a pose of a file's links, not of --list")
        every = all_structures()
        record, lines = every, told_list(every)
    else:
        pose = None
        if settings.position_mm is not None:
            quaternion = settings.quaternion or (0.0, 0.0, 0.0, 1.0)
            length = math.hypot(*quaternion)
            if not abs(length - 1.0) <= UNIT_TOLERANCE:
                raise SettingsError("quaternion", f"its length is {length:.9g}, not 1")
            pose = poses_from_rows(np.array([[*settings.position_mm, *quaternion]])).rows[0]
        one = described(read_linkage(settings.file), pose)
        record, lines = [one], told(one)
    progress(1.0, "structure")
    made: Any = record if settings.file is None else record[0]
    if settings.out is not None:
        files.write_text(settings.out, json.dumps(made, indent=1, allow_nan=False) + "\n")
    return Result(made, tuple(lines))
