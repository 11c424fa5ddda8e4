"""What a calibration delivers when the world is not as its files say: cases by an independent forward model, with the truth beside them.

    python benchmarks/broken_assumptions.py --rigs 16 --keep cases.jsonl [--case NAME ...]
    python benchmarks/broken_assumptions.py --alarms 300 --first 1000

Every rig is drawn, its campaign of twenty poses calibrated, and a run reconstructed with the result. Beside it: with the drawing, with the
plain fit (residuals taken as they are), and with the truth stated as a user can (uncertainties of poses, groups to solve for). "inside" is
the share of samples within the stated 95 % region of all six degrees of freedom. --keep goes on from what is kept.
"""

import itertools
import sys
from collections import Counter
from pathlib import Path
from unittest import mock

import numpy as np
import pandas as pd
from study import Study

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from real_rig import Flaws
from real_world import Case, RealCampaign, Score, make, reported, score, score_of

from lmeasure.calibration import CalibrationSettings, Campaign, Model, calibrate
from lmeasure.calibration.solve import solve
from lmeasure.calibration.validation.misfit import Explained
from lmeasure.core import LMeasureError
from lmeasure.estimation import Fit

EXACT = (0.0, 0.0)
CASES = {
    "sound": Case(),
    "orientations of 100 urad stated as 50": Case(u_rad=100e-6),
    "orientations off by 0.06 deg stated as exact": Case(u_rad=np.radians(0.06), stated=(0.05, 0.0)),
    "positions off by 0.15 mm stated as 0.05": Case(u_mm=0.15),
    "poses off by 0.5 mm and 0.1 deg stated as 0.05 mm and 50 urad": Case(u_mm=0.5, u_rad=np.radians(0.1)),
    "the same, nothing stated": Case(u_mm=0.5, u_rad=np.radians(0.1), stated=None),
    "exact poses, nothing stated": Case(u_mm=0.0, u_rad=0.0, stated=None),
    "poses of 0.05 mm, nothing stated": Case(stated=None),
    "circumference 0.05 %": Case(Flaws(circumference=5e-4), cure=("scale",)),
    "attachments 0.1 mm": Case(Flaws(attachment_mm=0.1), cure=("attachment",)),
    "pulleys eccentric by 0.05 mm": Case(Flaws(eccentric_mm=0.05)),
    "run-out 0.02 mm": Case(Flaws(run_out_mm=0.02)),
    "friction of 8 counts": Case(Flaws(friction_counts=8.0)),
    "play of 2 counts": Case(Flaws(play_counts=2.0)),
    "5 K warmer in the run than in the campaign, nothing stated": Case(Flaws(expansion_per_k=11.5e-6), warmer_k=5.0),
    "circumference 0.05 %, exact poses": Case(Flaws(circumference=5e-4), 0.0, 0.0, EXACT, cure=("scale",)),
    "run-out 0.02 mm, exact poses": Case(Flaws(run_out_mm=0.02), 0.0, 0.0, EXACT),
    "friction of 8 counts, exact poses": Case(Flaws(friction_counts=8.0), 0.0, 0.0, EXACT),
    "good drawing, poses off by 2 mm stated as 0.05": Case(u_mm=2.0, u_rad=np.radians(0.2), off=(0.05, 0.02)),
}


def _as_it_is(model: Model, found: Fit, blamed: list[str]) -> Explained:
    """Nothing is explained and nothing multiplied."""
    return Explained(model, found, [], False, np.zeros(len(model.campaign.cables)))


def plainly(made: RealCampaign, campaign: Campaign, settings: CalibrationSettings) -> Score:
    """The run with a calibration that takes its residuals as they are."""
    with mock.patch.object(solve, "explain_misfit", _as_it_is):
        return score_of(calibrate(campaign, settings), made)


def study(seed: int, name: str) -> dict[str, object]:
    """One rig of a case."""
    case = CASES[name]
    made = make(case, seed)
    row: dict[str, object] = {"case": name, "seed": seed, "drawing": score(made.campaign.rig, None, made).error_mm}
    try:
        result = calibrate(made.campaign)
    except LMeasureError as error:
        return row | {"refused": str(error)}
    codes = Counter(w.code for w in result.record.warnings)
    row |= {"refused": result.refused, "codes": " ".join(sorted(codes))}
    delivered = score_of(result, made)
    row |= {"delivered": delivered.error_mm, "inside": delivered.inside, "squares": delivered.squares}
    row["plain"] = plainly(made, made.campaign, CalibrationSettings()).error_mm
    stated = plainly(made, reported(made, case), CalibrationSettings(("position", "guide", *case.cure)))
    return row | {"stated": stated.error_mm, "stated_inside": stated.inside}


def alarm(seed: int) -> list[str]:
    """Return the warnings of a sound campaign but those that sound ones have."""
    result = calibrate(make(CASES["sound"], seed, samples=2).campaign)
    return [*sorted({w.code for w in result.record.warnings} - {"note", "underdetermined"}), *["refused"] * (result.refused is not None)]


def alarms(found: list[list[str]]) -> str:
    """Return how many of the sound campaigns raise which warnings."""
    return f"{len(found)} sound campaigns: {dict(Counter(itertools.chain(*found)))}"


def rms(values: pd.Series) -> float:
    """Root mean square."""
    return float(np.sqrt(np.nanmean(values.astype(float) ** 2)))


def table(found: list[dict[str, object]]) -> str:
    """A line for each case."""
    data = pd.DataFrame(found)
    out = [
        "| case | rigs | drawing | plain fit | truth stated | delivered | inside | worse than the drawing | refused | warnings |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name in CASES:
        own = data[data["case"] == name]
        if not len(own):
            continue
        used = own[own["refused"].isna()]
        worse = int((used["delivered"] > used["drawing"]).sum())
        codes = Counter(" ".join(own["codes"].dropna().astype(str)).split())
        said = ", ".join(f"{code} {times}" for code, times in codes.most_common() if code not in ("note", "underdetermined"))
        errors = " | ".join(f"{rms(own[c]):.4f}" for c in ("drawing", "plain", "stated"))
        out.append(
            f"| {name} | {len(own)} | {errors} | {rms(used['delivered']):.4f} | {100 * used['inside'].astype(float).mean():.1f} % | "
            f"{worse} | {len(own) - len(used)} | {said} |"
        )
    return "\n".join(out)


STUDY = Study("broken_assumptions", study, table, "rigs", 16, {"case": tuple(CASES)}, "{case} {seed}")
ALARMS = Study("broken_assumptions", alarm, alarms, "alarms", 300)

if __name__ == "__main__":
    sys.exit((ALARMS if "--alarms" in sys.argv else STUDY).command(__doc__))
