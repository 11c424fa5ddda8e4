"""A certificate as a whole: measured, printed, copied together and sealed."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lmeasure.certificate import (
    CERTIFICATE,
    Inputs,
    Measured,
    Printer,
    canonical,
    certificate,
    copy_into,
    dcc_xml,
    entries,
    environment,
    measure,
    new_folder,
    now,
    read_private_key,
    seal,
    write_zip,
)
from lmeasure.core import CertificationError, ForeignFolderError
from lmeasure.iso9283 import CertificationSettings, Evaluation
from lmeasure.report import certificate_tables as tables, certificate_text as say
from lmeasure.report.certificate_html import certificate_html
from lmeasure.report.certificate_pdf import certificate_pdf
from lmeasure.report.certificate_pictures import figures
from lmeasure.report.readable import page_alike, page_text, pdf_text, xml_text
from lmeasure.report.summary import counted
from lmeasure.report.text import word
from lmeasure.text import message
from lmeasure.trajectory import Trajectory

PDF = "certificate.pdf"
PAGE = "report.html"
XML = "certificate.xml"
BOOK, TABLE, ARRAYS = "certificate.xlsx", "certificate.csv", "certificate.mat"


def print_pdf(content: dict[str, Any], measured: Measured) -> bytes:
    """certificate.pdf."""
    return certificate_pdf(content, measured)


def print_page(content: dict[str, Any], measured: Measured) -> bytes:
    """report.html."""
    return certificate_html(content, measured).encode("utf-8", "backslashreplace")


def print_xml(content: dict[str, Any], measured: Measured) -> bytes:
    """certificate.xml."""
    return dcc_xml(content)


PRINTERS = {
    PDF: Printer(print_pdf, pdf_text),
    PAGE: Printer(print_page, page_text, close=page_alike),
    XML: Printer(print_xml, xml_text, needed=False),
    BOOK: Printer(tables.workbook, tables.workbook_text, needed=False, close=tables.workbook_alike),
    TABLE: Printer(lambda content, _: tables.csv_table(content), tables.csv_text, needed=False, close=tables.csv_alike),
    ARRAYS: Printer(tables.mat_file, tables.mat_text, needed=False, close=tables.mat_alike),
}


@dataclass(frozen=True)
class Choices:
    """Choices for writing a certificate: language; key to sign it with; dcc, and the XSD it must keep to; a zip of it beside the folder;
    force: replace an earlier certificate; tables: a workbook, a .csv and a .mat file too."""

    language: str = "en"
    key: Path | None = None
    dcc: bool = False
    xsd: Path | None = None
    zipped: bool = False
    force: bool = False
    tables: bool = False


def write_certificate(
    out: Path,
    inputs: Inputs,
    settings: CertificationSettings,
    choices: Choices,
    *,
    trajectory: Trajectory | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Write the folder of a certificate, whole or not at all, and return its content. trajectory: of the run, if already known.

    Raises the errors of reading and evaluating the inputs, and CertificationError if the folder has other content or the DCC breaks its
    XSD.
    """
    key = None if choices.key is None else read_private_key(choices.key)
    copies = inputs.copies()
    if inside := [path for path in copies.values() if path.resolve().is_relative_to(Path(out).resolve())]:
        raise ForeignFolderError(message("error.is_an_input_in", where=inside[0]))
    with new_folder(out, force=choices.force) as folder:
        measured = measure(inputs, settings, progress, trajectory=trajectory)
        if not measured.evaluation.characteristics:
            raise CertificationError(message("error.names_no_pose_or", where=inputs.program))
        _without_holes(measured.evaluation)
        copy_into(folder, copies)
        known = entries(folder, sorted(copies))
        versions = environment(measured.program.characteristics)
        content = certificate(measured, inputs, known, created=now(), language=choices.language, environment=versions)
        (folder / CERTIFICATE).write_bytes(canonical(content))
        for name in (PDF, PAGE, *((BOOK, TABLE, ARRAYS) if choices.tables else ())):
            (folder / name).write_bytes(PRINTERS[name](content, measured))
        if choices.dcc:
            (folder / XML).write_bytes(dcc_xml(content, choices.xsd))
        seal(folder, content["id"], known, key)
    if choices.zipped:
        write_zip(zip_of(out), Path(out))
    return content


