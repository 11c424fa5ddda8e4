"""Where tetrahedra are flat: the thesis' tables, boxes against draws, rates of edges against differences, and proofs that hold."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from lmeasure.core import StructureError
from lmeasure.linkages import flat_tetrahedra, intervals

laws = settings(max_examples=8, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)

# thesis 4.2, with sides and limits as printed
LIMITS = {"l1": (3.0, 3.5), "l2": (3.0, 3.5), "l3": (4.5, 5.0), "l4": (3.5, 4.0), "l5": (3.5, 4.0), "l6": (3.5, 4.0)}
LIMITS |= {n: (v, v) for n, v in {"b12": 1.5, "b23": 2.4, "b13": 2.4, "p12": 1.5, "p23": 1.25, "p13": 1.25}.items()}
T1 = flat_tetrahedra.Tetrahedron("b12", "l1", "l2", "b13", "b23", "l3")
T2 = flat_tetrahedra.Tetrahedron("l4", "l2", "p12", "b23", "l5", "l3")
T3 = flat_tetrahedra.Tetrahedron("p23", "p12", "p13", "l5", "l6", "l3")


def volume(edges: dict[str, float]) -> float:
    """Square of 6 V by the Cayley-Menger determinant of X, Y, P, Q; negative where there is no such tetrahedron."""
    d = {k: v**2 for k, v in edges.items()}
    rows = [
        [0, 1, 1, 1, 1], [1, 0, d["xy"], d["px"], d["qx"]], [1, d["xy"], 0, d["py"], d["qy"]], [1, d["px"], d["py"], 0, d["pq"]],
        [1, d["qx"], d["qy"], d["pq"], 0],
    ]  # fmt: skip
    return float(np.linalg.det(np.array(rows, dtype=float))) / 8.0


@laws
@given(seeds)
def test_a_flat_tetrahedron_has_no_volume(seed: int) -> None:
    rng = np.random.default_rng(seed)
    X, Y, P, Q = rng.normal(size=(4, 3))
    d = {
        k: float(np.linalg.norm(a - b)) for k, a, b in (("xy", X, Y), ("px", X, P), ("py", Y, P), ("qx", X, Q), ("qy", Y, Q), ("pq", P, Q))
    }
    near, far = (float(v) for v in flat_tetrahedra.flat([np.array(d[e]) for e in flat_tetrahedra.EDGES]))
    assert near <= d["pq"] <= far
    assert volume(d) == pytest.approx(float(np.linalg.det(np.array([Y - X, P - X, Q - X]))) ** 2, rel=1e-7, abs=1e-9)
    for value in (near, far):
        assert volume(d | {"pq": value}) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("tetrahedron", "values"),
    [(T1, (0.6249, 1.2907, 5.1845, 5.6985)), (T2, (2.0036, 3.0335, 3.4617, 4.8132)), (T3, (2.2605, 2.8181, 4.6519, 5.1582))],
)
def test_thesis_4_2_as_recomputed(tetrahedron: flat_tetrahedra.Tetrahedron, values: tuple[float, ...]) -> None:
    """The flat values printed there (4.9, 4.54, 4.923) are not those of its sides and limits."""
    found = flat_tetrahedra.bands(tetrahedron, LIMITS, "l3")
    got = (found.near.low[0], found.near.high[1], found.far.low[0], found.far.high[1])
    np.testing.assert_allclose(got, values, atol=6e-5)
    assert max(found.near.sharp, found.far.sharp) <= 5e-5
    assert found.safe == (found.near.high[1], found.far.low[0])


def test_thesis_4_2_printed_limits_are_not_free_and_what_is() -> None:
    band = flat_tetrahedra.safe_band([T1, T2, T3], LIMITS, "l3")
    assert band == pytest.approx((3.0335, 3.4617), abs=1e-4)
    # it has nothing in common with the printed limits of l3, 4.5 to 5
    assert not flat_tetrahedra.clear(T2, LIMITS)
    assert not flat_tetrahedra.clear(T3, LIMITS)
    free = flat_tetrahedra.adjusted([T1, T2, T3], LIMITS, ["l3"])
    assert band is not None
    assert band[0] < free["l3"][0] < free["l3"][1] < band[1]
    assert all(flat_tetrahedra.clear(t, free) for t in (T1, T2, T3))
    with pytest.raises(StructureError, match="may be flat"):
        flat_tetrahedra.adjusted([T1, T2, T3], LIMITS | {"l2": (1.0, 3.5)}, ["l1"])


def test_thesis_4_18_the_inner_length_of_a_flat_middle_tetrahedron() -> None:
    """l4 at which P1 B2 B3 P2 is flat with the others given: 3.653907 and 1.963252, gamma of (4.17) with l2 for l4."""
    own = {"l2": (3.2, 3.2), "l3": (4.2, 4.2), "l5": (3.7, 3.7), "b23": (2.4, 2.4), "p12": (1.5, 1.5)}
    found = flat_tetrahedra.bands(T2, own, "l4")
    assert (found.near.low[0], found.far.high[1]) == pytest.approx((1.963252, 3.653907), abs=1e-6)


def test_thesis_4_3_tables() -> None:
    """Table 4.1: columns 1 and 2, near and far; all of 4.2; the levers' range of a distance."""
    r, side = np.array([(38, 38), (38, 45), (45, 45), (45, 38)], dtype=float), np.full(4, 20.0)
    near, far = flat_tetrahedra.flat([side, r[:, 0], r[:, 1], side, side])
    np.testing.assert_allclose(near, [19.340097, 25.050101, 26.554314, 25.050101], atol=3e-5)
    np.testing.assert_allclose(far, [53.981114, 56.934106, 61.195330, 56.934106], atol=3e-5)
    # (4.22), with AP = 70, BB = 20
    levers = np.sqrt([70.0**2 + b**2 - 70.0 * (a**2 + b**2 - 20.0**2) / a for a in (38.0, 45.0) for b in (38.0, 45.0)])
    low, high = levers.min(), levers.max()
    assert (low, high) == pytest.approx((35.316034, 41.962389), abs=1e-6)
    r = np.array([(low, low), (high, low), (high, high), (low, high)])
    near, far = flat_tetrahedra.flat([np.full(4, 20.0), r[:, 0], r[:, 1], np.full(4, 35.0), np.full(4, 25.0)])
    np.testing.assert_allclose(near, [17.689124, 10.922330, 22.121028, 29.828294], atol=3e-5)
    np.testing.assert_allclose(far, [60.262255, 59.735561, 66.950312, 65.869318], atol=3e-5)
    # 4.2: rows by |A1B2|, |A1B3|, columns by |A2B2|, |A2B3|, on the same side of B2B3
    rows = np.array([(low, low), (low, high), (high, high), (high, low)])
    columns = np.array([(25.0, low), (25.0, high), (32.0, high), (32.0, low)])
    near, far = flat_tetrahedra.flat([np.full((4, 4), 20.0), *np.broadcast_arrays(*rows.T[:, :, None], *columns.T[:, None, :])])
    table = [
        (18.224843, 33.066021, 18.663512, 5.990268),
        (11.161958, 23.997293, 7.063102, 8.063168),
        (22.588305, 37.066797, 20.903973, 10.640848),
        (30.390024, 45.103745, 31.559932, 18.752149),
    ]
    np.testing.assert_allclose(near, table, atol=3e-5)
    # the greatest is 45.1037 at a corner too, the least 3.3160 is not; opposite sides lie beyond
    assert far.min() > near.max()


