"""The page of a trajectory: what is left out is seen in every number of samples, in both languages, of any instrument."""

import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from browser import opened

from lmeasure.accuracy import along, kept_rows
from lmeasure.accuracy.trajectory_quality import MOST_ROWS
from lmeasure.core import Status
from lmeasure.io import columns_of
from lmeasure.recording import read_run
from lmeasure.report import trajectory_summary, write_trajectory_page
from lmeasure.report.readable import page_text
from lmeasure.report.trajectory import space_figure, time_figure
from lmeasure.text import Cause, message
from lmeasure.trajectory import RESTORED_ORIGIN, Stated, Trajectory, read_trajectory, reconstruct, write_trajectory

TRUTH = Path(__file__).parents[1] / "authorities" / "truth"


def circle(samples: int, seconds: float = 10.0) -> Trajectory:
    """A tool on a circle of 100 mm, one turn, U95 known, turning about Z."""
    turn = np.linspace(0.0, 2.0 * np.pi, samples)
    nothing = np.zeros(samples)
    poses = np.column_stack([100 * np.cos(turn), 100 * np.sin(turn), nothing, nothing, nothing, np.sin(turn / 8), np.cos(turn / 8)])
    random = np.tile(np.diag([1e-10] * 3 + [1e-4] * 3), (samples, 1, 1))
    empty = np.full(samples, "", dtype=np.object_)
    gone = np.full(samples, np.nan)
    status = np.zeros(samples, np.int64)
    time_s = np.linspace(0.0, seconds, samples)
    return Trajectory(time_s, poses, gone, status.copy(), status, empty, empty.copy(), gone, random, np.zeros((samples, 6, 6)), "a test")


def lost(trajectory: Trajectory, first: int, last: int, status: Status, cause: Cause, cable: str) -> Trajectory:
    """Without these samples, or without a cable in them."""
    own = slice(first, last + 1)
    columns = {name: getattr(trajectory, name).copy() for name in ("status", "cause", "cable", "poses", "random")}
    columns["status"][own], columns["cause"][own], columns["cable"][own] = int(status), cause, cable
    if status != Status.OK:
        columns["poses"][own], columns["random"][own] = np.nan, np.nan
    return replace(trajectory, **columns)


def test_what_is_said_of_a_circle() -> None:
    found = along(lost(circle(2001), 500, 549, Status.GAP, "channel ch2 has no count", "c2"))
    reported = dict(trajectory_summary(found, "en"))
    assert reported["Duration"] == "10 s"
    assert reported["Samples"] == "2001, 200 per second"
    assert reported["With a pose"] == "1951 (97.5 %)"
    # three equal axes of 10 um: the sphere that holds 95 % has a radius of 2.7955 of them
    assert float(reported["Largest U95 of the position (radius)"].split()[0]) == pytest.approx(27.955, abs=0.01)
    assert float(reported["Largest speed"].split()[0]) == pytest.approx(2 * np.pi * 10, rel=1e-3)
    assert float(reported["Length of the path"].split()[0]) == pytest.approx(200 * np.pi, rel=5e-3)
    assert np.nanmax(np.abs(found.rotation_deg - np.column_stack([np.zeros((2001, 2)), np.linspace(0, 90, 2001)]))) < 1e-6
    russian = dict(trajectory_summary(found, "ru"))
    # between numbers whose decimal mark is a comma stands something else
    assert russian["Наибольшая U95 положения (радиус)"].count("; ") == 2
    assert russian["С известной позой"] == "1951 (97,5 %)"


