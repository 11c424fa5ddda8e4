"""Certificates as folders: sealed, signed, packed, tampered with, computed again."""

import itertools
import json
import random
import shutil
import subprocess
import zipfile
from pathlib import Path
from typing import Any

import pytest
from campaigns import write_campaign

from lmeasure.certification import Settings
from lmeasure.certification.again import RELATIVE, label
from lmeasure.certification.bundle import MANIFEST, SIGNATURE, check_seal, found_files, new_folder, opened_zip, seal, sidecar, write_zip
from lmeasure.certification.canonical import canonical
from lmeasure.certification.certificate import identification
from lmeasure.certification.measure import Inputs, inputs_in, measure, settings_from
from lmeasure.certification.signature import fingerprint, new_key, read_private_key, read_public_key, signer
from lmeasure.certification.verify import told, verify
from lmeasure.errors import CertificationError, ForeignFolderError, LMeasureError
from lmeasure.report.certificate import PRINTERS, Choices, write_certificate, zip_of

CHANGES = 1000


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("campaign")
    write_campaign(folder)
    return folder


def inputs(campaign: Path, **changes: Any) -> Inputs:
    given: dict[str, Any] = {"trajectory": campaign / "trajectory.parquet", "program": campaign / "program.toml", "run": campaign / "run"}
    return Inputs(**{**given, **changes})


