"""What a recording holds, read back."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from rerun.chunk import RrdReader

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
SINGLE = 2.0**-23  # rerun keeps lengths in single precision


def stored(path: Path, entity: str, component: str, timeline: str | None = None) -> tuple[IntArray, list[Any]]:
    """(index, cells) of one component of one entity; the index is empty for what holds at all times."""
    index: list[int] = []
    cells: list[Any] = []
    for chunk in RrdReader(path).stream().filter(content=f"{entity}", components=component, has_timeline=timeline):
        batch = chunk.to_record_batch()
        if timeline is not None:
            index += np.asarray(batch.column(timeline).cast(pa.int64())).tolist()
        cells += batch.column(component).to_pylist()
    order = np.argsort(index, kind="stable") if timeline is not None else np.arange(len(cells))
    return np.array(index, dtype=np.int64)[order] if timeline is not None else np.empty(0, np.int64), [cells[i] for i in order]


def scalars(path: Path, entity: str, timeline: str = "time", component: str = "Scalars:scalars") -> FloatArray:
    return np.array([cell[0] for cell in stored(path, entity, component, timeline)[1]])
