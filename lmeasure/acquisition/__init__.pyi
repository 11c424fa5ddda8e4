from .bus.adapters import (
    adapters as adapters,
)
from .bus.canopen_objects import (
    as_mapped as as_mapped,
)
from .bus.feed import (
    Pace as Pace,
)
from .bus.feed import (
    play as play,
)
from .bus.feed import (
    record_feed as record_feed,
)
from .bus.frames import (
    EXTENDED as EXTENDED,
)
from .bus.frames import (
    FD as FD,
)
from .bus.frames import (
    Frames as Frames,
)
from .bus.sources import (
    bus_opener as bus_opener,
)
from .bus.sources import (
    open_source as open_source,
)
from .bus.speakers import (
    Spoken as Spoken,
)
from .bus.speakers import (
    listen as listen,
)
from .check.self_test import (
    Check as Check,
)
from .check.self_test import (
    corrected as corrected,
)
from .check.self_test import (
    not_corrected as not_corrected,
)
from .check.self_test import (
    self_test as self_test,
)
from .check.watch import (
    Ask as Ask,
)
from .check.watch import (
    Moved as Moved,
)
from .check.watch import (
    Step as Step,
)
from .counters.codes import (
    GoneOn as GoneOn,
)
from .counters.codes import (
    folded as folded,
)
from .counters.codes import (
    moduli as moduli,
)
from .counters.counting import (
    STALE_S as STALE_S,
)
from .counters.counting import (
    Progress as Progress,
)
from .counters.counting import (
    watch as watch,
)
from .counters.decoders import (
    counter_fields as counter_fields,
)
from .counters.events import (
    Event as Event,
)
from .counters.samples import (
    Samples as Samples,
)
from .counters.samples import (
    joined as joined,
)
from .counters.wraps import (
    range_notes as range_notes,
)
from .logs.format import (
    LogFormat as LogFormat,
)
from .logs.import_log import (
    Imported as Imported,
)
from .logs.import_log import (
    import_logs as import_logs,
)
from .logs.import_log import (
    with_dbc as with_dbc,
)
from .logs.import_log import (
    with_files_beside as with_files_beside,
)
from .logs.import_log import (
    write_import as write_import,
)
from .logs.lines import (
    Line as Line,
)
from .logs.lines import (
    by_lines as by_lines,
)
from .logs.read import (
    read_frames as read_frames,
)
from .logs.registry import (
    log_suffixes as log_suffixes,
)
from .logs.report import (
    LogReport as LogReport,
)
from .logs.scan_log import (
    Scan as Scan,
)
from .logs.scan_log import (
    scan_log as scan_log,
)
from .recorder import (
    Recording as Recording,
)
from .recorder import (
    record as record,
)
from .session import (
    Link as Link,
)
from .session import (
    connect as connect,
)
from .session import (
    options_from_text as options_from_text,
)
from .session import (
    record_session as record_session,
)
