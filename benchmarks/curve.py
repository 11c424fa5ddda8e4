"""Study: trajectories in continuous time of a simulated robot, against the truth: poses, velocities, accelerations, clocks.

    python benchmarks/curve.py [--motions 25] [--cases six-free ...] [--keep curve.jsonl] [--write]

A robot moves for 4 s, by moves of limited jerk with rests between (1 m/s, 10 m/s^2) or by sums of sines, half and half. Counts are whole.
The simulator (tests/helpers/moving_robot.py) shares no formula with the solver. Of each motion: errors at 20 random instants against their
standard uncertainties, by the curve, by the poses sample by sample, and by SciPy's smoothing splines on these poses.
"""

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_smoothing_spline
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from cornering import cornering
from dithering import Dithering
from moving_robot import TRUTH, FreeRunning, Instrument, Motion, Moves, Shaken, Waves, errors, logged
from study import Study, table
from zeroed import zeroed_exactly

from lmeasure.core import LMeasureError
from lmeasure.iso9283 import CertificationSettings, evaluate
from lmeasure.recording import Counts, Program, Run, read_run
from lmeasure.trajectory import CurveStream, ErrorsOfCurve, JointLog, motion_of, motion_of_curve, reconstruct, reconstruct_curve

FloatArray = NDArray[np.float64]
LASTS_S, INSTANTS, EDGE_S = 4.0, 20, 0.1
DITHERED = 24
COMPARED = 6
"""Motions that are compared with poses sample by sample and with smoothing splines."""
WIDE = 1.959963984540054
CASES: dict[str, tuple[str, float, str]] = {
    "six-sync-1000-Hz": ("cell-run", 1000.0, "latched"),
    "six-sync-100-Hz": ("cell-run", 100.0, "latched"),
    "six-free-true-times": ("cell-run", 100.0, "true"),
    "six-free": ("cell-run", 100.0, "off"),
    "eight-free": ("eight-run", 100.0, "off"),
    "six-and-six-swivels-free": ("swivel-run", 100.0, "off"),
}
LATE_S, SLOW = 5e-3, 50e-6
RATES_HZ = (80.0, 1000.0)
LAGS_S = (0.1, 0.2, 0.5, 1.0)
CHARACTERISTICS = ("AP_p", "RP_l", "AT_p", "RT_p", "AV", "RV", "FV", "CR", "CO", "t_s", "OV")
QUANTITIES = ("pose", "velocity", "acceleration")


