"""A small certified campaign on the simulated cell, for tests of everything behind the figures."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import tomli_w
from scipy.spatial.transform import Rotation

from lmeasure.recording import read_run, write_run
from lmeasure.rig import Rig
from lmeasure.simulation import Leg, cell_rig, simulate_run, smooth_path
from lmeasure.trajectory import reconstruct, write_trajectory

HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
POSES = {"P1": (0.0, 0.0, 0.0), "P2": (120.0, 90.0, -80.0), "P3": (-110.0, 80.0, 70.0)}
CYCLES, RATE_HZ, DWELL_S, SPEED_MM_S = 5, 100.0, 0.5, 400.0


def write_campaign(
    folder: Path,
    names: dict[str, str] | None = None,
    *,
    seed: int = 0,
    offset_mm: float = 0.3,
    rig: Rig | None = None,
    cycles: int = CYCLES,
) -> None:
    """run/, trajectory.parquet and program.toml: three poses in cycles, and a line from P2 to P3 in each.

    names: to be written instead of P1, P2, P3 and line. The robot misses every pose by offset_mm along X and scatters by 0.1 mm. rig: whose
    absolute encoders tell where the run began, which nobody states then.
    """
    rng = np.random.default_rng(seed)
    shown = {name: name for name in (*POSES, "line")} | (names or {})
    legs, dwells = [], []
    for _ in range(cycles):
        for name, place in POSES.items():
            turn = Rotation.from_rotvec(rng.normal(0.0, 2e-4, 3)).as_quat()
            at = np.array(place) + [offset_mm, 0.0, 0.0] + rng.normal(0.0, 0.1, 3)
            legs.append(Leg(np.concatenate([at, turn]), SPEED_MM_S, 1.0, DWELL_S))
            dwells.append(name)
    time_s, poses = smooth_path(HOME, legs, RATE_HZ)
    windows: dict[str, list[list[float]]] = {name: [] for name in POSES}
    still = np.concatenate([[False], np.abs(np.diff(poses, axis=0)).max(axis=1) < 1e-12, [False]])
    edges = np.flatnonzero(np.diff(still.astype(int)))
    rests = [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=False) if (b - a) > 0.6 * DWELL_S * RATE_HZ]
    assert len(rests) == len(legs)
    for name, (a, b) in zip(dwells, rests, strict=True):
        windows[name].append([float(time_s[a]) + 0.05, float(time_s[b - 1]) - 0.05])
    lines = [[float(time_s[rests[i][1] - 1]), float(time_s[rests[i + 1][0]])] for i, name in enumerate(dwells) if name == "P2"]
    program = {
        "schema": "lmeasure.program/1",
        "pose": [
            {"name": shown[name], "position_mm": list(place), "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0], "windows_s": windows[name]}
            for name, place in POSES.items()
        ],
        "path": [
            {"name": shown["line"], "kind": "linear", "start_mm": list(POSES["P2"]), "end_mm": list(POSES["P3"]), "speed_mm_s": SPEED_MM_S,
             "windows_s": lines}
        ],
    }  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "program.toml").write_text(tomli_w.dumps(program), encoding="utf-8")
    run = simulate_run(rig or cell_rig(seed), time_s, poses, noise_mm=0.0, rng=rng).run
    write_run(folder / "run", run if rig is None else replace(run, start=None))
    write_trajectory(folder / "trajectory.parquet", reconstruct(read_run(folder / "run")))
