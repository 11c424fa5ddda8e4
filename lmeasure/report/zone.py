"""The report about an accuracy zone: one self-contained HTML page, and a PDF for the file."""

from pathlib import Path

import xarray as xr

from lmeasure.calibration_record import CalibrationRecord
from lmeasure.report.zone_html import write_zone_page
from lmeasure.report.zone_pdf import write_zone_pdf
from lmeasure.rig import Rig


def write_zone_report(
    folder: Path, zone: xr.Dataset, rig: Rig, calibration: CalibrationRecord | None = None, *, language: str = "en"
) -> None:
    """Write zone.html and zone.pdf into the folder, each whole or not at all; calibration: that of the zone."""
    write_zone_page(Path(folder) / "zone.html", zone, rig, calibration, language=language)
    write_zone_pdf(Path(folder) / "zone.pdf", zone, rig, language)
