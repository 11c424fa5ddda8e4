"""The commands of certificates as a user meets them: what they print, exit codes, nothing half-written."""

import json
import re
import shutil
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from campaigns import write_campaign
from in_process import code_and_text, refused

from lmeasure.certificate import dcc_xml
from lmeasure.core import LMeasureError


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("commands")
    write_campaign(folder)
    return folder


def test_certify_verify_compare(campaign: Path, tmp_path: Path) -> None:
    given = (campaign / "trajectory.parquet", "--run", campaign / "run", "--program", campaign / "program.toml")
    key, out, details = tmp_path / "k.pem", tmp_path / "c", tmp_path / "details.toml"
    details.write_text('schema = "lmeasure.report/1"\ncountry = "RU"\n')
    assert code_and_text("key", "--out", key)[0] == 0
    code, text = code_and_text(
        "certify",
        *given,
        "--out",
        out,
        "--key",
        key,
        "--zip",
        "--dcc",
        "--details",
        details,
        "--language",
        "ru",
        "--rule",
        "guarded",
        "--trials",
        "200",
    )
    assert code == 0, text
    assert text.startswith("Протокол испытаний робота, ISO 9283:1998 LM-")
    assert "\nХарактеристик: 52, из них с U95, достаточно малой для заключения: " in text
    assert len(text.splitlines()) < 20
    for target in (out, tmp_path / "c.zip"):
        code, text = code_and_text("verify", target, "--public-key", f"{key}.pub")
        assert code == 0, text
        assert "results recomputed and equal to the digit" in text
    assert (
        code_and_text("certify", *given, "--out", tmp_path / "d", "--tool-offset-mm", "0,0,1", "--capability", "0.1", "--trials", "200")[0]
        == 0
    )
    code, text = code_and_text("compare", out, tmp_path / "d" / "certificate.json", "--out", tmp_path / "compared.json")
    assert code == 0, text
    assert "certified with other settings" in text
    assert (tmp_path / "compared.json").exists()
    with (out / "report.html").open("ab") as page:
        page.write(b"x")
    with (tmp_path / "c.zip").open("ab") as packed:
        packed.write(b"x")
    code, text = code_and_text("verify", out)
    assert code == 1
    assert text.splitlines()[1].startswith("report.html: was changed")
    code, text = code_and_text("verify", tmp_path / "c.zip")
    assert code == 1
    assert "c.zip: was changed" in text


@pytest.mark.parametrize(
    ("options", "code", "reported"),
    [
        (("--language", "de"), 2, "not one of en, ru"),
        (("--rule", "strict"), 2, "'strict' is not one of simple, guarded"),
        (("--xsd", "x.xsd"), 2, "works only with --dcc"),
        (("--constraint", "planar"), 2, "works only with --run"),
        (("--repeatability-mm", "0.1"), 2, "works only with --run"),
        (("--angles", "euler"), 2, "not one of puma-oat"),
        (("--tool-offset-mm", "1,2"), 2, "three numbers"),
        (("--tool-offset-mm", "nan,0,0"), 2, "three numbers"),
        (("--tool-offset-mm", "1e300,0,0"), 1, "at most 1000000 mm"),
        (("--seed", "-1"), 2, "--seed"),
        (("--limit-deg", "-5"), 2, "--limit-deg"),
        (("--limit-deg", "nan"), 2, "--limit-deg"),
        (("--limit-deg", "0"), 1, "limit_angle_deg = 0: must be more than 0"),
        (("--limit-u95-mm", "-1"), 2, "--limit-u95-mm"),
        (("--still-mm", "nan"), 2, "--still-mm"),
        (("--details", "none.toml"), 1, "none.toml"),
        (("--key", "none.pem"), 1, "none.pem"),
        (("--dcc",), 1, "country is missing"),
        (("--run", "none"), 1, "none"),
    ],
)
def test_what_cannot_be_meant_writes_nothing(campaign: Path, tmp_path: Path, options: tuple[str, ...], code: int, reported: str) -> None:
    got, text = code_and_text(
        "certify", campaign / "trajectory.parquet", "--program", campaign / "program.toml", "--out", tmp_path / "c", *options
    )
    assert got == code, text
    assert reported in " ".join(text.replace("│", " ").split())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("tolerances", "reported"),
    [
        ('[[tolerance]]\ncharacteristic = "AP_q"\nupper = 1.0\n', "tolerance of AP_q: no characteristic is compared with it"),
        ('[[tolerance]]\ncharacteristic = "AP_p"\npath = "line"\nupper = 1.0\n', "tolerance of AP_p at line: no characteristic"),
        (
            '[[tolerance]]\ncharacteristic = "AP_p"\nupper = 1.0\n[[tolerance]]\ncharacteristic = "AP_p"\npose = "P2"\nupper = 2.0\n',
            "tolerance of AP_p at P2: no characteristic is compared with it. None has that name there, or an earlier",
        ),
    ],
)
def test_a_tolerance_that_decides_nothing_is_refused(campaign: Path, tmp_path: Path, tolerances: str, reported: str) -> None:
    program = tmp_path / "program.toml"
    program.write_text((campaign / "program.toml").read_text() + tolerances)
    code, text = code_and_text("certify", campaign / "trajectory.parquet", "--program", program, "--trials", "100", "--out", tmp_path / "c")
    assert code == 1
    assert reported in text
    assert not (tmp_path / "c").exists()


