"""Home begins projects beside the one that it shows, and opens them."""

from collections.abc import Sequence

from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from starlette.routing import Route

from lmeasure.core import LMeasureError
from lmeasure.workbench.answers import Form, bench_of, language_of, lost, posted
from lmeasure.workbench.pages import home
from lmeasure.workbench.project import OutsideError
from lmeasure.workbench.text import said


def begin(request: Request, form: Form) -> Response:
    """Begin a project and show it among the others; what is wrong with its name stands there too."""
    shelf = bench_of(request).shelf
    if shelf is None:
        return lost(request, said(language_of(request), "workbench.this_workbench_was_begun"))
    name = form.get("name", [""])[-1].strip()
    try:
        shelf.begin(name)
    except OutsideError as error:
        return home(request, wrong=str(error), typed=name)
    return RedirectResponse("/#projects", 303)


def go(request: Request) -> Response:
    """Open a project, where it is not open yet, and go there. It may be asked for as often as one likes."""
    shelf = bench_of(request).shelf
    if shelf is None:
        return lost(request, said(language_of(request), "workbench.this_workbench_was_begun"))
    try:
        path = shelf.path(request.path_params["name"])
        if not path.is_dir():
            raise OutsideError(f"{path.name}: there is no such project")
        return RedirectResponse(shelf.desk.address(path, shelf), 303)
    except LMeasureError as error:
        return lost(request, str(error))


def routes() -> Sequence[Route]:
    """Of projects."""
    return [Route("/projects", posted(begin), methods=["POST"]), Route("/projects/{name}", go)]
