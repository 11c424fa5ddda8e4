"""Rigs for the accuracy tests: the published one, and random ones with pulleys."""

from typing import Any

import numpy as np

from lmeasure.rig import Rig, rig_from_dict

# thesis Rashoyan 2021, 5.5: refined base points and attachment points; 5.7 takes straight cables and +-0.0125 mm per reading
PUBLISHED_POINTS = {"B1": (159.05, -1642.2, 1381.81), "B2": (2.05445, -1119.8, 1390.15), "B3": (-90.52, -1526.8, 1358.21)}
PUBLISHED_TOOL = {"P1": (14.58, -14.58, 5.75), "P2": (14.58, 14.58, 5.65), "P3": (-14.58, 14.58, 5.65)}
PUBLISHED_CABLES = (("B1", "P1"), ("B1", "P2"), ("B2", "P2"), ("B2", "P3"), ("B3", "P3"), ("B3", "P1"))


def point(name: str, position: Any, radius: float = 0.0, alpha: float = 45.0, beta: float = 180.0, **drum: Any) -> dict[str, Any]:
    values = {
        "counts_per_revolution": 6000, "count_length_mm": 0.0125, "groove_pitch_mm": 1.0, "tangent_length_mm": 180.0,
        "axial_offset_mm": 25.0,
    }  # fmt: skip
    return {
        "name": name, "position_mm": [float(v) for v in position], "guide_alpha_deg": alpha, "guide_beta_deg": beta,
        "pulley_radius_mm": radius, "drum": values | drum,
    }  # fmt: skip


def rig(points: list[dict[str, Any]], tool: Any, pairs: Any, name: str = "test") -> Rig:
    return rig_from_dict(
        {
            "schema": "lmeasure.rig/1",
            "unstated": "exact",
            "name": name,
            "observation_point": points,
            "tool": {key: [float(v) for v in value] for key, value in tool.items()},
            "cable": [{"name": f"c{i}", "channel": f"ch{i}", "from": a, "to": b} for i, (a, b) in enumerate(pairs, 1)],
        }
    )


def published() -> Rig:
    return rig([point(name, at) for name, at in PUBLISHED_POINTS.items()], PUBLISHED_TOOL, PUBLISHED_CABLES, "published")


def cell(seed: int = 0, cables: int = 6) -> Rig:
    """Six pulleys around a cell, two cables to each of three attachment points 150 mm from the tool's axis; up to three more cables, whose
    counts are coarser."""
    random = np.random.default_rng(seed)
    directions = np.array([[1, 0, 0.6], [-0.5, 0.87, 0.6], [-0.5, -0.87, 0.6], [-1, 0, -0.5], [0.5, -0.87, -0.5], [0.5, 0.87, -0.5]])
    points = [
        point(
            f"B{i + 1}", 1300 * d + random.uniform(-150, 150, 3), radius=float(random.uniform(12, 30)),
            alpha=float(random.uniform(20, 70)), beta=float(np.degrees(np.arctan2(d[0], d[1])) + random.uniform(-20, 20)),
        )
        for i, d in enumerate(directions)
    ]  # fmt: skip
    turn = np.radians([90, 210, 330])
    tool = {f"P{i + 1}": (150 * np.cos(a), 150 * np.sin(a), 10.0 * i) for i, a in enumerate(turn)}
    more = [(-200.0, -300.0, 1400.0), (1100.0, -900.0, -500.0), (-900.0, 1100.0, 300.0)][: cables - 6]
    points += [
        point(f"B{7 + i}", at, radius=20.0, alpha=30.0, beta=70.0 * i, count_length_mm=0.0125 * (2 + i)) for i, at in enumerate(more)
    ]
    pairs = [(f"B{i + 1}", f"P{i // 2 + 1}") for i in range(6)] + [(f"B{7 + i}", f"P{i + 1}") for i in range(len(more))]
    return rig(points, tool, pairs, "cell")
