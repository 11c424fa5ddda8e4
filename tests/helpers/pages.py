"""One page of every kind that the program writes, small, in a language: what the tests of pages open and read."""

import atexit
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import test_interim as interim
import xarray as xr
from campaigns import write_campaign

from lmeasure.accuracy import along, axis, scan_zone, tilts
from lmeasure.calibration import Calibration, CalibrationSettings, Campaign, Distance, calibrate, compare, read_campaign
from lmeasure.calibration.validation.compare import Earlier
from lmeasure.calibration.validation.guard import AgainstNominal
from lmeasure.certificate import Inputs
from lmeasure.core import se3
from lmeasure.io import columns_of
from lmeasure.iso9283 import CertificationSettings
from lmeasure.procedures import appended, check_instrument
from lmeasure.recording import read_run
from lmeasure.report import Choices, write_calibration_page, write_certificate, write_check_page, write_trajectory_page, write_zone_report
from lmeasure.rig import rig_from_dict, with_values
from lmeasure.robots.robot import shipped
from lmeasure.simulation import cell_rig
from lmeasure.simulation.instrument import simulate_campaign
from lmeasure.trajectory import Stated, read_trajectory, reconstruct
from lmeasure.workflows import load

ROOT = Path(__file__).parents[2]
TRUTH = ROOT / "tests" / "authorities" / "truth"
HOME = np.array([0.0, 0, 0, 0, 0, 0, 1])
LOGO = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 200 60"><rect width="200" height="60" rx="8" fill="#0072b2"/></svg>'
DETAILS = (Path(__file__).parent / "details.toml").read_text(encoding="utf-8")


@cache
def calibrated() -> Calibration:
    """Twelve poses, one held out."""
    return calibrate(read_campaign(TRUTH / "cell-12-poses"), CalibrationSettings(hold_out=("7",)))


@cache
def again() -> Calibration:
    """The same rig with errors of its poses and a robust loss."""
    return calibrate(read_campaign(TRUTH / "cell-20-poses-noisy"), CalibrationSettings(robust=True, seed=1))


@cache
def by_itself() -> Calibration:
    """Seven cables, whose rig and poses are found together."""
    data = cell_rig(1).to_dict()
    seventh = {"name": "B7", "position_mm": [1500.0, 900.0, 300.0], "guide_beta_deg": 59.0}
    data["observation_point"].append(data["observation_point"][0] | seventh)
    data["cable"].append({"name": "c7", "channel": "ch7", "from": "B7", "to": "P2", "pass": 1})
    rig = rig_from_dict(data)
    made = simulate_campaign(
        rig, 16, np.random.default_rng(0), centre=HOME, half_mm=(300,) * 3, tilt_rad=0.4, u_position_mm=2.0, u_rotation_rad=0.01,
        nominal_shift_mm=10.0, nominal_shift_deg=2.0,
    )  # fmt: skip
    zero = np.zeros(len(rig.cable), np.int64)
    campaign = Campaign(made.nominal, made.measured, rig.cable, made.recorded, zero)
    return calibrate(campaign, CalibrationSettings(self_calibration=True))


@cache
def undetermined() -> Calibration:
    """Four poses, which leave directions to the prior."""
    return calibrate(read_campaign(TRUTH / "thesis-4-poses"))


@cache
def zone(limit_deg: float) -> xr.Dataset:
    found, nodes = calibrated(), axis(-300, 300, 100)
    return scan_zone(found.rig, found.record, x=nodes, y=nodes, z=nodes, rotations=tilts(0.2, 2), limit_deg=limit_deg, full=True)


def _calibration(out: Path, language: str) -> Path:
    write_calibration_page(out / "report.html", calibrated(), None, language)
    return out / "report.html"


def _compared(out: Path, language: str) -> Path:
    earlier = Earlier(calibrated().rig, calibrated().record, "earlier")
    write_calibration_page(out / "report.html", again(), compare(earlier, again()), language)
    return out / "report.html"


