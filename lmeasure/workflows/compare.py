"""Certificates of one robot over time, or of robots of one type; two calibrations of one rig."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import Field

from lmeasure.core import SettingsError, pasted
from lmeasure.text import message, of_terminal
from lmeasure.workflows.flow import Progress, Result, present, silent, workflow
from lmeasure.workflows.settings import LANGUAGE, Paths, Writing, option, refuse, then

if TYPE_CHECKING:
    from lmeasure.calibration import Comparison as Moved
    from lmeasure.certificate import Comparison, Consensus


class Settings(Writing):
    """Settings of `lmeasure compare`."""

    OUT_FILE: ClassVar[str] = "comparison.json"
    certificates: Annotated[
        tuple[Path, ...],
        Field(min_length=1),
        option(
            "Folders of certificates or certificate.json files, or two calibrations; the earlier one first.",
            metavar="CERTIFICATE...",
            positional=True,
        ),
    ]
    out: Annotated[Path | None, option("JSON file to write all results of the comparison to.", metavar="FILE.json")] = None

    page: Annotated[
        Path | None, option("Folder for a report with both side by side, and the effect of a correction between them.", metavar="FILE.html")
    ] = None
    corrections: Annotated[
        Path | None,
        option("corrections.json of `lmeasure correct`: also list the remaining error of the kinematic calibration.", metavar="FILE"),
    ] = None
    between: Annotated[
        bool, option("Compare the results of several laboratories for one robot: consensus, degrees of equivalence, E_n. Also takes DCCs.")
    ] = False
    common_mm: Annotated[float, Field(ge=0), option("Standard uncertainty that all laboratories share, for results in mm.")] = 0.0
    artefact_mm: Annotated[float, Field(ge=0), option("Standard uncertainty of the robot between the measurements, for results in mm.")] = (
        0.0
    )
    language: Annotated[Literal["en", "ru"] | None, LANGUAGE] = None

    def following(self) -> str:
        """Return the command that draws the comparison, or opens it."""
        if self.page is not None or self.between:
            return then("verify {first}", first=self.certificates[0])
        return then(f"compare {' '.join(map(pasted, self.certificates))} --page comparison.html")

    def paths(self) -> Paths:
        """A comparison from certificates."""
        read = [path / name for path in self.certificates for name in ("certificate.json", "calibration.json", "rig.toml")]
        return Paths(present(self.out, self.page), (*self.certificates, *read, *present(self.corrections)))


@workflow
def run(settings: Settings, progress: Progress = silent) -> "Result[Any]":
    """Compare, and write the figures where they are asked for."""
    if settings.between:
        return _laboratories(settings)
    if stray := next((name for name in ("common_mm", "artefact_mm") if getattr(settings, name)), None):
        raise SettingsError(stray, message("error.goes_with_between"))
    if any(_is_calibration(path) for path in settings.certificates):
        return _calibrations(settings)
    from lmeasure.certificate import CERTIFICATE, as_dict, canonical, compare_certificates, improvement, lines, read_certificate
    from lmeasure.io import files
    from lmeasure.report import reported as of_improvement, write_comparison_page
    from lmeasure.robot_programs import identified_mm

    read = [(str(path), read_certificate(path / CERTIFICATE if path.is_dir() else path)) for path in settings.certificates]
    found = compare_certificates(read)
    progress(1.0, "compare")
    reported, better = list(lines(found)), None
    if len(read) == 2:
        by_name = dict(read)
        first, later = (by_name[name] for name in found.names)
        left = None if settings.corrections is None else identified_mm(settings.corrections)
        better = improvement(first, later, left) if any(pair.shifts for pair in found.pairs) else None
    if settings.corrections is not None and better is None:
        raise SettingsError("corrections", message("error.tells_of_two_certificates"))
    if settings.corrections is not None and better is not None:
        reported += of_improvement(better)
    # nothing is written before all that is read has been
    if settings.out is not None:
        files.write_text(settings.out, canonical(as_dict(found)).decode("utf-8"))
    if settings.page is not None:
        contents = [(name, dict(read)[name]) for name in found.names]
        write_comparison_page(settings.page, found, contents, better, language=settings.language or of_terminal())
    written = [str(path) for path in (settings.out, settings.page) if path is not None]
    reported += [message("line.written", files=tuple(written))] if written else []
    shifts = [shift.distance_mm for pair in found.pairs for shift in pair.shifts]
    figures = {"certificates": float(len(read)), "compared": float(sum(len(pair.changes) for pair in found.pairs))}
    figures |= {"largest_shift_mm": max(shifts)} if shifts else {}
    figures |= {"largest_exchangeability_mm": max(e.value_mm for e in found.exchangeability)} if found.exchangeability else {}
    return Result(found, tuple(reported), figures)


def _laboratories(settings: Settings) -> "Result[tuple[Consensus, ...]]":
    """Compare laboratories."""
    from lmeasure.certificate import as_json, canonical, compare_laboratories, laboratory_lines, read_laboratory
    from lmeasure.io import files

    if stray := next((name for name in ("page", "corrections") if getattr(settings, name) is not None), None):
        raise SettingsError(stray, message("error.does_not_go_with"))
    laboratories = [read_laboratory(path) for path in settings.certificates]
    found = compare_laboratories(laboratories, common_mm=settings.common_mm, artefact_mm=settings.artefact_mm)
    if settings.out is not None:
        files.write_text(settings.out, canonical(as_json(found)).decode("utf-8"))
    apart = {e.laboratory for one in found for e in one.laboratories if abs(e.e_n) > 1.0}
    figures = {"laboratories": float(len(laboratories)), "results": float(len(found)), "apart": float(len(apart))}
    figures["largest_e_n"] = max(abs(e.e_n) for one in found for e in one.laboratories)
    return Result(found, tuple(laboratory_lines(found)), figures)


def _is_calibration(path: Path) -> bool:
    return path.name == "calibration.json" or (path / "calibration.json").is_file()


def _calibrations(settings: Settings) -> "Result[Comparison | Moved]":
    """Return what moved between two calibrations, by their records."""
    from dataclasses import asdict

    from lmeasure.calibration import compare_records, comparison_summary, read_earlier
    from lmeasure.certificate import canonical
    from lmeasure.io import files

    other = next((path for path in settings.certificates if not _is_calibration(path)), None)
    if other is not None:
        raise SettingsError("certificates", message("error.holds_no_calibration_json", where=other))
    if len(settings.certificates) != 2:
        raise SettingsError("certificates", message("error.of_calibrations_two_are"))
    refuse(settings, message("refuse.certificates"), "page", "corrections")
    found = compare_records(*map(read_earlier, settings.certificates))
    if settings.out is not None:
        files.write_text(settings.out, canonical(asdict(found)).decode("utf-8"))
    figures = {"largest_shift_mm": found.together.distance_mm, "moved": float(sum(p.moved for p in found.points))}
    return Result(found, tuple(comparison_summary(found).splitlines()), figures, found.notes)
