"""Display of objects: one line at a prompt, a small table in a notebook, a data frame for everything else."""

from abc import abstractmethod
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pandas import DataFrame as DataFrame
else:
    DataFrame = Any  # pandas is loaded where a frame is made


class Shown:
    """A noun of the pipeline as a person meets it; pictures of it are drawn by `lmeasure.plot`."""

    @abstractmethod
    def about(self) -> dict[str, str]:
        """Return its properties, by name, most important first."""

    @abstractmethod
    def to_frame(self) -> DataFrame:
        """Its figures as a table, units in the names of the columns."""

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {', '.join(f'{name}: {value}' for name, value in self.about().items())}>"

    def __str__(self) -> str:
        return repr(self)

    def _repr_html_(self) -> str:
        from html import escape

        rows = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in self.about().items())
        return f"<table><caption>{escape(type(self).__name__)}</caption>{rows}</table>"


def framed(columns: Any) -> DataFrame:
    """A table of columns, or of rows that are mappings."""
    import pandas as pd

    return pd.DataFrame(columns)
