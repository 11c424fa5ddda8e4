"""A rig to begin with."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from lmeasure.core import SettingsError
from lmeasure.text import composed, message, of_terminal
from lmeasure.workflows.flow import Progress, Result, inside, silent, sizes_of, workflow
from lmeasure.workflows.settings import BROWSER, Paths, Writing, option, then

if TYPE_CHECKING:
    from lmeasure.rig import Rig
    from lmeasure.templates import Answers, Template

MOST_MM = 1e6
LEAST_MM = 1e-9
"""Of the cable in a count: more than nothing."""
MOST_COUNTS = 2**32 - 1

Ask = Callable[[str, str], str]
"""Is given a question and the answer that Enter gives; gives the answer."""


class Settings(Writing):
    """Settings of `lmeasure init`."""

    out: Annotated[
        Path,
        option(
            "Folder for rig.toml, drums.toml, placement.toml, scenario.toml and schemas; with a name in .toml, only the rig.",
            metavar="FOLDER_OR_FILE",
            positional=True,
        ),
    ] = Path()
    template: Annotated[
        str | None, option("Shape to start from; without it, `init` asks questions.", metavar="NAME", words="lmeasure.templates:TEMPLATES")
    ] = None
    list: Annotated[bool, option("List the templates only.", flag="--list")] = False
    show: Annotated[bool, option("Also write rig.html: guide angles and drum dimensions as a drawing, beside the file.")] = False
    browser: Annotated[bool, BROWSER] = True

    def following(self) -> str:
        """Return the command that lists the adapters of this machine, or writes a rig."""
        return then("init my-cell --template six-cables" if self.list else "scan")

    def paths(self) -> Paths:
        """A rig, and what goes with it."""
        if self.list:
            return Paths()
        names = ("rig", "drums", "placement", "scenario")
        files = (*(f"{name}.toml" for name in names), *(f"schemas/{name}.json" for name in names))
        page = (self.out.with_suffix(".html") if self.out.suffix == ".toml" else self.out / "rig.html",) if self.show else ()
        return Paths((*((self.out,) if self.out.suffix == ".toml" else inside(self.out, *files)), *page))


@workflow
def run(settings: Settings, progress: Progress = silent, *, ask: Ask | None = None) -> "Result[Rig | None]":
    """Write the files; ask is for what no template knows."""
    from lmeasure.templates import TEMPLATES, Answers, folder_files, rig_of, rig_text

    if settings.list:
        return Result(None, tuple(composed("{name:<14}{text}", name=name, text=template.text) for name, template in TEMPLATES.items()))
    if settings.template is None and ask is None:
        raise SettingsError("template", message("error.is_missing_2", templates=", ".join(TEMPLATES)))
    name = settings.template
    alone = settings.out.suffix == ".toml"
    if name is None and ask is not None:
        name = _choice(ask, message("init.shape"), tuple(TEMPLATES))
    if name not in TEMPLATES:
        raise SettingsError("template", message("error.is_not_one_of_2", name=name, templates=", ".join(TEMPLATES)))
    template = TEMPLATES[name]
    answers = Answers() if settings.template is not None or ask is None else _asked(ask, template)
    rig = rig_of(template, answers)
    progress(0.5, "working out what errors cost")
    texts = (
        {settings.out: rig_text(rig, template.text)}
        if alone
        else {settings.out / n: t for n, t in folder_files(rig, template.text).items()}
    )
    _write(texts)
    main = settings.out if alone else settings.out / "rig.toml"
    page = main.with_suffix(".html") if settings.show else None
    if page is not None:
        from lmeasure.report import write_rig_page

        write_rig_page(page, rig, texts[main], of_terminal())
    reported = [composed("{file}: {text}", file=str(main), text=template.text)]
    if rig.assumed:
        reported.append(message("workflows.values_guesses_stand_list", count=len(rig.assumed)))
    measures, to = main.with_name("drums.toml"), main.with_name("measured.toml")
    reported += [message("line.note", text=text) for text in sizes_of([main])]
    figures = {"cables": float(len(rig.cable)), "assumed": float(len(rig.assumed))}
    # a rig alone has no drums.toml to be filled in
    following = then("zone {rig} --out zone.nc", rig=main) if alone else then("drum {a} --rig {b} --out {c}", a=measures, b=main, c=to)
    return Result(rig, tuple(reported), figures, next=following, page=page)


def _write(texts: Mapping[Path, str]) -> None:
    """Write all of them or none."""
    from lmeasure.io import files

    with ExitStack() as together:
        for path, text in texts.items():
            files.write_text(together.enter_context(files.whole(path)), text)


def _choice(ask: Ask, question: str, options: tuple[str, ...]) -> str:
    while True:
        answer = ask(message("init.which", question=question, options=tuple(options)), options[0]).strip()
        if answer in options:
            return answer
        question = message("init.none_of_them", answer=answer)


def _asked(ask: Ask, template: "Template") -> "Answers":
    """Return what differs from rig to rig. Numbers are asked for again until they are some; Enter keeps a guess a guess."""
    from lmeasure.core import CONVENTIONS
    from lmeasure.templates import DRUM, PULLEY_RADIUS_MM, Answers

    name = ask(message("workflow.name_rig"), Answers().name).strip()
    angles = _choice(ask, message("init.angles"), tuple(CONVENTIONS))
    drum = {
        "counts_per_revolution": _numbers(
            ask, message("workflow.counts_encoder_one_turn"), (DRUM["counts_per_revolution"],), whole=True, least=1, most=MOST_COUNTS
        )[0],
        "count_length_mm": _numbers(ask, message("workflow.cable_per_count_mm"), (DRUM["count_length_mm"],), least=LEAST_MM)[0],
        "groove_pitch_mm": _numbers(ask, message("workflow.groove_pitch_drums_mm"), (DRUM["groove_pitch_mm"],))[0],
    }
    asked = message("workflow.radius_swivel_pulleys_middle")
    radius = _numbers(ask, asked, (PULLEY_RADIUS_MM,), least=0)
    positions = {f"B{i}": _numbers(ask, message("workflow.b_where_swivel_axis", i=i), place) for i, place in enumerate(template.points, 1)}
    tool = {f"P{i}": _numbers(ask, message("workflow.p_attachment_point_x", i=i), at) for i, at in enumerate(template.tool, 1)}
    measured = None if radius[0] == PULLEY_RADIUS_MM else radius[0]
    return Answers(
        name,
        angles,
        drum,
        measured,
        {k: (v[0], v[1], v[2]) for k, v in positions.items()},
        {k: (v[0], v[1], v[2]) for k, v in tool.items()},
    )


def _numbers(
    ask: Ask, question: str, default: tuple[float, ...], *, whole: bool = False, least: float = -MOST_MM, most: float = MOST_MM
) -> tuple[float, ...]:
    """What is answered, as many numbers as the default has; asked again until they are that, and none less than least or more than most."""
    asked = question
    while True:
        answer = ask(question, ",".join(f"{v:g}" for v in default))
        try:
            values = tuple((int if whole else float)(part) for part in answer.replace(";", ",").split(","))
        except ValueError:
            values = ()
        if len(values) == len(default) and not any(v != v for v in values):
            beyond = next((v for v in values if not least <= v <= most), None)
            if beyond is None:
                return values
            code, limit = ("init.at_least", least) if beyond < least else ("init.at_most", most)
            question = message(code, answer=answer, limit=limit, question=asked)
            continue
        code = "init.not_whole" if whole else "init.not_number" if len(default) == 1 else "init.not_numbers"
        question = message(code, answer=answer, n=len(default), question=asked)
