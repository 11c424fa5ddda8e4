"""A key to sign certificates with."""

from pathlib import Path
from typing import Annotated

from lmeasure.workflows.flow import Progress, Result, silent, workflow
from lmeasure.workflows.settings import Paths, Writing, option


class Settings(Writing):
    """What `lmeasure key` is asked."""

    out: Annotated[Path, option("Private key to write; the public one becomes FILE.pub.", metavar="FILE")]

    def paths(self) -> Paths:
        """A private and a public key."""
        return Paths((self.out, Path(f"{self.out}.pub")))


@workflow
def run(settings: Settings, progress: Progress = silent) -> Result[str]:
    """Write both keys; what was made is their fingerprint."""
    from lmeasure.certificate import new_key

    fingerprint, public = new_key(settings.out, force=settings.force), Path(f"{settings.out}.pub")
    told = (f"private key {settings.out}, public key {public}", f"fingerprint {fingerprint}")
    return Result(fingerprint, told)
