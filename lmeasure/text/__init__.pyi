from .catalogue import (
    BETWEEN_NUMBERS as BETWEEN_NUMBERS,
    DECIMAL_MARK as DECIMAL_MARK,
    LANGUAGES as LANGUAGES,
    decimal as decimal,
    number as number,
    numbers as numbers,
    of_terminal as of_terminal,
    plain as plain,
    retold as retold,
    settled as settled,
    signs as signs,
    texts as texts,
    typed as typed,
)
from .messages import JOINED as JOINED, Finding as Finding, finding as finding, from_stated as from_stated, recognised as recognised
from .page_text import ENGLISH as ENGLISH, PAGES as PAGES, TOLD as TOLD, Say as Say, powers as powers, typeset as typeset
from .sample_messages import (
    Cause as Cause,
    and_also as and_also,
    from_file as from_file,
    in_english as in_english,
    is_of as is_of,
    within as within,
    without as without,
)
