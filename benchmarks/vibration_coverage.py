"""Does U95 hold where the robot vibrates while it rests or moves, and where it turns corners without any error?

python benchmarks/vibration_coverage.py [--case NAME] [--campaigns 200] [--keep vibration.jsonl]

A robot with offsets and scatter of its own rests at two poses in turn, and swings about where it rests by a sinusoid of 5 to 13 Hz of one
amplitude in a direction that is drawn for each pose, of a phase that is drawn for each dwell or, `locked`, is the same in all. The rig is
known exactly and its counters were set to zero exactly, so that nothing but the dwells themselves can be wrong. The truth is taken in two
ways: where the robot rests, about which it swings, and the mean of its true motion over the window. Corners: a robot without any error
runs a rectangle.
`vibrating at F Hz, R/s`: velocity and acceleration of a tool that moves slowly and swings at 1 to 8 mm/s, known to 0.003 mm; U95 is two
standard uncertainties. `arc of R mm, F/s`: CR and AT of a robot that rounds a corner at 240 mm/s, sampled at a phase that is drawn, against
the true path.
Of each campaign --keep holds case, seed, figure, reading, error, U95; with --before those of an earlier program stand beside them.
"""

import itertools
import sys
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from certificate_coverage import NoErrors, trajectory_of
from erring_robot import posed
from numpy.typing import NDArray
from study import Study, table as as_table

from lmeasure.iso9283 import CertificationSettings, Evaluation, evaluate
from lmeasure.recording import Counts, Program, Run
from lmeasure.rig import Rig
from lmeasure.sensors import counts_from_poses, lengths_from_counts, recorded_from_counts
from lmeasure.simulation import cell_rig
from lmeasure.trajectory import RunModel, Trajectory, motion_of, reconstruction_of

FloatArray = NDArray[np.float64]

START = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
PLACES = {"P1": (0.0, 0.0, 0.0), "P2": (140.0, 120.0, -90.0)}
TRIALS = 400
FREQUENCIES_HZ = (5.0, 13.0)
FINER = 64
"""Times as often as it is sampled that the motion is averaged for its true mean."""


@dataclass(frozen=True)
class Case:
    """amplitude_mm of the swing, rate_hz of the samples, window_s of a dwell, cycles; locked: the same phase in every dwell."""

    amplitude_mm: float
    rate_hz: float = 250.0
    window_s: float = 0.5
    cycles: int = 10
    locked: bool = False


CASES = {
    "still": Case(0.0),
    "0.01 mm": Case(0.01),
    "0.02 mm": Case(0.02),
    "0.05 mm": Case(0.05),
    "0.02 mm, 50 Hz": Case(0.02, rate_hz=50.0),
    "0.02 mm, 1 kHz": Case(0.02, rate_hz=1000.0),
    "0.02 mm, 0.15 s": Case(0.02, window_s=0.15),
    "0.02 mm, 0.15 s, 3 cycles": Case(0.02, window_s=0.15, cycles=3),
    "0.02 mm, 1 s": Case(0.02, window_s=1.0),
    "0.02 mm, 30 cycles": Case(0.02, cycles=30),
    "0.02 mm, locked": Case(0.02, locked=True),
    "0.05 mm, 0.15 s": Case(0.05, window_s=0.15),
}
SHAKEN = {
    f"vibrating at {hz:g} Hz, {rate:g}/s": (hz, rate)
    for rate in (200.0, 1000.0)
    for hz in (5.0, 18.8, 25.0, 50.0, 70.0, 100.0)
    if hz <= 0.35 * rate
}
ARCS = {f"arc of {radius:g} mm, {rate:g}/s": (radius, rate) for radius in (0.0, 2.0, 5.0) for rate in (80.0, 250.0, 1000.0)}
KNOWN_MM = 0.003
EVERY = 10
"""Samples of a vibrating tool from one that is judged to the next."""
CORNERS = {"corners, 250 Hz": 250.0, "corners, 1 kHz": 1000.0}
EVERY_CASE = [*CASES, *CORNERS, *SHAKEN, *ARCS]


