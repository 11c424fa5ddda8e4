"""Regions of an eighth of the draws, half of a calibration's time, in the tests that do not look at regions."""

from collections.abc import Iterator

import pytest

from lmeasure.estimation import confidence_regions

LOOK_AT_REGIONS = ("test_doubted_residuals", "test_phase_of_zero", "test_published_rig", "test_recover", "test_regions", "test_robust")


@pytest.fixture(scope="module", autouse=True)
def fewer_draws(request: pytest.FixtureRequest) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        if request.module.__name__ not in LOOK_AT_REGIONS:
            patch.setattr(confidence_regions, "DRAWS", 512)
            patch.setattr(confidence_regions, "JOINT_DRAWS", 256)
        yield
