"""The first stages of every demo: reference poses counted over the bus, and the rig calibrated from them."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lmeasure.calibration import Calibration, calibrate, read_campaign
from lmeasure.demo.bus_loop import count_at_stops
from lmeasure.rig import Rig
from lmeasure.simulation import SimulatedCampaign, campaign_at, reference_poses, write_campaign
from lmeasure.text import of_terminal

Progress = Callable[[str, int, int], None]
"""Called with the stage, and how much of it is done of how much."""
Step = Callable[[str], Callable[[int, int], None]]
"""Begins a stage; its value takes how much of it is done of how much."""

COUNT, CALIBRATE = "count reference poses over the bus", "calibrate"
U_REFERENCE_MM = 0.02  # of each coordinate of a reference pose, as a laser tracker gives it
U_REFERENCE_RAD = 5e-5
NOMINAL_SHIFT_MM, NOMINAL_SHIFT_DEG = 30.0, 5.0


@dataclass(frozen=True)
class CalibratedCell:
    """The campaign, and the calibration made of its files."""

    campaign: SimulatedCampaign
    calibration: Calibration


def stages(progress: Progress | None) -> Step:
    """Progress stage by stage."""

    def step(stage: str) -> Callable[[int, int], None]:
        def report(done: int, of: int) -> None:
            if progress is not None:
                progress(stage, done, of)

        report(0, 1)
        return report

    return step


def calibrated_cell(out: Path, true: Rig, rng: np.random.Generator, step: Step) -> CalibratedCell:
    """Calibrate a nominal rig from counts of the true one; `campaign/` and `calibration/` are written into `out`."""
    # slow to import, and needed only for the page
    from lmeasure.report import write_calibration_page
    from lmeasure.rig import write_calibration_record, write_rig

    report = step(COUNT)
    asked = campaign_at(
        true,
        reference_poses(),
        rng,
        u_position_mm=U_REFERENCE_MM,
        u_rotation_rad=U_REFERENCE_RAD,
        nominal_shift_mm=NOMINAL_SHIFT_MM,
        nominal_shift_deg=NOMINAL_SHIFT_DEG,
    )
    campaign = replace(asked, recorded=count_at_stops(true, asked.poses, rng, report))
    write_campaign(out / "campaign", campaign)

    report = step(CALIBRATE)
    calibration = calibrate(read_campaign(out / "campaign"), progress=report)
    write_calibration_page(out / "calibration" / "report.html", calibration, language=of_terminal())
    write_calibration_record(out / "calibration" / "calibration.json", calibration.record)
    write_rig(out / "calibration" / "rig.toml", calibration.rig)
    return CalibratedCell(campaign, calibration)
