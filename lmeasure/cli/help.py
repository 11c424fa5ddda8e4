"""Help as it is printed: commands by the job that they belong to, options by their groups, whole sentences, in the reader's language."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from lmeasure.cli.text import word
from lmeasure.text import Message, of_terminal as language
from lmeasure.workflows import COMMANDS, JOBS, command_help, help_of, job_name, panel_of

_PIECES = {"[OPTIONS]": "cli.options_word", "COMMAND [ARGS]...": "cli.command_word"}


def _records(self: Any, ctx: Any) -> dict[str, list[tuple[str, str]]]:
    """Lines of all arguments and options, by their group."""
    found: dict[str, list[tuple[str, str]]] = {}
    for one in self.get_params(ctx):
        record = one.get_help_record(ctx)
        if record is None:
            continue
        kind = "cli.arguments" if one.param_type_name == "argument" else "cli.options"
        group = panel_of(one.rich_help_panel).text(language()) if getattr(one, "rich_help_panel", None) else word(kind)
        name, text = record
        if one.param_type_name == "argument":
            name = name.partition(" ")[0]  # without the kind of value behind its name
        # typer adds the brackets behind the text
        help_text = one.help or ""
        behind = text.removeprefix(help_text)
        for mark in ("required", "default"):
            behind = behind.replace(f"[{mark}", f"[{word(f'cli.{mark}')}").replace(f"; {mark}", f"; {word(f'cli.{mark}')}")
        found.setdefault(group, []).append((name, help_of(ctx.command.name, one.name, help_text).text(language()) + behind))
    return found


class _InWords:
    """Usage, purpose and options in the reader's language."""

    help: str | None

    def format_usage(self, ctx: Any, formatter: Any) -> None:
        """The line of usage."""
        pieces: Any = self
        words = (_PIECES.get(piece, piece) for piece in pieces.collect_usage_pieces(ctx))
        formatter.write_usage(ctx.command_path, " ".join(word(one) if one.startswith("cli.") else one for one in words), word("cli.usage"))

    def format_help_text(self, ctx: Any, formatter: Any) -> None:
        formatter.write_paragraph()
        with formatter.indentation():
            known = f"cli.{ctx.command.name}.help" if ctx.command.name in COMMANDS else "cli.help"
            formatter.write_text(Message(known, template=self.help or "").text(language()))

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Arguments, options, and groups of options."""
        for group, records in _records(self, ctx).items():
            with formatter.section(group):
                formatter.write_dl(records)


class Command(_InWords, TyperCommand):
    """A command whose help is in the reader's language, its options in their groups; `rows` are those that take rows of numbers,
    `former` the options that are an argument now."""

    rows: Mapping[str, Any] = MappingProxyType({})
    former: frozenset[str] = frozenset()

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """The words that were typed; numbers in a row may have blanks between them."""
        from lmeasure.workflows import as_arguments, with_commas

        return super().parse_args(ctx, as_arguments(with_commas(args, self.rows), self.former))


class Group(_InWords, TyperGroup):
    """The commands by their jobs."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Options, then the commands."""
        super().format_options(ctx, formatter)
        self.format_commands(ctx, formatter)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write names and first paragraphs, without loading the commands."""
        width = max(len(name) for commands in JOBS.values() for name in commands)
        for job, commands in JOBS.items():
            with formatter.section(job_name(job).text(language())):
                formatter.write_dl([(f"{name:{width}}", command_help(name).text(language()).split("\n")[0]) for name in commands])


def wrong_use(error: typer.TyperException) -> str:
    """Return the error of words that cannot be parsed."""
    lines = []
    ctx = getattr(error, "ctx", None)
    if ctx is not None:
        hint = word("cli.try_help", command=ctx.command_path, option=ctx.help_option_names[0])
        lines = [ctx.get_usage(), hint, ""]
    return "\n".join([*lines, f"{word('cli.error')}: {in_reader_words(error)}"])


def in_plain_words(error: typer.TyperException) -> str:
    """Return the parser's message, with the required and the given value if one is wrong."""
    cause, param = error.__cause__, getattr(error, "param", None)
    if getattr(param, "param_type_name", "") == "option" and not getattr(error, "param_hint", None):
        error.param_hint = f"'{param.opts[0]}'"  # type: ignore[attr-defined,union-attr]
    if isinstance(error, typer.BadParameter) and isinstance(cause, ValueError) and hasattr(cause, "errors"):
        from lmeasure.io import complaint

        error.message = complaint(cause.errors(include_url=False)[0])
    return error.format_message()


def in_reader_words(error: typer.TyperException) -> str:
    """Return the parser's message in the language of the terminal; messages of other kinds stay as they are."""
    kind, english = type(error).__name__, in_plain_words(error)
    known: Any = error
    if kind == "NoSuchOption":
        others = tuple(sorted(known.possibilities or ()))
        return word("cli.no_such_option_likely" if others else "cli.no_such_option", name=known.option_name, others=others)
    hint = getattr(known, "param_hint", None) or (known.param.get_error_hint() if getattr(known, "param", None) else "")
    if kind == "MissingParameter" and hint:
        argument = getattr(known.param, "param_type_name", "") == "argument"
        return word("cli.missing_argument" if argument else "cli.missing_option", name=hint)
    if kind == "BadParameter" and hint:
        return word("cli.invalid_value", name=hint, why=error.message)
    return english
