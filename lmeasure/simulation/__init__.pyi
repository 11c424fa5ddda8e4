from .cell import WORK_SPACE_MM as WORK_SPACE_MM, WORK_TILT_RAD as WORK_TILT_RAD, cell_rig as cell_rig, reference_poses as reference_poses
from .instrument import (
    SimulatedCampaign as SimulatedCampaign,
    SimulatedRun as SimulatedRun,
    campaign_at as campaign_at,
    simulate_run as simulate_run,
)
from .motion import Leg as Leg, scattered_poses as scattered_poses, smooth_path as smooth_path
from .scenario import (
    Scenario as Scenario,
    Simulated as Simulated,
    TestedRobot as TestedRobot,
    read_scenario as read_scenario,
    scenario_from_dict as scenario_from_dict,
    simulate as simulate,
    write_campaign as write_campaign,
    write_simulated as write_simulated,
)