@pytest.mark.parametrize(
    ("a12", "values"),
    [(45.2, (10.316, 17.429, 46.851, 54.999)), (50.0, (10.565, 18.457, 41.627, 50.309)), (55.0, (None, None, 34.38, None))],
)
def test_thesis_4_3_second_iteration(a12: float, values: tuple[float | None, ...]) -> None:
    """|A3B3| at which A1 A2 A3 B3 is flat when |A1A2| is made longer: 30 to 37 is free at 45.2 and 50, not at 55. The first iteration of
    the thesis makes |A3B3| at least 29.8283, and 74.8283 with 45."""
    low, high = 35.316034, 41.962389
    t = flat_tetrahedra.Tetrahedron("a12", "a1b3", "a2b3", "a13", "a23", "a3b3")
    own = {"a12": (a12, a12), "a1b3": (low, high), "a2b3": (low, high), "a13": (35.0, 35.0), "a23": (25.0, 25.0)}
    found = flat_tetrahedra.bands(t, own, "a3b3")
    got = (found.near.low[0], found.near.high[1], found.far.low[0], found.far.high[1])
    for mine, printed in zip(got, values, strict=True):
        assert printed is None or mine == pytest.approx(printed, abs=2e-2 if printed == 34.38 else 2e-3)
    assert flat_tetrahedra.clear(t, own | {"a3b3": (30.0, 37.0)}) == (a12 < 55.0)


