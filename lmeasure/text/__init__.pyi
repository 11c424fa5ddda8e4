from .catalogue import (
    LANGUAGES as LANGUAGES,
    decimal as decimal,
    number as number,
    numbers as numbers,
    of_terminal as of_terminal,
    plain as plain,
    settled as settled,
    signs as signs,
    texts as texts,
    typed as typed,
)
from .legacy import TOLD as TOLD, known as known, old_texts as old_texts, pages as pages, recognised as recognised, retold as retold
from .messages import (
    JOINED as JOINED,
    Finding as Finding,
    Message as Message,
    composed as composed,
    finding as finding,
    from_stated as from_stated,
    joined as joined,
    message as message,
    restored as restored,
    table as table,
)
from .page_text import ENGLISH as ENGLISH, Say as Say, powers as powers, typeset as typeset
from .sample_messages import (
    Cause as Cause,
    and_also as and_also,
    common as common,
    from_file as from_file,
    in_english as in_english,
    is_of as is_of,
    within as within,
    without as without,
)
