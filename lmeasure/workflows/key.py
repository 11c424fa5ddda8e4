"""A key to sign certificates with."""

from pathlib import Path
from typing import Annotated

from lmeasure.workflows.flow import Progress, Result, silent, workflow
from lmeasure.workflows.settings import Asked, option


class Settings(Asked):
    """What `lmeasure key` is asked. A key is never written over, not even by this command."""

    out: Annotated[Path, option("Private key to write; the public one becomes FILE.pub.", metavar="FILE")]


@workflow("key")
def run(settings: Settings, progress: Progress = silent) -> Result[str]:
    """Write both keys; what was made is their fingerprint."""
    from lmeasure.certification.signature import new_key

    fingerprint, public = new_key(settings.out), Path(f"{settings.out}.pub")
    told = (f"private key {settings.out}, public key {public}", f"fingerprint {fingerprint}")
    return Result(fingerprint, told, files=(settings.out, public))
