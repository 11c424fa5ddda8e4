from .capture.folder import (
    UNCERTAINTIES as UNCERTAINTIES,
)
from .capture.folder import (
    CaptureFolder as CaptureFolder,
)
from .capture.folder import (
    open_folder as open_folder,
)
from .capture.session import (
    Session as Session,
)
from .capture.session import (
    Settings as Settings,
)
from .capture.state import (
    state_of as state_of,
)
from .intermediate_check.check import (
    Checked as Checked,
)
from .intermediate_check.check import (
    Limits as Limits,
)
from .intermediate_check.check import (
    as_dict as as_dict,
)
from .intermediate_check.check import (
    check_instrument as check_instrument,
)
from .intermediate_check.check import (
    said as said,
)
from .intermediate_check.check import (
    verdict_text as verdict_text,
)
from .intermediate_check.closures import (
    Closure as Closure,
)
from .intermediate_check.explanation import (
    explained as explained,
)
from .intermediate_check.moved_parts import (
    Cause as Cause,
)
from .intermediate_check.trend import (
    Trend as Trend,
)
from .intermediate_check.trend import (
    appended as appended,
)
from .intermediate_check.trend import (
    now as now,
)