def known(seed: int) -> Rig:
    """The rig of a campaign, with counters set to zero exactly where a rig can say so."""
    rig = cell_rig(seed)
    points = []
    for point in rig.observation_point:
        exact = {"zero_exact": True} if "zero_exact" in type(point.drum).model_fields else {}
        points.append(point.model_copy(update={"drum": point.drum.model_copy(update=exact)}))
    return rig.model_copy(update={"observation_point": tuple(points)})


def measured(rig: Rig, time_s: FloatArray, poses: FloatArray) -> tuple[Run, Trajectory]:
    """What the rig records of a motion, whole counts, and the trajectory that it makes of them."""
    recorded = recorded_from_counts(rig, counts_from_poses(rig, poses, START))
    run = Run(rig, START, (Counts(time_s, tuple(c.channel for c in rig.cable), recorded, source="simulated"),), unstated="exact")
    solver = reconstruction_of(RunModel(rig, START))
    lengths = lengths_from_counts(run)
    return run, trajectory_of(time_s, solver.solve(solver.model.scheme.rows, solver.model.zero_pose, lengths.change_mm, lengths.flags))


def dwells(case: Case, seed: int) -> tuple[Evaluation, dict[str, Evaluation]]:
    """What is certified of a vibrating robot, and the same figures of its true rests and of its true means."""
    rng = np.random.default_rng(seed)
    rig = known(seed)
    n = round(case.window_s * case.rate_hz) + 1
    within = np.arange(n) / case.rate_hz
    fine = np.linspace(0.0, within[-1], FINER * (n - 1) + 1)
    offset, scatter = np.exp(rng.uniform(np.log([0.005, 0.002]), np.log([0.3, 0.05])))
    swing = {}
    for name in PLACES:
        direction = rng.normal(size=3)
        swing[name] = direction / np.linalg.norm(direction), rng.uniform(*FREQUENCIES_HZ), rng.uniform(0, 2 * np.pi), rng.normal(size=6)
    now, times, rows, true, windows = 0.0, [np.zeros(1)], [START[None, :]], {"rest": [START[None]], "mean": [START[None]]}, []
    for _ in range(case.cycles):
        for name, place in PLACES.items():
            direction, hz, phase, off = swing[name]
            phase = phase if case.locked else rng.uniform(0, 2 * np.pi)
            rest = np.array(place) + offset * off[:3] + scatter * rng.normal(size=3)
            turn = 1e-4 * off[3:] + 1e-5 * rng.normal(size=3)

            def at(t: FloatArray, hz: float = hz, phase: float = phase, direction: FloatArray = direction) -> FloatArray:
                return case.amplitude_mm * np.sin(2 * np.pi * hz * t + phase)[:, None] * direction

            now += 1.0
            times.append(now + within)
            windows.append((now, now + within[-1]))
            now = windows[-1][1]
            turns = np.tile(turn, (n, 1))
            rows.append(posed(rest + at(within), turns))
            true["rest"].append(posed(np.tile(rest, (n, 1)), turns))
            true["mean"].append(posed(np.tile(rest + at(fine).mean(axis=0), (n, 1)), turns))
    poses = [
        {"name": name, "position_mm": place, "quaternion_xyzw": (0.0, 0.0, 0.0, 1.0), "windows_s": windows[i :: len(PLACES)]}
        for i, (name, place) in enumerate(PLACES.items())
    ]
    program = Program.model_validate({"schema": "lmeasure.program/1", "pose": poses})
    time_s = np.concatenate(times)
    run, trajectory = measured(rig, time_s, np.concatenate(rows))
    settings = CertificationSettings(trials=TRIALS, seed=seed, limit_angle_deg=None)
    exact = replace(settings, trials=1)
    truth = {key: evaluate(trajectory_of(time_s, np.concatenate(r)), program, NoErrors(), settings=exact) for key, r in true.items()}
    return evaluate(trajectory, program, run=run, settings=settings), truth


