"""Parts that are not as drawn, planted in drawn campaigns: are they named as often as stated, and never by chance more often than stated?

    python benchmarks/physical_effects.py --kind run-out --draws 100 --keep effects.jsonl [--write]     (goes on from what is kept)

Each draw is a cell of its own, 24 poses in its work space known to 0.01 mm, a nominal rig off by up to 3 mm and 0.5 degrees, and one
observation point with one effect, whose counts the machine makes (`simulation.machine`, which shares no formula with the solvers); of even
draws at the size below, of odd ones at a tenth to the whole of it. `none` has no effect, `two` and `three` have as many, of different
points, of kinds that can be told from places. Passed: its own F test is beyond the limit; named: it is among those that are named;
wrong: something is named, and it is not. What is solved for is the one effect of the one point, and of `nothing` each kind of all six
points, with none planted. Errors of lengths and places are those of a run elsewhere in the work space, in units of the least-squares bound.
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import binom, chi2, f, ncf, ncx2
from study import Study

from lmeasure.api import reconstruct
from lmeasure.calibration import CHANCE, CalibrationSettings, Campaign, Effect, Model, calibrate, effects, unknowns_of
from lmeasure.calibration.solve.effect_candidates import named_effects
from lmeasure.calibration.solve.frame import model_of
from lmeasure.calibration.solve.solve import solved_effects
from lmeasure.core import se3
from lmeasure.estimation import Deletion, fit
from lmeasure.kernels import span_rows
from lmeasure.recording import poses_from_rows
from lmeasure.rig import Rig, rig_from_dict, value_of
from lmeasure.sensors import phased, span_lengths
from lmeasure.simulation import Leg, campaign_at, cell_rig, scattered_poses, simulate_run, smooth_path
from lmeasure.simulation.instrument import true_counts

FloatArray = NDArray[np.float64]
POSES, U_MM, HALF_MM, TILT = 24, 0.01, 280.0, 0.28
HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Kind:
    """An effect: the keys of rig.toml that have it, of the drum or the point; what it is called where it is named; what `--solve` calls
    it; a realistic size, in a unit; told: whether such counts can tell it from places and guides."""

    keys: tuple[str, ...]
    of_drum: bool
    named: str
    solve: str
    size: float
    unit: str
    reported: bool = True


KINDS = {
    "run-out": Kind(("run_out_mm",), True, "run-out of the drum", "run-out", 0.02, "mm"),
    "eccentricity": Kind(("pulley_eccentricity_mm",), False, "an eccentric pulley", "eccentricity", 0.05, "mm"),
    "radius": Kind(("pulley_radius_mm",), False, "a wrong pulley radius", "radius", 0.3, "mm", reported=False),
    "offset": Kind(("swivel_offset_mm",), False, "a swivel axis off its groove", "offset", 0.2, "mm", reported=False),
    "tilt": Kind(("swivel_tilt_deg",), False, "", "tilt", 0.3, "deg", reported=False),
    "backlash": Kind(("backlash_counts",), True, "play", "backlash", 2.0, "counts"),
    "diameter of the drum": Kind(("count_length_mm",), True, "a wrong drum diameter", "scale", 5e-4, "of it"),
    "pitch": Kind(("groove_pitch_mm",), True, "a wrong groove pitch", "pitch", 0.02, "mm"),
    "diameter of the cable": Kind(("cable_oversize_mm",), True, "a wrong drum diameter", "diameter", 0.05, "mm"),
}
ADDED = {"radius": "pulley_radius_mm", "pitch": "groove_pitch_mm"}
FEW = 100
SEVERAL = {"two": 2, "three": 3}


@dataclass(frozen=True)
class Draw:
    """What became of one campaign; NaN and empty where it does not apply. share: of the realistic size; power: probability that its F test
    passes, and that what is solved for is found; squares of the errors and of the bound, means over a run."""

    kind: str
    number: int
    share: float = np.nan
    power: float = np.nan
    passed: int = 0
    named: int = 0
    planted: int = 0
    wrong: int = 0
    solved_power: float = np.nan
    found: int = 0
    bits: float = np.nan
    length_error: float = np.nan
    length_bound: float = np.nan
    place_error: float = np.nan
    place_bound: float = np.nan
    place_stated: float = np.nan
    said: str = ""


def with_effect(rig: Rig, point: int, kind: str, size: float, rng: np.random.Generator) -> Rig:
    """The rig with an effect of that size at a point, in any direction."""
    data, angle = rig.to_dict(), rng.uniform(0.0, 2.0 * np.pi)
    owner = data["observation_point"][point]
    holder = owner["drum"] if KINDS[kind].of_drum else owner
    key = KINDS[kind].keys[0]
    sign = float(rng.choice([-1.0, 1.0]))
    if kind in ("run-out", "eccentricity", "tilt"):
        holder[key] = [size * np.cos(angle), size * np.sin(angle)]
    elif kind == "backlash":
        holder[key] = size
    elif kind == "diameter of the drum":
        holder[key] *= 1.0 + sign * size
    elif kind in ADDED:
        holder[key] += sign * size
    else:
        holder[key] = sign * size
    return rig_from_dict(data)


class EffectCell:
    """A cell with effects, its campaign, and the first fit of position and guide."""

    def __init__(self, kind: str, number: int) -> None:
        self.rng = rng = np.random.default_rng([number, 17])
        self.plain = cell_rig(int(rng.integers(1, 100_000)))
        self.share = 1.0 if number % 2 == 0 else float(rng.uniform(0.1, 1.0))
        points = rng.permutation(6)
        count = SEVERAL.get(kind, 1 if kind in KINDS else 0)
        own = [k for k in KINDS if KINDS[k].reported]
        self.planted = [(kind if kind in KINDS else str(rng.choice(own)), int(p)) for p in points[:count]]
        self.true = self.plain
        for name, point in self.planted:
            self.true = with_effect(self.true, point, name, KINDS[name].size * self.share, rng)
        self.poses = scattered_poses(POSES, (HALF_MM,) * 3, TILT, HOME, rng=rng)
        made = campaign_at(self.true, self.poses, rng, u_position_mm=U_MM, nominal_shift_mm=3.0, nominal_shift_deg=0.5)
        owners = tuple(
            p.model_copy(update={"drum": q.drum, "pulley_radius_mm": q.pulley_radius_mm})
            for p, q in zip(made.nominal.observation_point, self.plain.observation_point, strict=True)
        )
        nominal = made.nominal.model_copy(update={"observation_point": owners})
        self.campaign = Campaign(nominal, made.measured, self.true.cable, made.recorded, np.zeros(6, np.int64))

    def model(self, *solve: str) -> Model:
        """With these solved beside places and guides."""
        return model_of(self.campaign, unknowns_of(self.campaign, ("position", "guide", *solve)))

    def shift(self, model: Model, theta: FloatArray) -> FloatArray:
        """(e,) what the effects of the machine add to the residuals."""
        both = []
        for rig in (self.true, self.plain):
            counts = true_counts(rig, self.poses, self.poses[0], rig.cable)
            at = Model(replace(self.campaign, counts=counts), model.parameters)
            both.append(at.residuals(theta))
        out = both[0] - both[1]
        for name, point in self.planted:
            if name == "backlash":
                effect = next(e for e in effects(model, theta) if e.kind == "play" and e.channel == f"ch{point + 1}")
                out = out + effect.columns[:, 0] * KINDS[name].size * self.share
        return out

    def mine(self, effect: Effect) -> bool:
        """Whether it is one that was planted."""
        return any(effect.kind == KINDS[k].named and effect.channel == f"ch{p + 1}" for k, p in self.planted)


def study(number: int, kind: str) -> Draw:
    """One campaign."""
    at = EffectCell(kind, number)
    if kind == "nothing":
        return solved_of_nothing(at, number)
    model = at.model()
    found = fit(model, model.start)
    said, _ = named_effects(model, found)
    texts = [w.text.split(": p =")[0] for w in said]
    calls = [f"{KINDS[k].named} of ch{p + 1} (" for k, p in at.planted if KINDS[k].named]
    named = sum(any(call in text for text in texts) for call in calls)
    out = Draw(kind, number, at.share, named=named, planted=len(at.planted), said="; ".join(texts)[:200])
    out = replace(out, wrong=sum(not any(call in text for call in calls) for text in texts))
    if kind not in KINDS:
        return out
    deletion, tried = Deletion(found), list(effects(model, found.theta))
    mine = next((e for e in tried if at.mine(e)), None)
    if mine is not None:
        judged = deletion.added(mine.columns)
        assert judged is not None
        tested = deletion.test(judged.square, judged.freedom)
        assert tested is not None
        law = judged.freedom, found.freedom - judged.freedom
        limit = f.isf(CHANCE / len(tried), *law)
        both = deletion.information(np.column_stack([at.shift(model, found.theta), mine.columns]))

        noncentral = float(both[0, 1:] @ np.linalg.pinv(both[1:, 1:], hermitian=True) @ both[1:, 0])
        out = replace(out, power=float(ncf.sf(limit, *law, noncentral)), passed=int(tested[0] > limit))
    return solved(at, out)


def solved(at: EffectCell, out: Draw) -> Draw:
    """What calibration with the effect makes of it, and of a run elsewhere."""
    (kind, point), = at.planted  # fmt: skip
    name = f"B{point + 1}"
    result = calibrate(at.campaign, CalibrationSettings(solve=("position", "guide", f"{KINDS[kind].solve}:{name}")))
    (effect,) = result.record.effects
    begun = float(span_lengths(at.plain, at.poses[:1])[0, point])
    data = at.true.to_dict()
    data["observation_point"][point]["phase_length_mm"] = begun
    true = rig_from_dict(data)
    legs = [
        Leg(se3.pose(at.rng.uniform(-250, 250, 3), Rotation.from_rotvec(at.rng.uniform(-0.25, 0.25, 3))), 800.0, 60.0, 0.0)
        for _ in range(2)
    ]
    start = se3.pose(at.rng.uniform(-200, 200, 3), Rotation.from_rotvec(at.rng.uniform(-0.2, 0.2, 3)))
    time_s, path = smooth_path(start, legs, 25.0)
    C = bound(at, result.rig, f"{KINDS[kind].solve}:{name}")
    counts = true_counts(true, path, path[0], true.cable) / result.rig.scales(true.cable)
    here = Campaign(result.rig, poses_from_rows(path), true.cable, counts, np.zeros(6, np.int64), free_of_play=True)
    elsewhere = Model(here, unknowns_of(here, ("position", "guide", f"{KINDS[kind].solve}:{name}")))
    theta = np.array([value_of(result.rig, n) or 0.0 for n in elsewhere.parameters.names])
    error, J = elsewhere.residuals(theta), elsewhere.jacobian(theta)
    run = simulate_run(true, time_s, path, noise_mm=0.0, rng=at.rng).run
    got = reconstruct(replace(run, rig=result.rig, calibration=result.record))
    ok = np.isfinite(got.poses[:, 0])
    off = se3.displacement(got.poses[ok], path[ok])[:, 3:]
    rows = result.rig.cable_rows(true.cable)
    count = np.array([p.drum.count_length_mm for p in result.rig.observation_point])
    expected, i = [], elsewhere.pose_index
    for sample in np.flatnonzero(ok):
        W = np.linalg.inv(span_rows(rows, path[sample]))[3:]
        own = J[i == sample]
        # whole counts, here and where the counter was zeroed
        V = np.diag(count**2 / 6.0) + (own @ C @ own.T if len(own) else 0.0)
        if kind == "backlash":
            # where in its band the counter was zeroed
            V[point, point] += (count[point] * KINDS[kind].size * at.share) ** 2 / 3.0
        expected.append(float(np.trace(W @ V @ W.T)))
    planted = KINDS[kind].size * at.share
    left = max(chi2.isf(CHANCE, len(covariance_of(C, elsewhere, kind)[0])), 0.0)
    own_C = covariance_of(C, elsewhere, kind)
    along = own_C.shape[0] ** -0.5 * np.ones(own_C.shape[0]) * planted
    power = float(ncx2.sf(left, len(own_C), along @ np.linalg.solve(own_C, along)))
    return replace(
        out, solved_power=power, found=int(effect.found), bits=effect.bits,
        length_error=float(np.mean(error**2)), length_bound=float(np.mean(np.einsum("ei,ij,ej->e", J, C, J))),
        place_error=float(np.mean(np.sum(off**2, axis=1))), place_bound=float(np.mean(expected)),
        place_stated=float(np.mean(np.trace((got.random + got.systematic)[ok][:, 3:, 3:], axis1=1, axis2=2))),
    )  # fmt: skip


def covariance_of(C: FloatArray, model: Model, kind: str) -> FloatArray:
    """(q, q) of the effect's own values."""
    keys = ("run_out", "eccentricity", "pulley_radius", "swivel", "backlash", "scale", "pitch", "oversize")
    which = [i for i, n in enumerate(model.parameters.names) if any(k in n for k in keys)]
    return C[np.ix_(which, which)]


