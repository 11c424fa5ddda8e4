"""Zone: the part of the cell where the instrument measures well enough."""

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from lmeasure.core import AccuracyError, SettingsError
from lmeasure.text import message, of_terminal, reason
from lmeasure.workflows.flow import Progress, Result, inside, present, silent, steps, workflow
from lmeasure.workflows.settings import LANGUAGE, RERUN, Pair, Paths, Range, Recording, UnitQuaternion, Writing, option, then

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

    from lmeasure.core import FloatArray
    from lmeasure.structure import Piece

RANGE = "START:STOP:STEP"
LIMITS = "Limits"
COMPUTING = "Computing"
MORE_THAN_0 = (0.0, math.inf)


class ZoneSettings(Writing):
    NEXT: ClassVar[str] = "program --zone {out} --out program"
    OUT_FILE: ClassVar[str] = "zone.nc"
    rig: Annotated[Path, option("Rig; the uncertainty includes its linked calibration.", metavar="RIG.toml", positional=True)]
    out: Annotated[Path, option("netCDF file to write.")]
    x: Annotated[
        Range | None,
        option("Nodes of the tool origin along X [mm], both ends included; default a box around the rig.", metavar=RANGE, unit="mm"),
    ] = None
    y: Annotated[Range | None, option("Nodes along Y [mm].", metavar=RANGE, unit="mm")] = None
    z: Annotated[Range | None, option("Nodes along Z [mm].", metavar=RANGE, unit="mm")] = None
    tilt_deg: Annotated[float, option("Largest component of the rotation vector.", within=(0.0, 180.0))] = 0.0
    tilt_rad: Annotated[float, option("The same in radians, in place of --tilt-deg.", within=(0.0, math.pi))] = 0.0
    tilt_steps: Annotated[int, option("Number of equal steps from -tilt to +tilt; 1 means no tilt.", ge=1)] = 3
    quaternion: Annotated[UnitQuaternion | None, option("Centre orientation of the tilts.", metavar="X,Y,Z,W")] = None
    o: Annotated[Range | None, option("Angle O of the thesis [deg], with --a and --t, instead of tilts.", metavar=RANGE, unit="deg")] = None
    a: Annotated[Range | None, option("Angle A [deg].", metavar=RANGE, unit="deg")] = None
    t: Annotated[Range | None, option("Angle T [deg].", metavar=RANGE, unit="deg")] = None
    limit_deg: Annotated[float, option("Largest pressure angle.", panel=LIMITS, within=(0.0, 90.0))] = 60.0
    length_mm: Annotated[Pair | None, option("Cable lengths.", metavar="MIN:MAX", panel=LIMITS)] = None
    u95_mm: Annotated[float | None, option("Largest U95 of the position.", panel=LIMITS, within=MORE_THAN_0)] = None
    u95_rotation_deg: Annotated[float | None, option("Largest U95 of the orientation.", panel=LIMITS, within=MORE_THAN_0)] = None
    u95_attachment_mm: Annotated[float | None, option("Largest U95 of the worst attachment point.", panel=LIMITS, within=MORE_THAN_0)] = (
        None
    )
    wrap_deg: Annotated[float | None, option("Largest angle wrapped around a pulley.", panel=LIMITS, within=MORE_THAN_0)] = None
    clearance_mm: Annotated[float | None, option("Least distance between cables, and to obstacles.", panel=LIMITS, within=MORE_THAN_0)] = (
        None
    )
    bodies: Annotated[Path | None, option("Obstacles for the cables.", metavar="FILE.toml", panel=LIMITS)] = None
    one_assembly: Annotated[bool, option("Keep to one assembly mode, by the determinant's sign.", panel=LIMITS)] = False
    singularity: Annotated[float | None, option("Least distance to a singular pose.", panel=LIMITS, within=MORE_THAN_0)] = None
    full: Annotated[bool, option("Map orientation and attachment points too.", panel=COMPUTING)] = False
    reliability: Annotated[
        bool, option("Map the detectable faults of single channels, and the effect of undetected ones on the tool.", panel=COMPUTING)
    ] = False
    refine: Annotated[
        float | None,
        option("Refine the edge until the volume changes by less than this part.", metavar="RELATIVE", panel=COMPUTING, within=(0.0, 1.0)),
    ] = None
    workers: Annotated[int | None, option("Number of threads; default all cores.", panel=COMPUTING, ge=1)] = None
    scheduler: Annotated[str | None, option("dask scheduler to use.", metavar="tcp://HOST:PORT", panel=COMPUTING)] = None
    checkpoint: Annotated[
        Path | None, option("Folder for finished chunks; the same command continues after an interruption.", metavar="DIR", panel=COMPUTING)
    ] = None
    path: Annotated[Path | None, option("Check a robot program in the zone, and write OUT.path.csv.", metavar="PROGRAM.toml")] = None
    boundary: Annotated[
        bool, option("Trace the zone's edge at every level, for angle and lengths, and write OUT.boundary.csv.", panel=COMPUTING)
    ] = False
    report: Annotated[Path | None, option("Write zone.html and zone.pdf into this folder.", metavar="DIR")] = None
    language: Annotated[Literal["en", "ru"] | None, LANGUAGE] = None
    rerun: Annotated[Recording | None, RERUN] = None

    def paths(self) -> Paths:
        beside: tuple[Path, ...] = () if self.path is None else (self.out.with_suffix(".path.csv"),)
        beside += (self.out.with_suffix(".boundary.csv"),) if self.boundary else ()
        report = () if self.report is None else inside(self.report, "zone.html", "zone.pdf")
        return Paths((self.out, *present(self.rerun), *beside, *report), (self.rig, *present(self.bodies, self.path)))


