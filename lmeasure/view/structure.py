"""A structure as a recording: base, assemblies one after the other, a way with its determinant, the boundary of its workspace."""

from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from lmeasure.core import FloatArray, se3
from lmeasure.linkages import LINKS, incidence
from lmeasure.robots import ParallelFile, drawn, motion, nearness
from lmeasure.structure import Linkage, described_lines
from lmeasure.view.recording import cable_colour, named, recording, shown
from lmeasure.view.space import CABLE, GREY, PLAIN, THICK, metres

PLATFORM, BOUNDARY, LEAST = (86, 150, 255), (120, 220, 120), (190, 120, 255)
FACES = np.array([(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)], dtype=np.uint32)
MEASURES = {"determinant": "determinant", "mm_per_mm": "rim", "worst_pressure_angle_deg": "pressure_angle"}


def write_structure_recording(path: Path, name: str, linkage: Linkage, record: dict[str, Any], *, pose: FloatArray | None) -> None:
    """Write links and their record (`structure.record.described`) as one .rrd; timeline `assembly`: 0 is the pose, and those of the lengths
    behind it; timeline `way`: per mille of the way."""
    with recording(Path(path), f"lmeasure structure {name}") as rec:
        rec.log("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        labels = [point for _, point, _ in linkage.names]
        rec.log("/world/base", rr.Points3D(metres(linkage.base), radii=THICK, colors=PLAIN, labels=labels), static=True)
        poses = [] if pose is None else [(0, pose)]
        for i, one in enumerate(record.get("assemblies", []), 1):
            poses.append((i, np.array([*one["position_mm"], *one["quaternion_xyzw"]])))
        for number, at in poses:
            rec.set_time("assembly", sequence=number)
            _log_platform(rec, linkage, at)
            _log_tetrahedra(rec, linkage, at)
        rec.reset_time()
        if "least_seen_screw" in record and pose is not None:
            screw, size = record["least_seen_screw"], float(np.ptp(linkage.base, axis=0).max()) / 2.0
            way = size * np.array(screw["direction"])
            foot = np.array(screw["point_mm"])
            rec.log(
                "/world/screw_seen_least",
                rr.Arrows3D(origins=metres(foot - way / 2.0), vectors=metres(way), colors=LEAST, radii=THICK),
                static=True,
            )
        for k, piece in enumerate(record.get("boundary", {}).get("slices", [])):
            places = np.array(piece["places_mm"])
            strip = np.vstack([places, places[:1]]) if piece["closed"] else places
            rec.log(f"/world/boundary/{k}", rr.LineStrips3D([metres(strip)], colors=BOUNDARY, radii=CABLE), static=True)
        if "way" in record:
            _log_way(rec, linkage, record["way"])
        lines = "\n".join(f"- {shown(line).strip()}" for line in described_lines(record))
        rec.log("/notes", rr.TextDocument(f"# {name}\n\n{lines}\n", media_type=rr.MediaType.MARKDOWN), static=True)
        rec.send_blueprint(_blueprint("way" in record), make_active=True, make_default=True)


def _log_platform(rec: rr.RecordingStream, linkage: Linkage, pose: FloatArray) -> None:
    points = se3.apply(pose, linkage.platform)
    outline = metres(np.vstack([np.unique(points, axis=0), points[:1]]))
    rec.log("/world/platform", rr.LineStrips3D([outline], colors=PLATFORM, radii=THICK))
    rec.log("/world/platform/points", rr.Points3D(metres(points), radii=THICK, colors=PLATFORM, labels=[p for _, _, p in linkage.names]))
    strips = metres(linkage.strips(pose))
    rec.log("/world/links", rr.LineStrips3D(list(strips), colors=[cable_colour(i) for i in range(len(strips))], radii=CABLE))


def _log_tetrahedra(rec: rr.RecordingStream, linkage: Linkage, pose: FloatArray) -> None:
    """Those by which the assemblies are found, where there are such."""
    if len(linkage.base) != LINKS:
        return
    found = incidence(linkage.base, linkage.platform)
    place: dict[tuple[str, int], FloatArray] = {}
    for number, (p, b) in zip(found.order, found.structure.links, strict=True):
        place["P", p], place["B", b] = se3.apply(pose, linkage.platform[number]), linkage.base[number]
    for n, (side, i, corners) in enumerate(found.structure.placements or (), 1):
        points = np.array([place[side, i], *(place[c] for c in corners)])
        colour = (*cable_colour(n), 60)
        mesh = rr.Mesh3D(vertex_positions=metres(points), triangle_indices=FACES, albedo_factor=colour)
        rec.log(f"/world/tetrahedra/{n}", mesh)


def _log_way(rec: rr.RecordingStream, linkage: Linkage, way: dict[str, Any]) -> None:
    rec.log("/world/way", rr.LineStrips3D([metres(np.array(way["position_mm"]))], colors=GREY, radii=CABLE), static=True)
    for key in MEASURES:
        for share, value in zip(way["share"], way[key], strict=True):
            if value is not None:
                rec.set_time("way", sequence=round(1000.0 * share))
                rec.log(f"/way/{key}", rr.Scalars(value))
    rec.reset_time()


def _blueprint(way: bool) -> rrb.Blueprint:
    space: rrb.View = rrb.Spatial3DView(name=named("structure"), origin="/world", line_grid=rrb.LineGrid3D(visible=False))
    notes: rrb.View = rrb.TextDocumentView(name=named("notes"), origin="/notes")
    right: list[rrb.View] = [rrb.TimeSeriesView(name=named(name), origin=f"/way/{key}") for key, name in MEASURES.items()] if way else []
    return rrb.Blueprint(rrb.Horizontal(space, rrb.Vertical(*right, notes), column_shares=[3, 2]), rrb.TimePanel(state="expanded"))


ARM, LEG, PLATFORM = (124, 58, 237), (234, 120, 60), (86, 150, 255)


def write_mechanism_recording(path: Path, file: ParallelFile) -> None:
    """Write the motion as one .rrd; timeline `step`."""
    robot = file.model
    poses, joints = motion(file)
    near = nearness(robot.jacobians(poses, joints).output, robot.units)
    with recording(Path(path), f"lmeasure mechanism {file.name}") as rec:
        rec.log("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        rec.log("/world/base", rr.LineStrips3D([metres(s) for s in drawn(file, robot.home).base], colors=GREY, radii=CABLE), static=True)
        for step, (pose, q) in enumerate(zip(poses, joints, strict=True)):
            rec.set_time("step", sequence=step)
            at = drawn(file, pose)
            rec.log("/world/legs", rr.LineStrips3D([metres(s) for s in at.legs], colors=LEG, radii=CABLE))
            if at.arms:
                rec.log("/world/arms", rr.LineStrips3D([metres(s) for s in at.arms], colors=ARM, radii=THICK))
            rec.log("/world/platform", rr.LineStrips3D([metres(at.platform)], colors=PLATFORM, radii=THICK))
            for name, slides, value in zip(robot.joint_names, robot.sliding, q, strict=True):
                unit = "mm" if slides else "deg"
                rec.log(f"/joints/{unit}/{name}", rr.Scalars(float(value if slides else np.degrees(value))))
            rec.log("/nearness", rr.Scalars(float(near[step])))
        rec.reset_time()
        space = rrb.Spatial3DView(name=file.name, origin="/world", line_grid=rrb.LineGrid3D(visible=False))
        units = dict.fromkeys("mm" if slides else "deg" for slides in robot.sliding)
        views: list[rrb.View] = [rrb.TimeSeriesView(name=named("joints", unit=unit), origin=f"/joints/{unit}") for unit in units]
        views.append(rrb.TimeSeriesView(name=named("nearness"), origin="/nearness"))
        layout = rrb.Horizontal(space, rrb.Vertical(*views), column_shares=[3, 2])
        rec.send_blueprint(rrb.Blueprint(layout, rrb.TimePanel(state="expanded")), make_active=True, make_default=True)
