"""Long studies in pieces: what has run is kept line by line in a file, and the next start goes on from there."""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any


class Pieces:
    """Results by their keys, of a file of JSON lines, or of nothing without one; nothing new is begun `seconds` after it was made."""

    def __init__(self, path: Path | None, seconds: float) -> None:
        self.path, self.until = path, time.monotonic() + seconds
        lines = path.read_text(encoding="utf-8").splitlines() if path is not None and path.exists() else []
        self.known: dict[str, Any] = dict(json.loads(line) for line in lines)

    def __call__(self, key: str, run: Callable[[], Any]) -> Any:
        """What is known of the key, or what `run` gives of it now, plain numbers and lists; None where the time is over."""
        if key not in self.known:
            if time.monotonic() > self.until:
                return None
            self.known[key] = run()
            if self.path is not None:
                with self.path.open("a", encoding="utf-8") as out:
                    out.write(json.dumps([key, self.known[key]]) + "\n")
        return self.known[key]
