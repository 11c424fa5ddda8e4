"""The command line's own words, help, messages and progress, in the language of the terminal: `locale/*/cli.po`, by their English text.

What computations say of data, and errors, which scripts and people look up, stay English.
"""

from lmeasure.catalogue import of_terminal as language
from lmeasure.catalogue import retold as told
from lmeasure.catalogue import texts

DOMAIN = "cli"


def said(text: str, /, **values: object) -> str:
    """A text, or a template with its values, in the words of the terminal; as it is where the catalogue has none."""
    own = "en" if not text else language()
    found = text if own == "en" else texts(DOMAIN, own).get(text, text)
    return found.format(**values) if values else found


def retold(message: str) -> str:
    """A message of the parser, which is English, as one of the catalogue's templates has it."""
    own = language()
    return message if own == "en" else told(DOMAIN, own, message) or message