def corners(rate_hz: float, seed: int) -> tuple[Evaluation, dict[str, Evaluation]]:
    """What is certified of a robot that runs a rectangle without any error, and of its true path."""
    rng = np.random.default_rng(seed)
    rig = known(seed)
    places = 100.0 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) + rng.uniform(-40, 40, 3)
    units = np.roll(places, -1, axis=0) - places
    units /= 200.0
    speed = rng.uniform(100.0, 200.0)
    times, rows, windows, now = [np.zeros(1)], [START[None, :]], [], 0.0
    for _ in range(3):
        way = np.arange(-8.0, 808.0, speed / rate_hz) + speed / rate_hz * rng.random()
        k = np.clip((way // 200.0).astype(int), 0, 3)
        rows.append(posed(places[k] + (way - 200.0 * k)[:, None] * units[k], np.zeros((len(way), 3))))
        times.append(now + 1.0 + np.arange(len(way)) / rate_hz)
        windows.append((float(times[-1][0]), float(times[-1][-1])))
        now = windows[-1][1]
    path = {"name": "rectangle", "kind": "rectangular", "corners_mm": [tuple(c) for c in places.tolist()], "windows_s": windows}
    program = Program.model_validate({"schema": "lmeasure.program/1", "path": [path]})
    time_s, poses = np.concatenate(times), np.concatenate(rows)
    run, trajectory = measured(rig, time_s, poses)
    settings = CertificationSettings(trials=TRIALS, seed=seed, limit_angle_deg=None, planes=30)
    truth = evaluate(trajectory_of(time_s, poses), program, NoErrors(), settings=replace(settings, trials=1))
    return evaluate(trajectory, program, run=run, settings=settings), {"path": truth}


def shaken(hz: float, rate_hz: float, seed: int) -> list[dict[str, object]]:
    """Errors of velocity and acceleration of a tool that vibrates."""
    rng, t = np.random.default_rng(seed), np.arange(round(4.0 * rate_hz)) / rate_hz
    w, turned = 2.0 * np.pi * np.array([0.31, 0.43, 0.37]), 2.0 * np.pi * hz
    swing = rng.normal(size=3)
    swing *= rng.uniform(1.0, 8.0) / np.linalg.norm(swing)
    phase = turned * t[:, None] + rng.uniform(0.0, 2.0 * np.pi, 3)
    place = 60.0 * np.sin(np.outer(t, w)) + swing / turned * np.sin(phase)
    true = {
        "velocity": 60.0 * w * np.cos(np.outer(t, w)) + swing * np.cos(phase),
        "acceleration": -60.0 * w**2 * np.sin(np.outer(t, w)) - swing * turned * np.sin(phase),
    }
    measured = trajectory_of(t, posed(place + KNOWN_MM * rng.normal(size=place.shape), np.zeros((len(t), 3))))
    found = motion_of(replace(measured, random=np.tile(np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]) * KNOWN_MM**2, (len(t), 1, 1))))
    reported = {"velocity": (found.velocity, found.u_velocity), "acceleration": (found.acceleration, found.u_acceleration)}
    rows = range(0, len(t), EVERY)
    return [
        {"figure": name, "where": f"{'xyz'[a]} {i}", "reading": "sample", "error": v[i, 3 + a] - true[name][i, a], "u95": 2.0 * u[i, 3 + a]}
        for name, (v, u) in reported.items()
        for a in range(3)
        for i in rows
    ]


