"""What a rig states of dimensions that nothing has solved: against rigs that really err so, by a forward model that shares no code."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import real_rig
import scipy.stats
from scipy.spatial.transform import Rotation

from lmeasure.accuracy import scan_zone, tilts
from lmeasure.core import FloatArray, RigError
from lmeasure.kernels import changes_from_counts, length_gradients, span_lengths, span_rows
from lmeasure.recording import Counts, Run
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.sensors import DIMENSIONS, cable_covariance, stated_errors, unsolved_dimensions, zero_at
from lmeasure.trajectory import covariances, reconstruct

START = np.array([0.0, 0, 0, 0, 0, 0, 1])
DRAWS = 24

STATED: dict[str, tuple[dict[str, float], str]] = {
    "count length": ({"u_count_length_mm": 6e-6}, "drum"),
    "groove pitch": ({"u_groove_pitch_mm": 0.05}, "drum"),
    "run-out": ({"u_run_out_mm": 0.02}, "drum"),
    "eccentricity": ({"u_pulley_eccentricity_mm": 0.05}, "point"),
    "attachment": ({"u_attachment_mm": 0.1}, "rig"),
    "backlash": ({"u_backlash_counts": 6.0}, "drum"),
    "friction": ({"u_friction_counts": 8.0}, "drum"),
}


def stating(data: dict[str, Any], *names: str) -> Rig:
    """The rig that states these uncertainties."""
    out = dict(data)
    for keys, where in (STATED[name] for name in names):
        if where == "rig":
            out |= keys
        elif where == "point":
            out["observation_point"] = [p | keys for p in out["observation_point"]]
        else:
            out["observation_point"] = [p | {"drum": p["drum"] | keys} for p in out["observation_point"]]
    return rig_from_dict(out)


def drawn_flaws(rng: np.random.Generator, name: str, cables: int = 6) -> dict[str, Any]:
    """What the forward model is given for one draw of what `STATED` says."""
    z = rng.normal
    flaws: dict[str, Callable[[], dict[str, Any]]] = {
        "count length": lambda: {"stretch": z(0, 6e-6, cables) / real_rig.COUNT_MM},
        "groove pitch": lambda: {"pitch_mm": z(0, 0.05, cables)},
        "run-out": lambda: {"run_out_mm": z(0, 0.02, (cables, 2))},
        "eccentricity": lambda: {"eccentric_mm": z(0, 0.05, (cables, 2))},
        "attachment": lambda: {"tool": z(0, 0.1, (3, 3))},
        "backlash": lambda: {},
        "friction": lambda: {},
    }
    return flaws[name]()


def nominal(true: real_rig.RealRig) -> dict[str, Any]:
    """Its drawing, with counters zeroed exactly."""
    data = true.nominal()
    for point in data["observation_point"]:
        point["drum"]["zero_exact"] = True
    return data


def truth(seed: int) -> real_rig.RealRig:
    return real_rig.draw(seed, real_rig.Flaws(phase=False))


def after_play(counts: FloatArray, half: FloatArray, first: FloatArray) -> FloatArray:
    """(n, m) readings of counters behind a play of half a width (m,), from counts that begin at 0 in the state first (m,), -1 to 1."""
    out, held = np.empty_like(counts), -first * half
    for i, k in enumerate(counts):
        held = np.clip(held, k - half, k + half)
        out[i] = held
    return out + first * half


def residuals(rig: Rig, poses: FloatArray, counts: FloatArray) -> FloatArray:
    """(n, m) modelled less measured changes of a rig that knows of no flaw."""
    rows = rig.cable_rows()
    lengths = span_lengths(rows, np.vstack([START[None], poses]))
    return np.asarray(lengths[1:] - lengths[0] - changes_from_counts(rows, np.ascontiguousarray(counts)))


@pytest.mark.parametrize("name", ["count length", "groove pitch", "run-out", "eccentricity", "attachment"])
def test_shifts_are_what_flawed_rigs_are_off_by(name: str) -> None:
    """One thousandth of the stated flaw on one component after the other, central differences of the forward model."""
    # the forward model turns the pulley by what the drum winds off: without a groove that is what runs over the pulley
    true = replace(truth(3), pitch=np.zeros(6)) if name == "eccentricity" else truth(3)
    rig = stating(nominal(true), name)
    rng = np.random.default_rng(3)
    poses = real_rig.scattered(rng, 12)
    (variable,) = {v.kind for v in stated_errors.stated(rig)}
    effects = stated_errors.Unsolved(rig, stated_errors.stated(rig))
    counts = true.true_counts(poses, START)
    found = effects.shifts(rig.cable_rows(), zero_at(START, 6, 0.0), poses, counts)
    keyword = next(iter(drawn_flaws(rng, name)))
    blank = np.zeros_like(next(iter(drawn_flaws(rng, name).values())))
    u = next(iter(STATED[name][0].values())) / (real_rig.COUNT_MM if name == "count length" else 1.0)
    assert found.shape[2] == blank.size
    assert set(effects.sources) == {variable.text}
    for column in range(blank.size):
        moved = blank.copy()
        moved.flat[column] = 1e-3 * u
        above, below = (
            residuals(rig, poses, real_rig.without(true, **{keyword: sign * moved}).true_counts(poses, START)) for sign in (1, -1)
        )
        # the truth has no misfit, so that what the rig leaves out is missing in its lengths
        expected = -(above - below) / 2e-3
        np.testing.assert_allclose(found[:, :, column], expected, rtol=0, atol=1e-4 * np.abs(expected).max())
        assert np.abs(expected).max() > 1e-4 * (1e3 * u if name == "count length" else u)


def test_at_the_count_and_pose_where_it_was_zeroed_nothing_is_off() -> None:
    rig = stating(nominal(truth(1)), *STATED)
    effects = stated_errors.Unsolved(rig, stated_errors.stated(rig))
    found = effects.shifts(rig.cable_rows(), zero_at(START, 6, 0.0), START[None], np.zeros((1, 6)))
    np.testing.assert_allclose(found, 0.0, atol=1e-15)
    np.testing.assert_array_equal(effects.play(np.zeros((1, 6))), 0.0)


def test_play_stands_still_until_it_is_crossed() -> None:
    """Rises, flickers, falls, pauses in a gap: the way is the last one, and a counter's flicker is none."""
    k = np.array([0.0, 1.0, 0.0, 5.0, 40.0, 39.0, 40.0, np.nan, 41.0, 30.0, 31.0, 30.0, 35.0])
    expected = [0, 0, 0, 1, 1, 1, 1, 1, 1, -1, -1, -1, 1]
    state = np.zeros((1, 2))
    pieces = [stated_errors.last_travel(part[:, None], np.ones(1), state)[:, 0] for part in (k[:6], k[6:])]
    np.testing.assert_array_equal(np.concatenate(pieces), expected)
    np.testing.assert_array_equal(stated_errors.last_travel(k[:, None], np.ones(1))[:, 0], expected)