def draw(seed: int, case: str) -> dict[str, Any]:
    """One motion and its curve."""
    name, rate_hz, timing = CASES[case]
    rng, instrument = np.random.default_rng([seed, list(CASES).index(case)]), Instrument(name)
    m = len(instrument.channels)
    motion = Waves(rng, LASTS_S) if seed % 2 else Moves(rng, LASTS_S)
    frames = FreeRunning(rng, m, LASTS_S, rate_hz, *((LATE_S, SLOW) if timing == "off" else (0.0, 0.0)))
    latched = timing == "latched"
    true_s = np.tile(frames.time_s[:, None], (1, m)) if latched else frames.true_s
    phases = rng.uniform(-0.5, 0.5, m) if timing == "off" else 0.0
    recorded = instrument.recorded(motion, true_s, phases)
    run = read_run(TRUTH / name)
    run = replace(run, rig=run.rig.model_copy(update={"unstated": "exact"}), unstated="exact", start=np.array([0.0] * 6 + [1.0]))
    u = np.full(len(recorded), LATE_S / np.sqrt(3.0)) if timing == "off" else None
    counts = Counts(frames.time_s, instrument.channels, recorded, u_time_s=u, stamp_s=None if latched else frames.stamp_s)
    run = replace(run if timing == "off" else zeroed_exactly(run), passes=(counts,))
    record: dict[str, Any] = {"seed": seed, "case": case, "moves": not seed % 2}
    began = time.process_time()
    try:
        curve = reconstruct_curve(run)[1]
    except LMeasureError as refused:
        return record | {"refused": str(refused)}
    record["seconds"] = time.process_time() - began
    at = np.sort(rng.uniform(EDGE_S, LASTS_S - EDGE_S, INSTANTS))
    true_at = frames.common(at) if timing == "off" else at
    there = curve.at(at, rates=2)
    for d, (quantity, error) in enumerate(zip(QUANTITIES, errors(motion, true_at, there), strict=False)):
        record[quantity] = float((np.abs(error) < WIDE * there.u[:, d]).mean())
        record[f"{quantity} rms"] = float(np.sqrt((error[:, 3:] ** 2).sum(axis=1).mean()))
    if timing == "off":
        late = frames.late_s - frames.late_s.mean()
        record |= {"clocks": float(np.abs(curve.clocks_s - late).max()), "u clocks": float(curve.u_clocks_s.max())}
    if seed >= COMPARED:
        return record
    samples = reconstruct(run)
    known = np.isfinite(samples.poses[:, 0])
    if known.sum() < len(known) / 2:
        return record  # where clocks are off, the channels contradict each other at every sample
    truth = motion.at(frames.common(frames.time_s[known]) if timing == "off" else frames.time_s[known])[0]
    record["samples rms"] = float(np.sqrt(((samples.poses[known, :3] - truth) ** 2).sum(axis=1).mean()))
    began = time.process_time()
    smooth = [make_smoothing_spline(frames.time_s[known], samples.poses[known, c]) for c in range(3)]
    record["scipy seconds"] = time.process_time() - began
    place, _, velocity, acceleration = motion.at(true_at)
    for d, (quantity, true) in enumerate(zip(QUANTITIES, (place, velocity[:, 3:], acceleration[:, 3:]), strict=True)):
        found = np.stack([one.derivative(d)(at) if d else one(at) for one in smooth], axis=1)
        record[f"scipy {quantity}"] = float(np.sqrt(((found - true) ** 2).sum(axis=1).mean()))
    return record


def shrinkage() -> list[list[str]]:
    """Rows of characteristics and rates of one run: U95 by single samples and by the curve."""
    settings = CertificationSettings(trials=1000)
    found: list[tuple[str, str, str, float, float]] = []
    for rate_hz in RATES_HZ:
        run, program, _ = cornering(rate_hz, 3, 0.3)
        (trajectory, curve), samples = reconstruct_curve(run), reconstruct(run)
        single = evaluate(samples, program, run=run, settings=settings).characteristics
        smooth = {c.key: c for c in evaluate(trajectory, program, ErrorsOfCurve(curve), run=run, settings=settings).characteristics}
        for c in single:
            if c.name in CHARACTERISTICS and c.key in smooth:
                found.append((f"{rate_hz:g}", c.name, c.unit, c.u95, smooth[c.key].u95))
        moving = motion_of(samples), motion_of_curve(trajectory, curve)
        for name, unit in (("u_velocity", "mm/s"), ("u_acceleration", "mm/s²"), ("u_jerk", "mm/s³")):
            one, other = (WIDE * float(np.nanmedian(np.linalg.norm(getattr(m, name)[:, 3:], axis=1))) for m in moving)
            found.append((f"{rate_hz:g}", f"median {name.removeprefix('u_')}", unit, one, other))
    return [[*words, f"{one:.3g}", f"{other:.3g}", f"{other / max(one, 1e-300):.2f}"] for *words, one, other in found]


def run_at(name: str, motion: Motion, rate_hz: float, phases: FloatArray | float = 0.0, *, lasts_s: float = LASTS_S) -> Run:
    """A run of a motion by channels that are latched together."""
    instrument, time_s = Instrument(name), np.arange(int(lasts_s * rate_hz)) / rate_hz
    recorded = instrument.recorded(motion, np.tile(time_s[:, None], (1, len(instrument.channels))), phases)
    run = read_run(TRUTH / name)
    run = replace(run, rig=run.rig.model_copy(update={"unstated": "exact"}), unstated="exact", start=np.array([0.0] * 6 + [1.0]))
    run = replace(run, passes=(Counts(time_s, instrument.channels, recorded),))
    return run if np.any(phases) else zeroed_exactly(run)


