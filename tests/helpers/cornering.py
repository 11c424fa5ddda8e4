"""A run of a robot that turns a corner, by the counts of a simulator of our own, and its program."""

from dataclasses import replace

import numpy as np
from moving_robot import TRUTH, Cornering, Instrument
from zeroed import zeroed_exactly

from lmeasure.recording import Counts, Program, Run, read_run


def cornering(rate_hz: float, cycles: int, begin_s: float) -> tuple[Run, Program, Cornering]:
    """A run along a corner by the cables of an instrument, and its program; the run is zeroed exactly, and nothing else errs."""
    instrument, motion = Instrument("cell-run"), Cornering(cycles, begin_s=begin_s, swing_mm=0.5)
    time_s = np.arange(0.0, motion.lasts_s, 1.0 / rate_hz)
    recorded = instrument.recorded(motion, np.tile(time_s[:, None], (1, len(instrument.channels))))
    run = read_run(TRUTH / "cell-run")
    exact = run.rig.model_copy(update={"unstated": "exact"})
    run = replace(zeroed_exactly(replace(run, rig=exact, unstated="exact")), start=np.array([0.0] * 6 + [1.0]))
    end = [motion.LEG_MM, motion.LEG_MM, 0.0]
    rests = [(b + 0.4, b + 0.55) for _, b in motion.windows()]
    settling = [(a + 0.5, b + 0.55) for a, b in motion.windows()]
    corners = [[0.0, 0.0, 0.0], motion.corner.tolist(), end]
    path = {"name": "L", "kind": "points", "points_mm": corners, "speed_mm_s": motion.speed, "windows_s": motion.windows()}
    pose = {"name": "P", "position_mm": end, "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0], "windows_s": rests, "settling_s": settling}
    program = Program.model_validate({"schema": "lmeasure.program/1", "path": [path], "pose": [pose | {"limit_band_mm": 0.1}]})
    return replace(run, passes=(Counts(time_s, instrument.channels, recorded),)), program, motion
