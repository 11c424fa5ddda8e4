from .bundle import (
    CERTIFICATE as CERTIFICATE,
    check_seal as check_seal,
    copy_into as copy_into,
    entries as entries,
    new_folder as new_folder,
    opened_zip as opened_zip,
    seal as seal,
    write_zip as write_zip,
)
from .compare import (
    SIGNIFICANT as SIGNIFICANT,
    Comparison as Comparison,
    Improvement as Improvement,
    Pair as Pair,
    as_dict as as_dict,
    compare_certificates as compare_certificates,
    improvement as improvement,
    lines as lines,
)
from .content import (
    certificate as certificate,
    chosen as chosen,
    environment as environment,
    gathered as gathered,
    halving as halving,
    now as now,
)
from .dcc import Dcc as Dcc, dcc_xml as dcc_xml, read_dcc as read_dcc
from .details import SCHEMA as SCHEMA, Details as Details, read_details as read_details
from .inputs import Inputs as Inputs, Measured as Measured, measure as measure
from .laboratories import (
    Consensus as Consensus,
    Laboratory as Laboratory,
    as_json as as_json,
    compare_laboratories as compare_laboratories,
    consensus as consensus,
    laboratory_lines as laboratory_lines,
    read_laboratory as read_laboratory,
)
from .pictures import (
    Target as Target,
    magnification as magnification,
    round_scale as round_scale,
    round_up as round_up,
    targets as targets,
    way as way,
)
from .signature import (
    canonical as canonical,
    fingerprint as fingerprint,
    new_key as new_key,
    read_private_key as read_private_key,
    read_public_key as read_public_key,
    sign as sign,
)
from .verification import (
    Certificate as Certificate,
    Printer as Printer,
    Verification as Verification,
    read_certificate as read_certificate,
    report_lines as report_lines,
    verify as verify,
    with_u95 as with_u95,
)
