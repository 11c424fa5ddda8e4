"""The report about an accuracy zone: one self-contained HTML page, and a PDF for the file."""

from collections.abc import Sequence
from pathlib import Path

import xarray as xr

from lmeasure.report.zone_html import write_zone_page
from lmeasure.report.zone_pdf import write_zone_pdf
from lmeasure.rig import CalibrationRecord, Rig
from lmeasure.structure import Piece


def write_zone_report(
    folder: Path,
    zone: xr.Dataset,
    rig: Rig,
    calibration: CalibrationRecord | None = None,
    *,
    language: str = "en",
    followed: Sequence[Piece] = (),
) -> None:
    """Write zone.html and zone.pdf into the folder, each whole or not at all; calibration: that of the zone; followed: its edge, level by
    level, for the page."""
    write_zone_page(Path(folder) / "zone.html", zone, rig, calibration, language=language, followed=followed)
    write_zone_pdf(Path(folder) / "zone.pdf", zone, rig, language)