def run_of(rig: Rig, recorded: FloatArray) -> Run:
    return Run(rig, START, (Counts(np.arange(len(recorded)) / 100.0, rig.channels, recorded),), unstated="exact")


def way_of(rng: np.random.Generator) -> FloatArray:
    """(n, 7) a way from the start through the cell, with a rest at its end."""
    poses = real_rig.path(rng, 120)
    return np.vstack([poses, np.repeat(poses[-1:], 5, axis=0)])


def delta(found: FloatArray, poses: FloatArray) -> FloatArray:
    """(n, 6) errors, true less found: rotation [rad], position [mm]."""
    turn = Rotation.from_quat(poses[:, 3:]) * Rotation.from_quat(found[:, 3:]).inv()
    return np.column_stack([turn.as_rotvec(), poses[:, :3] - found[:, :3]])


def recorded_by(true: real_rig.RealRig, poses: FloatArray, rng: np.random.Generator, names: tuple[str, ...]) -> FloatArray:
    """Whole counts of a rig drawn from what is stated."""
    flaws: dict[str, Any] = {}
    half = np.zeros(6)
    for name in names:
        flaws |= drawn_flaws(rng, name)
        if name in ("backlash", "friction"):
            half = half + np.abs(rng.normal(0, next(iter(STATED[name][0].values())), 6))
    exact = real_rig.without(true, **flaws).true_counts(poses, poses[0])
    return np.rint(after_play(exact, half, rng.choice([-1.0, 1.0], 6)))


@pytest.mark.parametrize("names", [*[(n,) for n in STATED if n != "friction"], tuple(n for n in STATED if n != "friction")], ids=" ".join)
def test_errors_of_rigs_drawn_from_what_is_stated_are_what_is_stated(names: tuple[str, ...]) -> None:
    """Poses, and differences of poses of one run, over their covariances: chi-squared, on both sides."""
    squares = {"poses": 0.0, "differences": 0.0}
    for seed in range(DRAWS):
        rng = np.random.default_rng([seed, 11])
        true = truth(seed)
        rig, poses = stating(nominal(true), *names), way_of(rng)
        run = run_of(rig, recorded_by(true, poses, rng, names))
        found = reconstruct(run)
        at = np.sort(rng.choice(np.arange(30, len(poses)), 2, replace=False))
        errors = delta(found.poses, poses)[at]
        budget = covariances(found, run, at)
        np.testing.assert_allclose(budget.systematic, found.systematic[at], rtol=1e-9, atol=1e-18)
        squares["poses"] += errors[0] @ np.linalg.solve(budget.random[0] + budget.systematic[0], errors[0])
        apart = budget.factors[1] - budget.factors[0]
        difference = errors[1] - errors[0]
        squares["differences"] += difference @ np.linalg.solve(apart @ apart.T + budget.random.sum(axis=0), difference)
    for what, square in squares.items():
        p = scipy.stats.chi2.cdf(square, 6 * DRAWS)
        assert 0.005 < p < 0.995, (what, square / (6 * DRAWS))


