"""Temperatures of a campaign: one that warmed is warned of, and a rig that grows needs one."""

from dataclasses import replace

import numpy as np
import pytest
import real_rig
from test_unsolved import nominal, truth

from lmeasure.calibration import Campaign, calibrate
from lmeasure.core import FloatArray
from lmeasure.recording import Poses
from lmeasure.rig import rig_from_dict


def campaign(temperature_c: FloatArray | None = None) -> Campaign:
    rng, true = np.random.default_rng(4), truth(4)
    rows = real_rig.scattered(rng, 14)
    rig = rig_from_dict(nominal(true))
    reference = Poses(tuple(str(i) for i in range(14)), rows, np.full(14, 0.02), np.full(14, 1e-4))
    counts = np.rint(true.true_counts(rows, rows[0]))
    return Campaign(rig, reference, rig.cable, counts, np.zeros(6, dtype=np.int64), temperature_c=temperature_c)


def test_a_campaign_that_warmed_is_warned_of() -> None:
    warm = np.repeat(np.linspace(18.0, 26.0, 14)[:, None], 6, axis=1)
    found = calibrate(campaign(warm))
    (warning,) = [w for w in found.record.warnings if w.code == "temperature"]
    assert "up to 4.0 K off the campaign's mean of 22.0 deg C" in warning.text
    assert found.record.temperature_c == pytest.approx(22.0)
    assert warning.value is not None
    assert warning.value > 0.01


def test_a_rig_that_grows_wants_to_know_how_warm_it_was() -> None:
    base = campaign()
    grown = replace(base, rig=base.rig.model_copy(update={"frame_expansion_per_k": 1.2e-5}))
    (warning,) = [w for w in calibrate(grown).record.warnings if w.code == "temperature"]
    assert warning.text == "the rig has expansion coefficients, but no file has a temperature_c. The rig's reference, 20 deg C, is used"
