from . import files as files
from .cluster import LOCAL as LOCAL, cluster_client as cluster_client, in_order as in_order, processors as processors
from .files import (
    LARGEST_TOML as LARGEST_TOML,
    abandoned as abandoned,
    harmless as harmless,
    not_written as not_written,
    read_toml as read_toml,
    rewrite_toml as rewrite_toml,
    write_table as write_table,
)
from .foreign.layout import (
    COLUMN_KINDS as COLUMN_KINDS,
    Column as Column,
    columns_of as columns_of,
    decoded as decoded,
    headed as headed,
    text_of as text_of,
)
from .foreign.table import TIMES as TIMES, UNIT_TOLERANCE as UNIT_TOLERANCE, ForeignTable as ForeignTable
from .models import (
    Keys as Keys,
    Name as Name,
    Strict as Strict,
    Whole as Whole,
    checked as checked,
    complaint as complaint,
    complaints as complaints,
    gathered as gathered,
    loads as loads,
    of_key as of_key,
    refuse as refuse,
    reported as reported,
    whole as whole,
)
from .safe_open import (
    LARGEST_NAME as LARGEST_NAME,
    inside as inside,
    no_folder as no_folder,
    open_regular as open_regular,
    open_zip as open_zip,
    os_reason as os_reason,
    read_regular as read_regular,
    unpack as unpack,
)
from .schemas import FILE_KINDS as FILE_KINDS, shipped as shipped
from .tables import PIECE_ROWS as PIECE_ROWS, decoded_bytes as decoded_bytes
