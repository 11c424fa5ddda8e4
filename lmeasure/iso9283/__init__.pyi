from .attainment import Attainment as Attainment, in_program_frame as in_program_frame
from .characteristic import CertificationSettings as CertificationSettings, key_of as key_of
from .clause import Clause as Clause, IsoTest as IsoTest, Quantity as Quantity
from .clauses import quantity_of as quantity_of, trend_names as trend_names
from .evaluation import (
    SCHEMA as SCHEMA,
    AttainedPath as AttainedPath,
    Evaluation as Evaluation,
    evaluate as evaluate,
    undecided as undecided,
)
from .figure import Figure as Figure, Maker as Maker, Subject as Subject
from .program.campaign import (
    POSES as POSES,
    TESTS as TESTS,
    Campaign as Campaign,
    Cube as Cube,
    Tests as Tests,
    campaign as campaign,
    cube_in_zone as cube_in_zone,
    dithered as dithered,
    duration_s as duration_s,
    largest_cube as largest_cube,
    timed as timed,
)
from .program.command_files import (
    read_commands as read_commands,
    simulate_robot as simulate_robot,
    write_campaign as write_campaign,
    write_commands as write_commands,
    write_robot_run as write_robot_run,
)
from .program.command_windows import windows_from_rests as windows_from_rests
from .uncertainty import Spread as Spread, propagate as propagate
