"""Effects on the length of a cable besides its parameters: how uncertain drums, pulleys and attachment points are, and what that does.

With F and D of `kernels.cable`, N counts per turn, k the true count, every error as what it adds to f = F(P) - D(k):

    count length    c + dc:               -k dc
    groove pitch    g + dg:               a(k)/h(k) k/N dg
    attachment      P + dP in the tool:   (R^T e) . dP
    swivel axis     d beside the groove:  -d sin phi                                (`sensors.imperfect_parts`)
    other cable     o thicker:            o/2 phi - k dl, dl that of a count
    run-out         the drum pays out a cos(2 pi k/N) + b sin(2 pi k/N) more:  minus that
    eccentricity    below
    play            the true count is k + s w, s = 1 paying out, s = -1 winding in:  -s c w

each less the same at the pose and count where the counter was zeroed. Of the play, s is that of the last travel: where a run has got
to it is known, where the counter was zeroed it is not, and as either sign is as likely the two errors are uncorrelated, each of the
variance of w. Play between drum and encoder and friction along the cable obey the same law: a reading stands still until the band of
width 2 w is crossed. (While it is crossed s lies between its two values, and the last one is taken.) Temperature, tension and weight
need more than one number and have a module of their own (`lmeasure.sensors.cable_effects`).

Swivel pulley off its axle
--------------------------
Cable does not slip on the pulley, so D(k) turns it by psi = D(k)/R, from u towards n (module docstring of `kernels.cable`). Its groove is a
circle about O + x, with x = x1 (cos psi u + sin psi n) + x2 (cos psi n - sin psi u) fixed to the pulley. A tight cable pulls the pulley by
its tension times e - u, so that by virtual work the length changes by dF = x . (u - e) to first order, second orders being x^2/R:

    dF = x1 (cos psi (1 - cos phi) - sin psi sin phi) - x2 (sin psi (1 - cos phi) + cos psi sin phi)
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lmeasure.core import FloatArray
from lmeasure.kernels import RADIUS, TRAVEL, TURN_COUNTS
from lmeasure.sensors.wrap import Drum, Span, drum_of
from lmeasure.text import Message, message


class Acted(NamedTuple):
    """A cable at n samples: its row of the kernels, base_from_tool turns (n, 3, 3), true counts (n,), and how it runs."""

    row: FloatArray
    turns: FloatArray
    counts: FloatArray
    span: Span

    @property
    def drum(self) -> Drum:
        """Return what pays it out."""
        return drum_of(self.row)


@dataclass(frozen=True)
class CableEffect:
    """A kind of error. key: the rig's key that states it; text: its name, and code: the name's in the catalogues; of: the stated value of
    which a typical size is a share; parameter: its name in a calibration, if that can solve it; adds: what one unit of each of its
    components adds to F(P) - D(k), (n, components) [mm], None of play, which depends on the direction of travel."""

    key: str
    text: str
    code: str
    of: str | None = None
    parameter: str | None = None
    adds: Callable[[Acted], FloatArray] | None = None

    @property
    def said(self) -> Message:
        """Return what it is called, in every language."""
        return message(f"exact.{self.code}")


def _of_count_length(at: Acted) -> FloatArray:
    return -at.counts[:, None]


def _of_pitch(at: Acted) -> FloatArray:
    a = at.drum.axial_mm + at.drum.travel_mm * at.counts
    return (a / np.maximum(np.hypot(at.drum.tangent_mm, a), 1e-300) * at.counts / at.row[TURN_COUNTS])[:, None]


def _of_run_out(at: Acted) -> FloatArray:
    angle = 2.0 * np.pi * at.counts / at.row[TURN_COUNTS]
    return -np.column_stack([np.cos(angle), np.sin(angle)])


def _of_eccentricity(at: Acted) -> FloatArray:
    psi = at.drum.paid_out(at.counts) / at.row[RADIUS]
    lift, sine, c, s = 1.0 - at.span.cosine, at.span.sine, np.cos(psi), np.sin(psi)
    return np.column_stack([c * lift - s * sine, -s * lift - c * sine])


def _of_offset(at: Acted) -> FloatArray:
    return -at.span.sine[:, None]


def _of_oversize(at: Acted) -> FloatArray:
    turn = at.row[TURN_COUNTS]
    _, by_over = thicker(at.drum.count_mm * turn, at.row[TRAVEL] * turn, 0.0)
    return (0.5 * at.span.angle * (at.row[RADIUS] > 0.0) - at.counts / turn * by_over)[:, None]


def thicker(turn_mm: ArrayLike, pitch_mm: ArrayLike, over: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """How much longer a turn is on drums (...) of such pitches, with turn_mm of cable in it, of cables thicker by over; derivative."""
    turn, pitch, half = (np.asarray(v, dtype=np.float64) for v in (turn_mm, pitch_mm, 0.5 * np.asarray(over)))
    r = np.sqrt(turn**2 - pitch**2) / (2.0 * np.pi)
    # a difference of two lengths would lose the digits of a small one
    longer = np.hypot(2.0 * np.pi * (r + half), pitch)
    return 4.0 * np.pi**2 * half * (2.0 * r + half) / (longer + turn), 2.0 * np.pi**2 * (r + half) / longer


def _of_attachment(at: Acted) -> FloatArray:
    return np.asarray(np.einsum("nij,ni->nj", at.turns, at.span.direction))


COUNT_LENGTH = CableEffect("u_count_length_mm", "count length", "count_length", "count_length_mm", "scale", _of_count_length)
PITCH = CableEffect("u_groove_pitch_mm", "groove pitch", "groove_pitch", parameter="groove_pitch_mm", adds=_of_pitch)
RUN_OUT = CableEffect("u_run_out_mm", "run-out of drums", "run_out", adds=_of_run_out)
ECCENTRICITY = CableEffect("u_pulley_eccentricity_mm", "eccentric pulleys", "pulleys", adds=_of_eccentricity)
ATTACHMENT = CableEffect("u_attachment_mm", "attachment points", "attachment", parameter="attachment", adds=_of_attachment)
OFFSET = CableEffect("u_swivel_offset_mm", "swivel axes off the groove", "swivels", adds=_of_offset)
OVERSIZE = CableEffect("u_cable_oversize_mm", "cable diameter", "cable_diameter", adds=_of_oversize)
BACKLASH = CableEffect("u_backlash_counts", "backlash", "backlash")
FRICTION = CableEffect("u_friction_counts", "friction", "friction")

DIMENSIONS = (COUNT_LENGTH, PITCH, ATTACHMENT)
"""Dimensions of the rig, the same in every run and calibration."""
OTHERS = (RUN_OUT, ECCENTRICITY, BACKLASH, FRICTION, OFFSET, OVERSIZE)
"""Effects that depend on how drum and pulley stand and which way they turned, and what only a rig that states it has."""
EFFECTS = (COUNT_LENGTH, PITCH, RUN_OUT, ECCENTRICITY, ATTACHMENT, BACKLASH, FRICTION, OFFSET)
"""Effects with a typical size if nobody states it."""
STATED = (*EFFECTS, OVERSIZE)  # What a rig may state to be uncertain
