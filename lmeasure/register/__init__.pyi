from .charts import Chart as Chart, charts_of as charts_of, control_charts as control_charts
from .drift import Forecast as Forecast, forecast as forecast
from .entries import Entry as Entry, Result as Result, digest_of as digest_of, read_entries as read_entries
from .limits import Due as Due, Limit as Limit, Limits as Limits, due as due, read_limits as read_limits
from .register import FILE as FILE, Register as Register
