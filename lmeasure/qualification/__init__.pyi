from .checks import (
    CHECKS as CHECKS,
    Check as Check,
    check_text as check_text,
    run_checks as run_checks,
    write_qualification as write_qualification,
)
from .nist_strd import Judged as Judged, judge_all as judge_all
