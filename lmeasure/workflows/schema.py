"""The JSON Schemas of the files that a person writes."""

from pathlib import Path
from typing import Annotated, ClassVar

from lmeasure.core import SettingsError
from lmeasure.text import composed, message
from lmeasure.workflows.flow import Progress, Result, present, silent, workflow
from lmeasure.workflows.settings import Paths, Writing, option


class Settings(Writing):
    """Settings of `lmeasure schema`."""

    OUT_FILE: ClassVar[str] = "schema.json"
    NEXT: ClassVar[str] = "init my-cell"
    name: Annotated[
        str | None,
        option("Kind of file; without it, `schema` lists them.", metavar="NAME", positional=True, words="lmeasure.io.schemas:FILE_KINDS"),
    ] = None
    out: Annotated[Path | None, option("Write the schema to this file instead of the screen.", metavar="FILE.json")] = None

    def following(self) -> str:
        """Return the command that writes such files; none behind a schema that is printed, which programs read."""
        return "" if self.name is not None and self.out is None else super().following()

    def paths(self) -> Paths:
        """A schema, of nothing."""
        return Paths(present(self.out))


@workflow
def run(settings: Settings, progress: Progress = silent) -> Result[str]:
    """Print or write a schema."""
    from lmeasure.io import FILE_KINDS, files, shipped

    if settings.name is None:
        row = "{name:<10} {file:<15} {text}"
        listed = tuple(composed(row, name=name, file=kind.file, text=message(f"schema.{name}")) for name, kind in FILE_KINDS.items())
        return Result("", listed)
    if settings.name not in FILE_KINDS:
        raise SettingsError("name", message("error.is_not_one_of_2", name=settings.name, templates=", ".join(FILE_KINDS)))
    text = shipped(settings.name)
    if settings.out is None:
        return Result(text, (text.rstrip("\n"),))
    files.write_text(settings.out, text)
    return Result(text, (message("schema.first_line", file=FILE_KINDS[settings.name].file, line=f"#:schema {settings.out.name}"),))