@pytest.mark.parametrize(
    ("where", "keys", "determined"),
    [
        ("drum", {"u_count_length_mm": 0.01}, "u_count_length_mm: 0.01 is more than half of count_length_mm, 0.012"),
        ("drum", {"u_run_out_mm": -0.1}, "u_run_out_mm: must be at least 0"),
        ("drum", {"u_friction_count": 8}, "unknown key 'u_friction_count'. Did you mean 'u_friction_counts'"),
        ("point", {"u_pulley_eccentricity_mm": 20.0}, "u_pulley_eccentricity_mm: 20 is more than half of pulley_radius_mm"),
        ("rig", {"u_attachment_mm": float("nan")}, "u_attachment_mm: must be"),
    ],
)
def test_keys_that_cannot_be(where: str, keys: dict[str, float], determined: str) -> None:
    data = nominal(truth(1))
    point = data["observation_point"][0]
    {"drum": point["drum"], "point": point, "rig": data}[where].update(keys)
    with pytest.raises(RigError, match=determined):
        rig_from_dict(data)


def test_what_is_stated_of_dimensions_is_a_covariance_of_the_cables_parameters() -> None:
    """Columns of the kernels' parameters, through their gradients, are the shifts of the lengths."""
    rig = stating(nominal(truth(5)), "count length", "groove pitch", "attachment")
    poses = real_rig.scattered(np.random.default_rng(5), 8)
    counts = truth(5).true_counts(poses, START)
    rows, scales = rig.cable_rows(), rig.scales()
    gradients = length_gradients(rows, poses, counts, scales) - length_gradients(rows, START[None], np.zeros((1, 6)), scales)
    through = np.einsum("nmp,mps->nms", gradients, unsolved_dimensions(rig, None)[0].reshape(6, 13, -1))
    shifts = stated_errors.Unsolved(rig, stated_errors.stated(rig))
    direct = shifts.shifts(rows, zero_at(START, 6, 0.0), poses, counts)
    names = [n for v in stated_errors.stated(rig, None, (), DIMENSIONS) for n in v.names]
    # a drum's scale moves its pay-out point too, by a hundredth of the cable
    apart = np.abs(through[:, :, [names.index(name) for name in shifts.names]] - direct)
    assert (apart.max(axis=(0, 1)) < 0.01 * np.abs(direct).max(axis=(0, 1))).all()
    assert not cable_covariance(rig_from_dict(nominal(truth(5))), None).any()


def test_monte_carlo_draws_what_is_stated() -> None:
    names = ("count length", "attachment", "run-out", "eccentricity", "backlash")
    rng = np.random.default_rng(4)
    true = truth(4)
    rig, poses = stating(nominal(true), *names), real_rig.path(rng, 60)[::12]
    run = run_of(rig, true.true_counts(poses, poses[0]))
    linear, drawn = reconstruct(run), reconstruct(run, trials=300, seed=1)
    u = np.sqrt(np.einsum("nii->ni", linear.systematic))
    np.testing.assert_allclose(np.sqrt(np.einsum("nii->ni", drawn.systematic)), u, rtol=0.17, atol=1e-9)
    assert linear.covers == (
        "counts of half a unit, dimensions as stated, run-out of drums, eccentric pulleys and play of drums: "
        "the rig has no linked calibration"
    )


def test_a_rig_that_states_zero_is_exact() -> None:
    rig = rig_from_dict(nominal(truth(1)) | {"u_attachment_mm": 0.0})
    run = run_of(rig, np.rint(truth(1).true_counts(real_rig.path(np.random.default_rng(1), 120)[:20], START)))
    assert not reconstruct(run).systematic.any()


def test_zone_holds_what_is_stated() -> None:
    """At one place: the radius against draws of the forward model, zeroed at a drum's and a pulley's every angle."""
    names = ("count length", "attachment", "run-out", "eccentricity", "groove pitch")
    true = truth(6)
    at = (120.0, -80.0, 60.0)
    x, y, z = (np.array([v]) for v in at)
    rig = stating(nominal(true), *names)
    zone = scan_zone(rig, None, x=x, y=y, z=z, rotations=tilts(0.0, 1), start=START)
    rng, pose = np.random.default_rng(6), np.array([[*at, 0, 0, 0, 1.0]])
    inverse = np.linalg.inv(span_rows(rig.cable_rows(), pose[0]))
    errors = []
    for _ in range(600):
        flaws: dict[str, Any] = {}
        for name in names:
            flaws |= drawn_flaws(rng, name)
        counts = real_rig.without(true, **flaws).true_counts(pose, START) + rng.uniform(-0.5, 0.5, 6)
        errors.append(np.linalg.norm((inverse @ residuals(rig, pose, counts)[0])[3:]))
    radius = float(zone["u95_position_mm"].values.ravel()[0])
    inside = np.mean(np.array(errors) < radius)
    assert 0.925 < inside < 0.975, inside
    assert "count length, groove pitch, run-out of drums, eccentric pulleys, attachment points" in zone.attrs["u95_covers"]
    plain = scan_zone(rig_from_dict(nominal(true)), None, x=x, y=y, z=z, rotations=tilts(0.0, 1), start=START)
    assert radius > 5 * float(plain["u95_position_mm"].values.ravel()[0])
