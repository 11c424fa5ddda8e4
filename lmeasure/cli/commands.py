"""A command made of a workflow: its options from the model of its settings, its work by its face in the terminal."""

import contextlib
import inspect
import sys
import types
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union, get_args, get_origin

import typer
from annotated_types import Ge, Le

from lmeasure import workflows
from lmeasure.cli import machine
from lmeasure.cli.faces import FACES, Face, told_of_compiling, with_bar
from lmeasure.cli.help import Command
from lmeasure.cli.words import said
from lmeasure.errors import LMeasureError, SettingsError
from lmeasure.workflows.settings import Separated, said_of

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

JSON = inspect.Parameter(
    "as_json",
    inspect.Parameter.KEYWORD_ONLY,
    default=False,
    annotation=Annotated[bool, typer.Option(machine.FLAG, help="Print the result, or the error, as JSON.")],
)
"""Of every command."""


def command(name: str) -> Any:
    """The command of a workflow, as click has it."""
    workflow = workflows.load(name)
    face: Face = FACES.get(name, with_bar)

    def invoke(**given: Any) -> None:
        as_json = given.pop(JSON.name)
        try:
            # what was not typed is None, or empty where an option may be repeated
            settings = workflow.settings.model_validate({key: value for key, value in given.items() if value is not None and value != []})
            # a face talks to a person: beside JSON, on standard error
            with told_of_compiling(), contextlib.redirect_stdout(sys.stderr) if as_json else contextlib.nullcontext():
                result = face(workflow, settings)
        except SettingsError as error:
            field = workflow.settings.model_fields.get(error.option)
            raise typer.BadParameter(error.text, param_hint=error.option if field is None else flag_of(error.option, field)) from None
        for path in result.left_over:
            typer.echo(said("note: {path} was left by a command that was broken off; nothing needs it", path=path), err=True)
        if as_json:
            typer.echo(machine.written(machine.of_result(name, result)))
            if result.failure:
                typer.echo(f"lmeasure: {' '.join(result.failure.split())}", err=True)
            raise typer.Exit(1 if result.failure else result.exit_code)
        for line in result.summary:
            typer.echo(line)
        if result.failure:
            raise LMeasureError(result.failure)
        if result.exit_code:
            raise typer.Exit(result.exit_code)

    options = [*(parameter(key, field) for key, field in workflow.settings.model_fields.items()), JSON]
    invoke.__signature__ = inspect.Signature(options)  # type: ignore[attr-defined]
    invoke.__annotations__ = {o.name: o.annotation for o in options}
    alone = typer.Typer(add_completion=False, rich_markup_mode=None)
    made: Callable[..., None] = invoke
    alone.command(name, help=workflow.help, cls=Command)(made)
    return typer.main.get_command(alone)


def flag_of(name: str, field: "FieldInfo") -> str:
    """The option as it is typed; an argument by its place-holder."""
    said = said_of(field)
    return str(said["metavar"] if "positional" in said else said.get("flag", f"--{name.replace('_', '-')}"))


def parameter(name: str, field: "FieldInfo") -> inspect.Parameter:
    """The parameter of a command's function from which typer makes the option."""
    said, limits = said_of(field), field.metadata
    about: dict[str, Any] = {"help": field.description, "metavar": said.get("metavar")}
    about["min"] = next((m.ge for m in limits if isinstance(m, Ge)), None)
    about["max"] = next((m.le for m in limits if isinstance(m, Le)), None)
    if "positional" in said:
        told = typer.Argument(**about)
    else:
        told = typer.Option(flag_of(name, field), rich_help_panel=said.get("panel"), **about)
    kind, default = typed(field)
    required = inspect.Parameter.empty if field.is_required() else default
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=required, annotation=Annotated[kind, told])


def typed(field: "FieldInfo") -> tuple[Any, Any]:
    """How an option is typed, and its default in that form: values that belong together are one text, choices are words."""
    annotation: Any = field.annotation
    default = field.default
    optional = get_origin(annotation) in (Union, types.UnionType)
    kind: Any = next(part for part in get_args(annotation) if part is not type(None)) if optional else annotation
    marks = list(field.metadata)
    if get_origin(kind) is Annotated:
        kind, *inner = get_args(kind)
        marks += inner
    separated = next((mark for mark in marks if isinstance(mark, Separated)), None)
    if separated is not None:
        kind, default = str, None if field.is_required() or default is None else separated.written(default)
        optional = optional or default == ""
    elif get_origin(kind) is Literal:
        kind = str
    elif get_origin(kind) is tuple and get_args(kind)[-1] is Ellipsis:
        kind, optional, default = list[get_args(kind)[0]], not field.is_required(), None  # type: ignore[misc]
    return (kind | None if optional else kind), default