def _by_itself(out: Path, language: str) -> Path:
    write_calibration_page(out / "report.html", by_itself(), None, language)
    return out / "report.html"


def _undetermined(out: Path, language: str) -> Path:
    write_calibration_page(out / "report.html", undetermined(), None, language)
    return out / "report.html"


def _refused(out: Path, language: str) -> Path:
    why = AgainstNominal(3.2, 1.1, 10, 1e-4).refusal()
    found = calibrated()
    against = {"against_nominal": {"rms_mm": 3.2, "nominal_mm": 1.1, "poses": 10, "p_worse": 1e-4}}
    record = found.record.model_copy(update={"validation": found.record.validation | against})
    refused = replace(found, record=record, refused=why)
    write_calibration_page(out / "report.html", refused, None, language)
    return out / "report.html"


def _zone(out: Path, language: str) -> Path:
    write_zone_report(out, zone(40.0), calibrated().rig, calibrated().record, language=language)
    return out / "zone.html"


def _reliable_zone(out: Path, language: str) -> Path:
    """Of eight cables: which faults would show."""
    requested = {
        "rig": TRUTH / "eight-run" / "rig.toml",
        "out": out / "zone.nc",
        "x": "-300:300:150",
        "y": "-300:300:150",
        "z": "-150:150:150",
    }
    return _ran("zone", requested | {"tilt_rad": 0.2, "reliability": True, "report": out}, language, out / "zone.html")


def _empty_zone(out: Path, language: str) -> Path:
    write_zone_report(out, zone(1.0), calibrated().rig, calibrated().record, language=language)
    return out / "zone.html"


def _trajectory(out: Path, language: str) -> Path:
    run = read_run(TRUTH / "cell-run")
    found = along(reconstruct(run))
    write_trajectory_page(out / "trajectory.html", "cell-run", found, run.rig, inputs=[("run.toml", "0" * 64)], language=language)
    return out / "trajectory.html"


