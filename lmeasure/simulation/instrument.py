"""The instrument as a forward model: poses in, recorded counts out. It shares no inverse with the solvers.

A rig with imperfect drums and pulleys, as a machine: taut strings over eccentric discs, gears with play. Nothing here is a formula of
the solvers (`sensors.imperfect_parts`, `kernels.cable`).

A cable comes from the fixed pulley G, goes tangentially on to the groove, around it, and tangentially to P. Tangents of a disc of radius R
about C from a point at the distance d and the angle gamma touch it at gamma -+ acos(R/d). The pulley swivels to the shortest cable. It
turns with the cable: cable that runs on to it along u moves with the groove there, ds = (R - x_n) dpsi for a groove whose centre is x off
the axle. A drum is a disc that turns about a point beside its middle. Play is a dog in a slot: the encoder rests until the slot's other end
takes it along.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lmeasure.core import FloatArray, se3
from lmeasure.recording import Counts, Poses, Run, poses_from_rows
from lmeasure.rig import Cable, Drum, ObservationPoint, Observed, Rig, cables_among
from lmeasure.sensors import counts_from_poses, drawn_phases, effects_of, recorded_from_counts
from lmeasure.simulation.motion import scattered_poses

GUIDE_MM = 500.0  # From the fixed pulley to B, unless the rig states it
ROUNDS = 60
TURN = 2.0 * np.pi


def untrue(rig: Rig) -> bool:
    """Return whether a rig states imperfect drums, pulleys or swivel axes."""
    point = ("pulley_eccentricity_mm", "swivel_offset_mm", "swivel_tilt_deg")
    drum = ("run_out_mm", "cable_oversize_mm")
    return any(getattr(p, key) for p in rig.observation_point for key in point) or any(
        getattr(p.drum, key) for p in rig.observation_point for key in drum
    )


def true_counts(
    rig: Rig,
    poses: FloatArray,
    zero: FloatArray,
    cables: tuple[Observed, ...],
    *,
    temperature_c: FloatArray | None = None,
    zero_temperature_c: float | None = None,
) -> FloatArray:
    """(n, m) `sensors.lengths.counts_from_poses`, of cables over parts that are not as drawn by the machine. GeometryError as there."""
    plain = as_drawn(rig, tilted=True) if untrue(rig) else rig
    drawn = counts_from_poses(plain, poses, zero, cables, temperature_c=temperature_c, zero_temperature_c=zero_temperature_c)
    if plain is rig:
        return drawn
    for j, c in enumerate(cables_among(cables)):
        change = machine_counts(rig, c, poses, zero)
        # heat, stretch and sag hardly change the effects of the parts
        drawn[:, j] = change if effects_of(plain) is None else drawn[:, j] + change - machine_counts(plain, c, poses, zero)
    return drawn


def as_drawn(rig: Rig, *, tilted: bool = False) -> Rig:
    """The rig with drums, pulleys and swivel axes as drawn, and its other effects; tilted: but for the axes' tilt."""
    keys = (*ObservationPoint.UNTRUE, "phase_length_mm", *(() if tilted else ("swivel_tilt_deg",)))
    points = []
    for p in rig.observation_point:
        drum = p.drum.model_copy(update=dict.fromkeys(p.drum.UNTRUE))
        points.append(p.model_copy(update={"drum": drum} | dict.fromkeys(keys)))
    return rig.model_copy(update={"observation_point": tuple(points)})


def machine_counts(rig: Rig, cable: Cable, poses: FloatArray, zero: FloatArray) -> FloatArray:
    """(n,) how far the drum of a cable has turned at (n, 7) poses since the pose (7,) where it was zeroed, in its counts."""
    every = np.vstack([zero[None], poses])
    points = se3.apply(every, np.array(rig.tool[cable.to_point]))
    machine = _Machine(rig, cable)
    since = 0.0 if machine.phase_mm is None else machine.drawn_length(points[:1])[0] - machine.phase_mm
    turned = np.zeros(len(every))
    for _ in range(ROUNDS):
        out = machine.paid(turned, since)
        strings = machine.strings(points, out - out[0] + since)
        step = (strings - strings[0] - (out - out[0])) / machine.per_rad
        # the drum is at angle 0 where counting began
        turned = turned + step
        if np.abs(step).max() < 1e-14:
            break
    return np.asarray(turned[1:] / TURN * machine.counts_per_turn)