def test_thesis_4_3_extremes_are_not_all_at_corners() -> None:
    """The least flat distance A1A2 is 3.316, not the 5.990 of the table's corners; opposite sides begin at 54.4018."""
    low, high = 35.316034, 41.962389
    t = flat_tetrahedra.Tetrahedron("b", "a1b2", "a1b3", "a2b2", "a2b3", "a12")
    own = {"b": (20.0, 20.0), "a1b2": (low, high), "a1b3": (low, high), "a2b2": (25.0, 32.0), "a2b3": (low, high)}
    found = flat_tetrahedra.bands(t, own, "a12")
    got = (found.near.low[0], found.near.high[1], found.far.low[0], found.far.high[1])
    np.testing.assert_allclose(got, [3.3160, 45.1037, 54.4018, 73.9624], atol=6e-4)


@laws
@given(seeds, st.sampled_from(["xy", "px", "py", "qx", "qy", "pq"]))
def test_bands_hold_every_flat_value_of_draws(seed: int, edge: str) -> None:
    rng = np.random.default_rng(seed)
    X, Y, P, Q = rng.normal(size=(4, 3))
    d = {
        k: float(np.linalg.norm(a - b)) for k, a, b in (("xy", X, Y), ("px", X, P), ("py", Y, P), ("qx", X, Q), ("qy", Y, Q), ("pq", P, Q))
    }
    limits = {k: (v * (1.0 - w), v * (1.0 + w)) for (k, v), w in zip(d.items(), rng.uniform(0.0, 0.08, 6), strict=True)}
    t = flat_tetrahedra.Tetrahedron("xy", "px", "py", "qx", "qy", "pq")
    found, named = flat_tetrahedra.bands(t, limits, edge), t.seen_from(edge)
    draws = [rng.uniform(*limits[getattr(named, e)], 4000) for e in flat_tetrahedra.EDGES]
    near, far = flat_tetrahedra.flat(draws)
    fine = np.isfinite(near)
    assert fine.any()
    for band, values in ((found.near, near[fine]), (found.far, far[fine])):
        assert band.low[0] <= values.min()
        assert values.max() <= band.high[1]
        # and no wider than they are, where they could be enclosed sharply: corners come close, as draws do
        if band.high[1] - band.high[0] <= 2.0 * flat_tetrahedra.TOLERANCE * max(high for _, high in limits.values()):
            assert band.high[1] - values.max() <= 0.6 * (values.max() - values.min()) + 1e-3
    # a tetrahedron between is never flat
    if found.safe is not None:
        middle = 0.5 * sum(found.safe)
        for k in range(5):
            edges = {e: float(v[k]) for e, v in zip(flat_tetrahedra.EDGES, draws, strict=True)}
            assert volume(edges | {"pq": middle}) > 0.0


@pytest.mark.parametrize("seed", range(4))
def test_bands_hold_every_flat_value_where_there_is_no_time_to_look_closely(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flat_tetrahedra, "BOXES", 6)
    rng = np.random.default_rng(seed)
    limits = {e: (0.85 * v, 1.15 * v) for e, v in zip(flat_tetrahedra.EDGES, rng.uniform(0.9, 1.1, 5), strict=True)} | {"pq": (1.0, 1.0)}
    found = flat_tetrahedra.bands(flat_tetrahedra.Tetrahedron("xy", "px", "py", "qx", "qy", "pq"), limits, "pq")
    # corners and middles too, where extremes are
    parts = np.stack(np.meshgrid(*[[0.0, 0.5, 1.0]] * 5), axis=-1).reshape(-1, 5)
    parts = np.concatenate([parts, rng.uniform(size=(4000, 5))])
    draws = [low + part * (high - low) for part, (low, high) in zip(parts.T, (limits[e] for e in flat_tetrahedra.EDGES), strict=True)]
    for band, values in zip((found.near, found.far), flat_tetrahedra.flat(draws), strict=True):
        assert band.low[0] <= np.nanmin(values)
        assert np.nanmax(values) <= band.high[1]
        assert band.low[0] <= band.low[1] <= band.high[0] <= band.high[1]


def test_whether_everything_in_a_box_can_be_assembled() -> None:
    """Over a side of 1 edges of 0.5 and of 0.4 to 0.6 meet, or do not; of 0.8 and 0.8 to 0.81 they do."""
    some, every = [(1.0, 1.0), (0.4, 0.6), (0.5, 0.5)], [(1.0, 1.0), (0.8, 0.81), (0.8, 0.8)]
    boxes = np.array([[*some, *every[1:]], [*every, *some[1:]], [*every, *every[1:]]])
    for side in (1.0, -1.0):
        assert flat_tetrahedra.enclosed(boxes, side)[2].tolist() == [False, False, True]


