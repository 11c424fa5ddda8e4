from .capture import own_bus as own_bus
from .flow import Progress as Progress, Result as Result
from .options import (
    Option as Option,
    Written as Written,
    as_arguments as as_arguments,
    command_line as command_line,
    fields_of as fields_of,
    flag_of as flag_of,
    former_options as former_options,
    options_of as options_of,
    other_flags as other_flags,
    rows_of_numbers as rows_of_numbers,
    with_commas as with_commas,
    written as written,
)
from .registry import (
    COMMANDS as COMMANDS,
    JOBS as JOBS,
    Workflow as Workflow,
    command_help as command_help,
    help_of as help_of,
    job_name as job_name,
    load as load,
    panel_of as panel_of,
)
from .settings import CommandSettings as CommandSettings, Writing as Writing, said_of as said_of
