"""Load python-can without asammdf, which only its MF4 files need: with SymPy and pandas it costs each command on a bus or log a second."""

import sys
from importlib import import_module, reload
from typing import Any

_ASAMMDF = "asammdf"

_hides = _ASAMMDF not in sys.modules and "can" not in sys.modules
if _hides:
    sys.modules[_ASAMMDF] = None  # type: ignore[assignment]
try:
    import can as can
finally:
    if _hides:
        del sys.modules[_ASAMMDF]


def user(package: str) -> Any:
    """Return a package that loads python-can itself, such as canopen or cantools."""
    return import_module(package)


def mf4_reader() -> Any:
    """Return python-can's class that reads MF4 files, with asammdf if it is installed."""
    import can.io.mf4

    return (reload(can.io.mf4) if _hides else can.io.mf4).MF4Reader
