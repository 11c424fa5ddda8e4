"""Certificates as folders: sealed, signed, packed, tampered with, computed again."""

import io
import itertools
import json
import os
import random
import shutil
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import pypdfium2
import pypdfium2.raw
import pytest
from campaigns import write_campaign

from lmeasure.certificate import (
    Inputs,
    canonical,
    measure,
    new_folder,
    new_key,
    opened_zip,
    read_private_key,
    read_public_key,
    report_lines,
    seal,
    verify,
    write_zip,
)
from lmeasure.certificate.bundle import MANIFEST, SIGNATURE, check_seal, found_files, sidecar
from lmeasure.certificate.content import identification
from lmeasure.certificate.inputs import inputs_in, settings_from
from lmeasure.certificate.signature import digest, fingerprint, signer
from lmeasure.certificate.verification import FIGURES, label
from lmeasure.core import CertificationError, ForeignFolderError, LMeasureError
from lmeasure.io import files
from lmeasure.iso9283 import CertificationSettings
from lmeasure.report import PRINTERS, Choices, write_certificate
from lmeasure.report.certificate import zip_of

CHANGES = 300


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
    out, details = campaign / "signed", campaign / "details.toml"
    details.write_text('schema = "lmeasure.report/1"\ncountry = "DE"\n')
    write_certificate(
        out, replace(inputs(campaign), details=details), CertificationSettings(trials=200), Choices(key=key, dcc=True, zipped=True)
    )
    return out


@pytest.fixture
def copy(signed: Path, tmp_path: Path) -> Path:
    shutil.copytree(signed, tmp_path / "copy")
    return tmp_path / "copy"