def test_limits_that_are_none_are_refused() -> None:
    with pytest.raises(StructureError, match="has no edge"):
        flat_tetrahedra.bands(T1, LIMITS, "l6")
    with pytest.raises(StructureError, match="least before greatest"):
        flat_tetrahedra.bands(T1, LIMITS | {"l1": (3.5, 3.0)}, "l3")
    with pytest.raises(StructureError, match="cannot be assembled"):
        flat_tetrahedra.bands(T1, LIMITS | {"l1": (9.0, 9.5)}, "l3")
    for wrong in ((0.0, 3.5), (-1.0, 3.5), (3.0, np.inf), (np.nan, 3.5)):
        with pytest.raises(StructureError, match="of b12, l1, l2, b13, b23: must be positive"):
            flat_tetrahedra.bands(T1, LIMITS | {"l1": wrong}, "l3")


# all edges but PQ are what they are, and PQ is flat at two lengths
FIVE = {"xy": 5.0, "px": 4.0, "py": 4.5, "qx": 3.0, "qy": 3.5}
OWN = {name: (v, v) for name, v in FIVE.items()}
NEAR, FAR = (float(v) for v in flat_tetrahedra.flat(np.array(list(FIVE.values()))))
SIX = flat_tetrahedra.Tetrahedron("xy", "px", "py", "qx", "qy", "pq")


def test_what_varies_nothing_has_bands_of_one_number() -> None:
    found = flat_tetrahedra.bands(SIX, OWN, "pq")
    for band, value in ((found.near, NEAR), (found.far, FAR)):
        assert (*band.low, *band.high) == pytest.approx([value] * 4, rel=1e-12)
        assert band.low[0] <= value <= band.high[1]
        assert 0.0 <= band.sharp < 1e-12
    assert flat_tetrahedra.Band((1.0, 1.5), (3.0, 3.25)).sharp == 0.5
    assert flat_tetrahedra.Band((1.0, 1.125), (3.0, 3.25)).sharp == 0.25
    assert flat_tetrahedra.safe_band([SIX], OWN, "pq") == pytest.approx((NEAR, FAR), rel=1e-12)
    assert flat_tetrahedra.safe_band([SIX], OWN, "other") is None
    assert not flat_tetrahedra.Flat(flat_tetrahedra.Band((1.0, 1.0), (2.0, 2.0)), flat_tetrahedra.Band((2.0, 2.0), (3.0, 3.0))).safe


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ((NEAR - 0.5, 4.0), (NEAR + 0.25, 4.0)),
        ((3.0, FAR + 1.0), (3.0, FAR - 0.25)),
        ((NEAR - 0.5, FAR + 1.0), (NEAR + 0.25, FAR - 0.25)),
        # nothing in common with what is safe: as wide as before, in its middle
        ((FAR + 1.0, FAR + 1.5), ((NEAR + FAR) / 2.0 - 0.25, (NEAR + FAR) / 2.0 + 0.25)),
        ((0.1, 0.3), ((NEAR + FAR) / 2.0 - 0.1, (NEAR + FAR) / 2.0 + 0.1)),
        ((FAR + 1.0, FAR + 21.0), (NEAR + 0.25, FAR - 0.25)),
        # the edge is safe as it stands
        ((3.0, 4.0), (3.0, 4.0)),
        ((NEAR + 0.125, 4.0), (NEAR + 0.125, 4.0)),
    ],
)
def test_limits_are_cut_to_what_is_safe_but_for_a_margin(given: tuple[float, float], expected: tuple[float, float]) -> None:
    assert flat_tetrahedra.clear(SIX, OWN | {"pq": given}) == (given == expected)
    found = flat_tetrahedra.adjusted([SIX], OWN | {"pq": given}, ["pq"], 0.25)
    assert found["pq"] == pytest.approx(expected, abs=3e-9)
    assert {name: found[name] for name in OWN} == OWN
    assert flat_tetrahedra.clear(SIX, flat_tetrahedra.adjusted([SIX], OWN | {"pq": given}, ["pq"]))


