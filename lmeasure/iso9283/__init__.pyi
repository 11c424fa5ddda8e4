from .attainment import Attainment as Attainment
from .capability import undecided as undecided
from .characteristic import key_of as key_of
from .clause import Clause as Clause, IsoTest as IsoTest, Quantity as Quantity
from .clauses import quantity_of as quantity_of, trend_names as trend_names
from .evaluation import SCHEMA as SCHEMA, AttainedPath as AttainedPath, Evaluation as Evaluation, evaluate as evaluate
from .figure import Figure as Figure, Maker as Maker, Subject as Subject
from .fitted_frame import in_program_frame as in_program_frame
from .program.campaign import Campaign as Campaign, campaign as campaign, duration_s as duration_s, timed as timed
from .program.command_files import read_commands as read_commands, write_campaign as write_campaign, write_commands as write_commands
from .program.command_windows import windows_from_rests as windows_from_rests
from .program.cube import POSES as POSES, Cube as Cube, cube_in_zone as cube_in_zone, largest_cube as largest_cube
from .program.selection import TESTS as TESTS, Tests as Tests
from .program.simulated_run import simulate_robot as simulate_robot, write_robot_run as write_robot_run
from .settings import CertificationSettings as CertificationSettings
