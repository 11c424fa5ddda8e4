"""Before numpy is loaded, here and in started processes: matrices are small, and threads of BLAS only wait for each other."""

import os
from collections.abc import Generator
from typing import Any

import pytest
from alone import turn
from hypothesis import settings

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# what is printed is compared with English, whatever the language of the machine
os.environ["LANGUAGE"] = "en"
# how long an example takes says more of what else the machine does
settings.register_profile("unhurried", deadline=None)
settings.load_profile("unhurried")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, Any, Any]:
    """With several workers, a test marked `live` runs alone."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        return (yield)
    with turn(item.config.rootpath / ".pytest_cache" / "turns", item.get_closest_marker("live") is not None):
        return (yield)