def test_limits_that_no_edge_can_make_safe_are_named() -> None:
    wide, half = OWN | {"pq": (0.1, 9.0)}, (FAR - NEAR) / 2.0
    assert flat_tetrahedra.adjusted([SIX], wide, ["pq"], half - 1e-3)["pq"] == pytest.approx(((NEAR + FAR) / 2.0,) * 2, abs=1.1e-3)
    for adjustable, margin in ((["pq"], half + 1e-3), (["xy", "other"], 0.0)):
        with pytest.raises(StructureError, match="tetrahedron xy, px, py, qx, qy, pq: may be flat") as determined:
            flat_tetrahedra.adjusted([SIX], wide, adjustable, margin)
        assert str(determined.value).endswith(f"for any {', '.join(adjustable)}")
    # two that share an edge: what is safe for both, and none where that is nothing
    other = flat_tetrahedra.Tetrahedron("a", "px", "py", "qx", "qy", "pq")
    both = OWN | {"a": (6.0, 6.0)}
    each = [float(v) for v in flat_tetrahedra.flat(np.array([6.0, *list(FIVE.values())[1:]]))]
    assert flat_tetrahedra.safe_band([SIX, other], both, "pq") == pytest.approx((max(NEAR, each[0]), min(FAR, each[1])), rel=1e-12)
    small = flat_tetrahedra.Tetrahedron("s", "t", "t", "t", "t", "pq")
    assert flat_tetrahedra.safe_band([SIX, small], OWN | {"s": (1.0, 1.0), "t": (1.0, 1.0)}, "pq") == pytest.approx(
        (NEAR, 3.0**0.5), rel=1e-12
    )
    assert flat_tetrahedra.safe_band([SIX, small], OWN | {"s": (1.0, 1.0), "t": (0.6, 0.6)}, "pq") is None


@laws
@given(seeds)
def test_intervals_hold_what_their_operations_give(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = np.sort(rng.normal(size=(2, 50, 2)), axis=-1)
    positive = b - b[:, :1] + 0.1
    x, y, z = (rng.uniform(i[:, 0], i[:, 1]) for i in (a, b, positive))
    for found, value in [
        (intervals.add(a, b), x + y),
        (intervals.sub(a, b), x - y),
        (intervals.mul(a, b), x * y),
        (intervals.div(a, positive), x / z),
        (intervals.square(a), x * x),
        (intervals.root(positive), np.sqrt(z)),
    ]:
        assert (found[:, 0] <= value).all()
        assert (value <= found[:, 1]).all()
    for of_two in (intervals.add, intervals.sub, intervals.mul):
        np.testing.assert_array_equal(of_two(a[:, None], b[:, None]), of_two(a, b)[:, None])
    for of_one in (intervals.square, intervals.root):
        np.testing.assert_array_equal(of_one(positive[:, None]), of_one(positive)[:, None])
    determined = intervals.sign(a)
    assert (np.sign(x)[determined != 0] == determined[determined != 0]).all()
    assert set(np.unique(determined)) <= {-1.0, 0.0, 1.0}


def test_thesis_4_2_what_is_printed_can_hardly_be_assembled() -> None:
    """At l3 = 4.54 tetrahedron P1 B2 B3 P2 closes in 5.4 % of the limits of l2, l4, l5, at 4.9 nowhere."""
    rng = np.random.default_rng(0)
    l2, l4, l5 = rng.uniform((3.0, 3.5, 3.5), (3.5, 4.0, 4.0), (200_000, 3)).T
    near, far = flat_tetrahedra.flat([l4, l2, np.full_like(l2, 1.5), np.full_like(l2, 2.4), l5])
    named = T2.seen_from("l3")
    assert (named.xy, named.px, named.py, named.qx, named.qy) == ("l4", "l2", "p12", "b23", "l5")
    assert ((near <= 4.54) & (far >= 4.54)).mean() == pytest.approx(0.054, abs=0.002)
    assert not ((near <= 4.9) & (far >= 4.9)).any()


@laws
@given(seeds)
def test_seen_from_each_edge_it_is_the_same_tetrahedron(seed: int) -> None:
    """The volume tells: edges that are exchanged otherwise enclose another one, or none."""
    corners = np.random.default_rng(seed).normal(size=(4, 3))
    ends = {"xy": (0, 1), "px": (2, 0), "py": (2, 1), "qx": (3, 0), "qy": (3, 1), "pq": (2, 3)}
    d = {k: float(np.linalg.norm(corners[a] - corners[b])) for k, (a, b) in ends.items()}
    t = flat_tetrahedra.Tetrahedron(*ends)
    for edge in ends:
        named = t.seen_from(edge)
        assert named.pq == edge
        assert volume({k: d[name] for k, name in vars(named).items()}) == pytest.approx(volume(d), rel=1e-9)