class _Machine:
    """One cable, with angles [rad] of its drum and lengths [mm] of its string."""

    def __init__(self, rig: Rig, cable: Cable) -> None:
        p = rig.point(cable.from_point)
        drum, a, b = p.drum, *np.radians([p.guide_alpha_deg, p.guide_beta_deg])
        da, db = np.radians(p.swivel_tilt_deg or (0.0, 0.0))
        over = drum.cable_oversize_mm or 0.0
        self.base, self.counts_per_turn = np.array(p.position_mm), float(drum.counts_per_revolution)
        self.incoming, self.axis = _way(a, b), _way(a + da, b + db)
        self.radius, self.drawn_radius = p.pulley_radius_mm + (0.5 * over if p.pulley_radius_mm else 0.0), p.pulley_radius_mm
        self.eccentric, self.offset = p.pulley_eccentricity_mm or (0.0, 0.0), p.swivel_offset_mm or 0.0
        self.fixed = self.base - (drum.guide_length_mm or GUIDE_MM) * self.incoming
        self.phase_mm = p.phase_length_mm
        self.tangent, self.axial, self.pitch = drum.tangent_length_mm, drum.axial_offset_mm, drum.groove_pitch_mm
        middle = np.sqrt((drum.counts_per_revolution * drum.count_length_mm) ** 2 - self.pitch**2) / TURN
        self.disc = middle + 0.5 * over
        self.per_rad = np.hypot(self.disc, self.pitch / TURN)
        self.drawn_per_rad = np.hypot(middle, self.pitch / TURN)
        self.run_out = drum.run_out_mm or (0.0, 0.0)

    def paid(self, turned: FloatArray, since: float) -> FloatArray:
        """(n,) cable past the fixed pulley when the drum has turned by so much (n,) since it was zeroed, but for a constant."""
        # centre of the disc, turned clockwise with the drum; the fixed pulley is at the right, level with the top of the disc
        at_phase = 0.0
        for _ in range(ROUNDS if since else 0):
            slanted = np.hypot(self.tangent, self.axial + self.pitch * at_phase / TURN) - np.hypot(self.tangent, self.axial)
            at_phase = (slanted - since) / self.drawn_per_rad
        angle = turned - at_phase
        (a, b), c, s = self.run_out, np.cos(angle), np.sin(angle)
        x, y = a * c + b * s, b * c - a * s
        right, up = self.tangent - x, self.disc - y
        far = np.hypot(right, up)
        touch = np.arctan2(right, up) - np.arccos(self.disc / far)
        straight = np.sqrt(far**2 - self.disc**2)
        return np.asarray(self.per_rad * (turned - touch) - np.hypot(straight, self.axial + self.pitch * turned / TURN))

    def drawn_length(self, points: FloatArray) -> FloatArray:
        """(n,) cable from B to points (n, 3) over a pulley as drawn."""
        if self.drawn_radius == 0.0:
            return np.asarray(np.linalg.norm(points - self.base, axis=1))
        n = self._azimuth(points)
        far = self.base - GUIDE_MM * self.axis
        return self._string(points, n, far, np.zeros((len(points), 2)), self.drawn_radius, 0.0) - GUIDE_MM

    def strings(self, points: FloatArray, passed: FloatArray) -> FloatArray:
        """Return the (n,) cable from the fixed pulley to points (n, 3) after so much (n,) has passed the swivel pulley since its stated
        angle."""
        if self.radius == 0.0:
            return np.asarray(np.linalg.norm(points - self.base, axis=1))
        psi = passed / self.radius
        x1, x2 = self.eccentric
        for _ in range(ROUNDS if any(self.eccentric) else 0):
            psi = (passed + x1 * (1.0 - np.cos(psi)) + x2 * np.sin(psi)) / self.radius
        off = np.column_stack([x1 * np.cos(psi) - x2 * np.sin(psi), x1 * np.sin(psi) + x2 * np.cos(psi)])
        n = self._azimuth(points)

        def at(turn: FloatArray) -> FloatArray:
            c, s = np.cos(turn)[:, None], np.sin(turn)[:, None]
            return self._string(points, c * n + s * np.cross(self.axis, n), self.fixed, off, self.radius, self.offset)

        turn, h = np.zeros(len(points)), 1e-3
        for _ in range(8 if not np.array_equal(self.axis, self.incoming) else 0):
            less, here, more = at(turn - h), at(turn), at(turn + h)
            turn = turn - 0.5 * h * (more - less) / np.maximum(more - 2.0 * here + less, 1e-300)
        return at(turn)

    def _azimuth(self, points: FloatArray) -> FloatArray:
        away = points - self.base
        away = away - (away @ self.axis)[:, None] * self.axis
        return np.asarray(away / np.linalg.norm(away, axis=1)[:, None])

    def _string(self, points: FloatArray, n: FloatArray, fixed: FloatArray, off: FloatArray, radius: float, offset: float) -> FloatArray:
        """(n,) from the fixed point over a disc in the planes of the axis and n (n, 3), whose middle is off (n, 2) along and across."""
        along, across = off[:, 0], self.drawn_radius + offset + off[:, 1]
        ends = []
        for point, side in ((np.broadcast_to(fixed, points.shape), 1.0), (points, -1.0)):
            d = point - self.base
            w, outward, beside = d @ self.axis - along, (d * n).sum(axis=1) - across, (d * np.cross(self.axis, n)).sum(axis=1)
            far = np.hypot(w, outward)
            # angles from where the groove touches the axis, in the sense of travel
            ends.append((np.arctan2(w, -outward) + side * np.arccos(radius / far), np.sqrt(far**2 - radius**2 + beside**2)))
        (on, before), (left, after) = ends
        return np.asarray(before + radius * ((left - on) % TURN) + after)


def _way(alpha: float, beta: float) -> FloatArray:
    return np.array([-np.cos(alpha) * np.sin(beta), -np.cos(alpha) * np.cos(beta), np.sin(alpha)])


def with_play(rig: Rig, counts: FloatArray, cables: tuple[Observed, ...], generator: np.random.Generator) -> FloatArray:
    """(n, m) counts that encoders with play show of true ones (n, m), one after the other, zeroed at a count of 0, where the dog lies
    anywhere in its slot."""
    out = counts.copy()
    for j, c in enumerate(cables):
        drum = rig.counter(c)
        if not (isinstance(drum, Drum) and drum.backlash_counts):
            continue
        w = drum.backlash_counts / drum.scale
        begun = generator.uniform(-w, w)
        shown = begun
        for i, k in enumerate(counts[:, j]):
            shown = min(max(shown, k - w), k + w)
            out[i, j] = shown - begun
    return out


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
    # from its own stream, so that other draws do not depend on it
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
    # the written file has nominal drums and pulleys
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
