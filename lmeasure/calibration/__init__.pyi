from .campaign.campaign import Campaign as Campaign, extended as extended, of_cables as of_cables
from .campaign.dwells import mean_variance as mean_variance, pooled_scatter as pooled_scatter
from .campaign.files import further_columns as further_columns, read_campaign as read_campaign
from .campaign.known_lengths import Distance as Distance
from .plan.information import Instrument as Instrument
from .plan.pose_choice import (
    CHECKS_LOG2 as CHECKS_LOG2,
    Outlook as Outlook,
    Plan as Plan,
    PlanSettings as PlanSettings,
    lengths_over as lengths_over,
    outlook_of as outlook_of,
    plan_details as plan_details,
    plan_poses as plan_poses,
    plan_summary as plan_summary,
)
from .plan.reach import Limits as Limits, Region as Region, Usable as Usable
from .solve.effect_candidates import (
    CHANCE as CHANCE,
    MOST as MOST,
    NEAR as NEAR,
    Effect as Effect,
    effects as effects,
    size_of as size_of,
    tested as tested,
)
from .solve.points import CalibrationSettings as CalibrationSettings
from .solve.prediction import predict as predict
from .solve.record import predicted_entry as predicted_entry
from .solve.residuals import unknowns_of as unknowns_of
from .solve.run_samples import is_run as is_run, read_motion as read_motion, spread as spread
from .solve.solve import Calibration as Calibration, calibrate as calibrate
from .solve.unknowns import Model as Model
from .solve.update import continued as continued
from .validation.compare import (
    Comparison as Comparison,
    chance as chance,
    compare as compare,
    compare_records as compare_records,
    comparison_summary as comparison_summary,
    read_earlier as read_earlier,
)
from .validation.slips import without_slips as without_slips