def arc(radius: float, rate_hz: float, seed: int) -> list[dict[str, object]]:
    """Errors of CR and AT of a robot that rounds a corner of a right angle without any other error."""
    rng, step = np.random.default_rng(seed), 240.0 / rate_hz

    def places(way: FloatArray) -> FloatArray:
        turn = np.clip(way / radius if radius > 0.0 else np.where(way < 0.0, 0.0, np.inf), 0.0, np.pi / 2)
        behind = np.maximum(way - radius * np.pi / 2, 0.0)
        return np.column_stack([np.minimum(way, 0.0) - radius * (1.0 - np.sin(turn)), radius * (1.0 - np.cos(turn)) + behind, 0.0 * way])

    def run(steps: float, noise_mm: float) -> Evaluation:
        times, rows, windows, now = [], [], [], 0.0
        for _ in range(3):
            way = np.arange(-105.0, 105.0, steps) + steps * rng.random()
            times.append(now + np.arange(len(way)) * steps / 240.0)
            rows.append(posed(places(way) + noise_mm * rng.normal(size=(len(way), 3)), np.zeros((len(way), 3))))
            windows.append((float(times[-1][0]), float(times[-1][-1])))
            now = windows[-1][1] + 1.0
        path = {"name": "angle", "kind": "points", "points_mm": [(-100.0, 0, 0), (0.0, 0, 0), (0.0, 100.0, 0)], "windows_s": windows}
        program = Program.model_validate({"schema": "lmeasure.program/1", "path": [path]})
        time_s = np.concatenate(times)
        exact = trajectory_of(time_s, np.concatenate(rows))
        random = np.tile(np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]) * noise_mm**2, (len(time_s), 1, 1))
        settings = CertificationSettings(trials=TRIALS, seed=seed, limit_angle_deg=None, planes=30)
        return evaluate(replace(exact, random=random, absent=()), program, None if noise_mm else NoErrors(), settings=settings)

    found, truth = run(step, KNOWN_MM), run(0.01, 0.0)
    return [
        {"figure": c.name, "where": c.where, "reading": "path", "error": c.value - t.value, "u95": c.u95}
        for c, t in zip(found.characteristics, truth.characteristics, strict=True)
        if c.name in ("CR", "AT_p")
    ]


def lines_of(seed: int, case: str) -> list[dict[str, object]]:
    """The lines of a campaign."""
    if case in SHAKEN or case in ARCS:
        own = shaken(*SHAKEN[case], seed) if case in SHAKEN else arc(*ARCS[case], seed)
        return [{"case": case, "seed": seed} | line for line in own]
    found, truths = corners(CORNERS[case], seed) if case in CORNERS else dwells(CASES[case], seed)
    out: list[dict[str, object]] = []
    for reading, truth in truths.items():
        for c, t in zip(found.characteristics, truth.characteristics, strict=True):
            if (c.name, c.where) != (t.name, t.where):
                raise SystemExit(f"{case}, campaign {seed}: {c.name} of {c.where} is held against {t.name} of {t.where}")
            line = {"case": case, "seed": seed, "figure": c.name, "where": c.where, "reading": reading}
            out.append(line | {"error": c.value - t.value, "u95": c.u95})
    return out


SHOWN: dict[str, dict[str, tuple[str, ...]]] = {
    "rest": {"AP_p": ("AP_p",), "AP_x, y, z": ("AP_x", "AP_y", "AP_z"), "RP_l": ("RP_l",)},
    "mean": {"AP_p": ("AP_p",), "AP_x, y, z": ("AP_x", "AP_y", "AP_z"), "RP_l": ("RP_l",)},
    "path": {"CO": ("CO",), "CR": ("CR",), "AT_p": ("AT_p",)},
    "sample": {"velocity, mm/s": ("velocity",), "acceleration, mm/s²": ("acceleration",)},
}


def table(found: list[list[dict[str, object]]]) -> str:
    """The table of results."""
    data, rows = pd.DataFrame(list(itertools.chain(*found))), []
    for case in EVERY_CASE:
        for reading, figures in SHOWN.items():
            for name, members in figures.items():
                own = chosen(data, case, reading, members)
                if len(own):
                    ratio, u95 = (own["error"].abs() / own["u95"]).median(), own["u95"].median()
                    rows.append([case, reading, name, len(own), f"{own['inside'].mean():.1%}", f"{u95:.5f}", f"{ratio:.2f}"])
    return as_table(["case", "truth", "figure", "figures", "inside U95", "median U95, mm", "median error / U95"], rows)


def chosen(data: pd.DataFrame, case: str, reading: str, members: tuple[str, ...]) -> pd.DataFrame:
    """Figures of a case by one truth, with whether they lie inside U95."""
    own = data[(data["case"] == case) & (data["reading"] == reading) & data["figure"].isin(members)]
    return own.assign(inside=own["error"].abs() <= own["u95"] + 1e-12)


STUDY = Study("vibration_coverage", lines_of, table, "campaigns", 200, {"case": tuple(EVERY_CASE)}, "{case} {seed}")

if __name__ == "__main__":
    sys.exit(STUDY.command(__doc__))
