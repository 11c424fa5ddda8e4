"""Certificates of one robot over time, or of robots of one type."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from lmeasure.workflows.flow import Progress, Result, present, silent, workflow
from lmeasure.workflows.settings import Asked, Paths, option

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

    def paths(self) -> Paths:
        """A comparison from certificates."""
        return Paths(present(self.out), self.certificates)


@workflow("compare")
def run(settings: Settings, progress: Progress = silent) -> "Result[Comparison]":
    """Compare, and write the figures where they are asked for."""
    from lmeasure import files
    from lmeasure.certification.bundle import CERTIFICATE
    from lmeasure.certification.canonical import canonical
    from lmeasure.certification.compare import as_dict, compare_certificates, lines
    from lmeasure.certification.verify import read_certificate

    read = [(str(path), read_certificate(path / CERTIFICATE if path.is_dir() else path)) for path in settings.certificates]
    found = compare_certificates(read)
    progress(1.0, "compare")
    if settings.out is not None:
        files.write_text(settings.out, canonical(as_dict(found)).decode("utf-8"))
    shifts = [shift.distance_mm for pair in found.pairs for shift in pair.shifts]
    figures = {"certificates": float(len(read)), "compared": float(sum(len(pair.changes) for pair in found.pairs))}
    figures |= {"largest_shift_mm": max(shifts)} if shifts else {}
    figures |= {"largest_exchangeability_mm": max(e.value_mm for e in found.exchangeability)} if found.exchangeability else {}
    return Result(found, tuple(lines(found)), figures)
