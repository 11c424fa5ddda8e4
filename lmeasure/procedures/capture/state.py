"""State of a session as plain values: for pages and other programs."""

import math
from typing import Any

import numpy as np

from lmeasure.core import conventions
from lmeasure.procedures.capture.folder import mean_variances
from lmeasure.procedures.capture.progress import Worth
from lmeasure.procedures.capture.session import Session

MOVES_S = 0.1
"""A rest is no rest before that."""


def state_of(session: Session) -> dict[str, Any]:
    """Return the wanted pose, in the form for the controller; whether the robot rests, its time and the required time; counts; poses with
    their results; readings with standard uncertainties [counts]; their value (95 %, mm), after each of them, and the expected value of all
    poses."""
    folder, rest = session.folder, session.rest
    newest = rest.counts[-1] if len(rest.counts) else np.full(len(folder.channels), np.nan)
    wanted = session.settings.settle_s + session.settings.dwell_s
    silent = folder.channels if session.idle else rest.silent
    state = "lost" if session.lost and not session.idle else "silent" if silent else "still" if rest.lasts_s > MOVES_S else "moving"
    return {
        "pose": session.goal,
        "typed": [] if session.goal is None else typed(session, session.goal),
        "back": session.returns,
        "state": state,
        "still_s": round(rest.lasts_s, 2),
        "needs_s": wanted,
        "channels": [{"name": c, "count": _number(v), "silent": c in silent} for c, v in zip(folder.channels, newest, strict=True)],
        "doubted": session.doubt,
        "poses": [{"name": n, "is": _became(session, n)} for n in session.poses.names],
        "readings": _readings(session),
        "worth": [worth(count, w) for count, w in session.progress.history],
        "promised": None if session.progress.of_all is None else worth(len(session.poses), session.progress.of_all),
        "finished": session.finished,
    }


def typed(session: Session, name: str) -> list[tuple[str, float]]:
    """A pose in the controller's convention, its angles as they are typed: column and value."""
    poses, angles = session.poses, session.folder.rig.angles
    i = poses.names.index(name)
    out = [(axis, round(float(v), 1) + 0.0) for axis, v in zip(("x", "y", "z"), poses.rows[i, :3], strict=True)]
    if poses.oriented:
        values = conventions.rounded_angles(angles, conventions.angles_from_rotation(angles, poses.rotation[i]))
        out += [(c.rsplit("_", 1)[0], float(v)) for c, v in zip(conventions.convention(angles).columns, values, strict=True)]
    return out


def worth(readings: int, reported: Worth) -> dict[str, Any]:
    """After so many readings."""
    position = None if reported.position_mm is None else _number(reported.position_mm)
    return {
        "readings": readings,
        "rms_mm": reported.rms_mm,
        "worst_mm": reported.worst_mm,
        "cable": reported.worst_cable,
        "position_mm": position,
        "rank": reported.rank,
        "unknowns": reported.unknowns,
        "enough": reported.enough(readings),
    }


def _became(session: Session, name: str) -> str:
    if any(r.pose == name for r in session.folder.of_pass):
        return "read"
    return "left out" if name in session.skipped else "open"


def _readings(session: Session) -> list[dict[str, Any]]:
    readings = session.folder.of_pass
    if not readings:
        return []
    u = np.sqrt(mean_variances(readings))
    return [
        {"pose": r.pose, "samples": len(r.counts), "spread": float(r.spread.max()), "u_counts": round(float(one.max()), 4)}
        for r, one in zip(readings, u, strict=True)
    ]


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
