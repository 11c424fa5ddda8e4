"""The commands in a browser, over a project folder."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from lmeasure.core import SettingsError
from lmeasure.io import os_reason
from lmeasure.text import message
from lmeasure.workflows.flow import Progress, Result, present, silent, workflow
from lmeasure.workflows.settings import BROWSER, Asked, Paths, option

Serve = Callable[["Settings", Callable[[str], None], Callable[[str], object] | None], None]
"""Serves a project until it is ended: by its settings, a function that is called with an address for one browser, and one that opens a
browser, or None."""


class Settings(Asked):
    """Settings of `lmeasure workbench`."""

    NEXT: ClassVar[str] = "workbench {folder}"
    folder: Annotated[Path, option("Project folder; created if it does not exist.", metavar="FOLDER", positional=True)] = Path()
    within: Annotated[Path | None, option("Folder of projects: the page Home opens and creates projects in it.", metavar="FOLDER")] = None
    port: Annotated[int, option("Port to listen on; 0 uses a free one.", ge=0, le=65535)] = 0
    host: Annotated[
        str, option("Name of this machine for browsers of other machines; needs --tls-certificate and --tls-key.", metavar="NAME")
    ] = ""
    tls_certificate: Annotated[Path | None, option("With --host: certificate of that name, with its chain.", metavar="FILE.pem")] = None
    tls_key: Annotated[Path | None, option("With --host: key of the certificate, without a password.", metavar="FILE.pem")] = None
    scheduler: Annotated[str | None, option("Dask scheduler for the jobs batch and zone.", metavar="tcp://HOST:PORT")] = None
    browser: Annotated[bool, BROWSER] = True
    language: Annotated[Literal["en", "ru"], option("Language of the jobs' output (en, ru); pages use the browser's language.")] = "en"

    def paths(self) -> Paths:
        """The files of TLS."""
        return Paths((), present(self.tls_certificate, self.tls_key))


@workflow
def run(settings: Settings, progress: Progress = silent, *, serve: Serve) -> Result[None]:
    """Serve the pages until Ctrl-C; progress gets where."""
    if settings.within is not None and settings.folder.resolve().parent != settings.within.resolve():
        raise SettingsError("folder", message("error.is_no_folder_of_within", where=settings.folder, within=settings.within))
    if settings.folder.exists() and not settings.folder.is_dir():
        raise SettingsError("folder", message("error.is_a_file_no", where=settings.folder))
    if len({bool(settings.host), settings.tls_certificate is not None, settings.tls_key is not None}) > 1:
        raise SettingsError("host", message("error.host_needs_tls"))
    try:
        settings.folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SettingsError("folder", message("error.cannot_be_made", where=settings.folder, error=os_reason(error))) from error

    show = None
    if settings.browser:
        import webbrowser

        show = webbrowser.open
    serve(settings, lambda address: progress(0.0, address), show)
    return Result(None, ())