def bound(at: EffectCell, rig: Rig, solve: str) -> FloatArray:
    """(p, p) covariance of least squares with the nominal rig as a prior, at the truth as well as it is known."""
    campaign = replace(at.campaign, rig=phased(at.campaign.rig, unknowns_of(at.campaign, (solve,)).names, at.poses[[0] * 6], at.true.cable))
    model = model_of(campaign, unknowns_of(campaign, ("position", "guide", solve)))
    theta = np.array([value_of(rig, n) or 0.0 for n in model.parameters.names])
    J, V = model.jacobian(theta), model.covariance(theta)
    return np.asarray(np.linalg.inv(J.T @ np.linalg.solve(V, J) + np.diag(model.parameters.width**-2.0)))


def solved_of_nothing(at: EffectCell, number: int) -> Draw:
    """How many kinds, each solved for at all points, are said to be found where there is nothing."""
    found = []
    for kind in KINDS.values():
        if kind.solve == "tilt":
            continue
        model = at.model(kind.solve)
        some = solved_effects(model, fit(model, model.start), estimated=False)
        if any(e.found for e in some):
            found.append(kind.solve)
    return Draw("nothing", number, found=len(found), said=", ".join(found))


def table(every: list[Draw]) -> str:
    """The page of results."""
    lines = ["# Physical effects in calibrations", "", (__doc__ or "").split("\n\n", 2)[2].strip(), ""]
    lines += [
        "| effect | size | campaigns | passed | stated | named, size as stated | something else named |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += list(_named(every))
    lines += [
        "",
        "| effect | found when solved for | stated | bits, median | lengths over bound | places over bound | places over stated |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += list(_solved(every))
    if min((sum(d.kind == kind for d in every) for kind in KINDS), default=0) < FEW:
        lines += [
            "",
            f"Errors of one campaign go together: ratios of fewer than {FEW} campaigns scatter by some tenths, and decide nothing.",
        ]
    lines.append("")
    for kind, text in (
        ("none", "campaigns without any in which something is named"),
        ("nothing", "kinds, each solved for at all points, found"),
    ):
        own = [d for d in every if d.kind == kind]
        if own:
            n, times = (len(own), sum(d.wrong > 0 for d in own)) if kind == "none" else (8 * len(own), sum(d.found for d in own))
            low, high = (int(binom.ppf(q, n, CHANCE)) for q in (5e-4, 1 - 5e-4))
            lines.append(f"- {text}: {times} of {n}; stated at most {CHANCE:.0%}, consistent with it from {low} to {high}")
    for kind, count in SEVERAL.items():
        own = [d for d in every if d.kind == kind and d.share == 1.0]
        if own:
            hist = [sum(d.named == k for d in own) for k in range(count + 1)]
            lines.append(
                f"- {kind} at once, {len(own)} campaigns at the size: "
                + ", ".join(f"{k} named in {h}" for k, h in enumerate(hist))
                + f"; something else named in {sum(d.wrong > 0 for d in own)}"
            )
    return "\n".join([*lines, ""])


def _named(every: list[Draw]) -> Iterator[str]:
    for kind, k in KINDS.items():
        own = [d for d in every if d.kind == kind]
        if not own or not k.named:
            continue
        power = np.array([d.power for d in own])
        spread = 3.3 * np.sqrt(np.sum(power * (1.0 - power)))
        full = [d for d in own if d.share == 1.0]
        yield (
            f"| {kind} | {k.size:g} {k.unit} | {len(own)} | {sum(d.passed for d in own)} | {power.sum():.0f} +- {spread:.0f} | "
            f"{sum(d.named for d in full)} of {len(full)} | {sum(d.wrong > 0 for d in own)} |"
        )


def _solved(every: list[Draw]) -> Iterator[str]:
    for kind in KINDS:
        own = [d for d in every if d.kind == kind]
        if not own:
            continue
        power = np.array([d.solved_power for d in own])
        spread = 3.3 * np.sqrt(np.sum(power * (1.0 - power)))
        ratio = [np.sqrt(np.mean([getattr(d, a) for d in own]) / np.mean([getattr(d, b) for d in own])) for a, b in PAIRS]
        yield (
            f"| {kind} | {sum(d.found for d in own)} of {len(own)} | {power.sum():.0f} +- {spread:.0f} | "
            f"{np.median([d.bits for d in own]):.1f} | {ratio[0]:.3f} | {ratio[1]:.3f} | {ratio[2]:.3f} |"
        )


PAIRS = (("length_error", "length_bound"), ("place_error", "place_bound"), ("place_error", "place_stated"))


STUDY = Study("physical_effects", study, table, "draws", factors={"kind": (*KINDS, "none", "nothing", *SEVERAL)}, record=Draw)

if __name__ == "__main__":
    sys.exit(STUDY.command(__doc__))
