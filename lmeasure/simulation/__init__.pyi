from .cell import (
    WORK_SPACE_MM as WORK_SPACE_MM,
)
from .cell import (
    WORK_TILT_RAD as WORK_TILT_RAD,
)
from .cell import (
    cell_rig as cell_rig,
)
from .cell import (
    reference_poses as reference_poses,
)
from .instrument import (
    SimulatedCampaign as SimulatedCampaign,
)
from .instrument import (
    SimulatedRun as SimulatedRun,
)
from .instrument import (
    campaign_at as campaign_at,
)
from .instrument import (
    simulate_run as simulate_run,
)
from .motion import (
    Leg as Leg,
)
from .motion import (
    scattered_poses as scattered_poses,
)
from .motion import (
    smooth_path as smooth_path,
)
from .scenario import (
    Scenario as Scenario,
)
from .scenario import (
    Simulated as Simulated,
)
from .scenario import (
    TestedRobot as TestedRobot,
)
from .scenario import (
    read_scenario as read_scenario,
)
from .scenario import (
    scenario_from_dict as scenario_from_dict,
)
from .scenario import (
    simulate as simulate,
)
from .scenario import (
    write_campaign as write_campaign,
)
from .scenario import (
    write_simulated as write_simulated,
)
