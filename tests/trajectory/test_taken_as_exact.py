"""What nobody stated is said to be taken as exact, with what a usual size of it would add to this very run, calibration or zone."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import real_rig
from numpy.typing import NDArray
from test_unsolved import START, nominal, run_of, truth

from lmeasure.accuracy import scan_zone, tilts
from lmeasure.calibration import Campaign, calibrate
from lmeasure.recording import Poses, Run, read_run_head, write_run
from lmeasure.report import write_calibration_page, zone_text
from lmeasure.rig import TYPICAL_SIZES, CalibrationRecord, Rig, rig_from_dict
from lmeasure.sensors import ATTACHMENT, ECCENTRICITY, OFFSET, Taken, counts_from_poses, stated_errors
from lmeasure.sensors.effect_laws import BACKLASH, EFFECTS, FRICTION, CableEffect
from lmeasure.text import ENGLISH
from lmeasure.trajectory import Trajectory, reconstruct, reconstruct_stream

FloatArray = NDArray[np.float64]

WHAT = [kind.text for kind in EFFECTS] + ["temperature"]


def way(seed: int = 2, count: int = 60) -> FloatArray:
    return real_rig.path(np.random.default_rng(seed), count)


def plain_run(seed: int = 2) -> Run:
    true, poses = truth(seed), way(seed)
    return run_of(rig_from_dict(nominal(true)), np.rint(true.true_counts(poses, poses[0])))


def taken(run: Run) -> dict[str, Taken]:
    return {t.text: t for t in reconstruct(run).taken_as_exact}


def largest_systematic(found: Trajectory) -> float:
    return float(np.sqrt(np.einsum("nii->n", found.systematic[:, 3:, 3:]).max()))


def with_usual(rig: Rig, kind: CableEffect) -> Rig:
    """The rig that states the usual size of one kind."""
    u = TYPICAL_SIZES[kind.key].value * (real_rig.COUNT_MM if kind.of else 1.0)
    if kind is ATTACHMENT:
        return rig.model_copy(update={kind.key: u})
    points = [
        p.model_copy(update={kind.key: u})
        if kind in (ECCENTRICITY, OFFSET)
        else p.model_copy(update={"drum": p.drum.model_copy(update={kind.key: u})})
        for p in rig.observation_point
    ]
    return rig.model_copy(update={"observation_point": tuple(points)})


@pytest.mark.parametrize("kind", EFFECTS, ids=lambda k: k.text)
def test_what_a_usual_size_would_add_is_what_stating_it_adds(kind: CableEffect) -> None:
    run = plain_run()
    before = taken(run)
    assert list(before) == WHAT
    assert str(kind.said) == kind.text
    found = reconstruct(replace(run, rig=with_usual(run.rig, kind)))
    # at the start itself, where play has not been crossed, the table is on the safe side
    assert before[kind.text].mm == pytest.approx(largest_systematic(found), rel=0.02)
    assert kind.text not in {t.text for t in found.taken_as_exact}
    assert len(found.taken_as_exact) == len(WHAT) - 1


@pytest.mark.parametrize("kind", [kind for kind in EFFECTS if kind is not ATTACHMENT], ids=lambda k: k.text)
def test_of_a_point_that_is_measured_too(kind: CableEffect) -> None:
    """Three cables to one point: its place in the tool frame does not enter, and no orientation is known to look from."""
    true, poses = truth(4), way(4)
    true = replace(true, tied=np.zeros(len(true.tied), dtype=np.int64))
    data, counts = nominal(true), np.rint(true.true_counts(poses, poses[0]))
    first = [f"B{j}" for j in (1, 3, 5)]
    data["observation_point"] = [p for p in data["observation_point"] if p["name"] in first]
    data["cable"] = [c for c in data["cable"] if c["from"] in first]
    run = run_of(rig_from_dict(data), counts[:, [0, 2, 4]])
    before = taken(run)
    assert list(before) == [text for text in WHAT if text != ATTACHMENT.text]
    found = reconstruct(replace(run, rig=with_usual(run.rig, kind)))
    assert before[kind.text].mm == pytest.approx(largest_systematic(found), rel=0.02)


def test_the_summary_says_it_in_one_line() -> None:
    text = reconstruct(plain_run()).summary()
    (line,) = [line for line in text.splitlines() if line.startswith("taken as exact")]
    assert re.search(r"count length \(0\.05 %\) 0\.\d+, groove pitch \(0\.01 mm\) 0\.\d+, run-out of drums \(0\.02 mm\) ", line)
    assert "temperature (5 K since zeroing) " in line


def test_a_run_in_pieces_says_the_same(tmp_path: Path) -> None:
    run = plain_run()
    write_run(tmp_path / "run", run)
    summary = reconstruct_stream(read_run_head(tmp_path / "run"), tmp_path / "out.parquet")
    assert summary.text() == reconstruct(run).summary()


def test_pieces_are_put_together_by_where_each_is_worst() -> None:
    backlash, friction = ((kind.said, TYPICAL_SIZES[kind.key].size) for kind in (BACKLASH, FRICTION))
    pieces = [Taken(*backlash, 0.1), Taken(*friction, 0.3), Taken(*backlash, 0.2)]
    assert stated_errors.worst(pieces) == (Taken(*backlash, 0.2), Taken(*friction, 0.3))


def record_of(rig: Rig, temperature_c: float | None) -> CalibrationRecord:
    return CalibrationRecord(
        rig=rig.name, parameters=(), covariance=(), residuals=(), equations=0, unknowns=0, rank=0, temperature_c=temperature_c
    )


@pytest.mark.parametrize(
    ("of_run", "of_record", "determined"),
    [
        (None, None, "5 K since zeroing"), (25.0, None, "5 K since zeroing"), (None, 21.0, "5 K since zeroing, calibrated at 21.0 deg C"),
        (25.0, 20.0, "up to 5.0 K off the calibration's 20.0 deg C"), (20.2, 20.0, None),
    ],
)  # fmt: skip
def test_temperature_that_is_not_stated_or_differs_is_flagged(
    of_run: float | None, of_record: float | None, determined: str | None
) -> None:
    run = plain_run()
    run = replace(run, calibration=record_of(run.rig, of_record), temperature_c=of_run)
    found = taken(run)
    assert (found["temperature"].usual if determined else found.get("temperature")) == determined
    # a rig that says how it grows, in a run that says how warm it was, has it all in its budget
    grown = run.rig.model_copy(update={"frame_expansion_per_k": 1.2e-5})
    assert ("temperature" in taken(replace(run, rig=grown))) == (of_run is None)


def test_a_rig_without_calibration_has_its_dimensions_at_its_reference() -> None:
    run = replace(plain_run(), temperature_c=26.0)
    note = [line for line in reconstruct(run).summary().splitlines() if line.startswith("note: no thermal expansion")]
    assert len(note) == 1
    assert note[0].startswith(
        "note: no thermal expansion is stated, and the temperature was up to 6.0 K off the rig's 20.0 deg C; steel would add up to 0.0"
    )


def test_sizes_of_temperature_are_those_of_rigs_that_grow() -> None:
    """A whole rig 5 K warmer by the forward model; a cable that warms after it was zeroed by the model of physical effects."""
    true, poses = truth(2), way()
    rig = rig_from_dict(nominal(true))
    warm = real_rig.without(true, expansion_per_k=stated_errors.EXPANSION_PER_K)
    plain = reconstruct(run_of(rig, true.true_counts(poses, poses[0]))).poses[:, :3]

    def off(counts: FloatArray) -> float:
        return float(np.linalg.norm(reconstruct(run_of(rig, counts)).poses[:, :3] - plain, axis=1).max())

    run = plain_run()
    scaled = taken(replace(run, calibration=record_of(rig, 20.0), temperature_c=25.0))["temperature"].mm
    assert off(warm.true_counts(poses, poses[0], warmer_k=5.0)) == pytest.approx(scaled, rel=0.02)
    data = nominal(true)
    for p in data["observation_point"]:
        p["drum"] |= {"cable_expansion_per_k": stated_errors.EXPANSION_PER_K}
    later = counts_from_poses(rig_from_dict(data), poses, START, None, temperature_c=np.full(len(poses), 25.0), zero_temperature_c=20.0)
    assert off(later) == pytest.approx(taken(run)["temperature"].mm, rel=0.05)


def campaign(temperature_c: FloatArray | None = None) -> Campaign:
    rng, true = np.random.default_rng(4), truth(4)
    rows = real_rig.scattered(rng, 14)
    rig = rig_from_dict(nominal(true))
    reference = Poses(tuple(str(i) for i in range(14)), rows, np.full(14, 0.02), np.full(14, 1e-4))
    counts = np.rint(true.true_counts(rows, rows[0]))
    return Campaign(rig, reference, rig.cable, counts, np.zeros(6, dtype=np.int64), temperature_c=temperature_c)


def test_a_calibration_lists_it_and_its_page_has_a_table(tmp_path: Path) -> None:
    found = calibrate(campaign())
    assert [t["text"] for t in found.record.taken_as_exact] == WHAT
    assert all(t["mm"] > 0 for t in found.record.taken_as_exact)
    assert not [w for w in found.record.warnings if w.code == "temperature"]
    write_calibration_page(tmp_path / "report.html", found)
    page = (tmp_path / "report.html").read_text()
    assert "NOT included in the uncertainty (no value given)" in page
    assert "eccentric pulleys" in page


def test_a_campaign_that_warmed_is_warned_of() -> None:
    warm = np.repeat(np.linspace(18.0, 26.0, 14)[:, None], 6, axis=1)
    found = calibrate(campaign(warm))
    (warning,) = [w for w in found.record.warnings if w.code == "temperature"]
    assert "up to 4.0 K off the campaign's mean of 22.0 deg C" in warning.text
    assert found.record.temperature_c == pytest.approx(22.0)
    assert warning.value is not None
    assert warning.value > 0.01


def test_a_rig_that_grows_wants_to_know_how_warm_it_was() -> None:
    base = campaign()
    grown = replace(base, rig=base.rig.model_copy(update={"frame_expansion_per_k": 1.2e-5}))
    (warning,) = [w for w in calibrate(grown).record.warnings if w.code == "temperature"]
    assert warning.text == "the rig has expansion coefficients, but no file has a temperature_c; the rig's reference, 20 deg C, is used"


def test_a_zone_says_it_on_its_page() -> None:
    x, y, z = (np.linspace(-100.0, 100.0, 3) for _ in range(3))
    zone = scan_zone(rig_from_dict(nominal(truth(2))), None, x=x, y=y, z=z, rotations=tilts(0.0, 1), limit_deg=80.0)
    lines = zone_text.taken_as_exact(zone, ENGLISH)
    assert [line.split(":")[1].split(";")[0].strip() for line in lines] == WHAT


def test_certificates_in_russian_say_it_in_russian() -> None:
    for t in reconstruct(plain_run()).taken_as_exact:
        assert not re.search("[a-z]{3}", t.said.text("ru")), t.said