def test_a_million_samples_are_thinned_and_no_fault_is_hidden() -> None:
    n = 200_000
    rng = np.random.default_rng(1)
    made = circle(n, 400.0)
    single = np.sort(rng.choice(np.arange(10, n - 10), 40, replace=False))
    for sample in single.tolist():
        made.status[sample], made.cause[sample], made.poses[sample] = int(Status.JUMP), "a jump", np.nan
    worst = 123_457
    while worst in single:
        worst += 1
    made.random[worst] *= 25.0
    found = along(made)
    assert len(found.rows) <= MOST_ROWS + 4 * len(single)
    assert set(single.tolist()) <= set(found.rows.tolist())
    assert worst in found.rows
    assert found.worst == worst
    figure = time_figure(found)
    (lane,) = [t for t in figure.data if t.mode == "lines+markers"]
    begun = {round(float(t), 9) for t in lane.x[::3]}
    assert begun == {round(float(t), 9) for t in made.time_s[single]}
    # a line that would cross a fault is broken there
    (x,) = [t for t in figure.data if t.name == "X" and t.yaxis == "y"]
    assert np.isnan(np.asarray(x.y)[np.isin(found.rows, single)]).all()


@pytest.mark.parametrize("size", [10, 1000, 4001])
def test_rows_that_are_kept_have_the_extremes_of_every_piece(size: int) -> None:
    rng = np.random.default_rng(size)
    series = [rng.normal(size=size), rng.normal(size=size)]
    series[1][rng.random(size) < 0.3] = np.nan
    rows = kept_rows(series, np.array([3, 7]), 100)
    assert (np.diff(rows) > 0).all()
    assert {0, 3, 7, size - 1} <= set(rows.tolist())
    assert len(rows) <= 104
    for values in series:
        assert np.nanmin(values[rows]) == np.nanmin(values)
        assert np.nanmax(values[rows]) == np.nanmax(values)


def test_the_path_marks_where_it_broke_off() -> None:
    found = along(lost(lost(circle(500), 100, 120, Status.GAP, "g", "c1"), 300, 310, Status.OK, "", "c5"))
    marks = {t.name: t for t in space_figure(found, None).data if t.mode == "markers"}
    assert marks["no pose from here"].x[0] == found.trajectory.poses[99, 0]
    assert "c5" in marks["without a cable"].text[0]


@pytest.mark.parametrize(
    ("language", "heading", "state", "lane"),
    [
        ("en", "excluded or restored", "ok, origin restored", "origin restored"),
        ("ru", "исключено или восстановлено", "известно, нуль восстановлен", "нуль восст."),
    ],
)
def test_a_cable_from_a_restored_origin_is_not_called_left_out(language: str, heading: str, state: str, lane: str, tmp_path: Path) -> None:
    restored = message(RESTORED_ORIGIN, cable="c3", after_s=2.0)
    found = along(lost(circle(500), 100, 499, Status.OK, restored, "c3"))
    (marked,) = (t for t in space_figure(found, None, language).data if t.mode == "markers")
    assert marked.name == state
    assert marked.text[0].startswith(state)
    over_time = time_figure(found, language)
    assert over_time.layout.annotations[-1].text == heading
    assert set(over_time.data[-1].y) == {lane, None}
    write_trajectory_page(tmp_path / "t.html", "t", found, None, inputs=[], language=language)
    text = page_text((tmp_path / "t.html").read_bytes())
    assert state in text
    both = along(lost(found.trajectory, 20, 30, Status.OK, "", "c5"))
    assert {t.name for t in space_figure(both, None).data if t.mode == "markers"} == {"ok, origin restored", "without a cable"}


def test_bands_are_spoken_of_where_they_are(tmp_path: Path) -> None:
    made = circle(50)
    for random, said in ((made.random, True), (np.full_like(made.random, np.nan), False), (np.zeros_like(made.random), False)):
        write_trajectory_page(tmp_path / "t.html", "t", along(replace(made, random=random)), None, inputs=[])
        text = page_text((tmp_path / "t.html").read_bytes())
        assert "local cubics" in text
        assert ("Bands contain 95 % of each coordinate." in text) is said
        assert ("Its band includes" in text) is said