def test_a_path_of_which_a_part_was_not_seen_is_not_certified(campaign: Path, tmp_path: Path) -> None:
    from lmeasure.iso9283 import evaluate
    from lmeasure.recording import read_program
    from lmeasure.trajectory import read_trajectory

    table = pq.read_table(campaign / "trajectory.parquet")
    program = read_program(campaign / "program.toml")
    begin, end = program.path[0].windows_s[2]
    time = table["time_s"].to_numpy()
    seen = (time < begin + 0.4 * (end - begin)) | (time > begin + 0.6 * (end - begin))
    holed = tmp_path / "holed.parquet"
    pq.write_table(table.filter(pa.array(seen)), holed)
    code, text = code_and_text("certify", holed, "--program", campaign / "program.toml", "--trials", "100", "--out", tmp_path / "c")
    assert code == 1
    assert re.fullmatch(
        r"path line, cycle 3: there are no samples from [\d.]+ to [\d.]+ s, on [\d.]+ mm of the path: "
        "the robot was not measured there. Measure again, or state windows_s of the poses and of this path's other cycles",
        text,
    )
    assert list(tmp_path.iterdir()) == [holed]
    # what was sealed before is computed again as it was
    assert evaluate(read_trajectory(holed), program).characteristics


def test_what_is_no_calibration_beside_one_is_named(tmp_path: Path) -> None:
    (tmp_path / "calibrated").mkdir()
    (tmp_path / "calibrated" / "calibration.json").write_text("{}")
    code, text = code_and_text("compare", tmp_path / "calibrated", "nowhere")
    assert code == 2
    assert "nowhere: contains no calibration.json. To compare calibrations, give two folders" in " ".join(text.replace("│", " ").split())


def test_the_load_that_a_compliance_test_needs_is_asked_for_by_its_option(tmp_path: Path) -> None:
    box = ("--x", "0:100", "--y", "0:100", "--z", "0:100")
    code, text = code_and_text("program", *box, "--tests", "compliance", "--out", tmp_path / "p")
    assert code == 1
    assert text.startswith("the compliance test needs a load (--loads, loads_kg)")
    assert not (tmp_path / "p").exists()


def test_conformity_is_told_on_the_screen(campaign: Path, tmp_path: Path) -> None:
    program = tmp_path / "program.toml"
    program.write_text((campaign / "program.toml").read_text() + '[[tolerance]]\ncharacteristic = "AP_p"\nupper = 0.01\n')
    code, text = code_and_text(
        "certify", campaign / "trajectory.parquet", "--program", program, "--trials", "100", "--full", "--out", tmp_path / "c"
    )
    assert code == 0, text
    # each pose, and the worst again in the headline
    assert sum("U95 small enough; fail (< 0.1 %); ≤ 0.01" in line for line in text.splitlines()) == 4


def test_an_interrupted_command_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(_: Path, **__: object) -> str:
        raise KeyboardInterrupt

    monkeypatch.setattr("lmeasure.certificate.new_key", interrupted)
    assert refused("key", "--out", tmp_path / "k.pem", code=130) == "interrupted. Nothing was left half-written"


def test_a_program_is_written_with_its_commands_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    box = ("--x", "0:100", "--y", "0:100", "--z", "0:100", "--tests", "pose", "--out", tmp_path)
    assert code_and_text("program", *box, "--cycles", "pose=2")[0] == 0
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert set(before) == {"program.toml", "commands.csv", "robodk.csv"}

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("lmeasure.iso9283.program.command_files.write_robodk", full)
    code, text = code_and_text("program", *box, "--cycles", "pose=3", "--force")
    assert code == 1
    assert "robodk.csv: cannot be written: No space left on device" in text
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize(
    ("options", "reported"),
    [
        (("--quaternion", "0,0,0,2"), "quaternion 0, 0, 0, 2: is not of length 1"),
        (("--quaternion", "0,0,nan,1"), "is not of length 1"),
        (("--angles", "euler"), "angles: 'euler' is not one of puma-oat"),
        (("--x", "0:1e9", "--y", "0:1e9", "--z", "0:1e9"), "a cube of 1e+09 mm"),
        (("--x", "nan:1"), "no volume"),
        (("--loads", "5,5"), "a load is given twice: 5.0, 5.0"),
        (("--speeds", "50,50"), "a speed is given twice"),
        (("--tests", "pose,pose"), "a test is given twice"),
        (("--cycles", "pose=100000000"), "10000 at most"),
        (("--tests", "drift", "--drift-hours", "1e9"), "too long: 100 h at most"),
    ],
)
def test_a_program_that_cannot_be_is_one_line(options: tuple[str, ...], reported: str, tmp_path: Path) -> None:
    code, text = code_and_text("program", "--x", "0:100", "--y", "0:100", "--z", "0:100", "--out", tmp_path / "p", *options)
    assert code == 1
    assert reported in text
    assert not (tmp_path / "p").exists()


