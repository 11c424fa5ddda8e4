"""Tables of other people: any usual header, separator, decimal mark and code page, and columns under other names in other units."""

from lmeasure.io.foreign.columns import ANGLES, COLUMN_KINDS, UNITS, Column, columns_of, headed
from lmeasure.io.foreign.layout import decoded, text_of
from lmeasure.io.foreign.table import TIMES, UNIT_TOLERANCE, ForeignTable

__all__ = [
    "ANGLES",
    "COLUMN_KINDS",
    "TIMES",
    "UNITS",
    "UNIT_TOLERANCE",
    "Column",
    "ForeignTable",
    "columns_of",
    "decoded",
    "headed",
    "text_of",
]
