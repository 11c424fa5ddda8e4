"""A command made of a workflow: its options from the model of its settings, its work by its face in the terminal."""

import contextlib
import inspect
import pkgutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from annotated_types import Ge, Le

from lmeasure.cli import events, machine
from lmeasure.cli.help import Command
from lmeasure.cli.progress import FACES, SILENT, Face, opens_pages, quietly, reported_compiling, with_bar
from lmeasure.cli.text import rendered
from lmeasure.core import LMeasureError, SettingsError, one_line
from lmeasure.kernels import compilation, used
from lmeasure.text import message
from lmeasure.workflows import Written, fields_of, flag_of, former_options, load, other_flags, rows_of_numbers, said_of, written

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

    from lmeasure.workflows import Result

OF_ALL = {
    "as_json": ((machine.FLAG,), "Print the result, or the error, as JSON."),
    "quiet": (("--quiet", "-q"), "Print errors only."),
    "verbose": (("--verbose", "-v"), "Print all numbers of the result and every written file too."),
}
"""Flags and help of the options that every command has."""


def command(name: str) -> Any:
    """The command of a workflow, as click has it."""
    workflow = load(name)
    face: Face = FACES.get(name, with_bar)

    def invoke(**given: Any) -> None:
        as_json, quiet, verbose = (given.pop(name) for name in OF_ALL)
        try:
            # an omitted option is None, or empty if it may be repeated
            settings = workflow.settings.model_validate({key: value for key, value in given.items() if value is not None and value != []})
            # text for people goes to standard error beside JSON
            with events.tied(name), reported_compiling(), contextlib.redirect_stdout(sys.stderr) if as_json else contextlib.nullcontext():
                result = (quietly if quiet and face in SILENT else face)(workflow, settings)
        except SettingsError as error:
            field = workflow.settings.model_fields.get(error.option)
            raise typer.BadParameter(error.text, param_hint=error.option if field is None else flag_of(error.option, field)) from None
        if as_json:
            document = machine.of_result(name, result)
            if events.enabled():
                document |= {"shown": [rendered(line) for line in result.summary if line]}
                document |= {"shown_warnings": [rendered(line) for line in document["warnings"]]}
                made = document["made"] if isinstance(document["made"], dict) else {}
                document |= {"shown_made": {key: rendered(text) for key, text in made.items() if isinstance(text, str)}}
            typer.echo(machine.written(document))
            if result.failure:
                typer.echo(f"lmeasure: {one_line(rendered(result.failure))}", err=True)
            raise typer.Exit(1 if result.failure else result.exit_code)
        if not quiet:
            _print(result, verbose)
        if result.page is not None and not quiet and opens_pages(settings):
            import webbrowser

            webbrowser.open(result.page.resolve().as_uri())
        if result.failure:
            raise LMeasureError(result.failure)
        if result.exit_code:
            raise typer.Exit(result.exit_code)

    options = [parameter(key, field) for key, field in fields_of(workflow.settings).items()]
    options += [
        inspect.Parameter(key, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=Annotated[bool, typer.Option(*flags, help=text)])
        for key, (flags, text) in OF_ALL.items()
    ]
    invoke.__signature__ = inspect.Signature(options)  # type: ignore[attr-defined]
    invoke.__annotations__ = {o.name: o.annotation for o in options}
    alone = typer.Typer(add_completion=False, rich_markup_mode=None)
    made: Callable[..., None] = invoke
    alone.command(name, help=workflow.help, cls=Command)(made)
    out: Any = typer.main.get_command(alone)
    out.rows, out.former = rows_of_numbers(workflow.settings), former_options(workflow.settings)
    return out


def _print(result: "Result", verbose: bool) -> None:
    """Print the summary and the next command; where they are verbose, all numbers and files too."""
    for line in (*result.summary, *(result.details if verbose else ())):
        typer.echo(rendered(line))
    for name, value in result.figures.items() if verbose else ():
        typer.echo(f"{name}: {value:.9g}")
    for path in result.files if verbose else ():
        typer.echo(rendered(message("line.written", files=path)))
    if verbose and (used or compilation.names):
        none = message("page.none")
        kernels = {"uncompiled": tuple(sorted(used)) or none, "compiled": tuple(dict.fromkeys(compilation.names)) or none}
        typer.echo(rendered(message("line.kernels", **kernels)))
    if result.next and not result.failure:
        # a document on standard output stays alone
        typer.echo(rendered(message("workflow.next", command=result.next)), err=result.summary == (result.made,))


def place_holder(form: Written) -> str | None:
    """Return the placeholder of a value in the help, if the option has none: its choices, or its kind."""
    if form.choices:
        return "|".join(form.choices)
    return {Path: "PATH", int: "N", float: "NUMBER", str: "TEXT"}.get(form.kind)


def _completion(choices: tuple[str, ...], names: str | None) -> Callable[[str], list[str]]:
    """Return the completion of an option's choices, or of the names at module:NAME."""

    def beginning(incomplete: str) -> list[str]:
        return [word for word in choices or pkgutil.resolve_name(str(names)) if word.startswith(incomplete)]

    return beginning


def parameter(name: str, field: "FieldInfo") -> inspect.Parameter:
    """The parameter of a command's function from which typer makes the option."""
    said, form = said_of(field), written(field)
    about: dict[str, Any] = {"help": field.description, "metavar": said.get("metavar") or place_holder(form)}
    about["min"] = next((m.ge for m in field.metadata if isinstance(m, Ge)), None)
    about["max"] = next((m.le for m in field.metadata if isinstance(m, Le)), None)
    if form.choices or "words" in said:
        about["autocompletion"] = _completion(form.choices, said.get("words"))
    if "positional" in said:
        declared = typer.Argument(**about)
    else:
        declared = typer.Option(flag_of(name, field), *other_flags(name, field), rich_help_panel=said.get("panel"), **about)
    # a folder is known by the slash at the end of its name, which a Path has no more
    kind = list[form.kind] if form.repeated else str if name == "out" else form.kind  # type: ignore[name-defined]
    required = inspect.Parameter.empty if field.is_required() else form.default
    return inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, default=required, annotation=Annotated[kind | None if form.optional else kind, declared]
    )
