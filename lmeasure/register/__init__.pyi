from .drift import (
    Chart as Chart,
    Due as Due,
    Forecast as Forecast,
    Limit as Limit,
    Limits as Limits,
    charts_of as charts_of,
    control_charts as control_charts,
    due as due,
    forecast as forecast,
    read_limits as read_limits,
)
from .register import (
    FILE as FILE,
    Entry as Entry,
    Register as Register,
    Result as Result,
    digest_of as digest_of,
    read_entries as read_entries,
)
