"""Stages in a row: closed loops over a simulated cell, from counts on a bus to what is said of them, beside the truth they came from."""

from lmeasure.chains.cell_demo import STAGES, Demo, Line, demo
from lmeasure.chains.over_the_bus import count_at_stops, record_motion
from lmeasure.chains.truth import Errors, errors_of, held_out_length_error

__all__ = [
    "STAGES",
    "Demo",
    "Errors",
    "Line",
    "count_at_stops",
    "demo",
    "errors_of",
    "held_out_length_error",
    "record_motion",
]