@pytest.mark.parametrize("language", ["en", "ru"])
def test_pages_in_a_browser_at_any_width(language: str, tmp_path: Path) -> None:
    run = read_run(TRUTH / "cell-run")
    made = lost(reconstruct(run), 300, 380, Status.GAP, message("cause.no_count", channel="<b>"), "c2")
    page_file = tmp_path / "trajectory.html"
    write_trajectory_page(page_file, "<i>run</i>", along(made), run.rig, inputs=[("pass1.csv", "0" * 64)], language=language)
    with opened(page_file) as page:
        for width in (390, 1400, 2560):
            page.call("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False)
            page.wait("document.querySelectorAll('.js-plotly-plot .main-svg').length > 0 && document.querySelector('canvas') !== null")
            page.wait(f"document.documentElement.scrollWidth <= {width}", 20.0)
        assert page.errors == []
    text = page_text(page_file.read_bytes())
    assert {"en": "channel <b> has no count", "ru": "в канале <b> нет отсчёта"}[language] in text
    assert ("81 of 2000" if language == "en" else "81 из 2000") in text
    assert 'src="http' not in page_file.read_text(encoding="utf-8")


def test_a_trajectory_of_another_instrument(tmp_path: Path) -> None:
    made = circle(50)
    write_trajectory(tmp_path / "t.tum", made)
    rows = np.column_stack([made.time_s * 1e9, made.poses[:, :3] / 1e3, made.poses[:, [6, 3, 4, 5]]])
    header = "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"
    np.savetxt(tmp_path / "euroc.csv", rows, ["%d", *["%.12g"] * 7], ",", header=header, comments="")
    lines = [f"{t * 1e3:.9f};{x / 1e3:.12f};{y / 1e3:.12f};0,0" for t, (x, y, *_) in zip(made.time_s, made.poses, strict=True)]
    (tmp_path / "tracker.csv").write_text("\n".join(["t;X;Y;Z", *(line.replace(".", ",") for line in lines)]))
    mapped = columns_of("time=t[ms],x=X[m],y=Y[m],z=Z[m]")
    for name, columns, turned in (("t.tum", {}, True), ("euroc.csv", {}, True), ("tracker.csv", mapped, False)):
        read = read_trajectory(tmp_path / name, Stated(columns))
        assert read.time_s == pytest.approx(made.time_s, abs=1e-9)
        assert read.poses[:, :3] == pytest.approx(made.poses[:, :3], abs=1e-6)
        assert np.isnan(read.poses[:, 3]).all() != turned
        if turned:
            assert read.poses[:, 3:] == pytest.approx(made.poses[:, 3:], abs=1e-9)
        found = along(read)
        assert found.worst is None
        assert dict(trajectory_summary(found, "en"))["Largest U95 of the position (radius)"] == "not stated"
        write_trajectory_page(tmp_path / "t.html", "t", found, None, inputs=[])
        assert ("rotation vectors" in page_text((tmp_path / "t.html").read_bytes())) is turned
    stated = along(read_trajectory(tmp_path / "tracker.csv", Stated(mapped, 0.01)))
    assert dict(trajectory_summary(stated, "en"))["Largest U95 of the rotation (radius)"] == "orientation not measured"
    assert stated.u95_mm == pytest.approx(np.full(50, 0.027955), rel=1e-4)
    write_trajectory(tmp_path / "own.parquet", made)
    assert read_trajectory(tmp_path / "own.parquet").u == pytest.approx(made.u, rel=1e-12)


def test_the_catalogues_have_the_same_keys() -> None:
    from lmeasure.text import texts

    assert list(texts("en", "trajectory")) == list(texts("ru", "trajectory"))
    assert json.dumps(dict(texts("ru", "trajectory"))) != json.dumps(dict(texts("en", "trajectory")))


def test_titles_of_lanes_have_room_however_few_they_are() -> None:
    found = circle(101)
    for one in (found, replace(found, random=np.full_like(found.random, np.nan), poses=np.where(np.arange(7) < 3, found.poses, np.nan))):
        layout = time_figure(along(one)).layout
        high = layout.height - layout.margin.t - layout.margin.b
        lanes = sorted((layout[axis].domain for axis in layout if axis.startswith("yaxis")), reverse=True)
        assert len(lanes) > 1
        assert all((above[0] - below[1]) * high > 40.0 for above, below in itertools.pairwise(lanes))
        # the legend stands over the first title
        assert (layout.legend.y - 1.0) * high > 30.0
