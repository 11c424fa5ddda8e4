"""The pictures beside a certificate's tables, on paper and on the page: where each pose was attained, how each path was run."""

from typing import Any, NamedTuple

import numpy as np

from lmeasure.certificate import chosen, targets
from lmeasure.iso9283 import AttainedPath, Evaluation
from lmeasure.report import certificate_text as say, drawings, html
from lmeasure.report.text import unit, word
from lmeasure.text import number
from lmeasure.trajectory import AttainedPose

MOST_CYCLES = 30
MOST_POSES = 40


class Picture(NamedTuple):
    """SVGs that belong together, and their caption."""

    svgs: tuple[str, ...]
    caption: str


def beside(language: str, evaluation: Evaluation) -> dict[tuple[str, str], Picture]:
    """Pictures by (pose or path, its name)."""
    out = {("pose", pose.name): _targets(language, pose) for pose in evaluation.poses[:MOST_POSES]}
    return out | {("path", path.name): _path(language, path) for path in evaluation.paths}


def _targets(language: str, pose: AttainedPose) -> Picture:
    """The pose from above, from the front and from the side."""
    views = targets(pose, readable=True)
    radius = views[0].radius
    reported = [word(language, "bullseye.rings", radius=_short(language, radius), step=_short(language, drawings.ring_step(radius)))]
    if views[0].enlarged > 1.0:
        reported.append(word(language, "bullseye.enlarged", factor=_short(language, views[0].enlarged)))
    name = say.visible(pose.name)
    axes = ("XYZ"[v.axes[0]] + "XYZ"[v.axes[1]] for v in views)
    return Picture(tuple(drawings.target(v, f"{name} {a}") for v, a in zip(views, axes, strict=True)), "; ".join(reported))


def _path(language: str, path: AttainedPath) -> Picture:
    """Deviation and speed along the path."""
    name, along = say.visible(path.name), word(language, "axis.arc")
    middles = 0.5 * (path.arc_mm[1:] + path.arc_mm[:-1])
    drawn = [drawings.Curves(path.arc_mm, path.deviation_mm[:MOST_CYCLES], along, word(language, "axis.deviation"))]
    if len(middles) > 1:
        speed = path.speed_mm_s[:MOST_CYCLES]
        drawn.append(drawings.Curves(middles, speed, along, word(language, "axis.speed"), path.commanded_speed_mm_s))
    return Picture(tuple(drawings.curves(d, language, f"{name}: {d.up}") for d in drawn), word(language, "curves.text"))


def _short(language: str, value: float) -> str:
    return number(language, value, "g")


def errors_in_space(certificate: dict[str, Any]) -> Picture | None:
    """The box of the commanded poses with the error of each as an arrow, as certificate.json has their means; None without poses."""
    language, attained = certificate["language"], certificate["attained"]
    if not attained:
        return None
    commanded = np.array([a["commanded_mm"] for a in attained], dtype=np.float64)
    mean = np.array([a["mean_mm"] for a in attained], dtype=np.float64)
    names, seen = [], set()
    for a, place in zip(attained, commanded, strict=True):
        key = np.round(place, 3).tobytes()
        names.append("" if key in seen else html.cut(say.visible(a["pose"])))
        seen.add(key)
    title = word(language, "errors")
    svg, factor, sides = drawings.errors_in_space(names, commanded, mean - commanded, title)
    box = " × ".join(_short(language, round(float(s), 1)) for s in sides)
    return Picture((svg,), word(language, "errors.text", box=f"{box}\u00a0{unit(language, 'mm')}", factor=_short(language, factor)))


class SummaryFigure(NamedTuple):
    """A figure of the summary: as it is printed, at which pose or path, and its bar."""

    result: say.Result
    where: str
    bar: str


def figures(certificate: dict[str, Any]) -> list[SummaryFigure]:
    """The figures that matter most."""
    out = []
    for one in chosen(certificate):
        result, where = say.result(certificate, one.figure), say.place_of(certificate["language"], one.figure)
        if one.of > 1:
            where = word(certificate["language"], "summary.worst", place=where, number=one.of)
        label = " ".join(t for t in (result.symbol, result.value, result.u95, result.unit, result.limits) if t)
        out.append(SummaryFigure(result, where, drawings.bar(one.figure, label)))
    return out
