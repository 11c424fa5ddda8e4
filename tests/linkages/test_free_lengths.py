"""Limits of lengths without singular poses: the law behind it, and proofs held against draws, for every structure."""

import numpy as np
import pytest
from linkages import lengths_at, rig

from lmeasure.core import FloatArray, se3
from lmeasure.linkages import Around, Structure, chain, incidence, singularity, structures, tetrahedra

SOLVED = [s for s in structures() if s.closed_form]
SIGNS = np.array(np.meshgrid(*[(-1.0, 1.0)] * 6)).reshape(6, -1).T


def high(structure: Structure) -> tuple[FloatArray, FloatArray, FloatArray, int]:
    """Base, platform, lengths and number of the assembly whose tetrahedra stand highest, of some rigs."""
    found = []
    for seed in range(20):
        base, platform, poses = rig(structure, seed, poses=50)
        lengths = lengths_at(base, platform, poses)
        height = tetrahedra.heights(base, platform, lengths)
        i, k = np.unravel_index(int(np.argmax(height)), height.shape)
        found.append((height[i, k], (base, platform, lengths[i], int(k))))
    return max(found, key=lambda one: one[0])[1]


@pytest.mark.parametrize("structure", SOLVED, ids=lambda s: s.notation)
def test_the_determinant_is_a_product_of_three_volumes(structure: Structure) -> None:
    """|det| times the lengths of the links is 6V1 6V2 6V3 of the corners by which tetrahedra place points, whatever they stand on."""
    for seed in range(3):
        base, platform, (pose,) = rig(structure, seed)
        order = incidence(base, platform).order
        there = {("B", b): base[order[i]] for i, (_, b) in enumerate(structure.links)}
        there |= {("P", p): se3.apply(pose, platform[order[i]]) for i, (p, _) in enumerate(structure.links)}
        six = [abs(np.linalg.det([there[c] - there[side, i] for c in corners])) for side, i, corners in structure.placements or ()]
        product = abs(singularity.determinants(base, platform, pose)) * lengths_at(base, platform, pose).prod()
        assert product == pytest.approx(np.prod(six), rel=1e-9)


@pytest.mark.parametrize("structure", SOLVED[::2], ids=lambda s: s.notation)
def test_what_tetrahedra_prove_holds_for_draws(structure: Structure) -> None:
    """Boxes that reach over a fold are never proved, small ones around a good assembly are; where it is proved, every draw stands."""
    base, platform, lengths, k = high(structure)
    sides = (1.0 if k % 2 == 0 else -1.0, 1.0 if k // 2 % 2 == 0 else -1.0)
    judge = chain.Chain(incidence(base, platform), base, platform, sides).judge
    rng = np.random.default_rng(0)
    determined = []
    for wide in (1e-4, 0.003, 0.3):
        box = np.stack([lengths * (1.0 - wide), lengths * (1.0 + wide)], axis=-1)
        determined.append(chain.proved(judge, box, 300))
        draws = lengths * (1.0 + wide * np.vstack([SIGNS, rng.uniform(-1.0, 1.0, (500, 6))]))
        if determined[-1]:
            assert (tetrahedra.heights(base, platform, draws)[:, k] > 0.0).all()
            assert tetrahedra.closed_form(base, platform, draws)[1][:, k].all()
    assert determined[0]
    assert not determined[-1]


@pytest.mark.parametrize("structure", [s for s in structures() if s.degenerate is None][::8], ids=lambda s: s.notation)
def test_what_is_proved_around_a_pose_holds_for_draws(structure: Structure) -> None:
    base, platform, poses = rig(structure, 1, poses=30)
    best = int(np.argmin([singularity.hold(base, platform, pose).mm_per_mm for pose in poses]))
    pose = poses[best]
    lengths = lengths_at(base, platform, pose)
    around = Around(base, platform, pose)
    low, far = 0.0, 0.5
    for _ in range(12):
        middle = (low + far) / 2.0
        box = np.stack([lengths * (1.0 - middle), lengths * (1.0 + middle)], axis=-1)
        low, far = (middle, far) if around.sound(box) else (low, middle)
    assert low > 1e-4
    there = singularity.determinants(base, platform, pose)
    for sign in SIGNS[::7]:
        aim, now = lengths * (1.0 + low * sign), pose
        for _ in range(20):
            rows, length, _ = singularity.link_rows(base, platform, now)
            now = singularity.moved(now, np.linalg.solve(np.roll(rows, 3, axis=1), aim - length))
        np.testing.assert_allclose(lengths_at(base, platform, now), aim, rtol=1e-9)
        assert singularity.determinants(base, platform, now) / there > 0.0


def test_nothing_is_proved_around_a_singular_pose() -> None:
    """The three columns of 4.5; nor of limits that do not hold the pose's own lengths."""
    base = np.array([(0, -1, -1.6), (1, 0, -1.6), (0, 1, -1.6), (0, -2.6, 0), (2.6, 0, 0), (0, 2.6, 0)])
    body = np.array([(0, -1, 0), (1, 0, 0), (0, 1, 0)] * 2, dtype=float)
    here = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    assert not Around(base, body, here).sound(np.tile([1.6 - 1e-9, 1.6 + 1e-9], (6, 1)))
    turned = singularity.moved(here, np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0]))
    lengths = lengths_at(base, body, turned)
    assert Around(base, body, turned).sound(np.stack([lengths - 1e-6, lengths + 1e-6], axis=-1))
    assert not Around(base, body, turned).sound(np.stack([lengths + 1e-7, lengths + 1e-6], axis=-1))
