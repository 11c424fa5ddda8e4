"""A rig to begin with."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from lmeasure.core import SettingsError
from lmeasure.text import composed, message, of_terminal
from lmeasure.workflows.flow import Progress, Result, inside, present, silent, sizes_of, steps, workflow
from lmeasure.workflows.settings import BROWSER, RERUN, Paths, Recording, Writing, option, then

if TYPE_CHECKING:
    from lmeasure.templates import Answers, Template


MOST_MM = 1e6
LEAST_MM = 1e-9
"""Least cable in a count: more than nothing."""
MOST_COUNTS = 2**32 - 1

Ask = Callable[[str, str], str]
"""Is given a question and the answer that Enter gives; gives the answer."""


class InitSettings(Writing):
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
        return then("init my-cell --template six-cables" if self.list else "scan")

    def paths(self) -> Paths:
        if self.list:
            return Paths()
        names = ("rig", "drums", "placement", "scenario")
        files = (*(f"{name}.toml" for name in names), *(f"schemas/{name}.json" for name in names))
        page = (self.out.with_suffix(".html") if self.out.suffix == ".toml" else self.out / "rig.html",) if self.show else ()
        return Paths((*((self.out,) if self.out.suffix == ".toml" else inside(self.out, *files)), *page))


@workflow
def run_init(settings: InitSettings, progress: Progress = silent, *, ask: Ask | None = None) -> Result:
    """Write the files; ask gets values that no template knows."""
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
    """Return the values that differ from rig to rig. A question is repeated until the answer is a number; Enter keeps the guess."""
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
    requested = message("workflow.radius_swivel_pulleys_middle")
    radius = _numbers(ask, requested, (PULLEY_RADIUS_MM,), least=0)
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
    """Return the answer, with as many numbers as the default; the question is repeated until it is right, within least and most."""
    requested = question
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
            question = message(code, answer=answer, limit=limit, question=requested)
            continue
        code = "init.not_whole" if whole else "init.not_number" if len(default) == 1 else "init.not_numbers"
        question = message(code, answer=answer, n=len(default), question=requested)


class PlaceSettings(Writing):
    NEXT: ClassVar[str] = "zone {out}/rig.toml --out {out}/zone.nc"
    rig: Annotated[Path, option("Present rig, or a first sketch of it.", metavar="RIG.toml", positional=True)]
    task: Annotated[Path, option("Task, mounting boxes, keep-outs, tolerance.", metavar="PLACEMENT.toml")]
    out: Annotated[Path, option("Folder for rig.toml and placement.json.", metavar="DIR")]
    seed: Annotated[int, option("Seed of the search.", ge=0)] = 0
    generations: Annotated[int, option("Largest number of generations of the global search.", ge=1)] = 2000
    rerun: Annotated[Recording | None, RERUN] = None

    def paths(self) -> Paths:
        return Paths((*inside(self.out, "placement.json", "rig.toml"), *present(self.rerun)), (self.rig, self.task))


@workflow
def run_place(settings: PlaceSettings, progress: Progress = silent) -> Result:
    """Search, and write the rig and the record of it."""
    from lmeasure.accuracy import place, placement_record, read_placement
    from lmeasure.io import files
    from lmeasure.rig import read_rig, write_rig

    wanted = read_placement(settings.task)
    sketch = read_rig(settings.rig)
    placed = place(sketch, wanted, settings.seed, steps(progress, "place"), generations=settings.generations)
    record = placement_record(placed, settings.seed)
    files.write_json(settings.out / "placement.json", record)
    write_rig(settings.out / "rig.toml", placed.rig)
    if settings.rerun is not None:
        from lmeasure.view import write_recording

        write_recording(settings.rerun, placed.rig, nominal=sketch)
    figures = (
        {"rigs_tried": float(placed.evaluations)}
        | placed.after
        | {f"before_{name}": v for name, v in placed.before.items()}
        | placed.assumed.figures()
    )
    return Result(placed, tuple(placed.summary().splitlines()), figures)


class DrumSettings(Writing):
    NEXT: ClassVar[str] = "scan"
    OUT_FILE: ClassVar[str] = "measured.toml"
    measurements: Annotated[
        Path, option("Measurements, one drum table per observation point (docs/drum.md).", metavar="MEASUREMENTS.toml", positional=True)
    ]
    rig: Annotated[Path, option("Rig with these drums.")]
    out: Annotated[Path, option("Rig file to write.")]
    point: Annotated[tuple[str, ...], option("Fill only this observation point; may be repeated.")] = ()

    def paths(self) -> Paths:
        return Paths((self.out,), (self.measurements, self.rig))


WRITTEN = ("tangent_length_mm", "axial_offset_mm", "count_length_mm")


@workflow
def run_drum(settings: DrumSettings, progress: Progress = silent) -> Result:
    """Write the rig with its drums."""
    from lmeasure.io import files
    from lmeasure.rig import choose, drum_geometry, drum_summary, drums_into, read_drums, rig_from_dict

    before = files.read_toml(settings.rig)
    measured = choose(read_drums(settings.measurements), list(settings.point), str(settings.measurements))
    content = before.holding(drums_into(before, measured, str(settings.rig)))
    rig = rig_from_dict(content, str(settings.rig))
    progress(1.0, "drums")
    files.rewrite_toml(settings.out, content)
    linked = before.get("calibration")
    dropped = message("workflow.link_dropped", file=linked)
    notes = () if linked is None else (dropped,)
    found = {f"{m.point}.{name}": float(getattr(drum_geometry(m), name)) for m in measured for name in WRITTEN}
    return Result(rig, (*drum_summary(measured), *notes), found, notes)


class SchemaSettings(Writing):
    OUT_FILE: ClassVar[str] = "schema.json"
    NEXT: ClassVar[str] = "init my-cell"
    name: Annotated[
        str | None,
        option("Kind of file; without it, `schema` lists them.", metavar="NAME", positional=True, words="lmeasure.io.schemas:FILE_KINDS"),
    ] = None
    out: Annotated[Path | None, option("Write the schema to this file instead of the screen.", metavar="FILE.json")] = None

    def following(self) -> str:
        return "" if self.name is not None and self.out is None else super().following()

    def paths(self) -> Paths:
        return Paths(present(self.out))


@workflow
def run_schema(settings: SchemaSettings, progress: Progress = silent) -> Result:
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
