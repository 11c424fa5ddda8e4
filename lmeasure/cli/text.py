"""Render messages and the command line's own words in the language of the terminal.

`--json`, on which scripts rely, stays English.
"""

from lmeasure.text import Lines, Message, of_terminal as language, signs, texts


def word(code: str, /, **values: object) -> str:
    """Return the text of an id with its values in the language of the terminal."""
    return Message(code, values).text(language())


def rendered(text: str) -> str:
    """Return a message, or lines of them, in the language of the terminal, any other text as it is; signs are those that people write."""
    if isinstance(text, Lines):
        return "\n".join(map(rendered, text.lines))
    return signs(text.text(language()) if isinstance(text, Message) else text)


def stage(name: str) -> str:
    """Return the name of a stage of work in the language of the terminal."""
    if isinstance(name, Message):
        return rendered(name)
    return texts(language()).get(f"cli.stage.{name.replace(' ', '_').replace('-', '_')}", name)
