from .correction import (
    Corrected as Corrected,
    Outcome as Outcome,
    as_record as as_record,
    corrected_program as corrected_program,
    fits as fits,
    identified_mm as identified_mm,
    mapped_program as mapped_program,
)
from .program import Dialect as Dialect, Listing as Listing, Source as Source, Target as Target, Unread as Unread, of_angles as of_angles
from .registry import dialect_names as dialect_names, dialect_of as dialect_of, is_dialect as is_dialect, opened as opened
