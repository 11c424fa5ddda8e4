"""The commands in a browser, over a project folder."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Protocol

from lmeasure.core import SettingsError
from lmeasure.io import os_reason
from lmeasure.text import message
from lmeasure.workflows.flow import Progress, Result, silent, workflow
from lmeasure.workflows.settings import BROWSER, Asked, option


class Serve(Protocol):
    """Serves a project folder on a port of 127.0.0.1 in a language until it is ended, says an address for one browser, and shows a page
    that leads one in; within: see Settings."""

    def __call__(
        self,
        folder: Path,
        port: int,
        language: str,
        say: Callable[[str], None],
        *,
        within: Path | None,
        show: Callable[[str], object] | None,
    ) -> None: ...


class Settings(Asked):
    """What `lmeasure workbench` is asked."""

    NEXT: ClassVar[str] = "workbench {folder}"
    folder: Annotated[Path, option("Project folder; created if it does not exist.", metavar="FOLDER", positional=True)] = Path()
    within: Annotated[Path | None, option("Folder of projects: the page Home opens and creates projects in it.", metavar="FOLDER")] = None
    port: Annotated[int, option("Port of 127.0.0.1; 0 uses a free one.", ge=0, le=65535)] = 0
    browser: Annotated[bool, BROWSER] = True
    language: Annotated[Literal["en", "ru"], option("Language of the jobs' output (en, ru); pages use the browser's language.")] = "en"


@workflow
def run(settings: Settings, progress: Progress = silent, *, serve: Serve) -> Result[None]:
    """Serve the pages until Ctrl-C; progress gets where."""
    if settings.within is not None and settings.folder.resolve().parent != settings.within.resolve():
        raise SettingsError("folder", message("error.is_no_folder_of_within", where=settings.folder, within=settings.within))
    if settings.folder.exists() and not settings.folder.is_dir():
        raise SettingsError("folder", message("error.is_a_file_no", where=settings.folder))
    try:
        settings.folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SettingsError("folder", message("error.cannot_be_made", where=settings.folder, error=os_reason(error))) from error

    show = None
    if settings.browser:
        import webbrowser

        show = webbrowser.open
    serve(settings.folder, settings.port, settings.language, lambda address: progress(0.0, address), within=settings.within, show=show)
    return Result(None, ())