def lags() -> list[list[str]]:
    """Rows of poses that come while the run goes on, by lag, and of those of the whole run."""
    out, motions = [], (Moves(np.random.default_rng(1), LASTS_S), Waves(np.random.default_rng(2), LASTS_S))
    for name in ("cell-run", "eight-run"):
        phases = 0.0 if name == "cell-run" else np.random.default_rng(3).uniform(-0.5, 0.5, 8)
        runs = [(motion, run_at(name, motion, 1000.0, phases)) for motion in motions]
        for lag_s in (*LAGS_S, np.inf):
            found, seconds, samples = [], 0.0, 0
            for motion, run in runs:
                counts, began = run.passes[0], time.process_time()
                if np.isinf(lag_s):
                    every = [reconstruct_curve(run)[1].at(counts.time_s, rates=1)]
                else:
                    stream = CurveStream(run, lag_s=lag_s)
                    pushed = [stream.push(*sample) for sample in zip(counts.time_s.tolist(), counts.recorded, strict=True)]
                    every = [each for each in [*pushed, stream.finish()] if each is not None]
                seconds, samples = seconds + time.process_time() - began, samples + len(counts.time_s)
                found += [(errors(motion, each.time_s, each)[0], each.u[:, 0]) for each in every]
            error, u = (np.concatenate(each) for each in zip(*found, strict=True))
            sizes = [
                f"{1e3 * np.sqrt(np.nanmean((of[:, at] ** 2).sum(axis=1))):.2f}" for of, at in ((error, slice(3, 6)), (u, slice(3, 6)))
            ]
            covered, missing = 100.0 * (np.abs(error) < WIDE * u)[np.isfinite(u)].mean(), 100.0 * np.isnan(error[:, 3]).mean()
            shares = [f"{covered:.1f} %", f"{missing:.1f} %", f"{1e6 * seconds / samples:.0f}"]
            out.append([name, "whole run" if np.isinf(lag_s) else f"{lag_s:g}", *sizes, *shares])
    return out


def logs() -> list[list[str]]:
    """Rows of motions with defects that a joint log does not show, by the log that is a prior."""
    out, at = [], np.linspace(EDGE_S, LASTS_S - EDGE_S, 1000)
    defects: list[tuple[str, Callable[[FloatArray], FloatArray]]] = [
        ("none", lambda t: 0.0 * t),
        ("bump of 0.05 mm in 20 ms", lambda t: np.asarray(0.05 * np.exp(-0.5 * ((t - 2.0) / 0.02) ** 2))),
        ("sag of 0.5 mm, 0.02 mm at 17 Hz", lambda t: np.asarray(0.5 * np.sin(1.4 * np.pi * t) + 0.02 * np.sin(34.0 * np.pi * t))),
    ]
    for name, shown in (("waves", Waves(np.random.default_rng(3), LASTS_S)), ("moves", Moves(np.random.default_rng(3), LASTS_S))):
        for defect, by in defects:
            motion = Shaken(shown, by)
            run = run_at("cell-run", motion, 1000.0)
            for log, noise_mm in (("no log", None), ("log", 0.0), ("log with 0.02 mm noise", 0.02)):
                joints = None if noise_mm is None else JointLog(*logged(shown, LASTS_S, 0.0137, noise_mm))
                trajectory, curve = reconstruct_curve(run, joints=joints)
                used = "" if joints is None else "yes" if trajectory.notes[-1].code == "curve.log_used" else "no"
                there = curve.at(at, rates=2)
                every = errors(motion, at, there)
                covered = [f"{100.0 * (np.abs(e) < WIDE * there.u[:, d]).mean():.1f} %" for d, e in enumerate(every)]
                rms, largest = (1e3 * of for of in (np.sqrt((every[0][:, 3:] ** 2).sum(axis=1).mean()), np.abs(every[0][:, 3:]).max()))
                out.append([name, defect, log, used, f"{rms:.2f}", f"{largest:.1f}", *covered])
    return out


