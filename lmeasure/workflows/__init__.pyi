from .flow import (
    Progress as Progress,
)
from .flow import (
    Result as Result,
)
from .options import (
    Option as Option,
)
from .options import (
    Written as Written,
)
from .options import (
    command_line as command_line,
)
from .options import (
    fields_of as fields_of,
)
from .options import (
    flag_of as flag_of,
)
from .options import (
    options_of as options_of,
)
from .options import (
    rows_of_numbers as rows_of_numbers,
)
from .options import (
    with_commas as with_commas,
)
from .options import (
    written as written,
)
from .play import (
    GROUP as GROUP,
)
from .registry import (
    COMMANDS as COMMANDS,
)
from .registry import (
    JOBS as JOBS,
)
from .registry import (
    Workflow as Workflow,
)
from .registry import (
    load as load,
)
from .settings import (
    Asked as Asked,
)
from .settings import (
    Writing as Writing,
)
from .settings import (
    said_of as said_of,
)
