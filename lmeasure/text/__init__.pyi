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
from .messages import (
    JOINED as JOINED,
    Lines as Lines,
    Message as Message,
    Versions as Versions,
    composed as composed,
    count_of as count_of,
    faults as faults,
    from_stated as from_stated,
    joined as joined,
    message as message,
    reason as reason,
    restored as restored,
    sentence as sentence,
    table as table,
)
from .page_text import ENGLISH as ENGLISH, Say as Say, powers as powers, typeset as typeset
from .sample_messages import (
    Cause as Cause,
    and_also as and_also,
    common as common,
    is_of as is_of,
    of_file as of_file,
    stated_causes as stated_causes,
    within as within,
    without as without,
)
