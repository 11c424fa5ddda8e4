"""Qualify this installation for use in a laboratory."""

from pathlib import Path
from typing import Annotated, Any, ClassVar

from lmeasure.text import message
from lmeasure.workflows.flow import Progress, Result, inside, present, silent, steps, workflow
from lmeasure.workflows.settings import Paths, Writing, option


class Settings(Writing):
    """Settings of `lmeasure qualify`."""

    NEXT: ClassVar[str] = "certify trajectory.parquet --program program.toml --out certificate"
    out: Annotated[Path, option("Folder for qualification.json and qualification.pdf.", metavar="DIR")]
    key: Annotated[Path | None, option("Sign qualification.json with this private key.", metavar="FILE")] = None

    def paths(self) -> Paths:
        """A report from a key."""
        names = ("qualification.json", "qualification.pdf", *(("signature.json",) if self.key else ()))
        return Paths(inside(self.out, *names), present(self.key))


@workflow
def run(settings: Settings, progress: Progress = silent) -> Result[dict[str, Any]]:
    """Run all checks and write the report."""
    from lmeasure.certificate import read_private_key
    from lmeasure.qualification import check_text, run_checks, write_qualification

    if settings.key is not None:
        read_private_key(settings.key)  # nobody waits for checks that a wrong key would end
    checks = run_checks(steps(progress, "qualify"))
    settings.out.mkdir(parents=True, exist_ok=True)
    content = write_qualification(settings.out, checks, settings.key)
    lines = [
        message("qualify.passed" if c.passed else "qualify.failed", check=check_text(c), found=c.found, wanted=c.wanted) for c in checks
    ]
    failed = [c for c in checks if not c.passed]
    lines.append(message("qualify.qualified" if not failed else "qualify.not_qualified", count=len(checks), failed=len(failed)))
    figures = {"checks": float(len(checks)), "failed": float(len(failed))}
    return Result(content, tuple(lines), figures, exit_code=1 if failed else 0)
