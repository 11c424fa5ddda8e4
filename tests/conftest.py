"""Before numpy is loaded, here and in started processes: matrices are small, and threads of BLAS only wait for each other."""

import gc
import os
import signal
import sys
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest
from alone import turn
from hypothesis import settings

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# what pytest makes of assertions takes a worker ten seconds: it is kept, whatever the machine says of compiled files
sys.dont_write_bytecode = False
# what is printed is compared with English, whatever the language of the machine
os.environ["LANGUAGE"] = "en"
# begun behind another program, or by nohup, tests and what they start would not hear it
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
# how long an example takes depends on the load of the machine; the same examples every time; 50 where a test states no number
settings.register_profile("unhurried", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("unhurried")


LOOK_AT_REGIONS = ("test_doubted_residuals", "test_phase_of_zero", "test_published_rig", "test_recover", "test_regions", "test_robust")


@pytest.fixture(scope="module", autouse=True)
def fewer_draws(request: pytest.FixtureRequest) -> Iterator[None]:
    """Regions by an eighth of the draws, half of a calibration's time, where tests of calibrations do not look at regions."""
    with pytest.MonkeyPatch.context() as patch:
        if request.path.parent.name == "calibration" and request.path.stem not in LOOK_AT_REGIONS:
            from lmeasure.estimation import confidence_regions

            patch.setattr(confidence_regions, "DRAWS", 512)
            patch.setattr(confidence_regions, "JOINT_DRAWS", 256)
        yield


@pytest.fixture(scope="session")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with inputs of every command. Tests write into other folders within it, and leave these as they are."""
    from desk import set_up

    here = tmp_path_factory.mktemp("desk")
    set_up(here)
    return here


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, Any, Any]:
    """A test marked `live` goes before what other workers and programs do, or runs alone."""
    with turn(item.config.rootpath / ".pytest_cache" / "turns", item.get_closest_marker("live") is not None):
        return (yield)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest first: at the end no worker waits for another's."""
    items.sort(key=lambda item: "tests/workbench" not in item.path.as_posix())


def pytest_collection_finish() -> None:
    """What was collected stays to the end: nobody need look through it again and again for what could be thrown away."""
    gc.collect()
    gc.freeze()
