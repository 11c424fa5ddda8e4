"""The instrument as a forward model only: motions in, recorded counts out."""

from lmeasure.simulation.cell import cell_rig
from lmeasure.simulation.instrument import Campaign, SimulatedRun, campaign_at, simulate_campaign, simulate_run
from lmeasure.simulation.motion import Leg, scattered_poses, smooth_path
from lmeasure.simulation.scenario import Scenario, Simulated, read_scenario, scenario_from_dict, simulate, write_campaign, write_simulated

__all__ = [
    "Campaign",
    "Leg",
    "Scenario",
    "Simulated",
    "SimulatedRun",
    "campaign_at",
    "cell_rig",
    "read_scenario",
    "scattered_poses",
    "scenario_from_dict",
    "simulate",
    "simulate_campaign",
    "simulate_run",
    "smooth_path",
    "write_campaign",
    "write_simulated",
]