def _without_holes(evaluation: Evaluation) -> None:
    """Raise CertificationError for a path with results though part of it has no samples. This applies to new certificates only: earlier
    sealed ones are verified by their own statements."""
    out = {e.name for e in evaluation.excluded if e.kind == "path"}
    for path in evaluation.paths:
        if path.unseen is not None and path.name not in out:
            raise CertificationError(message("error.path_what_the_robot", name=path.name, unseen=path.unseen))


def zip_of(out: Path) -> Path:
    """Return the path of a folder's .zip."""
    target = Path(out).resolve()
    return target.with_name(target.name + ".zip")


def headline(content: dict[str, Any], folder: Path) -> list[str]:
    """Return the lines on the screen: the most important results, the number of verdicts, and the files."""
    language = content["language"]
    rows = [(f.result, f.where) for f in figures(content)]
    out = [f"{say.title(content)} {content['id']}"]
    if rows:
        out.append(word(language, "headline", figures=len(content["characteristics"])))
        out += _columns([(r.symbol, r.name, where, r.value, f"{r.u95} {r.unit}".strip(), _verdict(r)) for r, where in rows])
    out += [say.outcome(content)[1], *counted(content)]
    without = _without_figures(content)
    out += [f"{word(language, 'headline.without')}: {', '.join(without)}"] if without else []
    out.append(f"{word(language, 'headline.look')} {folder / PDF}, {folder / PAGE}")
    out.append(f"{word(language, 'headline.check')}: lmeasure verify {folder}")
    return _plain(out)


def _without_figures(content: dict[str, Any]) -> list[str]:
    """Return poses and paths of the program without a result and without a reason. A program with times of some parts is not searched in
    the trajectory, and its other parts would be missing silently."""
    names = {kind: [str(part["name"]) for part in content["program"][kind]] for kind in ("pose", "path")}
    reported = {(kind, str(c[kind])) for c in content["characteristics"] for kind in names if c.get(kind) is not None}
    reported |= {(str(e["kind"]), str(e["name"])) for e in content["excluded"]}
    reported |= {("pose", one) for a, b in itertools.permutations(names["pose"], 2) if ("pose", f"{a}-{b}") in reported for one in (a, b)}
    missing = [(kind, name) for kind in names for name in names[kind] if (kind, name) not in reported]
    return [f"{word(content['language'], f'kind.{kind}')} {say.visible(name)}" for kind, name in missing]


def every_figure(content: dict[str, Any], *, brief: bool = False) -> list[str]:
    """Return all figures, test by test; brief: without their names in words and coverage factors."""
    out = [f"{say.title(content)} {content['id']}"]
    for test in say.results(content):
        out.append(f"{test.title}:")
        rows: list[tuple[str, ...]] = [
            (place, r.symbol, *(() if brief else (r.name,)), r.value, f"{r.u95} {r.unit}".strip())
            + (() if brief else (f"k {r.k}" if r.k else "", _verdict(r)))
            for place, r in test.rows
        ]
        out += _columns(rows)
    return _plain(out)


def _verdict(r: say.Result) -> str:
    return "; ".join(text for text in (r.verdict, r.conformity, r.limits) if text)


def _columns(rows: list[tuple[str, ...]]) -> list[str]:
    """Return rows with aligned columns, numbers to the right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    cells = [[f"{c:>{w}}" if c[:1].isdigit() or c[:1] == "-" else f"{c:{w}}" for c, w in zip(row, widths, strict=True)] for row in rows]
    return [f"  {'  '.join(row)}".rstrip() for row in cells]


def _plain(lines: list[str]) -> list[str]:
    # on the screen a blank is a blank: lines are not broken there, but searched
    return [line.replace("\u00a0", " ") for line in lines]
