"""Keys, archives and files that are not what a certificate should be; what two certificates differ by."""

import zipfile
from pathlib import Path
from typing import Any

import pytest

from lmeasure.certificate import new_key, opened_zip, read_certificate, read_private_key, read_public_key, verify
from lmeasure.certificate.content import identification
from lmeasure.certificate.signature import digest
from lmeasure.certificate.verification import FIGURES, Compared, compare
from lmeasure.core import CertificationError, KeyKeptError, LMeasureError


def test_a_folder_without_a_certificate_is_named(tmp_path: Path) -> None:
    with pytest.raises(CertificationError, match=f"{tmp_path}: is no folder of a certificate: it contains neither manifest.json nor"):
        verify(tmp_path)


def test_keys_are_kept_and_refused(tmp_path: Path) -> None:
    path = tmp_path / "k.pem"
    new_key(path)
    assert path.stat().st_mode & 0o077 == 0
    with pytest.raises(KeyKeptError, match=r"exists. Use --force to replace the key"):
        new_key(path)
    before = read_public_key(path.with_name("k.pem.pub"))
    new_key(path, force=True)
    assert read_public_key(path.with_name("k.pem.pub")) == read_private_key(path).public_key() != before
    for text in ("", "nothing", path.with_name("k.pem.pub").read_text()):
        (tmp_path / "bad").write_text(text)
        with pytest.raises(CertificationError, match="bad"):
            read_private_key(tmp_path / "bad")
    with pytest.raises(CertificationError, match="is not a public key"):
        read_public_key(path)
    with pytest.raises(LMeasureError, match="cannot be read"):
        read_public_key(tmp_path / "none")


def test_zips_that_would_write_elsewhere_or_grow_are_refused(tmp_path: Path) -> None:
    for number, name in enumerate(("../out.txt", "/tmp/out.txt", "a/../../out.txt", "a\\b", "C:x")):
        with zipfile.ZipFile(tmp_path / f"{number}.zip", "w") as archive:
            archive.writestr(name, "x")
        (tmp_path / str(number)).mkdir()
        with pytest.raises(CertificationError), opened_zip(tmp_path / f"{number}.zip", tmp_path / str(number)):
            pass
    with zipfile.ZipFile(tmp_path / "big.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("zeros", bytes(10_000_000))
    with pytest.raises(CertificationError, match="not stored"), opened_zip(tmp_path / "big.zip", tmp_path):
        pass
    assert not (tmp_path.parent / "out.txt").exists()


def test_files_that_are_no_certificate(tmp_path: Path) -> None:
    path = tmp_path / "certificate.json"
    for text in ("", "[]", "{}", '{"schema": "lmeasure.certificate/1"}', "[" * 100_000, '{"schema": "lmeasure.certificate/1", "id": NaN}'):
        path.write_text(text)
        with pytest.raises(LMeasureError, match=r"certificate\.json"):
            read_certificate(path)
    with pytest.raises(CertificationError, match="no folder"):
        verify(tmp_path / "none")


def test_compare_looks_into_every_entry() -> None:
    figure: dict[str, Any] = {
        "name": "AP_p", "pose": "P1", "value": 1.0, "u95": 0.1, "unit": "mm", "capable": True, "conformity": {"upper": 2.0},
    }  # fmt: skip
    base: dict[str, Any] = {"characteristics": [figure], "excluded": [], "notes": []}
    base |= {"figures_sha256": digest({key: base.get(key) for key in FIGURES})}
    stated = base | {"id": identification(base)}
    assert compare(stated, stated) == Compared(())
    other = stated | {"characteristics": [figure | {"conformity": {"upper": 2.0 + 1e-9}}]}
    assert (compare(stated, other).differences, compare(stated, other).moved) == ((), True)
    assert compare(stated, stated | {"excluded": [{"kind": "pose", "name": "P1"}]}).differences
    # a table that later versions write is not missed in an earlier certificate, nor let go in one of this version
    assert not compare(stated, stated | {"program": {}}, other_version=True).differences
    assert compare(stated, stated | {"program": {}}).differences
    assert compare(stated | {"program": {}}, stated, other_version=True).differences
