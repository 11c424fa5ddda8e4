from .attainment import (
    Attainment as Attainment,
)
from .capability import (
    undecided as undecided,
)
from .characteristic import (
    key_of as key_of,
)
from .clause import (
    Clause as Clause,
)
from .clause import (
    IsoTest as IsoTest,
)
from .clause import (
    Quantity as Quantity,
)
from .clauses import (
    quantity_of as quantity_of,
)
from .clauses import (
    trend_names as trend_names,
)
from .evaluation import (
    SCHEMA as SCHEMA,
)
from .evaluation import (
    AttainedPath as AttainedPath,
)
from .evaluation import (
    Evaluation as Evaluation,
)
from .evaluation import (
    evaluate as evaluate,
)
from .figure import (
    Figure as Figure,
)
from .figure import (
    Maker as Maker,
)
from .figure import (
    Subject as Subject,
)
from .fitted_frame import (
    in_program_frame as in_program_frame,
)
from .program.campaign import (
    Campaign as Campaign,
)
from .program.campaign import (
    campaign as campaign,
)
from .program.campaign import (
    duration_s as duration_s,
)
from .program.campaign import (
    timed as timed,
)
from .program.command_files import (
    read_commands as read_commands,
)
from .program.command_files import (
    write_campaign as write_campaign,
)
from .program.command_files import (
    write_commands as write_commands,
)
from .program.command_windows import (
    windows_from_rests as windows_from_rests,
)
from .program.cube import (
    POSES as POSES,
)
from .program.cube import (
    Cube as Cube,
)
from .program.cube import (
    cube_in_zone as cube_in_zone,
)
from .program.cube import (
    largest_cube as largest_cube,
)
from .program.selection import (
    TESTS as TESTS,
)
from .program.selection import (
    Tests as Tests,
)
from .program.simulated_run import (
    simulate_robot as simulate_robot,
)
from .program.simulated_run import (
    write_robot_run as write_robot_run,
)
from .settings import (
    CertificationSettings as CertificationSettings,
)
