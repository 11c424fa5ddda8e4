from .catalogue import (
    BETWEEN_NUMBERS as BETWEEN_NUMBERS,
)
from .catalogue import (
    DECIMAL_MARK as DECIMAL_MARK,
)
from .catalogue import (
    LANGUAGES as LANGUAGES,
)
from .catalogue import (
    decimal as decimal,
)
from .catalogue import (
    number as number,
)
from .catalogue import (
    numbers as numbers,
)
from .catalogue import (
    of_terminal as of_terminal,
)
from .catalogue import (
    plain as plain,
)
from .catalogue import (
    retold as retold,
)
from .catalogue import (
    settled as settled,
)
from .catalogue import (
    signs as signs,
)
from .catalogue import (
    texts as texts,
)
from .catalogue import (
    typed as typed,
)
from .messages import (
    JOINED as JOINED,
)
from .messages import (
    Finding as Finding,
)
from .messages import (
    finding as finding,
)
from .messages import (
    from_stated as from_stated,
)
from .messages import (
    recognised as recognised,
)
from .page_text import (
    ENGLISH as ENGLISH,
)
from .page_text import (
    PAGES as PAGES,
)
from .page_text import (
    TOLD as TOLD,
)
from .page_text import (
    Say as Say,
)
from .page_text import (
    powers as powers,
)
from .page_text import (
    typeset as typeset,
)
from .sample_messages import (
    Cause as Cause,
)
from .sample_messages import (
    and_also as and_also,
)
from .sample_messages import (
    from_file as from_file,
)
from .sample_messages import (
    in_english as in_english,
)
from .sample_messages import (
    is_of as is_of,
)
from .sample_messages import (
    within as within,
)
from .sample_messages import (
    without as without,
)
