from . import files as files
from .files import (
    LARGEST_TOML as LARGEST_TOML,
)
from .files import (
    abandoned as abandoned,
)
from .files import (
    not_written as not_written,
)
from .files import (
    read_toml as read_toml,
)
from .files import (
    rewrite_toml as rewrite_toml,
)
from .files import (
    write_table as write_table,
)
from .foreign.columns import (
    COLUMN_KINDS as COLUMN_KINDS,
)
from .foreign.columns import (
    Column as Column,
)
from .foreign.columns import (
    columns_of as columns_of,
)
from .foreign.columns import (
    headed as headed,
)
from .foreign.layout import (
    decoded as decoded,
)
from .foreign.layout import (
    text_of as text_of,
)
from .foreign.table import (
    TIMES as TIMES,
)
from .foreign.table import (
    UNIT_TOLERANCE as UNIT_TOLERANCE,
)
from .foreign.table import (
    ForeignTable as ForeignTable,
)
from .models import (
    Name as Name,
)
from .models import (
    Strict as Strict,
)
from .models import (
    Whole as Whole,
)
from .models import (
    checked as checked,
)
from .models import (
    complaint as complaint,
)
from .models import (
    complaints as complaints,
)
from .models import (
    gathered as gathered,
)
from .models import (
    refuse as refuse,
)
from .models import (
    told as told,
)
from .models import (
    whole as whole,
)
from .safe_open import (
    LARGEST_NAME as LARGEST_NAME,
)
from .safe_open import (
    inside as inside,
)
from .safe_open import (
    no_folder as no_folder,
)
from .safe_open import (
    open_regular as open_regular,
)
from .safe_open import (
    open_zip as open_zip,
)
from .safe_open import (
    read_regular as read_regular,
)
from .safe_open import (
    unpack as unpack,
)
from .schemas import (
    FILE_KINDS as FILE_KINDS,
)
from .schemas import (
    shipped as shipped,
)
from .tables import (
    decoded_bytes as decoded_bytes,
)
from .toml_lines import (
    Keys as Keys,
)
from .toml_lines import (
    loads as loads,
)
