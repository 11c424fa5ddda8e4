"""Labels of a drawing in space: each on the free side of its marker as the page opens."""

from typing import Any

import numpy as np
import plotly.graph_objects as go
import scipy

from lmeasure.core import FloatArray

SIDES: dict[str, tuple[float, float]] = {
    "middle right": (1.0, 0.0),
    "middle left": (-1.0, 0.0),
    "top center": (0.0, 0.7),
    "bottom center": (0.0, -0.7),
    "top right": (0.9, 0.6),
    "top left": (-0.9, 0.6),
    "bottom right": (0.9, -0.6),
    "bottom left": (-0.9, -0.6),
}
REACH = 0.1
"""Distance from a marker to the middle of its label, in widths of the drawing: between a telephone's and a desk's."""
WIDE = np.array([1.6, 1.0])
"""A label is wider than high."""
STEPS = np.linspace(0.0, 1.0, 20)
DENSE = 500
"""A line of more points is an obstacle by its points alone."""
GAP = "\u00a0\u00a0"


def place_labels(drawing: go.Figure) -> None:
    """Give each label its side, seen from the eye of the drawing's camera. Parts hidden as the page opens do not count."""
    own = [t for t in drawing.data if t.type == "scatter3d" and t.visible in (None, True)]
    named = [t for t in drawing.data if t.type == "scatter3d" and "text" in (t.mode or "")]
    camera = drawing.layout.scene.camera.eye
    eye = (camera.x, camera.y, camera.z)
    taken = [_seen(_places(t), eye) for t in own]
    every = np.concatenate([_seen(_points(t), eye) for t in {id(t): t for t in own + named}.values()] or [np.empty((0, 2))])
    if not named or not len(every):
        return
    reach = REACH * max(float(np.ptp(every, axis=0).max()), 1e-9)
    obstacles = np.concatenate([*taken, np.empty((0, 2))])
    for trace in named:
        texts = [str(text) for text in trace.text]
        sides, obstacles = _sides(_seen(_points(trace, whole=True), eye), texts, obstacles, reach)
        pads = {"middle right": (GAP, ""), "middle left": ("", GAP)}
        trace.text = [f"{pads[s][0]}{t}{pads[s][1]}" if t and s in pads else t for s, t in zip(sides, texts, strict=True)]
        trace.textposition = sides


def _sides(at: FloatArray, texts: list[str], obstacles: FloatArray, reach: float) -> tuple[list[str], FloatArray]:
    """A side for each label at (n, 2), and the obstacles (m, 2) with the labels among them."""
    sides = []
    for place, text in zip(at, texts, strict=True):
        middles = place + reach * np.array(list(SIDES.values()))
        # its own marker is as near on every side
        others = obstacles[np.hypot(*(obstacles - place).T) > 1e-3 * reach]
        room = (
            scipy.spatial.distance.cdist(middles / WIDE, others / WIDE, "chebyshev").min(axis=1) if len(others) else np.ones(len(middles))
        )
        room = np.minimum(room, reach)
        best = int(np.argmax(room)) if text and np.isfinite(room).all() else 0
        sides.append(list(SIDES)[best])
        if text and np.isfinite(middles[best]).all():
            obstacles = np.vstack([obstacles, middles[best]])
    return sides, obstacles


def _seen(points: FloatArray, eye: tuple[float, float, float]) -> FloatArray:
    """(n, 2) of points (n, 3): to the right and up, as seen from the eye."""
    ahead = -np.array(eye) / np.linalg.norm(eye)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= max(float(np.linalg.norm(right)), 1e-9)
    return points @ np.column_stack([right, np.cross(right, ahead)])


def _points(trace: Any, *, whole: bool = False) -> FloatArray:
    """(n, 3) of a trace, without gaps unless whole."""
    points = np.column_stack([np.array(trace[axis], dtype=np.float64) for axis in "xyz"])
    return points if whole else points[np.isfinite(points).all(axis=1)]


def _places(trace: Any) -> FloatArray:
    """(k, 3) where a trace draws: its markers, and points along its lines."""
    points = _points(trace, whole=True)
    if "lines" in (trace.mode or "") and len(points) <= DENSE:
        points = (points[:-1, None] + STEPS[:, None] * np.diff(points, axis=0)[:, None]).reshape(-1, 3)
    return points[np.isfinite(points).all(axis=1)]