def test_what_a_folder_holds(signed: Path, campaign: Path) -> None:
    assert found_files(signed) == {
        "certificate.json", "certificate.pdf", "certificate.xml", "report.html", MANIFEST, SIGNATURE, "inputs/trajectory.parquet",
        "inputs/details.toml", "inputs/program.toml", "inputs/run/run.toml", "inputs/run/rig.toml", "inputs/run/pass1.csv",
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
    again = write_certificate(tmp_path / "again", inputs(campaign), CertificationSettings(trials=200), Choices())
    first = json.loads((signed / "certificate.json").read_text(encoding="utf-8"))
    assert again["figures_sha256"] == first["figures_sha256"]
    assert canonical(again["characteristics"]) == canonical(first["characteristics"])
    assert again["id"] != first["id"]


@pytest.mark.parametrize("form", ["folder", "zip"])
def test_hundreds_of_single_byte_changes_are_all_named(copy: Path, key: Path, tmp_path: Path, form: str) -> None:
    """Every file gets its share of the changes, whatever its size; a zip is refused as a whole, with its sidecar or without."""
    r = random.Random(7)
    if form == "folder":
        # the page's five megabytes of drawing code would be read hundreds of times
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
    if "characteristics" in (change or {}):
        content["figures_sha256"] = digest({key: content[key] for key in FIGURES})
    content["id"] = identification(content)
    path.write_bytes(canonical(content))
    (folder / SIGNATURE).unlink(missing_ok=True)
    seal(folder, content["id"], [])


def reprinted(folder: Path, change: dict[str, Any] | None = None, *, other_bytes: bool = True) -> None:
    """What people read, as somebody with this program and another one's libraries would print it of certificate.json; `change` is printed
    besides and stands nowhere else."""
    stated = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    measured = measure(inputs_in(folder, stated["measurement"]), settings_from(stated["settings"]))
    for name, printer in PRINTERS.items():
        if (folder / name).exists():
            content = printer(stated | (change or {}), measured)
            (folder / name).write_bytes(content + (b"<!-- -->" if name == "report.html" else b"\n") * other_bytes)
    resealed(folder)


def test_a_figure_changed_with_care_is_found_by_computing_it_again(copy: Path, key: Path) -> None:
    """Sealed anew, with digests and id to match: only the raw data and the missing signature give it away."""
    content = json.loads((copy / "certificate.json").read_text(encoding="utf-8"))
    figures = content["characteristics"]
    figures[0]["value"] *= 1.00001
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
    assert told_of["certificate.pdf"] == "differs from the print of certificate.json"
    assert SIGNATURE in {d.what for d in verify(copy, public(key)).differences}


@pytest.mark.parametrize(("what", "moved"), [("script", False), ("white box", True), ("style", True)])
def test_a_page_changed_with_care_is_never_passed(what: str, moved: bool, copy: Path) -> None:
    """Also where a figure was changed in its last digit, so that other bytes might be those of another processor."""
    page, paper = copy / "report.html", copy / "certificate.pdf"
    if moved:
        content = json.loads((copy / "certificate.json").read_text(encoding="utf-8"))
        content["characteristics"][0]["value"] *= 1.0 + 1e-12
        resealed(copy, {"characteristics": content["characteristics"]})
        reprinted(copy, other_bytes=False)
        assert verify(copy, printers=PRINTERS).exit_code == 0
    text = page.read_bytes()
    if what == "white box":
        paper.write_bytes(covered(paper.read_bytes()))
    else:
        old, new = {
            "style": (b"</style>", b"td{color:white}</style>"),
            "script": (b"</body>", b"<script>document.title='passed'</script></body>"),
        }[what]
        page.write_bytes(text.replace(old, new, 1))
        assert page.read_bytes() != text
    resealed(copy)
    found = verify(copy, printers=PRINTERS)
    name = "certificate.pdf" if what == "white box" else "report.html"
    if moved:
        assert (found.differences, found.exit_code) == ((), 3)
        assert found.skipped == (f"{name}: only its text was compared, not its drawings and layout",)
    else:
        assert [d.what for d in found.differences] == [name]
    assert report_lines(found, requested=False)[0] == "unsigned: origin not proved"


def covered(pdf: bytes) -> bytes:
    """The PDF with a white box over its first page, as any editor of PDFs draws it."""
    document = pypdfium2.PdfDocument(pdf)
    first = document[0]
    box = pypdfium2.raw.FPDFPageObj_CreateNewRect(50, 300, 400, 300)
    pypdfium2.raw.FPDFPageObj_SetFillColor(box, 255, 255, 255, 255)
    pypdfium2.raw.FPDFPath_SetDrawMode(box, 1, False)
    pypdfium2.raw.FPDFPage_InsertObject(first.raw, box)
    pypdfium2.raw.FPDFPage_GenerateContent(first.raw)
    out = io.BytesIO()
    document.save(out)
    return out.getvalue()


KERNELS = (
    "OPENBLAS_CORETYPE=Prescott", "OPENBLAS_CORETYPE=Sandybridge", "OPENBLAS_CORETYPE=Nehalem", "NUMBA_CPU_NAME=generic",
    "OPENBLAS_NUM_THREADS=2",
)  # fmt: skip


@pytest.mark.parametrize("kernel", [KERNELS[0], *(pytest.param(kernel, marks=pytest.mark.slow) for kernel in KERNELS[1:])])
def test_another_kernel_of_blas_makes_no_difference(kernel: str, signed: Path, key: Path) -> None:
    name, _, value = kernel.partition("=")
    words = [sys.executable, "-m", "lmeasure", "verify", str(signed), "--public-key", f"{key}.pub"]
    done = subprocess.run(words, env=os.environ | {name: value}, capture_output=True, text=True)
    lines = done.stdout.splitlines()
    assert (done.returncode, done.stderr) == (0, "")
    assert lines[0].endswith("the requested key")
    assert ("NUM_THREADS" in kernel) or lines[1].startswith("results differ in their last digits, by at most")
    assert "every file's hash is right, all " in lines[-2]


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
    assert "row 999 differs from the run's counts" in found.differences[0].text


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
    with pytest.raises(ForeignFolderError, match="contains other files"), new_folder(tmp_path):
        pass
    with pytest.raises(ForeignFolderError, match="is not a folder"), new_folder(tmp_path / "own.txt"):
        pass
    out = tmp_path / "out"
    with pytest.raises(ZeroDivisionError), new_folder(out) as folder:
        (folder / "half").write_text(str(1 // 0))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["own.txt"]
    # an earlier certificate is replaced as a whole, and only when that is asked for, unless something was put into it
    for text in ("a", "b"):
        with new_folder(out, force=text == "b") as folder:
            (folder / text).write_text(text)
            seal(folder, text, [])
    assert found_files(out) == {"b", MANIFEST}
    with pytest.raises(ForeignFolderError, match="Use --force to replace the certificate"), new_folder(out):
        pass
    (out / "own.txt").write_text("mine")
    with pytest.raises(CertificationError, match=r"contains own\.txt"), new_folder(out, force=True):
        pass


@pytest.mark.parametrize("exchanged", [True, False])
def test_at_each_step_of_a_replacement_there_is_a_whole_certificate(
    exchanged: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where the file system cannot exchange two folders: then a kill may put the earlier one aside; the next call restores it."""
    out, steps, usual = tmp_path / "out", [], Path.rename

    def write(text: str) -> None:
        with new_folder(out, force=True) as folder:
            (folder / text).write_text(text)
            seal(folder, text, [])

    class KilledError(BaseException):
        pass

    def renamed(self: Path, target: Path) -> Path:
        steps.append(target.name)
        if len(steps) == last:
            gone = subprocess.Popen([sys.executable, "-c", ""])
            gone.wait()
            for path in tmp_path.glob(f".out.{os.getpid()}.*"):  # as of a process that was killed here
                usual(path, path.with_name(path.name.replace(str(os.getpid()), str(gone.pid))))
            raise KilledError
        return usual(self, target)

    write("a")
    monkeypatch.setattr(Path, "rename", renamed)
    if not exchanged:
        monkeypatch.setattr(files, "exchange", lambda one, other: False)
    for last in (1, 2, 3):
        steps.clear()
        before = found_files(out) - {MANIFEST}
        try:
            write(str(last))
        except KilledError:
            whole = [path for path in tmp_path.iterdir() if found_files(path) - {MANIFEST} == before]
            assert out in whole or (last > 1 and len(whole) == 1) or found_files(out) - {MANIFEST} == {str(last)}
            last = 0
            write(str(last))
        assert found_files(out) - {MANIFEST} == {str(last)}
        assert list(tmp_path.iterdir()) == [out]
    assert exchanged == (steps == [])


def test_an_earlier_certificate_that_a_killed_process_put_aside_gets_its_name_back(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with new_folder(out) as folder:
        (folder / "a").write_text("a")
        seal(folder, "a", [])
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    out.rename(tmp_path / f".out.{gone.pid}.old")
    with pytest.raises(ForeignFolderError, match="exists"), new_folder(out):
        pass
    assert found_files(out) == {"a", MANIFEST}


def test_a_trajectory_that_is_not_the_runs_is_refused(campaign: Path, tmp_path: Path) -> None:
    import pandas as pd

    data = pd.read_parquet(campaign / "trajectory.parquet")
    data["y_mm"] = data["y_mm"] + 1e-3 * (data.index == 100)
    data.to_csv(tmp_path / "other.csv", index=False)
    with pytest.raises(CertificationError, match=r"other\.csv: row 100 differs from the run's counts: y_mm"):
        write_certificate(tmp_path / "c", inputs(campaign, trajectory=tmp_path / "other.csv"), CertificationSettings(trials=200), Choices())
    data.iloc[:-1].to_csv(tmp_path / "short.csv", index=False)
    with pytest.raises(CertificationError, match=r"short\.csv: has \d+ rows"):
        write_certificate(tmp_path / "c", inputs(campaign, trajectory=tmp_path / "short.csv"), CertificationSettings(trials=200), Choices())
    assert not (tmp_path / "c").exists()


def test_without_a_run_the_trajectory_itself_is_certified(campaign: Path, tmp_path: Path) -> None:
    content = write_certificate(tmp_path / "c", inputs(campaign, run=None), CertificationSettings(trials=200), Choices())
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
    content = write_certificate(tmp_path / "c", chosen, CertificationSettings(trials=200), Choices())
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
