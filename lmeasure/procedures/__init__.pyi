from .capture.folder import UNCERTAINTIES as UNCERTAINTIES, CaptureFolder as CaptureFolder, open_folder as open_folder
from .capture.session import Session as Session, Settings as Settings
from .capture.state import state_of as state_of
from .intermediate_check.check import (
    COLUMNS as COLUMNS,
    Checked as Checked,
    Limits as Limits,
    Trend as Trend,
    appended as appended,
    as_dict as as_dict,
    check_instrument as check_instrument,
    now as now,
    said as said,
    verdict_text as verdict_text,
)
from .intermediate_check.closures import Closure as Closure
from .intermediate_check.moved_parts import Cause as Cause, explained as explained