def _doubted_trajectory(out: Path, language: str) -> Path:
    """Of eight cables, one of which loses 300 counts on the way."""
    shutil.copytree(TRUTH / "eight-run", out / "run")
    lines = (out / "run" / "pass1.csv").read_text().splitlines()
    rows = [line.split(",") for line in lines[len(lines) // 2 :]]
    stepped = [",".join([*row[:3], str(int(row[3]) + 300), *row[4:]]) for row in rows]
    (out / "run" / "pass1.csv").write_text("\n".join([*lines[: len(lines) // 2], *stepped]) + "\n")
    return _ran("report", {"measured": out / "run", "out": out}, language, out / "trajectory.html")


def _foreign_trajectory(out: Path, language: str) -> Path:
    """Positions of a tracker, without uncertainty or orientation."""
    time = np.linspace(0.0, 2.0, 300)
    rows = np.column_stack([time, 100 * np.sin(3 * time), 100 * np.cos(3 * time), 20 * time])
    out.mkdir(parents=True, exist_ok=True)
    (out / "tracker.csv").write_text("time_s,x_mm,y_mm,z_mm\n" + "\n".join(",".join(f"{v:.6f}" for v in row) for row in rows) + "\n")
    found = along(read_trajectory(out / "tracker.csv", Stated(columns_of(""), None, None)))
    write_trajectory_page(out / "trajectory.html", "tracker.csv", found, None, inputs=[("tracker.csv", "0" * 64)], language=language)
    return out / "trajectory.html"


def _certificate(out: Path, language: str) -> Path:
    write_campaign(out / "campaign")
    given = Inputs(out / "campaign" / "trajectory.parquet", out / "campaign" / "program.toml", out / "campaign" / "run")
    write_certificate(out / "certificate", given, CertificationSettings(trials=200), Choices(language))
    return out / "certificate" / "report.html"


def _certificate_in_full(out: Path, language: str) -> Path:
    """Thirty cycles, a logo, and the longest names that people give."""
    named = {"P1": "Greifposition über der Vorrichtung am Förderband 3", "line": "Bahn_von_Greifposition_zu_Ablageposition_unbelastet"}
    write_campaign(out / "campaign", named, cycles=30)
    (out / "campaign" / "logo.svg").write_text(LOGO, encoding="utf-8")
    (out / "campaign" / "details.toml").write_text(DETAILS, encoding="utf-8")
    given = Inputs(
        out / "campaign" / "trajectory.parquet",
        out / "campaign" / "program.toml",
        out / "campaign" / "run",
        details=out / "campaign" / "details.toml",
    )
    write_certificate(out / "certificate", given, CertificationSettings(trials=200), Choices(language))
    return out / "certificate" / "report.html"


def _check(out: Path, language: str) -> Path:
    """A point that has moved, with the trend of two checks."""
    rig, _ = interim.calibrated()
    place = rig.point("B3").position_mm
    moved = with_values(interim.true_rig(), {"B3.x_mm": place[0] + 0.5, "B3.y_mm": place[1]})
    known = [Distance("P1", "P2", float(np.linalg.norm(interim.PLACES[0])), 0.02)]
    for number, true in enumerate((interim.true_rig(), moved)):
        found = check_instrument(interim.run_of(true, number)[0], known, interim.LIMITS)
        when = f"2026-0{3 + number}-05T09:00:00Z"
        trend = appended(out / "checks.csv", found, when)
    write_check_page(out / "check.html", found, trend, inputs=[("run.toml", "0" * 64)], language=language, when=when)
    return out / "check.html"


def _checks_of_years(out: Path, language: str) -> Path:
    """The trend of nine checks, a quarter of a year apart."""
    rig, _ = interim.calibrated()
    place = rig.point("B3").position_mm
    out.mkdir(parents=True, exist_ok=True)
    for number in range(9):
        true = with_values(interim.true_rig(), {"B3.x_mm": place[0] + 0.03 * number, "B3.y_mm": place[1]})
        found = check_instrument(interim.run_of(true, number)[0], [], interim.LIMITS)
        when = f"{2024 + number // 4}-{1 + 3 * (number % 4):02d}-05T09:00:00Z"
        trend = appended(out / "checks.csv", found, when)
    write_check_page(out / "check.html", found, trend, inputs=[("run.toml", "0" * 64)], language=language, when=when)
    return out / "check.html"


def _structure(out: Path, language: str) -> Path:
    requested = {"file": TRUTH / "cell-12-poses" / "rig.toml", "position_mm": "0,0,0", "quaternion": "0,0,0,1", "boundary": "xy"}
    return _ran("structure", requested | {"levels": "0:100:50", "to_mm": "100,50,0", "report": out}, language, out / "structure.html")


def _structures(out: Path, language: str) -> Path:
    return _ran("structure", {"listed": True, "report": out}, language, out / "structure.html")


def _identification(out: Path, language: str) -> Path:
    table = np.genfromtxt(ROOT / "datasets" / "ur5" / "grid.csv", delimiter=",", names=True)[::12]
    rows = [[f"P{k}", *(r[f"joint_{i}"] for i in range(1, 7)), *(r[f"{a}_t"] + r[f"{a}_dif"] for a in "xyz")] for k, r in enumerate(table)]
    head = ",".join(["name", *(f"joint_{i}_deg" for i in range(1, 7)), "x_mm", "y_mm", "z_mm"])
    out.mkdir(parents=True, exist_ok=True)
    (out / "rows.csv").write_text("\n".join([head, *(",".join(map(str, row)) for row in rows)]) + "\n")
    return _ran("identify", {"robot": "ur5", "measurements": out / "rows.csv", "out": out / "robot"}, language, out / "robot/report.html")


def _correction(out: Path, language: str) -> Path:
    """Targets of a robot that differs from its nominal one, some of them beyond its reach, skipped or unreadable."""
    nominal, rng = shipped("generic6").model, np.random.default_rng(3)
    sizes = {"theta_deg": 5e-4, "alpha_deg": 5e-4, "beta_deg": 5e-4, "d_mm": 0.3, "a_mm": 0.3}
    true = nominal.moved(np.array([rng.normal() * sizes.get(p.name.rpartition(".")[2], 0.0) for p in nominal.parameters]))
    joints = rng.uniform(-1.5, 1.5, (80, 6))
    joints[:, 4] = rng.choice([-1.0, 1.0], 80) * rng.uniform(0.4, 1.4, 80)
    tool = np.array([10.0, 20.0, 150.0, 0.0, 0.0, 0.0, 1.0])
    places = se3.compose(true.forward(joints), np.broadcast_to(tool, (80, 7)))[:, :3]
    head = ["name", *(f"joint_{i}_deg" for i in range(1, 7))]
    rows = [[f"m{k}", *np.degrees(q), *xyz] for k, (q, xyz) in enumerate(zip(joints, places, strict=True))]
    out.mkdir(parents=True, exist_ok=True)
    (out / "rows.csv").write_text("\n".join([",".join([*head, "x_mm", "y_mm", "z_mm"]), *(",".join(map(str, r)) for r in rows)]) + "\n")
    _ran("identify", {"robot": "generic6", "measurements": out / "rows.csv", "out": out / "robot"}, language, out / "robot" / "report.html")
    targets = [[f"P{k}", *np.degrees(q).round(4)] for k, q in enumerate(joints[:20])]
    lines = [*(",".join(map(str, t)) for t in targets), "P20,0,0,400,0,50,0", "P21,1,2,x,4,5,6"]
    (out / "pick.csv").write_text("\n".join([",".join(head), *lines]) + "\n")
    requested = {"programs": [out / "pick.csv"], "identified": out / "robot", "out": out / "corrected", "skip": "P3", "most_mm": 2.0}
    return _ran("correct", requested, language, out / "corrected" / "corrections.html")


def _ran(command: str, requested: dict[str, Any], language: str, page: Path) -> Path:
    found = load(command)
    found.run(found.settings.model_validate(requested | {"language": language}))
    return page


def _comparison(out: Path, language: str) -> Path:
    """One robot before and after it was corrected."""
    made = []
    for number, offset in enumerate((0.3, 0.02)):
        folder = out / f"{number}"
        campaign = folder / "campaign"
        write_campaign(campaign, seed=number, offset_mm=offset)
        given = Inputs(campaign / "trajectory.parquet", campaign / "program.toml", campaign / "run")
        write_certificate(folder / "certificate", given, CertificationSettings(trials=200), Choices(language))
        made.append(folder / "certificate")
    return _ran("compare", {"certificates": made, "page": out / "comparison.html"}, language, out / "comparison.html")


def _mechanism(out: Path, language: str) -> Path:
    requested = {"robot": "four-chains-arms", "x": "-40:40:20", "y": "-20:40:20", "z": "70:130:20", "report": out}
    return _ran("mechanism", requested, language, out / "mechanism.html")


PAGES: dict[str, Callable[[Path, str], Path]] = {
    "calibration": _calibration, "calibration-compared": _compared, "calibration-by-itself": _by_itself,
    "calibration-undetermined": _undetermined, "calibration-refused": _refused, "zone": _zone, "zone-empty": _empty_zone,
    "zone-reliability": _reliable_zone, "trajectory": _trajectory, "trajectory-doubted": _doubted_trajectory,
    "trajectory-foreign": _foreign_trajectory, "certificate": _certificate, "certificate-in-full": _certificate_in_full,
    "comparison": _comparison, "check": _check, "check-trend": _checks_of_years, "structure": _structure, "structures": _structures,
    "mechanism": _mechanism, "identification": _identification, "correction": _correction,
}  # fmt: skip
"""Every kind of page, and what writes one into a folder in a language."""
PDFS = ("zone.pdf", "certificate.pdf")
"""The page on paper, beside it."""


@cache
def page_of(kind: str, language: str) -> Path:
    """A page of this kind, written once for all tests of this process, which leave it as it is."""
    folder = Path(tempfile.mkdtemp(prefix=f"{kind}-{language}-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return PAGES[kind](folder, language)
