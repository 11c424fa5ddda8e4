from .bundle import (
    CERTIFICATE as CERTIFICATE,
)
from .bundle import (
    copy_into as copy_into,
)
from .bundle import (
    entries as entries,
)
from .bundle import (
    new_folder as new_folder,
)
from .bundle import (
    opened_zip as opened_zip,
)
from .bundle import (
    seal as seal,
)
from .bundle import (
    write_zip as write_zip,
)
from .canonical_json import (
    canonical as canonical,
)
from .compare import (
    SIGNIFICANT as SIGNIFICANT,
)
from .compare import (
    Comparison as Comparison,
)
from .compare import (
    Pair as Pair,
)
from .compare import (
    as_dict as as_dict,
)
from .compare import (
    compare_certificates as compare_certificates,
)
from .compare import (
    lines as lines,
)
from .content import (
    certificate as certificate,
)
from .content import (
    now as now,
)
from .dcc import (
    dcc_xml as dcc_xml,
)
from .details import (
    SCHEMA as SCHEMA,
)
from .details import (
    Details as Details,
)
from .inputs import (
    Inputs as Inputs,
)
from .inputs import (
    Measured as Measured,
)
from .inputs import (
    measure as measure,
)
from .pictures import (
    Target as Target,
)
from .pictures import (
    magnification as magnification,
)
from .pictures import (
    round_scale as round_scale,
)
from .pictures import (
    round_up as round_up,
)
from .pictures import (
    targets as targets,
)
from .pictures import (
    way as way,
)
from .robot_improvement import (
    Improvement as Improvement,
)
from .robot_improvement import (
    improvement as improvement,
)
from .rounding import (
    with_u95 as with_u95,
)
from .sealed import (
    Certificate as Certificate,
)
from .signature import (
    new_key as new_key,
)
from .signature import (
    read_private_key as read_private_key,
)
from .signature import (
    read_public_key as read_public_key,
)
from .verification import (
    Printer as Printer,
)
from .verification import (
    Verification as Verification,
)
from .verification import (
    read_certificate as read_certificate,
)
from .verification import (
    told as told,
)
from .verification import (
    verify as verify,
)
from .versions import (
    environment as environment,
)