def test_a_name_cannot_turn_a_message_around() -> None:
    assert str(LMeasureError("pose a\u202eb\u2066:\nx")) == "pose a\\u{202E}b\\u{2066}: x"


def test_a_trajectory_by_another_rig_than_the_runs_is_told_which_option_names_it(campaign: Path, tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    stated = (campaign / "run" / "rig.toml").read_text(encoding="utf-8")
    rig.write_text(re.sub(r"pulley_radius_mm = \d+", "pulley_radius_mm = 31", stated), encoding="utf-8")
    assert code_and_text("reconstruct", campaign / "run", "--rig", rig, "--out", tmp_path / "t.parquet")[0] == 0
    given = ("certify", tmp_path / "t.parquet", "--run", campaign / "run", "--program", campaign / "program.toml", "--trials", "200")
    code, text = code_and_text(*given, "--out", tmp_path / "c")
    assert code == 1
    assert "differs from the run's counts" in text
    assert text.endswith("If it was reconstructed with another rig than the run's own, --rig names it")
    assert not (tmp_path / "c").exists()
    code, text = code_and_text(*given, "--rig", rig, "--out", tmp_path / "c")
    assert code == 0, text


def test_a_template_a_reference_and_an_authorised_signer(campaign: Path, tmp_path: Path) -> None:
    """The details choose language and rule, and name the reference's DCC; one of the laboratory's keys signs."""
    valid = "<dcc:statement><dcc:traceable>true</dcc:traceable><dcc:period>P1Y</dcc:period></dcc:statement></dcc:statements>"
    of_tracker = {"country": "DE", "laboratory": {"name": "Lab"}, "dates": {"measured_to": "2025-01-31"}}
    figure = {"name": "E", "value": 0.0, "unit": "mm", "u95": 0.02, "capable": True}
    stated = {"id": "T-1", "created": "2025-02-01T00:00:00Z", "details": of_tracker, "environment": {}, "characteristics": [figure]}
    (tmp_path / "tracker.xml").write_text(dcc_xml(stated).decode().replace("</dcc:statements>", valid))
    (tmp_path / "details.toml").write_text(
        'schema = "lmeasure.report/1"\nlanguage = "ru"\nrule = "simple"\n[reference]\ndcc = "tracker.xml"\n'
        "[dates]\nmeasured_to = 2026-03-01\n"
    )
    for name in ("head", "other"):
        assert code_and_text("key", "--out", tmp_path / f"{name}.pem")[0] == 0
        (tmp_path / name).mkdir()
        (tmp_path / f"{name}.pem.pub").rename(tmp_path / name / f"{name}.pub")
    files = ("--program", campaign / "program.toml", "--details", tmp_path / "details.toml", "--key", tmp_path / "head.pem")
    code, text = code_and_text("certify", campaign / "trajectory.parquet", *files, "--trials", "100", "--out", tmp_path / "c")
    assert code == 0, text
    content = json.loads((tmp_path / "c" / "certificate.json").read_text())
    assert (content["language"], content["settings"]["rule"]) == ("ru", "simple")
    assert (
        content["details"]["traceability"] == "industrial robot, serial number not stated: calibration certificate T-1 of Lab, 2025-01-31"
    )
    assert "valid until 2026-01-31. It was used on 2026-03-01" in " ".join(content["notes"])
    assert (tmp_path / "c" / "inputs" / "tracker.xml").is_file()
    code, text = code_and_text("verify", tmp_path / "c", "--public-key", tmp_path / "head")
    assert (code, text.startswith("authorised: head")) == (0, True), text
    code, text = code_and_text("verify", tmp_path / "c", "--public-key", tmp_path / "other")
    assert (code, text.startswith("NOT authorised")) == (1, True), text
    assert "1 difference" in text


def test_a_calibration_by_an_expired_reference_warns(tmp_path: Path) -> None:
    folder = tmp_path / "campaign"
    shutil.copytree(Path(__file__).parents[1] / "authorities" / "truth" / "cell-12-poses", folder)
    period = "<dcc:statement><dcc:date>2020-01-01</dcc:date><dcc:period>P1Y</dcc:period></dcc:statement></dcc:statements>"
    stated = {"id": "T-1", "created": "2020-01-01T00:00:00Z", "details": {"country": "DE"}, "environment": {}, "characteristics": []}
    (folder / "reference.xml").write_text(dcc_xml(stated).decode().replace("</dcc:statements>", period))
    code, text = code_and_text("calibrate", folder, "--out", tmp_path / "out")
    assert (code, "T-1 was valid until 2021-01-01" in text) == (0, True), text
    record = json.loads((tmp_path / "out" / "calibration.json").read_text())
    assert [w["code"] for w in record["warnings"]].count("reference") == 1
    assert "reference.xml" in [i["file"] for i in record["inputs"]]