@workflow
def run_zone(settings: ZoneSettings, progress: Progress = silent) -> Result:
    """Scan the box and write the zone, with its page, its recording and a compared program on request."""
    from lmeasure.accuracy import Limits, Scan, advice, box_around, goes_on, map_zone, read_bodies, said as faults_said, summary, write_zone
    from lmeasure.io import files
    from lmeasure.recording import read_program
    from lmeasure.rig import read_linked_rig

    rotations = _rotations(settings)
    given = {name: getattr(settings, name) for name in "xyz"}
    for name, span in given.items():
        if span is not None:
            _axis(name, span)
    kept = ("u95_mm", "u95_rotation_deg", "u95_attachment_mm", "wrap_deg", "clearance_mm", "one_assembly", "singularity")
    limits = Limits(settings.limit_deg, settings.length_mm, **{name: getattr(settings, name) for name in kept})
    rig, calibration = read_linked_rig(settings.rig)
    ranges = {name: span or chosen for (name, span), chosen in zip(given.items(), box_around(rig), strict=True)}
    nodes = _axis("x", ranges["x"]), _axis("y", ranges["y"]), _axis("z", ranges["z"])
    program = None if settings.path is None else read_program(settings.path)
    scan = Scan(
        limits=limits,
        full=settings.full or settings.report is not None,
        bodies=() if settings.bodies is None else tuple(read_bodies(settings.bodies)),
        spacing_mm=(ranges["x"][2], ranges["y"][2], ranges["z"][2]),
        workers=settings.workers,
        scheduler=settings.scheduler,
        checkpoint=settings.checkpoint,
        refine=settings.refine,
        reliability=settings.reliability,
    )
    data = map_zone(rig, calibration, nodes, rotations, scan=scan, progress=steps(progress, "zone"))
    write_zone(settings.out, data)
    followed: list[Piece] = []
    said: list[str] = []
    if settings.boundary:
        from lmeasure.accuracy import columns as edge_columns, edges

        followed, said = edges(rig, data, rotations, settings.length_mm)
        files.write_table(settings.out.with_suffix(".boundary.csv"), edge_columns(followed))
    if settings.report is not None:
        from lmeasure.report import write_zone_report

        write_zone_report(settings.report, data, rig, calibration, language=settings.language or of_terminal(), followed=followed)
    if settings.rerun is not None:
        from lmeasure.view import write_recording

        write_recording(settings.rerun, rig, zone=data)
    chosen = " ".join(f"--{name} {':'.join(f'{v:g}' for v in ranges[name])}" for name, span in given.items() if span is None)
    missing = [f"--{name}" for name, span in given.items() if span is None]
    code = "zone_line.no_range" if len(missing) == len(given) else "zone_line.no_range_for"
    lines = [*([message(code, ranges=tuple(missing), box=chosen)] if chosen else []), *summary(data).splitlines()]
    if chosen and (over := goes_on(data)):
        lines.append(message("workflows.zone_goes_beyond_box", axes=tuple(over)))
    if not data["in_zone"].values.any():
        lines += advice(data, settings.rig)
    lines += [*faults_said(data), *(piece.line("z") for piece in followed), *said]
    if program is not None:
        from lmeasure.accuracy import guard, guard_columns

        parts = guard(rig, calibration, data, program, rotation=rotations.mean())
        files.write_table(settings.out.with_suffix(".path.csv"), guard_columns(parts))
        lines += [part.line() for part in parts]
    inside = data["in_zone"].values.astype(bool)
    figures: dict[str, float] = json.loads(data.attrs["assumed_figures"])
    figures["zone_volume_mm3"] = float(data.attrs["zone_volume_mm3"])
    figures |= {"nodes": float(inside.size), "nodes_in_zone": float(inside.sum())}
    figures["smallest_worst_pressure_angle_deg"] = float(data["worst_pressure_angle_deg"].min())
    if inside.any():
        u95 = data["u95_position_mm"].values[inside]
        figures |= {"least_u95_position_mm": float(u95.min()), "largest_u95_position_mm": float(u95.max())}
    return Result(data, tuple(lines), figures, next="" if inside.any() else _after_empty(settings))


