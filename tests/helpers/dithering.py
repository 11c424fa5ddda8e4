"""A robot that visits one pose again and again, and swings about it or rests. Nothing here imports lmeasure."""

import numpy as np
from moving_robot import FloatArray, Instants
from scipy.spatial.transform import Rotation


class Dithering:
    """Cycles from a place 30 mm away to a pose with a repeatability, where the tool rests for 0.5 s and swings for some periods of 1 s.

    The robot takes `pace` times as long for its swings, and its servos average over smooth_s.
    """

    AWAY_MM, MOVE_S, SETTLE_S = np.array([20.0, -15.0, 15.0]), 0.6, 0.5

    def __init__(self, seed: int, cycles: int, swings: int, size_mm: float, repeatability_mm: float, *, pace: float = 1.1) -> None:
        rng = np.random.default_rng(seed)
        self.commanded = np.array([40.0, -30.0, 20.0]) + rng.uniform(-1.0, 1.0, 3)
        self.rests = self.commanded + repeatability_mm * rng.standard_normal((cycles, 3)) + rng.uniform(-0.02, 0.02, 3)
        self.size_mm, self.pace, self.smooth_s = size_mm, pace, 0.06
        self.stays_s = self.SETTLE_S + swings * pace + 0.2
        self.period_s = 2.0 * self.MOVE_S + self.stays_s + 0.3
        self.lasts_s = cycles * self.period_s
        self.swings_s = swings * pace

    def windows(self) -> list[tuple[float, float]]:
        """Times of the swings without their ends."""
        begin = self.MOVE_S + self.SETTLE_S
        return [(begin + j * self.period_s + 0.15, begin + self.swings_s + j * self.period_s - 0.1) for j in range(len(self.rests))]

    def _swing(self, t: FloatArray) -> FloatArray:
        inside = np.clip(t, 0.0, self.swings_s)[:, None] / self.pace
        return np.asarray(self.size_mm * 2.0 / np.pi * np.arcsin(np.sin(2.0 * np.pi * inside * np.arange(1.0, 4.0))))

    def at(self, time_s: FloatArray) -> Instants:
        """Return places and turns; no rates."""
        cycle = np.clip((time_s // self.period_s).astype(int), 0, len(self.rests) - 1)
        t = time_s - cycle * self.period_s
        part = np.clip(t / self.MOVE_S, 0.0, 1.0) - np.clip((t - self.MOVE_S - self.stays_s) / self.MOVE_S, 0.0, 1.0)
        there = part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
        rest, away = self.rests[cycle], self.commanded + self.AWAY_MM
        smooth = np.mean([self._swing(t - self.MOVE_S - self.SETTLE_S + s) for s in np.linspace(-0.5, 0.5, 21) * self.smooth_s], axis=0)
        place = away + there[:, None] * (rest - away) + (part >= 1.0)[:, None] * smooth
        return place, Rotation.identity(len(time_s)), np.zeros((len(time_s), 6)), np.zeros((len(time_s), 6))
