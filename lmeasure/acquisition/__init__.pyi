from .bus.adapters import adapters as adapters
from .bus.canopen import as_mapped as as_mapped
from .bus.feed import Pace as Pace, play as play, record_feed as record_feed
from .bus.frames import EXTENDED as EXTENDED, FD as FD, Frames as Frames
from .bus.sources import bus_opener as bus_opener, open_source as open_source
from .check.self_test import Check as Check, corrected as corrected, not_corrected as not_corrected, self_test as self_test
from .check.watch import Ask as Ask, Finished as Finished, Moved as Moved, Step as Step
from .counters.decoders import counter_fields as counter_fields
from .counters.events import Event as Event
from .counters.origins import ContinuedCounts as ContinuedCounts, folded as folded, moduli as moduli, range_notes as range_notes
from .counters.samples import Samples as Samples, joined as joined
from .logs.import_log import (
    Imported as Imported,
    import_logs as import_logs,
    with_dbc as with_dbc,
    with_files_beside as with_files_beside,
    write_import as write_import,
)
from .logs.read import log_suffixes as log_suffixes, read_frames as read_frames
from .logs.report import Line as Line, LogFormat as LogFormat, LogReport as LogReport, by_lines as by_lines
from .logs.scan_log import LiveIdentifier as LiveIdentifier, Scan as Scan, listen as listen, scan_log as scan_log
from .recorder import STALE_S as STALE_S, Progress as Progress, Recording as Recording, record as record, watch as watch
from .session import Link as Link, connect as connect, options_from_text as options_from_text, record_session as record_session
