"""Tables of other people: any usual header, separator, decimal mark and code page, and columns under other names in other units."""

from lmeasure.foreign.columns import ANGLES, KINDS, UNITS, Column, columns_of, headed
from lmeasure.foreign.layout import decoded, text_of
from lmeasure.foreign.table import TIMES, UNIT_TOLERANCE, ForeignTable

__all__ = ["ANGLES", "KINDS", "TIMES", "UNITS", "UNIT_TOLERANCE", "Column", "ForeignTable", "columns_of", "decoded", "headed", "text_of"]
