"""What `verify` finds in a certificate sealed with care: one fault at a time, each found by its own check and told in its own words."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from synthetic_trajectories import synthetic_campaign

from lmeasure.certificate import (
    CERTIFICATE,
    Inputs,
    Measured,
    Printer,
    Verification,
    canonical,
    certificate,
    copy_into,
    entries,
    environment,
    measure,
    read_certificate,
    report_lines,
    seal,
    verify,
)
from lmeasure.certificate.bundle import SIGNATURE, Difference
from lmeasure.certificate.content import METHOD, identification
from lmeasure.certificate.signature import digest
from lmeasure.certificate.verification import FIGURES, RELATIVE, SOURCES, beside, compare, label, of_environment
from lmeasure.core import CertificationError
from lmeasure.iso9283 import CertificationSettings
from lmeasure.trajectory import write_trajectory

PAGE = "page.txt"


def test_a_library_whose_metadata_was_removed_is_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lmeasure.certificate.content.LIBRARIES", ("numpy", "not-installed-anywhere"))
    reported = environment()
    assert reported["numpy"] != "unknown"
    assert reported["not-installed-anywhere"] == "unknown"


def print_page(content: dict[str, Any], measured: Measured) -> bytes:
    """A page that names the certificate and its figures."""
    return "\n".join([content["id"], *map(label, content["characteristics"])]).encode()


def text_of(content: bytes) -> str:
    """Its text, whatever is blank; ValueError where it is none."""
    return " ".join(content.decode("utf-8").split())


PRINTERS = {PAGE: Printer(print_page, text_of), "more.txt": Printer(print_page, text_of, needed=False)}


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small certificate without a run, and its page."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("sound")
    trajectory, program = synthetic_campaign(np.array([0.3, -0.4, 1.2]), 0.1, cycles=3)
    write_trajectory(source / "trajectory.csv", trajectory)
    (source / "program.toml").write_text(tomli_w.dumps(program), encoding="utf-8")
    inputs = Inputs(source / "trajectory.csv", source / "program.toml")
    copies = inputs.copies()
    copy_into(out, copies)
    measured = measure(inputs, CertificationSettings(trials=200))
    content = certificate(
        measured, inputs, entries(out, sorted(copies)), created="2026-01-02T03:04:05Z", language="en", environment=environment()
    )
    (out / PAGE).write_bytes(print_page(content, measured))
    (out / CERTIFICATE).write_bytes(canonical(content))
    seal(out, content["id"], [])
    return out


@pytest.fixture
def folder(sound: Path, tmp_path: Path) -> Path:
    shutil.copytree(sound, tmp_path / "copy")
    return tmp_path / "copy"


def content_of(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / CERTIFICATE).read_bytes()))


def resealed(folder: Path, change: dict[str, Any], *, own_id: str | None = None, sealed_as: str | None = None) -> dict[str, Any]:
    """The folder with a changed certificate, sealed anew; under ids that are not its own where those are given."""
    content = content_of(folder) | change
    if "characteristics" in change:
        content |= with_digest(content)
    content["id"] = own_id or identification(content)
    (folder / CERTIFICATE).write_bytes(canonical(content))
    seal(folder, sealed_as or content["id"], [])
    return content


def with_digest(content: dict[str, Any]) -> dict[str, Any]:
    """The table with the digest of its figures."""
    return content | {"figures_sha256": digest({key: content.get(key) for key in FIGURES})}


def texts(found: Verification) -> list[str]:
    return [str(d) for d in found.differences]


def test_a_sound_one_is_sound(folder: Path) -> None:
    content, seen = content_of(folder), []
    found = verify(folder, printers=PRINTERS, progress=lambda done, total: seen.append((done, total)))
    assert found == Verification(content["id"], (), len(content["characteristics"]))
    assert found.exit_code == 0
    assert found.figures > 10
    assert seen[-1] == (400, 400)
    digits = f"{content['id']}: every file's hash is right, all {found.figures} results recomputed and equal to the digit"
    assert report_lines(found, requested=False) == ["unsigned: origin not proved", digits]


def test_an_id_that_is_not_that_of_the_content(folder: Path) -> None:
    own = content_of(folder)["id"]
    resealed(folder, {}, own_id="LM-00000000-00000000")
    assert texts(verify(folder)) == [f"certificate.json: id is LM-00000000-00000000, but its content gives {own}"]


def test_a_manifest_of_another_certificate(folder: Path) -> None:
    own = content_of(folder)["id"]
    resealed(folder, {}, sealed_as="LM-1")
    found = verify(folder)
    assert texts(found) == [f"certificate.json: its id {own} is not that of the manifest, LM-1"]
    assert found.certificate == own
    # a manifest that names none contradicts nothing
    seal(folder, "", [])
    assert texts(verify(folder)) == []


def test_a_digest_of_figures_that_is_not_theirs(folder: Path) -> None:
    resealed(folder, {"figures_sha256": "0" * 64})
    assert texts(verify(folder)) == ["certificate.json: figures_sha256 is not that of its figures"]


def test_figures_of_another_method_stand_beside_those_of_today(folder: Path) -> None:
    figures = content_of(folder)["characteristics"]
    first = label(figures[0])
    content = resealed(folder, {"method": METHOD + 1, "characteristics": [figures[0] | {"value": 5.0, "u95": 0.5}, *figures[1:]]})
    found = verify(folder, printers=PRINTERS)
    assert (texts(found), found.figures, found.largest, found.exit_code) == ([], 0, 0.0, 3)
    assert found.skipped == (
        f"results: computed by method {METHOD + 1}. This version uses {METHOD}",
        f"{PAGE}: its printed texts, because another version of lmeasure prints other texts",
    )
    assert found.beside[0] == f"results by method {METHOD + 1}, as sealed, beside those by method {METHOD}:"
    assert len(found.beside) == 1 + len(figures)
    assert found.beside[1].startswith(f"{first}: sealed 5.0")
    lines = report_lines(found, requested=False)
    assert lines[1 : 1 + len(found.beside)] == list(found.beside)
    assert lines[-1] == f"{content['id']}: hashes are right. 2 items above were not compared"
    # what no method has a part in is held all the same, and so is the id
    resealed(folder, {"kind": "test certificate"}, own_id="LM-2")
    assert [t.split(" is ")[0] for t in texts(verify(folder))] == ["certificate.json: kind", "certificate.json: id"]


@pytest.mark.parametrize("method", [METHOD, METHOD + 1])
def test_inputs_that_are_refused_are_no_fault_of_a_certificate_by_another_method(folder: Path, method: int) -> None:
    measurement = content_of(folder)["measurement"]
    content = resealed(folder, {"method": method, "measurement": measurement | {"repeatability_mm": "wide"}})
    found, refused = verify(folder), "measurement: constraint or repeatability_mm is not in the form that this program writes"
    assert found.certificate == content["id"]
    if method > METHOD:
        assert found.differences == ()
        assert found.skipped == (
            f"results: computed by method {method}. Today's method {METHOD} rejects the inputs: {CERTIFICATE}: {refused}",
        )
    else:
        assert texts(found) == [f"{CERTIFICATE}: cannot be computed again: {CERTIFICATE}: {refused}"]
        assert found.skipped == ("results: see above",)


@pytest.mark.parametrize("method", [METHOD, METHOD + 1])
def test_settings_that_are_refused_are_no_fault_of_a_certificate_by_another_method(folder: Path, method: int) -> None:
    resealed(folder, {"method": method, "settings": content_of(folder)["settings"] | {"trials": "many"}})
    found = verify(folder)
    assert (texts(found) == []) == (method > METHOD)
    assert found.skipped[0].startswith(
        f"results: computed by method {method}. Today's method {METHOD} rejects the inputs" if method > METHOD else "results: see above"
    )


def test_an_environment_is_one_of_versions_under_known_names() -> None:
    """Of the names only those of the same sources are known."""
    here = environment()
    assert of_environment(here, here) == []
    there = {key: value for key, value in here.items() if key != "typst"} | {"plot": "1.0"}
    assert [str(d).partition(": environment: ")[2] for d in of_environment(there, here)] == ["plot is no part of it", "typst is missing"]
    assert of_environment(there | {SOURCES: "0" * 64}, here) == []
    for bad in ("x" * 81, "a b c", "", "1.0\n", 1.0, "1,0"):
        assert [d.text.partition(": no version")[1] for d in of_environment(here | {"numpy": bad}, here)] == [": no version"]
    for good in ("x" * 80, "a b", "1.0+local", "x86-64_v(3)"):
        assert of_environment(here | {"numpy": good}, here) == []


@pytest.mark.parametrize(("length", "shown"), [(80, "x" * 80), (81, "x" * 80 + "...")])
def test_what_is_long_is_shown_by_its_first_80_characters(length: int, shown: str) -> None:
    stated = with_digest({"characteristics": [], "notes": "x" * length})
    out = compare(stated | {"id": identification(stated)}, stated | {"notes": "y"}).differences
    assert [str(d) for d in out] == [f"{CERTIFICATE}: notes is {shown}, computed again y"]


@pytest.mark.parametrize(("times", "differs"), [(0.8, False), (1.25, True)])
def test_another_environment_is_allowed_so_much_of_a_figure_and_no_more(folder: Path, times: float, differs: bool) -> None:
    content = content_of(folder)
    figures = content["characteristics"]
    number = next(i for i, f in enumerate(figures) if abs(f["value"]) > f["u95"])
    figures[number]["value"] *= 1.0 + times * RELATIVE
    resealed(folder, {"characteristics": figures, "environment": content["environment"] | {"numpy": "1.0"}})
    found = verify(folder)
    assert found.environment == (f"numpy 1.0, here {np.__version__}",)
    assert [d.what for d in found.differences] == ([label(figures[number])] if differs else [])
    assert found.largest == (0.0 if differs else pytest.approx(times * RELATIVE, rel=1e-5))
    lines = report_lines(found, requested=False)
    assert f"not compared: environment: numpy 1.0, here {np.__version__}: the certificate's environment cannot be checked here" in lines
    if not differs:
        assert f"results differ in their last digits, by at most {found.largest:.2g}. Up to 1e-06 is accepted" in lines
    assert lines[-1].endswith("1 difference" if differs else "equal within 1e-06. 1 item above was not compared")


@pytest.mark.parametrize("u95", [None, 0.0])
@pytest.mark.parametrize(("times", "differs"), [(0.8, False), (1.25, True)])
def test_a_figure_without_an_uncertainty_is_allowed_a_part_of_itself(u95: float | None, times: float, differs: bool) -> None:
    """Of 2 micrometres as of 2 metres."""
    figure = {"name": "AP_p", "pose": "P1", "value": 0.002, "u95": u95, "unit": "mm", "capable": None}
    stated = with_digest({"characteristics": [figure], "method": METHOD})
    again = stated | {"characteristics": [figure | {"value": 0.002 * (1.0 + times * RELATIVE)}]}
    found = compare(stated | {"id": identification(stated)}, again)
    assert bool(found.differences) == differs
    assert found.largest == (0.0 if differs else pytest.approx(times * RELATIVE, rel=1e-5))


def test_a_large_value_hides_no_other_u95_and_a_small_one_is_compared_with_its_u95() -> None:
    """Neither does a forged one widen what is allowed: sizes are those of the figure as it is computed again."""
    figure = {"name": "AP_x", "pose": "P1", "value": 1e-5, "u95": 0.01, "unit": "mm", "capable": False, "coverage_factor": 2.0}
    large = figure | {"name": "AV", "value": 1000.0}
    stated = with_digest({"characteristics": [figure, large], "method": METHOD})

    def found(**forged: float) -> list[str]:
        table = with_digest(stated | {"characteristics": [figure | forged, large | forged]})
        return [d.what for d in compare(table | {"id": identification(table)}, stated).differences]

    assert found() == []
    assert found(u95=0.01 + 5e-9) == []
    assert found(u95=0.01 + 5e-8) == ["AP_x of P1", "AV of P1"]
    assert found(u95=1e6) == ["AP_x of P1", "AV of P1"]
    assert found(coverage_factor=2.0 + 1e-5) == ["AP_x of P1", "AV of P1"]
    assert found(value=1e-5 + 5e-9) == ["AV of P1"]
    assert found(value=1e-5 + 5e-8) == ["AP_x of P1", "AV of P1"]


@pytest.mark.parametrize(
    ("one", "other", "alike"),
    [
        ({"a": [1.0, "x"]}, {"a": [1.0 + 0.9e-6, "x"]}, True), ({"a": [1.0, "x"]}, {"a": [1.0 + 1.1e-6, "x"]}, False),
        ({"a": 1.0}, {"a": 1.0, "b": 1.0}, False), ([1.0, 2.0], [1.0], False), ([1.0], [1.0, 2.0], False), (0.0, 0.9e-9, True),
        (0.0, 1.1e-9, False), (True, True, True), (True, 1, False), (True, 1.0 + 0.5e-6, False), (None, None, True), (None, 0.0, False),
        ({"a": 1.0}, None, False), ([1.0], None, False), ("1", None, False), ("U95 0.0123 mm", "U95 0.0124 mm", True),
        ("U95 0.0123 mm", "U95 0.0125 mm", False), ("U95 0.0123 mm", "U95 0.0123 deg", False), ("U95 0.0123 mm", "U96 0.0123 mm", False),
        ("1.5e-07 mm", "1.6e-07 mm", True), ("5 poses", "6 poses", False), ("5", 5.0, False), ("1e3 mm", "1e4 mm", False),
        ("1e6 mm", "1000001e0 mm", True), ("5 poses", "5e0 poses", True), ("5 poses", "5 poses 7", False),
        ("1234567.0 s", "1234567.9 s", True), ("2.5", "-2.5", False), ("1000000.0 s", "1000001.0 s", True),
        ("U95 0.0123 mm", "U95 0.01239 mm", True), ("U95 0.0123 mm", "U95 0.01245 mm", False),
    ],
)  # fmt: skip
def test_tables_alike_but_for_last_digits(one: Any, other: Any, alike: bool) -> None:
    for a, b in ((one, other), (other, one)):
        stated = with_digest({"characteristics": [], "notes": a})
        found = compare(stated | {"id": identification(stated)}, stated | {"notes": b})
        assert [d.what for d in found.differences] == ([] if alike else [CERTIFICATE])
        # a printed digit may be another rounding, and is named
        assert bool(found.skipped) == (alike and isinstance(a, str) and a != b)


@pytest.mark.parametrize("exact", [True, False])
def test_a_table_that_earlier_versions_did_not_write_is_missed_where_this_very_one_should_have(exact: bool) -> None:
    """One that this version would not write is no part of a certificate, whichever wrote it; of codes the texts tell enough."""
    stated = with_digest({"characteristics": [], "method": METHOD, "notes": []})
    stated["id"] = identification(stated)
    found = compare(stated, stated | {"novel": [1.0]}, other_version=not exact)
    assert (exact, len(found.skipped)) in ((True, 0), (False, 1))
    out = found.differences
    assert [str(d) for d in out] == ([f"{CERTIFICATE}: novel is None, computed again [1.0]"] if exact else [])
    more = stated | {"novel": [1.0]}
    out = compare(more | {"id": identification(more)}, stated, other_version=not exact).differences
    assert [str(d) for d in out] == [f"{CERTIFICATE}: novel is [1.0], computed again None"]
    coded = stated | {"findings": [{"code": "x", "text": "y"}]}
    out = compare(coded | {"id": identification(coded)}, stated | {"findings": []}, other_version=not exact).differences
    assert bool(out) == exact


def test_what_no_method_has_a_part_in_is_held_to_the_digit_beside_those_of_another() -> None:
    stated: dict[str, Any] = {"characteristics": [], "method": METHOD + 1, "measurement": {"constraint_mm": 2.0}, "settings": {"trials": 1}}
    stated["id"] = identification(stated)
    for change, said in (({}, []), ({"settings": {"trials": 2}}, []), ({"measurement": {"constraint_mm": 2.0 + 1e-12}}, ["measurement"])):
        assert [str(d).removeprefix(f"{CERTIFICATE}: ").split()[0] for d in beside(stated, stated | change)[0]] == said


def test_a_millionth_of_a_result_is_no_difference() -> None:
    figure = {"name": "AP_p", "pose": "P1", "value": 1e-3, "u95": 1.0, "unit": "mm", "capable": True}
    base = with_digest({"characteristics": [figure], "method": METHOD})
    base["id"] = identification(base)
    for off, seen in ((0.9e-6, 0), (1.1e-6, 1)):
        other = base | {"characteristics": [figure | {"value": 1e-3 + off}]}
        found = compare(base, other)
        assert len(found.differences) == seen
        assert found.largest == (0.0 if seen else pytest.approx(off))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"details": 1}, "details is missing"),
        ({"inputs": {}}, "inputs is missing"),
        ({"created": "yesterday"}, "created is not a date"),
        ({"method": 0}, "method is not a number"),
        ({"method": True}, "method is not a number"),
        ({"method": 1.0}, "method is not a number"),
        ({"language": "fr"}, "language is not one of en, ru"),
        ({"schema": "lmeasure.certificate/2"}, "is not a certificate"),
        ({"characteristics": [{"name": "AP_p"}]}, "lacks its name, value, unit, u95 or capable"),
        ({"characteristics": ["AP_p"]}, "lacks its name"),
        ({"findings": {}}, "findings are not texts with their codes"),
        ({"findings": ["misfit"]}, "findings are not texts with their codes"),
        ({"findings": [{"text": "x"}, {"text": 1}]}, "findings are not texts with their codes"),
        ({"characteristics": [{"name": "A", "value": "1", "unit": "mm", "u95": 0.0, "capable": True}]}, "A: value and u95 must be finite"),
        ({"characteristics": [{"name": "A", "value": 1.0, "unit": "mm", "u95": None, "capable": True}]}, "A: value and u95 must be finite"),
    ],
)
def test_a_table_that_is_no_certificate_is_named(folder: Path, change: dict[str, Any], said: str) -> None:
    resealed(folder, change)
    with pytest.raises(CertificationError, match=said):
        read_certificate(folder / CERTIFICATE)
    found = verify(folder)
    assert said in texts(found)[0]
    assert str(folder) not in texts(found)[0]
    assert found.skipped == ("results: see above",)


def test_every_digit_is_as_it_is_written(folder: Path) -> None:
    path = folder / CERTIFICATE
    assert read_certificate(path) == content_of(folder)
    assert read_certificate(path) == content_of(folder) | {"method": METHOD}
    text = path.read_text(encoding="utf-8")
    for other in (
        text.replace(f'"method": {METHOD}', f'"method": {METHOD},\n "method": {METHOD}'),
        text + "\n",
        text.replace('"value": ', '"value":  ', 1),
    ):
        path.write_text(other, encoding="utf-8")
        with pytest.raises(CertificationError, match="is not written as lmeasure writes it"):
            read_certificate(path)
    for other in (text.replace('"value": ', '"value": NaN, "v": ', 1), text[:-3]):
        path.write_text(other, encoding="utf-8")
        with pytest.raises(CertificationError, match="is not JSON"):
            read_certificate(path)
    # methods are numbered from 1
    path.write_text(text, encoding="utf-8")
    assert resealed(folder, {"method": 1}) == read_certificate(path)
    # of an infinite number only the digits stand in the file
    path.write_text(text.replace('"u95": 0.0', '"u95": 1e999', 1), encoding="utf-8")
    with pytest.raises(CertificationError, match="value and u95 must be finite"):
        read_certificate(path)


def test_inputs_that_were_changed_are_not_computed(folder: Path) -> None:
    path = folder / "inputs" / "trajectory.csv"
    path.write_bytes(path.read_bytes() + b"\n")
    found = verify(folder)
    assert [d.what for d in found.differences] == ["inputs/trajectory.csv"]
    assert found.skipped == ("results: these are not the certified inputs",)
    assert found.figures == 0


def test_files_that_are_no_part_of_a_certificate(folder: Path) -> None:
    (folder / "note.txt").write_text("x")
    (folder / "inputs" / "note.txt").write_text("x")
    resealed(folder, {})
    # without its printers it is not known what else may stand there
    assert texts(verify(folder)) == ["inputs/note.txt: is no input of the certificate"]
    assert texts(verify(folder, printers=PRINTERS)) == [
        "inputs/note.txt: is no part of a certificate",
        "note.txt: is no part of a certificate",
    ]


def test_pages_are_printed_again(folder: Path) -> None:
    page = (folder / PAGE).read_bytes()
    (folder / PAGE).write_bytes(page + b"\n")
    # what the seal has named is not named twice
    assert texts(verify(folder, printers=PRINTERS)) == [f"{PAGE}: was changed: {len(page) + 1} bytes instead of {len(page)}"]
    content = resealed(folder, {})
    says_otherwise = [f"{PAGE}: differs from the print of certificate.json"]
    assert texts(verify(folder, printers=PRINTERS)) == says_otherwise
    # other libraries print other bytes: then the text is compared, and it is said that no more was
    other = resealed(folder, {"environment": content["environment"] | {"typst": "0.1"}})
    (folder / PAGE).write_bytes(page.replace(content["id"].encode(), other["id"].encode()) + b"\n")
    resealed(folder, {})
    found, text_only = verify(folder, printers=PRINTERS), f"{PAGE}: only its text was compared, not its drawings and layout"
    assert (texts(found), found.skipped[1:], found.exit_code) == ([], (text_only,), 3)
    (folder / PAGE).write_bytes(page + b"and more")
    resealed(folder, {})
    assert texts(verify(folder, printers=PRINTERS)) == says_otherwise
    (folder / PAGE).write_bytes(b"\xff")
    resealed(folder, {})
    assert texts(verify(folder, printers=PRINTERS))[0].startswith(f"{PAGE}: cannot be read: ")
    # another version of this program may print other texts; where they are the same they were compared
    other = resealed(folder, {"environment": content["environment"] | {"lmeasure": "0.0.1"}})
    (folder / PAGE).write_bytes(page.replace(content["id"].encode(), other["id"].encode()) + b"\n")
    resealed(folder, {})
    assert verify(folder, printers=PRINTERS).skipped[1:] == (text_only,)
    (folder / PAGE).write_bytes(page + b"and more")
    resealed(folder, {})
    found = verify(folder, printers=PRINTERS)
    assert (texts(found), found.exit_code) == ([], 3)
    assert found.skipped[1:] == (f"{PAGE}: its printed texts, because another version of lmeasure prints other texts",)
    (folder / PAGE).unlink()
    resealed(folder, {})
    assert verify(folder, printers=PRINTERS).skipped[1:] == (f"{PAGE}: missing in the folder",)


@pytest.fixture
def stated() -> Callable[..., Verification]:
    return lambda **changes: replace(Verification("LM-1", (), 7, "0123456789abcdef0123"), **changes)


def test_whose_key_signed_it_is_only_said_where_it_was_asked(stated: Callable[..., Verification]) -> None:
    signed = "signed by 0123456789abcdef: "
    assert report_lines(stated(), requested=True)[0] == signed + "the requested key"
    assert report_lines(stated(), requested=False)[0] == signed + "no confirmed key here"
    other = stated(differences=(Difference(SIGNATURE, "is by another key"),))
    assert report_lines(other, requested=True)[:2] == [signed + "no confirmed key here", "signature.json: is by another key"]
    assert report_lines(stated(differences=(Difference("a", "b"),)), requested=True)[0] == signed + "the requested key"
    assert report_lines(stated(signer=None), requested=True)[0] == "unsigned: origin not proved"
    # a signature that cannot be read is named, and it is not said that there is none
    broken = stated(signer=None, differences=(Difference(SIGNATURE, "is not one"),))
    assert report_lines(broken, requested=True) == ["signature.json: is not one", "LM-1: 1 difference"]


def test_the_last_line_says_what_came_of_it(stated: Callable[..., Verification]) -> None:
    one = Difference("a", "b")
    assert report_lines(stated(), requested=True)[-1] == "LM-1: every file's hash is right, all 7 results recomputed and equal to the digit"
    assert report_lines(stated(figures=0), requested=True)[-1] == "LM-1: every file's hash is right"
    assert report_lines(stated(differences=(one, one)), requested=True)[-1] == "LM-1: 2 differences"
    assert report_lines(stated(certificate="", differences=(one,)), requested=True)[-1] == "certificate: 1 difference"
    skipped = report_lines(stated(skipped=("x: y", "z")), requested=True)
    assert skipped[1:3] == ["not compared: x: y", "not compared: z"]
    assert skipped[-1].endswith("equal to the digit. 2 items above were not compared")
    other = report_lines(stated(environment=("numpy 1.0, here 2.0",), largest=2e-9), requested=True)
    assert other[1] == "results differ in their last digits, by at most 2e-09. Up to 1e-06 is accepted"
    assert other[-1].endswith("results recomputed and equal within 1e-06")
    assert [stated(**c).exit_code for c in ({}, {"skipped": ("x",)}, {"differences": (one,), "skipped": ("x",)})] == [0, 3, 1]