def dithers() -> list[list[str]]:
    """Rows of rests and swings of a robot that repeats by 4 um per axis: errors and U95 of its AP and RP, and how many U95 covers."""
    out = []
    for size_mm, stated in ((0.0, False), (0.05, False), (0.03, True), (0.05, True), (0.1, True)):
        found: dict[str, list[tuple[float, float]]] = {"AP_p": [], "RP_l": []}
        for seed in range(DITHERED):
            motion = Dithering(seed, 10, 2, size_mm, 0.004)
            pose: dict[str, Any] = {"name": "P", "position_mm": motion.commanded.tolist(), "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0]}
            pose |= {"windows_s": motion.windows()} | ({"dither_mm": [size_mm] * 3, "dither_s": 1.0} if stated else {})
            run = run_at("cell-run", motion, 100.0, lasts_s=motion.lasts_s)
            program = Program.model_validate({"schema": "lmeasure.program/1", "pose": [pose]})
            every = evaluate(reconstruct(run), program, run=run, settings=CertificationSettings(trials=300)).characteristics
            away = np.linalg.norm(motion.rests - motion.rests.mean(axis=0), axis=1)
            true = np.linalg.norm(motion.rests.mean(axis=0) - motion.commanded), away.mean() + 3.0 * away.std(ddof=1)
            for name, value in zip(found, true, strict=True):
                (own,) = (c for c in every if c.name == name)
                found[name].append((float(own.value - value), own.u95))
        row = [f"{size_mm:g}", "yes" if stated else "no"]
        for errors_of in found.values():
            off, u95 = np.array(errors_of).T
            row += [f"{1e3 * np.sqrt((off**2).mean()):.2f}", f"{1e3 * u95.mean():.2f}", f"{int((np.abs(off) < u95).sum())}"]
        out.append(row)
    return out


def bounds() -> list[list[str]]:
    """Rows of runs of the truth: control poses, errors of the curve, and the least that an estimate of so many control poses can have."""
    out = []
    for name in ("cell-run", "eight-run", "swivel-run"):
        truth = np.loadtxt(TRUTH / name / "truth.csv.gz", delimiter=",", skiprows=1)
        run = read_run(TRUTH / name)
        run = replace(run, rig=run.rig.model_copy(update={"unstated": "exact"}), unstated="exact")
        alone = name == "cell-run"
        trajectory, _ = reconstruct_curve(zeroed_exactly(run) if alone else run)
        reached = np.sqrt(((trajectory.poses[:, :3] - truth[:, 1:4]) ** 2).sum(axis=1).mean())
        basis, J = sensitivities(name, truth)
        phases = (
            np.zeros((len(J), 0))
            if alone
            else np.tile(np.eye(J.shape[0] // len(truth))[:, : len(Instrument(name).cables)], (len(truth), 1))
        )
        least = [normal_bound(basis, np.hstack([J, phases])), interval_bound(basis, J) if alone else np.nan]
        out.append([name, str(basis.shape[1]), *("" if np.isnan(rms) else f"{1e3 * rms:.2f}" for rms in (reached, *least))])
    return out


ADEQUATE_MM, LEVER_MM = 1e-4, 300.0
FEW, SIDE = 9, 4


def sensitivities(name: str, truth: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Basis (n, K) of quintic splines of the widest knots that miss true poses (n, 8) by less than 0.1 um, and the changes (n m, 6 K) of
    counts by displacements (turn; shift) of their control poses, by difference quotients of the simulator."""
    time_s, place, turn = truth[:, 0], truth[:, 1:4], Rotation.from_quat(truth[:, 4:])
    path, off, spacing_s = np.column_stack([place, LEVER_MM * turn.as_rotvec()]), np.inf, 0.5
    while off > ADEQUATE_MM:
        spacing_s /= 2.0**0.25
        knots = time_s[0] + spacing_s * np.arange(-5, int(np.ceil(np.ptp(time_s) / spacing_s)) + 6)
        basis = BSpline.design_matrix(time_s, knots, 5, extrapolate=True).toarray()
        left = path - basis @ np.linalg.lstsq(basis, path, rcond=None)[0]
        off = float(np.sqrt((left**2).sum(axis=1).mean()))
    instrument, step = Instrument(name), 1e-4 * np.eye(6) / np.repeat([LEVER_MM, 1.0], 3)
    m, cables = len(instrument.channels), len(instrument.cables)
    G = np.empty((len(time_s), m, 6))
    for j in range(m):
        for a in range(6):
            one, other = (instrument.counts(j, place + s * step[a, 3:], Rotation.from_rotvec(s * step[a, :3]) * turn) for s in (1.0, -1.0))
            G[:, j, a] = (one - other) / (2.0 * step[a, a])
            if j >= cables:  # whole turns
                per_turn = instrument.swivels[j - cables][2]["counts_per_revolution"] / (2.0 * step[a, a])
                G[:, j, a] -= per_turn * np.rint(G[:, j, a] / per_turn)
    return basis, np.einsum("tk,tja->tjka", basis, G).reshape(len(time_s) * m, -1)


def normal_bound(basis: FloatArray, J: FloatArray) -> float:
    """Root mean square [mm] of positions by the inverse of the Fisher information of normal errors of 1/12 count^2. Beyond those of
    control poses, the columns of J are of sub-count offsets, of the same variance before the run."""
    own = 6 * basis.shape[1]
    information = 12.0 * J.T @ J
    information[range(own, J.shape[1]), range(own, J.shape[1])] += 12.0
    covariance = np.linalg.inv(information)[:own, :own].reshape(basis.shape[1], 6, -1, 6)
    return float(np.sqrt(sum(np.einsum("tk,kl,tl->t", basis, covariance[:, a, :, a], basis) for a in (3, 4, 5)).mean()))


def interval_bound(basis: FloatArray, J: FloatArray) -> float:
    """Root mean square [mm] of positions at some instants by the bound of Ziv and Zakai, for counts as intervals.

    Two motions that differ by h along a direction of control poses cannot be told apart with probability prod(1 - |J h|), where the places
    within a count are independent and uniform. Then an estimate errs by h / 2 at least. So its mean square error is at least the
    integral of h / 2 times that probability. Any direction gives a bound: that of the least |J h| about the instant is taken.
    """
    m, squares = len(J) // len(basis), []
    for i in np.linspace(0, len(basis) - 1, FEW).astype(int):
        acting = np.flatnonzero(basis[i])
        acting = np.arange(max(acting[0] - SIDE, 0), min(acting[-1] + SIDE + 1, basis.shape[1]))
        rows = np.flatnonzero(basis[:, acting].any(axis=1))
        A = J.reshape(len(basis), m, -1, 6)[rows][:, :, acting].reshape(len(rows) * m, -1)
        total = 0.0
        for a in (3, 4, 5):
            e, weight, best = np.zeros((len(acting), 6)), np.ones(len(A)), np.full(len(A), np.inf)
            e[:, a] = basis[i, acting]
            for _ in range(8):  # least sum of sizes, by weights
                h = np.linalg.solve(A.T @ (weight[:, None] * A), e.ravel())
                moved = np.abs(A @ h) / (e.ravel() @ h)
                best = moved if moved.sum() < best.sum() else best
                weight = 1.0 / np.maximum(moved, 1e-3 * moved.mean())
            h = np.linspace(0.0, min(1.0 / best.max(), 40.0 / best.sum()), 1001)
            alike = np.exp(np.log1p(-np.minimum(h[:, None] * best, 1.0 - 1e-12)).sum(axis=1))
            total += float(np.trapezoid(0.5 * h * alike, h))
        squares.append(total)
    return float(np.sqrt(np.mean(squares)))


def peers() -> list[list[str]]:
    """Rows of one motion by the curve, by SciPy's smoothing splines on poses, and by a dense least squares, with processor seconds."""
    out = []
    for rate_hz, lasts_s in ((100.0, 2.0), (1000.0, 4.0), (1000.0, 180.0)):
        instrument, motion = Instrument("cell-run"), Waves(np.random.default_rng(7), lasts_s)
        time_s = np.arange(int(lasts_s * rate_hz)) / rate_hz
        recorded = instrument.recorded(motion, np.tile(time_s[:, None], (1, len(instrument.channels))))
        run = read_run(TRUTH / "cell-run")
        run = replace(run, rig=run.rig.model_copy(update={"unstated": "exact"}), unstated="exact", start=np.array([0.0] * 6 + [1.0]))
        run = zeroed_exactly(replace(run, passes=(Counts(time_s, instrument.channels, recorded),)))
        truth, samples = motion.at(time_s)[0], reconstruct(run)
        ways: list[tuple[str, int, Callable[[], FloatArray]]] = [
            ("the curve, with covariances", 3, partial(continuous, run)),
            ("SciPy, smoothing splines on poses", 1, partial(smoothed, time_s, samples.poses[:, :3])),
        ]
        if lasts_s < LASTS_S:
            ways.append(("SciPy, dense least squares", 1, partial(dense, instrument, time_s, recorded, samples.poses)))
        for name, times, way in ways:
            seconds = []
            for _ in range(times):
                began = time.process_time()
                places = way()
                seconds.append(time.process_time() - began)
            rms, best = 1e3 * float(np.sqrt(((places - truth) ** 2).sum(axis=1).mean())), min(seconds)
            out.append([f"{len(time_s)} at {rate_hz:g} Hz", name, f"{rms:.3g}", f"{best:.3g}", f"{len(time_s) / best:,.0f}"])
    return out


def continuous(run: Run) -> FloatArray:
    """Places (n, 3) by the curve, whose covariances are worked out too."""
    trajectory, _ = reconstruct_curve(run)
    return trajectory.poses[:, :3]


def smoothed(time_s: FloatArray, places: FloatArray) -> FloatArray:
    """Places (n, 3) by a smoothing spline for each coordinate."""
    return np.stack([make_smoothing_spline(time_s, places[:, c])(time_s) for c in range(3)], axis=1)


def dense(instrument: Instrument, time_s: FloatArray, recorded: FloatArray, poses: FloatArray, spacing_s: float = 0.05) -> FloatArray:
    """Places (n, 3) of splines of place and rotation vector, fitted to all counts as a user of SciPy would do it."""
    inner = np.linspace(time_s[0], time_s[-1], max(int(np.ptp(time_s) / spacing_s), 2) + 1)
    knots = np.concatenate([np.repeat(inner[0], 5), inner, np.repeat(inner[-1], 5)])
    basis = BSpline.design_matrix(time_s, knots, 5).toarray()
    first = np.column_stack([poses[:, :3], Rotation.from_quat(poses[:, 3:]).as_rotvec()])

    def residuals(control: FloatArray) -> FloatArray:
        at = basis @ control.reshape(-1, 6)
        turn = Rotation.from_rotvec(at[:, 3:])
        return np.concatenate([instrument.counts(j, at[:, :3], turn) - recorded[:, j] for j in range(recorded.shape[1])])

    control = least_squares(residuals, np.linalg.lstsq(basis, first, rcond=None)[0].ravel(), x_scale="jac").x
    return np.asarray((basis @ control.reshape(-1, 6))[:, :3])


def page(records: list[dict[str, Any]]) -> tuple[str, bool]:
    """The results."""
    covered, sizes, good = [], [], True
    for case in CASES:
        own = [r for r in records if r["case"] == case]
        sound = [r for r in own if "refused" not in r]
        if not sound:
            continue

        def rms(key: str, of: list[dict[str, Any]] = sound) -> float:
            return float(np.sqrt(np.mean([r[key] ** 2 for r in of if key in r] or [np.nan])))

        shares = [float(np.mean([r[q] for r in sound])) for q in QUANTITIES]
        clocks = f"{1e6 * rms('clocks'):.0f} (u {1e6 * rms('u clocks'):.0f})" if "clocks" in sound[0] else ""
        covered.append([case, len(sound), len(own) - len(sound), *(f"{100.0 * s:.1f} %" for s in shares), clocks])
        sizes.append(
            [case, 1e3 * rms("pose rms"), 1e3 * rms("samples rms"), 1e3 * rms("scipy pose"), rms("velocity rms"), rms("scipy velocity")]
            + [rms("acceleration rms"), rms("scipy acceleration")]
        )
        sizes[-1] = [sizes[-1][0], *(f"{value:.3g}" for value in sizes[-1][1:])]
        good &= len(sound) == len(own) and min(shares) > 0.93
    head = ["channels", "curve [um]", "samples [um]", "SciPy [um]", "curve [mm/s]", "SciPy [mm/s]", "curve [mm/s2]", "SciPy [mm/s2]"]
    lines = [
        "# Trajectories in continuous time",
        "",
        "Written by `python benchmarks/curve.py --write`. A simulated robot moves for 4 s at up to 1 m/s and 10 m/s². Half of the motions",
        "are moves of limited jerk with rests between, half are sums of sines. Counts are 0.012 mm, and swivels have 17 bits. Free",
        "channels send at 100 Hz by their own timers. Their clocks are off by up to 5 ms and 50 ppm, except with true times.",
        "",
        "## Coverage",
        "",
        f"Share of errors within the 95 % interval, at {INSTANTS} random instants of each motion.",
        "",
        table(["channels", "motions", "refused", *QUANTITIES, "largest error of a clock, rms [us]"], covered),
        "",
        "## Errors",
        "",
        'Root mean square of the position and its rates. "Samples" are the poses of `reconstruct` without `--continuous`, "SciPy" are',
        "`make_smoothing_spline` on these poses.",
        "",
        table(head, sizes),
        "",
        "## Bounds",
        "",
        "Error of the curve in three runs of the truth, and the least error that an estimate of so many control poses has on average.",
        "The knots are the widest ones whose spline misses the true motion by less than 0.1 um. The Cramér-Rao bound takes roundings as",
        "independent normal errors of 1/12 count². Counts are intervals, and a uniform error has no Fisher information, so an estimate",
        "may fall below it. The bound of Ziv and Zakai is for intervals, with independent uniform positions within a count. Neither uses",
        "that the motion is smooth beyond these knots. Where sub-count offsets are unknown, a run has one draw of them, and the bound",
        "is the mean of all draws.",
        "",
        table(["run", "control poses", "curve, rms [um]", "Cramér-Rao [um]", "Ziv-Zakai [um]"], bounds()),
        "",
        "## Uncertainties of characteristics",
        "",
        "U95 by single samples and by the curve, of a run along a corner that is passed at 240 mm/s and 2 mm, from rest to rest. Counts",
        "are the only source of error. At 80 samples/s the path may hide a bend between samples, which dominates U95.",
        "",
        table(["samples/s", "result", "unit", "samples", "curve", "ratio"], shrinkage()),
        "",
        "## Dither",
        "",
        f"Errors and mean U95 [um] of AP_p and RP_l of a pose in {DITHERED} runs of ten cycles, and in how many of them U95 covers the",
        "error. The robot repeats by 4 um per axis. It rests, or swings for two seconds by a size [mm] along each axis; the program states",
        "it or not. Samples come at 100 Hz, and rounding is the only source of error.",
        "",
        table(["swing [mm]", "stated", "AP_p", "U95", "covered", "RP_l", "U95", "covered"], dithers()),
        "",
        "## While the run goes on",
        "",
        "Two motions at 1000 Hz: errors and standard uncertainties of positions by lag, coverage of poses, samples without a pose, and",
        "processor time per sample on one core.",
        "",
        table(["channels", "lag [s]", "error, rms [um]", "u, rms [um]", "coverage", "without pose", "time per sample [us]"], lags()),
        "",
        "## Joint log",
        "",
        "Six drums with SYNC at 1000 Hz. The log shows the motion at 250 Hz without the defect, by a clock that is 13.7 ms late.",
        "",
        table(["motion", "defect", "by", "used", "rms [um]", "largest [um]", *QUANTITIES], logs()),
        "",
        "## Speed",
        "",
        "One motion of sums of sines, by six drums with SYNC. Processor seconds on one core, best of three; SciPy's once, the dense one",
        "of quintic splines with a knot each 0.05 s (the best of four) and numerical derivatives. Times of SciPy do not include the poses.",
        "",
        table(["samples", "by", "error, rms [um]", "seconds", "samples a second"], peers()),
    ]
    text = "\n".join(lines)
    return text, good


STUDY = Study("curve", draw, page, runs="motions", count=25, factors={"cases": tuple(CASES)}, key="{cases} {seed}")

if __name__ == "__main__":
    sys.exit(STUDY.command(__doc__))
