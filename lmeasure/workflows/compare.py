"""Certificates of one robot over time, or of robots of one type."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from lmeasure.catalogue import of_terminal
from lmeasure.errors import SettingsError
from lmeasure.workflows.flow import Progress, Result, present, silent, workflow
from lmeasure.workflows.settings import LANGUAGE, Asked, Paths, option

if TYPE_CHECKING:
    from lmeasure.certification.compare import Comparison


class Settings(Asked):
    """What `lmeasure compare` is asked."""

    certificates: Annotated[
        tuple[Path, ...],
        Field(min_length=1),
        option("Folders of certificates, or certificate.json files.", metavar="CERTIFICATE...", positional=True),
    ]
    out: Annotated[Path | None, option("Also write every figure of the comparison.", metavar="FILE.json")] = None

    page: Annotated[
        Path | None, option("Also write a page of them side by side, with what a correction between two of them made.", metavar="FILE.html")
    ] = None
    corrections: Annotated[
        Path | None,
        option("corrections.json of `lmeasure correct`: what identification left is told with what limits the robot.", metavar="FILE"),
    ] = None
    language: Annotated[Literal["en", "ru"] | None, LANGUAGE] = None

    def paths(self) -> Paths:
        """A comparison from certificates."""
        return Paths(present(self.out, self.page), (*self.certificates, *present(self.corrections)))


@workflow("compare")
def run(settings: Settings, progress: Progress = silent) -> "Result[Comparison]":
    """Compare, and write the figures where they are asked for."""
    from lmeasure import files
    from lmeasure.certification.bundle import CERTIFICATE
    from lmeasure.certification.canonical import canonical
    from lmeasure.certification.compare import as_dict, compare_certificates, lines
    from lmeasure.certification.improvement import improvement
    from lmeasure.certification.verify import read_certificate
    from lmeasure.report.comparison import told as of_improvement
    from lmeasure.report.comparison import write_comparison_page
    from lmeasure.robots.corrected_program import identified_mm

    read = [(str(path), read_certificate(path / CERTIFICATE if path.is_dir() else path)) for path in settings.certificates]
    found = compare_certificates(read)
    progress(1.0, "compare")
    if settings.out is not None:
        files.write_text(settings.out, canonical(as_dict(found)).decode("utf-8"))
    told, better = list(lines(found)), None
    if len(read) == 2:
        by_name = dict(read)
        first, later = (by_name[name] for name in found.names)
        left = None if settings.corrections is None else identified_mm(settings.corrections)
        better = improvement(first, later, left) if any(pair.shifts for pair in found.pairs) else None
    if settings.corrections is not None and better is None:
        raise SettingsError("corrections", "tells of two certificates that have poses in common, the earlier one without correction")
    if settings.corrections is not None and better is not None:
        told += of_improvement(better)
    if settings.page is not None:
        contents = [(name, dict(read)[name]) for name in found.names]
        write_comparison_page(settings.page, found, contents, better, language=settings.language or of_terminal())
        told.append(f"written: {settings.page}")
    shifts = [shift.distance_mm for pair in found.pairs for shift in pair.shifts]
    figures = {"certificates": float(len(read)), "compared": float(sum(len(pair.changes) for pair in found.pairs))}
    figures |= {"largest_shift_mm": max(shifts)} if shifts else {}
    figures |= {"largest_exchangeability_mm": max(e.value_mm for e in found.exchangeability)} if found.exchangeability else {}
    return Result(found, tuple(told), figures)