def _after_empty(settings: ZoneSettings) -> str:
    """Return the command after a zone of no node: the same rig in a box of its own, or better places of its points."""
    if None in (settings.x, settings.y, settings.z):
        return then("place {rig} --task placement.toml --out placed", rig=settings.rig)
    return then("zone {rig} --out {out}", rig=settings.rig, out=settings.out.with_stem(f"{settings.out.stem}-whole"))


def _rotations(settings: ZoneSettings) -> "Rotation":
    """The orientations that are tried at each node: over the angles O, A, T, or tilts."""
    import numpy as np
    from scipy.spatial.transform import Rotation

    from lmeasure.accuracy import MAX_ORIENTATIONS, tilts
    from lmeasure.core import rotation_from_angles

    angles = {"o": settings.o, "a": settings.a, "t": settings.t}
    missing = next((name for name, span in angles.items() if span is None), None)
    if settings.o is None and settings.a is None and settings.t is None:
        middle = None if settings.quaternion is None else Rotation.from_quat(settings.quaternion)
        if settings.tilt_deg and settings.tilt_rad:
            raise SettingsError("tilt_rad", message("error.is_given_and_so_is"))
        return tilts(settings.tilt_rad or math.radians(settings.tilt_deg), settings.tilt_steps, middle)
    if missing is not None:
        raise SettingsError(missing, message("error.give_o_a_and"))
    if settings.tilt_deg or settings.tilt_rad or settings.quaternion:
        raise SettingsError("tilt_deg", message("error.give_either_o_a"))
    values = [_axis(name, span) for name, span in angles.items() if span is not None]
    if math.prod(map(len, values)) > MAX_ORIENTATIONS:
        raise SettingsError("o", message("error.more_than_orientations", max_orientations=MAX_ORIENTATIONS))
    return rotation_from_angles("puma-oat", np.stack(np.meshgrid(*values, indexing="ij"), axis=-1).reshape(-1, 3))


def _axis(name: str, span: tuple[float, float, float]) -> "FloatArray":
    from lmeasure.accuracy import axis

    try:
        return axis(*span)
    except AccuracyError as error:
        raise SettingsError(name, reason(error)) from None
