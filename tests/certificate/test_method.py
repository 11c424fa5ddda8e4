"""Folders against another environment, another method and a forger: what is compared, what is refused, and what is said not to be."""

import json
import os
import shutil
import struct
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from campaigns import write_campaign
from in_process import refused
from test_bundle import reprinted, resealed

from lmeasure.certificate import Inputs, Verification, canonical, opened_zip, read_public_key, seal, verify, write_zip
from lmeasure.certificate.bundle import MANIFEST, check_seal
from lmeasure.certificate.content import METHOD
from lmeasure.certificate.inputs import inputs_in
from lmeasure.certificate.signature import digest, fingerprint
from lmeasure.core import CertificationError, LMeasureError
from lmeasure.iso9283 import CertificationSettings
from lmeasure.report import PRINTERS, Choices, write_certificate
from lmeasure.trajectory import read_trajectory

SEALED = Path(__file__).parents[1] / "authorities" / "sealed"


@pytest.fixture(scope="module")
def sealed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder without a run, which is computed again in no time."""
    folder = tmp_path_factory.mktemp("method")
    write_campaign(folder)
    inputs = Inputs(folder / "trajectory.parquet", folder / "program.toml")
    write_certificate(folder / "c", inputs, CertificationSettings(trials=200, still_mm=0.25), Choices())
    return folder / "c"


@pytest.fixture
def copy(sealed: Path, tmp_path: Path) -> Path:
    shutil.copytree(sealed, tmp_path / "c")
    return tmp_path / "c"


def content_of(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / "certificate.json").read_text(encoding="utf-8")))


def looked_at(folder: Path) -> Verification:
    return verify(folder, printers=PRINTERS)


def elsewhere(folder: Path, **versions: str) -> None:
    """As if it had been made with other libraries."""
    environment = content_of(folder)["environment"] | (versions or {"numpy": "1.0"})
    resealed(folder, {"environment": environment})
    reprinted(folder)


def test_figures_of_another_method_are_listed_beside_those_of_today() -> None:
    key, folder = read_public_key(SEALED / "laboratory.pem.pub"), SEALED / "with-run"
    found = verify(folder, key, PRINTERS)
    assert found.differences == ()
    assert found.exit_code == 3
    assert found.signer == fingerprint(key)
    assert f"results: computed by method 2. This version uses {METHOD}" in found.skipped
    first, *others = content_of(folder)["characteristics"]
    assert len(found.beside) >= 2 + len(others)
    assert found.beside[1].startswith(f"{first['name']} of {first['pose']}: sealed ")
    assert ", today " in found.beside[1]
    assert "hashes are right. " in refused("verify", folder, code=3)


def test_texts_are_compared_where_bytes_are_others(copy: Path) -> None:
    elsewhere(copy)
    found = looked_at(copy)
    assert (found.differences, found.exit_code) == ((), 3)
    assert [text.partition(":")[0] for text in found.skipped] == ["environment", "certificate.pdf", "report.html"]
    # a paper that says more, or otherwise, than certificate.json
    figures = content_of(copy)["characteristics"]
    figures[0] = figures[0] | {"value": figures[0]["value"] * 1.02}
    for forged in ({"characteristics": figures}, {"notes": ["meets every tolerance"]}):
        reprinted(copy, forged)
        assert {"certificate.pdf", "report.html"} == {d.what for d in looked_at(copy).differences}


def listed(folder: Path, rows: list[dict[str, Any]]) -> None:
    """A manifest of these rows, in the one form that manifests have."""
    old = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    new = {"schema": old["schema"], "certificate": old["certificate"], "files": rows}
    (folder / MANIFEST).write_bytes(canonical(new | {"sha256": digest(new)}))


def test_entries_of_a_manifest_that_stand_twice_or_for_nothing_are_refused(copy: Path) -> None:
    rows = json.loads((copy / MANIFEST).read_text(encoding="utf-8"))["files"]
    for forged in ([*rows, rows[-1]], rows[::-1], [rows[0] | {"note": "x"}, *rows[1:]], [*rows, rows[-1] | {"file": MANIFEST}]):
        listed(copy, sorted(forged, key=lambda r: r["file"]) if forged != rows[::-1] else forged)
        assert [str(d) for d in check_seal(copy).differences] == ["manifest.json: its bytes were changed"]
    listed(copy, rows)
    assert check_seal(copy).differences == ()
    for name in ("readme.txt", "inputs/more.csv"):
        (copy / name).write_text("x")
        (copy / MANIFEST).unlink()
        seal(copy, content_of(copy)["id"], [])
        assert [d.what for d in looked_at(copy).differences] == [name]
        (copy / name).unlink()


def test_a_name_that_stands_twice_in_a_certificate_is_refused(copy: Path) -> None:
    path = copy / "certificate.json"
    path.write_bytes(path.read_bytes().replace(b'{\n "schema"', b'{\n "kind": "test certificate",\n "schema"', 1))
    (copy / MANIFEST).unlink()
    seal(copy, content_of(copy)["id"], [])
    assert "is not written as lmeasure writes it" in str(verify(copy).differences[0])


ASK = """
import sys
from lmeasure.cli.app import main
sys.stderr, targets = sys.stdout, sys.argv[1:]
for target in targets:
    print("asked:", target, flush=True)
    sys.argv = ["lmeasure", "verify", target]
    try:
        main()
    except SystemExit as end:
        print("exit code", end.code)