@pytest.fixture(scope="module")
def key(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("key") / "laboratory.pem"
    new_key(path)
    return path


def public(key: Path) -> Any:
    return read_public_key(key.with_name(key.name + ".pub"))


@pytest.fixture(scope="module")
def signed(campaign: Path, key: Path) -> Path:
    out = campaign / "signed"
    write_certificate(out, inputs(campaign), Settings(), Choices(key=key, dcc=True, zipped=True))
    return out


@pytest.fixture
def copy(signed: Path, tmp_path: Path) -> Path:
    shutil.copytree(signed, tmp_path / "copy")
    return tmp_path / "copy"


def test_what_a_folder_holds(signed: Path, campaign: Path) -> None:
    assert found_files(signed) == {
        "certificate.json", "certificate.pdf", "certificate.xml", "report.html", MANIFEST, SIGNATURE, "inputs/trajectory.parquet",
        "inputs/program.toml", "inputs/run/run.toml", "inputs/run/rig.toml", "inputs/run/pass1.csv",
    }  # fmt: skip
    for name in ("run.toml", "rig.toml", "pass1.csv"):
        assert (signed / "inputs" / "run" / name).read_bytes() == (campaign / "run" / name).read_bytes()
    content = json.loads((signed / "certificate.json").read_text(encoding="utf-8"))
    assert content["schema"] == "lmeasure.certificate/1"
    assert content["id"] == identification(content)
    assert content["kind"] == "test report"
    first = content["characteristics"][0]
    assert next(iter(first)) == "name"
    assert {"name", "pose", "value", "unit", "u95", "capable"} <= set(first)


def test_it_verifies_as_a_folder_and_as_a_zip(signed: Path, key: Path, tmp_path: Path) -> None:
    found = verify(signed, public(key), PRINTERS)
    assert found.differences == ()
    assert (found.environment, found.skipped, found.largest) == ((), (), 0.0)
    assert found.figures == len(json.loads((signed / "certificate.json").read_text())["characteristics"])
    assert found.signer == fingerprint(public(key))
    with opened_zip(zip_of(signed), tmp_path) as folder:
        assert check_seal(folder, public(key)).differences == ()
        assert found_files(folder) == found_files(signed)


def test_certified_twice_the_figures_are_the_same_and_the_ids_are_not(signed: Path, campaign: Path, tmp_path: Path) -> None:
    again = write_certificate(tmp_path / "again", inputs(campaign), Settings(), Choices())
    first = json.loads((signed / "certificate.json").read_text(encoding="utf-8"))
    assert again["figures_sha256"] == first["figures_sha256"]
    assert canonical(again["characteristics"]) == canonical(first["characteristics"])
    assert again["id"] != first["id"]


@pytest.mark.parametrize("form", ["folder", "zip"])
def test_a_thousand_single_byte_changes_are_all_named(copy: Path, key: Path, tmp_path: Path, form: str) -> None:
    """Every file gets its share of the changes, whatever its size; a zip is refused as a whole, with its sidecar or without."""
    r = random.Random(7)
    if form == "folder":
        # the page's five megabytes of drawing code would be read a thousand times
        page = copy / "report.html"
        page.write_bytes(page.read_bytes()[:20_000])
        seal(copy, "LM", [], read_private_key(key))
        names = sorted(found_files(copy))
        for i in range(CHANGES):
            path = copy / names[i % len(names)]
            change = changed_byte(path, r)
            named = {d.what for d in check_seal(copy, public(key)).differences}
            assert names[i % len(names)] in named, f"change {i} at byte {change}"
            # what was changed is named and nothing else is blamed, but that a manifest of other bytes is not the one signed
            assert named <= {names[i % len(names)], *([SIGNATURE] if names[i % len(names)] == MANIFEST else [])}
            undo(path, change)
        assert check_seal(copy, public(key)).differences == ()
    else:
        small = tmp_path / "small"
        (small / "inputs").mkdir(parents=True)
        for name in ("certificate.json", "inputs/program.toml"):
            shutil.copyfile(copy / name, small / name)
        seal(small, "LM", [])
        archive = tmp_path / "small.zip"
        write_zip(archive, small)
        for i in range(CHANGES):
            if i == CHANGES // 2:
                sidecar(archive).unlink()
            change = changed_byte(archive, r)
            (tmp_path / str(i)).mkdir()
            with pytest.raises(CertificationError, match=r"small\.zip"), opened_zip(archive, tmp_path / str(i)):
                pass
            shutil.rmtree(tmp_path / str(i))
            undo(archive, change)


def changed_byte(path: Path, r: random.Random) -> tuple[int, int]:
    """(place, byte that stood there) after a byte of the file was changed."""
    place = r.randrange(path.stat().st_size)
    with path.open("r+b") as file:
        file.seek(place)
        before = file.read(1)[0]
        file.seek(place)
        file.write(bytes([before ^ r.randrange(1, 256)]))
    return place, before


def undo(path: Path, change: tuple[int, int]) -> None:
    with path.open("r+b") as file:
        file.seek(change[0])
        file.write(bytes([change[1]]))


def test_files_added_taken_and_exchanged_are_named(copy: Path) -> None:
    (copy / "inputs" / "note.txt").write_text("x")
    (copy / "empty").mkdir()
    (copy / "certificate.pdf").unlink()
    (copy / "report.html").rename(copy / "Report.html")
    (copy / "certificate.pdf").symlink_to("/etc/hostname")
    named = {d.what: d.text for d in check_seal(copy).differences}
    assert named == {
        "inputs/note.txt": "is not in the manifest: it was added",
        "empty": "is not in the manifest: it was added",
        "Report.html": "is not in the manifest: it was added",
        "report.html": "is missing",
        "certificate.pdf": "is a link, not a file",
    }
    (copy / MANIFEST).unlink()
    assert MANIFEST in {d.what for d in check_seal(copy).differences}


def resealed(folder: Path, change: dict[str, Any] | None = None) -> None:
    """As somebody would who has no key but knows how a folder is sealed; `change` goes into certificate.json."""
    path = folder / "certificate.json"
    content = json.loads(path.read_text(encoding="utf-8")) | (change or {})
    content["id"] = identification(content)
    path.write_bytes(canonical(content))
    (folder / SIGNATURE).unlink(missing_ok=True)
    seal(folder, content["id"], [])


def reprinted(folder: Path, change: dict[str, Any] | None = None) -> None:
    """What people read, as somebody with this program and another one's libraries would print it of certificate.json; `change` is printed
    besides and stands nowhere else."""
    stated = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    measured = measure(inputs_in(folder, stated["measurement"]), settings_from(stated["settings"]))
    for name, printer in PRINTERS.items():
        if (folder / name).exists():
            content = printer(stated | (change or {}), measured)
            (folder / name).write_bytes(content + (b"<!-- -->" if name == "report.html" else b"\n"))
    resealed(folder)


def test_a_figure_changed_with_care_is_found_by_computing_it_again(copy: Path, key: Path) -> None:
    """Sealed anew, with digests and id to match: only the raw data and the missing signature give it away."""
    content = json.loads((copy / "certificate.json").read_text(encoding="utf-8"))
    figures = content["characteristics"]
    figures[0]["value"] *= 1.000000001
    figures[1]["capable"] = not figures[1]["capable"]
    gone = figures.pop(2)
    resealed(copy, {"characteristics": figures, "notes": ["all is well"]})
    found = verify(copy, printers=PRINTERS)
    told_of = {d.what: d.text for d in found.differences}
    assert "value is certified as" in told_of[label(figures[0])]
    assert "capable is certified as" in told_of[label(figures[1])]
    assert told_of[label(gone)] == "is not certified, but the inputs give it"
    assert any("notes" in d.text for d in found.differences)
    # the PDF still prints what was true
    assert told_of["certificate.pdf"] == "does not print what certificate.json says"
    assert SIGNATURE in {d.what for d in verify(copy, public(key)).differences}


def test_a_pdf_of_something_else_is_found(copy: Path) -> None:
    (copy / "certificate.pdf").write_bytes((copy / "certificate.pdf").read_bytes() + b"\n")
    resealed(copy)
    named = {d.what for d in verify(copy, printers=PRINTERS).differences}
    assert "certificate.pdf" in named


def test_raw_data_changed_with_care_are_found(copy: Path) -> None:
    path = copy / "inputs" / "run" / "pass1.csv"
    rows = path.read_text().splitlines()
    cells = rows[1000].split(",")
    rows[1000] = ",".join([cells[0], str(int(cells[1]) + 1), *cells[2:]])
    path.write_text("\n".join(rows) + "\n")
    found = verify(copy)
    assert [d.what for d in found.differences] == ["inputs/run/pass1.csv"]
    assert found.skipped
    resealed(copy)
    found = verify(copy)
    assert len(found.differences) == 1
    assert "row 999 is not what the run's counts give" in found.differences[0].text


def test_another_environment_allows_the_last_digits_and_says_so(copy: Path) -> None:
    content = json.loads((copy / "certificate.json").read_text(encoding="utf-8"))
    figures = content["characteristics"]
    figures[0]["value"] *= 1 + 1e-9
    resealed(copy, {"characteristics": figures, "environment": content["environment"] | {"numpy": "1.0"}})
    # printed by another version: other bytes, the same text
    reprinted(copy)
    found = verify(copy, printers=PRINTERS)
    assert (found.differences, found.skipped, found.exit_code) == ((), (), 0)
    assert found.environment[0].startswith("numpy 1.0, here ")
    assert 1e-10 < found.largest < 1e-8
    assert f"allowed here {RELATIVE:g}" in "\n".join(told(found, asked=False))
    figures[0]["value"] *= 1 + 1e-5
    resealed(copy, {"characteristics": figures})
    assert [d.what for d in verify(copy).differences] == [label(figures[0])]


def test_signatures(copy: Path, key: Path, tmp_path: Path) -> None:
    content, table = (copy / MANIFEST).read_bytes(), (copy / SIGNATURE).read_bytes()
    assert fingerprint(signer(content, table)) == fingerprint(public(key))
    new_key(tmp_path / "other.pem")
    other = public(tmp_path / "other.pem")
    assert [str(d).split(",")[0] for d in check_seal(copy, other).differences] == ["signature.json: is by another key"]
    # somebody else signs the same: found by who asks for the laboratory's key, and by nobody else
    resealed(copy)
    seal(copy, json.loads((copy / "certificate.json").read_text())["id"], [], read_private_key(tmp_path / "other.pem"))
    assert check_seal(copy).differences == ()
    assert SIGNATURE in {d.what for d in check_seal(copy, public(key)).differences}
    for broken in (b"", b"{}", b"[]", b"\xff", table.replace(b"Ed25519", b"ed25519"), table + b" ", table[:-4] + b"\n}\n"):
        with pytest.raises(CertificationError):
            signer(content, broken)


def test_openssl_knows_our_keys_and_signatures(copy: Path, key: Path, tmp_path: Path) -> None:
    import base64

    program = shutil.which("openssl")
    assert program, "the test of signatures by another program needs openssl"
    table = json.loads((copy / SIGNATURE).read_text())
    (tmp_path / "raw").write_bytes(base64.b64decode(table["signature"]))
    command = [program, "pkeyutl", "-verify", "-pubin", "-inkey", f"{key}.pub", "-rawin", "-in", str(copy / MANIFEST), "-sigfile"]
    done = subprocess.run([*command, str(tmp_path / "raw")], capture_output=True, text=True)
    assert done.returncode == 0, done
    made = tmp_path / "theirs.pem"
    subprocess.run([program, "genpkey", "-algorithm", "ed25519", "-out", str(made)], check=True, capture_output=True)
    read_private_key(made)


def test_the_zip_has_the_same_bytes_each_time_and_any_unzip_reads_it(signed: Path, tmp_path: Path) -> None:
    write_zip(tmp_path / "a.zip", signed)
    assert (tmp_path / "a.zip").read_bytes() == zip_of(signed).read_bytes()
    with zipfile.ZipFile(tmp_path / "a.zip") as archive:
        assert archive.testzip() is None
        assert set(archive.namelist()) == found_files(signed)


def test_a_folder_of_somebody_else_is_not_touched(tmp_path: Path, campaign: Path) -> None:
    (tmp_path / "own.txt").write_text("mine")
    with pytest.raises(ForeignFolderError, match="holds other files"), new_folder(tmp_path):
        pass
    with pytest.raises(ForeignFolderError, match="is not a folder"), new_folder(tmp_path / "own.txt"):
        pass
    out = tmp_path / "out"
    with pytest.raises(ZeroDivisionError), new_folder(out) as folder:
        (folder / "half").write_text(str(1 // 0))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["own.txt"]
    # an earlier certificate is replaced as a whole, unless something was put into it
    for text in ("a", "b"):
        with new_folder(out) as folder:
            (folder / text).write_text(text)
            seal(folder, text, [])
    assert found_files(out) == {"b", MANIFEST}
    (out / "own.txt").write_text("mine")
    with pytest.raises(CertificationError, match=r"holds own\.txt"), new_folder(out):
        pass


def test_a_trajectory_that_is_not_the_runs_is_refused(campaign: Path, tmp_path: Path) -> None:
    import pandas as pd

    data = pd.read_parquet(campaign / "trajectory.parquet")
    data["y_mm"] = data["y_mm"] + 1e-3 * (data.index == 100)
    data.to_csv(tmp_path / "other.csv", index=False)
    with pytest.raises(CertificationError, match=r"other\.csv: row 100 is not what the run's counts give: y_mm"):
        write_certificate(tmp_path / "c", inputs(campaign, trajectory=tmp_path / "other.csv"), Settings(), Choices())
    data.iloc[:-1].to_csv(tmp_path / "short.csv", index=False)
    with pytest.raises(CertificationError, match=r"short\.csv: has \d+ rows"):
        write_certificate(tmp_path / "c", inputs(campaign, trajectory=tmp_path / "short.csv"), Settings(), Choices())
    assert not (tmp_path / "c").exists()


def test_without_a_run_the_trajectory_itself_is_certified(campaign: Path, tmp_path: Path) -> None:
    content = write_certificate(tmp_path / "c", inputs(campaign, run=None), Settings(), Choices())
    assert content["instrument"] is None
    assert verify(tmp_path / "c", printers=PRINTERS).differences == ()


def test_a_rig_of_elsewhere_and_its_record_are_copied_beside_each_other(campaign: Path, tmp_path: Path) -> None:
    rigs = tmp_path / "rigs" / "cell"
    rigs.mkdir(parents=True)
    text = (campaign / "run" / "rig.toml").read_text()
    record = {"rig": "simulated cell 0", "parameters": [], "covariance": [], "residuals": [], "equations": 0, "unknowns": 0, "rank": 0}
    (rigs / "records").mkdir()
    (rigs / "records" / "record.json").write_text(json.dumps(record))
    (rigs / "calibrated.toml").write_text('calibration = "records/record.json"\n' + text)
    chosen = inputs(campaign, rig=rigs / "calibrated.toml")
    assert chosen.copies()["inputs/rig/records/record.json"] == rigs / "records/record.json"
    content = write_certificate(tmp_path / "c", chosen, Settings(), Choices())
    assert content["instrument"]["calibrated"]
    shutil.rmtree(tmp_path / "rigs")
    assert verify(tmp_path / "c").differences == ()
    rigs.mkdir(parents=True)
    (rigs / "calibrated.toml").write_text('calibration = "../../../record.json"\n' + text)
    (tmp_path.parent / "record.json").write_text(json.dumps(record))
    with pytest.raises(LMeasureError, match="lies outside the rig's folder"):
        inputs(campaign, rig=rigs / "calibrated.toml").copies()


def test_whatever_stands_in_a_certificate_verify_ends_in_a_list(copy: Path) -> None:
    """Values of all kinds anywhere in certificate.json, sealed anew: named as differences, never a traceback."""
    original = json.loads((copy / "certificate.json").read_text(encoding="utf-8"))
    r = random.Random(3)
    values: list[Any] = [None, True, -1, 0.5, "x", "../..", [], {}, [1], {"a": 1}, 1e300, "inputs/run"]
    for key in [k for k in original if k not in ("id",)]:
        for value in r.sample(values, 3):
            if value == original[key]:
                continue
            resealed(copy, {key: value})
            assert verify(copy).differences, (key, value)
    for table, value in itertools.product(("measurement", "settings"), values):
        inner = dict(original[table])
        name = r.choice(list(inner))
        if inner[name] == value:
            continue
        resealed(copy, {table: inner | {name: value}})
        assert verify(copy).differences, (table, name, value)
