"""A key to sign certificates with."""

from pathlib import Path
from typing import Annotated, ClassVar

from lmeasure.text import message
from lmeasure.workflows.flow import Progress, Result, silent, workflow
from lmeasure.workflows.settings import Paths, Writing, option


class Settings(Writing):
    """Settings of `lmeasure key`."""

    NEXT: ClassVar[str] = "certify trajectory.parquet --program program.toml --key {out} --out certificate"
    OUT_FILE: ClassVar[str] = "key.pem"
    out: Annotated[Path, option("Private key to write; the public key is FILE.pub.", metavar="FILE")]

    def paths(self) -> Paths:
        """A private and a public key."""
        return Paths((self.out, Path(f"{self.out}.pub")))


@workflow
def run(settings: Settings, progress: Progress = silent) -> Result[str]:
    """Write both keys; what was made is their fingerprint."""
    from lmeasure.certificate import new_key

    fingerprint, public = new_key(settings.out, force=settings.force), Path(f"{settings.out}.pub")
    reported = (
        message("workflows.private_key_public_key", file=settings.out, public=public),
        message("workflows.fingerprint", fingerprint=fingerprint),
    )
    return Result(fingerprint, reported)