"""


def test_pipes_are_never_opened(copy: Path, tmp_path: Path) -> None:
    """By a process of its own, which a pipe that is opened would hold for ever."""
    pipes = []
    for name in ("certificate.json", MANIFEST, "signature.json"):
        pipes.append(shutil.copytree(copy, tmp_path / name) / name)
    write_zip(tmp_path / "c.zip", SEALED / "with-run")
    pipes += [tmp_path / "pipe.zip", tmp_path / "c.zip.sha256"]
    for pipe in pipes:
        pipe.unlink(missing_ok=True)
        os.mkfifo(pipe)
    targets = [tmp_path / name for name in ("certificate.json", MANIFEST, "signature.json", "pipe.zip", "c.zip")]
    done = subprocess.run([sys.executable, "-c", ASK, *map(str, targets)], capture_output=True, text=True, timeout=100, check=True)
    reported = done.stdout.split("asked: ")[1:]
    assert len(reported) == len(targets)
    for target, text in zip(targets, reported, strict=True):
        assert text.startswith(str(target))
        assert "is no regular file" in text
        assert text.endswith("exit code 1\n")


def test_a_zip_whose_files_lie_over_each_other_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    """One file of a megabyte, named in the directory of the zip 500 times: half a gigabyte."""
    with zipfile.ZipFile(tmp_path / "one.zip", "w") as archive:
        archive.writestr("a000", bytes(1_000_000))
    raw = (tmp_path / "one.zip").read_bytes()
    at = raw.index(b"PK\x01\x02")
    entry, end = raw[at : raw.index(b"PK\x05\x06")], raw[raw.index(b"PK\x05\x06") :]
    entries = b"".join(entry.replace(b"a000", b"a%03d" % i) for i in range(500))
    end = end[:8] + struct.pack("<HHLL", 500, 500, len(entries), at) + end[20:]
    local = raw[:at]
    (tmp_path / "bomb.zip").write_bytes(local + entries + end)
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    with pytest.raises(CertificationError, match="overlaps another file"), opened_zip(tmp_path / "bomb.zip", scratch):
        pass
    assert sum(p.stat().st_size for p in scratch.rglob("*") if p.is_file()) == 0


def test_what_was_passed_over_when_a_folder_was_sealed_is_passed_over_again(sealed: Path, tmp_path: Path) -> None:
    """A mapping of more than the file's columns, beside a TUM file, or half a quaternion: new certificates name it."""
    table = "time_s,x_mm,y_mm,z_mm,qx\n0,1,2,3,0\n0.1,1,2,3,0\n"
    for name, text, mapping in (("t.csv", table, "speed=x_mm"), ("t.csv", table, ""), ("t.tum", "0 1 2 3 0 0 0 1\n", "x=X")):
        (tmp_path / name).write_text(text, encoding="utf-8")
        requested = Inputs(tmp_path / name, tmp_path / "program.toml", columns=mapping)
        with pytest.raises(LMeasureError):
            read_trajectory(tmp_path / name, requested.beside)
        assert read_trajectory(tmp_path / name, replace(requested, sealed=True).beside).poses[0, :3] == pytest.approx(
            [1.0, 2.0, 3.0] if name == "t.csv" else [1e3, 2e3, 3e3]
        )
    assert inputs_in(sealed, content_of(sealed)["measurement"]).sealed
