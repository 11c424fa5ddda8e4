"""What is to be known of the measurements of a robot: a code as files have it, and words by the catalogue."""

from dataclasses import dataclass
from typing import Any

from lmeasure.text import Message, message


@dataclass(frozen=True)
class Noted:
    """One line: code as in identified.json, what it says, what it is of, if anything, and the value that it is judged by."""

    code: str
    said: Message
    of: str = ""
    value: float | None = None

    @property
    def text(self) -> str:
        """Return the message, whose text is English."""
        return self.said

    def stated(self) -> dict[str, Any]:
        """As identified.json has it."""
        return {"code": self.code, "of": self.of, "value": self.value, "text": self.text, "finding": self.said.stated()}


def noted(code: str, words: str, of: str = "", value: float | None = None, **values: Any) -> Noted:
    """A note in the words of the catalogue's `identify.WORDS` with these values."""
    return Noted(code, message(f"identify.{words}", **values), of, value)
