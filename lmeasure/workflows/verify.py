"""A certificate recomputed from its own folder."""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from lmeasure.core import CertificationError
from lmeasure.text import message
from lmeasure.workflows.flow import Progress, Result, silent, steps, workflow
from lmeasure.workflows.settings import Asked, option

if TYPE_CHECKING:
    from lmeasure.certificate import Verification


class Settings(Asked):
    """Settings of `lmeasure verify`."""

    NEXT: ClassVar[str] = "inspect {bundle}"
    bundle: Annotated[Path, option("Folder or zip that `certify` wrote.", metavar="DIR|FILE.zip", positional=True)]
    public_key: Annotated[Path | None, option("Public key of the expected signer, or a folder of authorised keys.", metavar="FILE|DIR")] = (
        None
    )


@workflow
def run(settings: Settings, progress: Progress = silent) -> "Result[Verification]":
    """Look at every byte and compute every figure again; the exit code says what came of it."""
    from lmeasure.certificate import opened_zip, read_public_key, report_lines, verify
    from lmeasure.report import PRINTERS

    names = _authorised(settings.public_key)
    key = None if settings.public_key is None or names else read_public_key(settings.public_key)
    step = steps(progress, "verify")
    if settings.bundle.is_dir():
        found = verify(settings.bundle, key, PRINTERS, step)
    else:
        with tempfile.TemporaryDirectory() as scratch, opened_zip(settings.bundle, Path(scratch)) as folder:
            found = verify(folder, key, PRINTERS, step)
    if names:
        found = replace(found, authorised=names.get(found.signer or "", ""))
    figures: dict[str, float] = {"figures": found.figures, "differences": len(found.differences), "not_compared": len(found.skipped)}
    figures |= {"largest_relative_difference": found.largest} if found.figures else {}
    return Result(found, tuple(report_lines(found, asked=key is not None)), figures, exit_code=found.exit_code)


def _authorised(path: Path | None) -> dict[str, str]:
    """Return the names of the keys of a folder, such as a register's keys/, by their fingerprints; none where it is no folder."""
    from lmeasure.certificate import fingerprint, read_public_key

    if path is None or not path.is_dir():
        return {}
    keys = {fingerprint(read_public_key(key)): key.name.split(".")[0] for key in sorted(path.glob("*.pub"))}
    if not keys:
        raise CertificationError(message("error.holds_no_public_key", where=path))
    return keys
