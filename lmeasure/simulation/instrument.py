"""The instrument as a forward model: poses in, recorded counts out. It shares no inverse with the solvers."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lmeasure.core import FloatArray, se3
from lmeasure.recording import Counts, Poses, Run, poses_from_rows
from lmeasure.rig import Rig
from lmeasure.sensors import drawn_phases, recorded_from_counts
from lmeasure.simulation.machine import as_drawn, true_counts, with_play
from lmeasure.simulation.motion import scattered_poses


@dataclass(frozen=True)
class SimulatedRun:
    """A run and the true poses (n, 7) of its samples."""

    run: Run
    poses: FloatArray


@dataclass(frozen=True)
class SimulatedCampaign:
    """A calibration campaign: the nominal rig a person would write down, the true one, the reference poses as measured and as they were,
    and the recorded counts (n, m) of the channels of pass 1, zeroed at the first pose."""

    nominal: Rig
    true: Rig
    measured: Poses
    poses: FloatArray
    channels: tuple[str, ...]
    recorded: FloatArray
    temperature_c: FloatArray | None = None
    """(n,) at the poses, None where it is not recorded."""


def simulate_run(
    rig: Rig,
    time_s: FloatArray,
    poses: FloatArray,
    *,
    noise_mm: float,
    rng: np.random.Generator,
    temperature_c: FloatArray | None = None,
    noise_deg: float = 0.0,
) -> SimulatedRun:
    """Simulate every pass of the rig along the same motion, zeroed at its first pose, anywhere within a count unless the drum's zero is
    exact.

    noise_mm, noise_deg: standard deviation of each length and angle at each sample, independent. temperature_c (n,), the first at the zero
    pose, has the effects that the rig states. Run and rig state that all missing statements mean exact values. GeometryError when a cable
    cannot run at a pose.
    """
    rig = rig.model_copy(update={"unstated": "exact"})
    warm = None if temperature_c is None else float(temperature_c[0])
    start = poses[0]
    # of its own stream: what else is drawn does not depend on it
    of_phases, plays = rng.spawn(2)
    phase, passes = drawn_phases(rig, of_phases, rig.observed), []
    for number in range(1, rig.passes + 1):
        cables = tuple(c for c in rig.observed if c.passage == number)
        true = true_counts(rig, poses, start, cables, temperature_c=temperature_c, zero_temperature_c=warm)
        true = with_play(rig, true, cables, plays)
        counters = [rig.counter(c) for c in cables]
        noise = [np.hypot(noise_mm if c.is_length else math.radians(noise_deg), c.u_reading) / c.per_count for c in counters]
        scatter = np.array(noise)
        noisy = true + rng.normal(0.0, 1.0, true.shape) * scatter if scatter.any() else true
        recorded = recorded_from_counts(rig, noisy, cables, phase[[c.passage == number for c in rig.observed]])
        names = tuple(c.channel for c in cables)
        passes.append(Counts(time_s, names, recorded, source=f"simulated pass {number}", temperature_c=temperature_c))
    return SimulatedRun(Run(rig, start, tuple(passes), temperature_c=warm, unstated="exact"), poses)


def simulate_campaign(
    rig: Rig,
    count: int,
    rng: np.random.Generator,
    *,
    centre: FloatArray,
    half_mm: tuple[float, float, float],
    tilt_rad: float,
    **errors: Any,
) -> SimulatedCampaign:
    """`campaign_at` scattered poses: so many, about a centre, within half_mm of it and tilts up to tilt_rad; errors: as there, by name."""
    return campaign_at(rig, scattered_poses(count, half_mm, tilt_rad, centre, rng=rng), rng, **errors)


def campaign_at(
    rig: Rig,
    poses: FloatArray,
    rng: np.random.Generator,
    *,
    u_position_mm: float = 0.0,
    u_rotation_rad: float = 0.0,
    nominal_shift_mm: float = 0.0,
    nominal_shift_deg: float = 0.0,
    temperature_c: FloatArray | None = None,
) -> SimulatedCampaign:
    """Simulate counts at reference poses (n, 7) whose measurement has the given standard uncertainties.

    The nominal rig's observation points are off by up to nominal_shift_mm per axis and its guide angles by up to nominal_shift_deg.
    temperature_c (n,) at the poses has the effects that the rig states. The counters are zeroed at the first pose, anywhere within a count
    unless the drum's zero is exact; other sensors have their stated errors. Imperfect parts are in the counts, and not in the nominal rig.
    Both rigs state that all missing statements mean exact values.
    """
    rig = rig.model_copy(update={"unstated": "exact"})
    count, cables = len(poses), tuple(c for c in rig.observed if c.passage == 1)
    warm = None if temperature_c is None else float(temperature_c[0])
    counts = true_counts(rig, poses, poses[0], cables, temperature_c=temperature_c, zero_temperature_c=warm)
    of_phases, plays = rng.spawn(2)
    counts = with_play(rig, counts, cables, plays)
    of_sensors = of_phases.spawn(1)[0]
    counters = [rig.counter(c) for c in cables]
    counts = counts + of_sensors.normal(size=counts.shape) * [c.u_reading / c.per_count for c in counters]
    recorded = recorded_from_counts(rig, counts, cables, drawn_phases(rig, of_phases, cables))
    shift, turn = u_position_mm * rng.normal(size=(count, 3)), u_rotation_rad * rng.normal(size=(count, 3))
    rows = se3.displaced(poses, np.column_stack([turn, shift]))
    measured = replace(poses_from_rows(rows), u_position_mm=np.full(count, u_position_mm), u_rotation_rad=np.full(count, u_rotation_rad))
    # what a person writes down are drums and pulleys as drawn
    nominal = as_drawn(rig).model_copy(
        update={
            "observation_point": tuple(
                p.model_copy(
                    update={
                        "position_mm": tuple(float(x) for x in p.position_mm + rng.uniform(-nominal_shift_mm, nominal_shift_mm, 3)),
                        "guide_alpha_deg": float(np.clip(p.guide_alpha_deg + rng.uniform(-nominal_shift_deg, nominal_shift_deg), -90, 90)),
                        "guide_beta_deg": p.guide_beta_deg + float(rng.uniform(-nominal_shift_deg, nominal_shift_deg)),
                    }
                )
                for p in as_drawn(rig).observation_point
            )
        }
    )
    nominal = nominal.with_sensors(lambda sensor: sensor.drawn(of_sensors))
    return SimulatedCampaign(nominal, rig, measured, poses, tuple(c.channel for c in cables), recorded, temperature_c)
