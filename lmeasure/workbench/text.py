"""Words of the workbench's pages, by their English text: `locale/*/workbench.po`, the labels of options, and the command line's for their
help and for commands."""

from lmeasure.text import LANGUAGES, texts

DOMAINS = ("workbench", "labels", "cli")


def said(language: str, text: str, /, **values: object) -> str:
    """A text, or a template with its values, in a language; as it is where no catalogue has it."""
    found = text
    if language != "en" and language in LANGUAGES:
        found = next((own for domain in DOMAINS if (own := texts(domain, language).get(text))), text)
    return found.format(**values) if values else found


def preferred(header: str) -> str:
    """The language of a browser's Accept-Language that there is; English without one."""
    for part in header.split(","):
        name = part.split(";")[0].strip().split("-")[0].lower()
        if name in LANGUAGES:
            return name
    return "en"
