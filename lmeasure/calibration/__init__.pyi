from .campaign.campaign import (
    Campaign as Campaign,
)
from .campaign.campaign import (
    extended as extended,
)
from .campaign.campaign import (
    of_cables as of_cables,
)
from .campaign.dwells import (
    mean_variance as mean_variance,
)
from .campaign.dwells import (
    pooled_scatter as pooled_scatter,
)
from .campaign.files import (
    further_columns as further_columns,
)
from .campaign.files import (
    read_campaign as read_campaign,
)
from .campaign.known_lengths import (
    Distance as Distance,
)
from .plan.information import (
    Instrument as Instrument,
)
from .plan.pose_choice import (
    CHECKS_LOG2 as CHECKS_LOG2,
)
from .plan.pose_choice import (
    Outlook as Outlook,
)
from .plan.pose_choice import (
    Plan as Plan,
)
from .plan.pose_choice import (
    PlanSettings as PlanSettings,
)
from .plan.pose_choice import (
    lengths_over as lengths_over,
)
from .plan.pose_choice import (
    outlook_of as outlook_of,
)
from .plan.pose_choice import (
    plan_poses as plan_poses,
)
from .plan.pose_choice import (
    plan_summary as plan_summary,
)
from .plan.reach import (
    Limits as Limits,
)
from .plan.reach import (
    Region as Region,
)
from .plan.reach import (
    Usable as Usable,
)
from .solve.effect_candidates import (
    CHANCE as CHANCE,
)
from .solve.effect_candidates import (
    MOST as MOST,
)
from .solve.effect_candidates import (
    NEAR as NEAR,
)
from .solve.effect_candidates import (
    Effect as Effect,
)
from .solve.effect_candidates import (
    effects as effects,
)
from .solve.effect_candidates import (
    size_of as size_of,
)
from .solve.effect_candidates import (
    tested as tested,
)
from .solve.points import (
    CalibrationSettings as CalibrationSettings,
)
from .solve.prediction import (
    predict as predict,
)
from .solve.record import (
    predicted_entry as predicted_entry,
)
from .solve.residuals import (
    unknowns_of as unknowns_of,
)
from .solve.run_samples import (
    is_run as is_run,
)
from .solve.run_samples import (
    read_motion as read_motion,
)
from .solve.run_samples import (
    spread as spread,
)
from .solve.solve import (
    Calibration as Calibration,
)
from .solve.solve import (
    calibrate as calibrate,
)
from .solve.unknowns import (
    Model as Model,
)
from .solve.update import (
    continued as continued,
)
from .validation.compare import (
    Comparison as Comparison,
)
from .validation.compare import (
    chance as chance,
)
from .validation.compare import (
    compare as compare,
)
from .validation.compare import (
    compare_records as compare_records,
)
from .validation.compare import (
    comparison_summary as comparison_summary,
)
from .validation.compare import (
    read_earlier as read_earlier,
)
from .validation.slips import (
    without_slips as without_slips,
)
