"""Forms of commands: their fields from the models of their settings, and the filled values as a checked command line."""

import json
import os
import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lmeasure.core import LMeasureError, SettingsError
from lmeasure.io import LARGEST_NAME
from lmeasure.text import message, reason
from lmeasure.workbench.project import OutsideError, Project, inside
from lmeasure.workflows import Option, Writing, as_arguments, command_line, former_options, load, options_of, other_flags, own_bus, said_of

HIDDEN = {"scheduler", "browser"}
"""Options that would make this machine ask another one, or open a window."""
INSTEAD: dict[str, set[str]] = {"import": {"position_mm", "quaternion_xyzw"}, "zone": {"tilt_rad"}, "mechanism": {"tilt_rad"}}
"""Options that replace others."""
NOT_HERE = {"docs", "inspect", "view", "warm", "schema", "workbench"}
"""Commands that a page has in another way: they print, or open windows."""
ALWAYS: dict[str, dict[str, Any]] = {"record": {"live": True}}
"""Options that a page always sets."""
KINDS = {
    "rig": ("rig",),
    "poses": ("poses",),
    "folder": ("calibration",),
    "program": ("program",),
    "path": ("program",),
    "trajectory": ("trajectory",),
    "run": ("run",),
    "scenario": ("scenario",),
    "measurements": ("measurements", "poses"),
    "file": ("structure", "rig"),
    "robot": ("robot",),
    "details": ("details",),
    "task": ("placement",),
    "zone": ("zone",),
    "commands": ("commands",),
    "identified": ("identification",),
    "measured": ("run", "trajectory"),
    "key": ("key",),
    "public_key": ("public key",),
}
"""Kinds of the project's files that a field offers, by its name."""
BY_COMMAND = {
    ("verify", "bundle"): ("certificate",),
    ("compare", "certificates"): ("certificate",),
    ("import", "logs"): ("log",),
    ("frames", "measured"): ("measurements",),
    ("drum", "measurements"): ("drums",),
    ("plan-poses", "poses"): (),  # how many
}
SUGGESTED = {
    ("demo", "out"): "+cell",
    ("init", "out"): ".",
    ("init", "template"): "six-cables",
    ("drum", "out"): "+measured.toml",
    ("check", "write"): "+rig-checked.toml",
    ("key", "out"): "+lab.key",
    ("record", "out"): "+runs/run",
    ("import", "out"): "+runs/run",
    ("simulate", "out"): "+runs/simulated",
    ("plan-poses", "out"): "+calibration/planned.csv",
    ("plan-poses", "poses"): "20",
    ("capture", "out"): "+calibration/poses",
    ("calibrate", "out"): "+calibration/rig",
    ("zone", "out"): "+zones/zone.nc",
    ("zone", "report"): "+zones/page",
    ("place", "out"): "+zones/placed",
    ("reconstruct", "out"): "+runs/trajectory.parquet",
    ("report", "out"): "+runs/page",
    ("motion", "out"): "+runs/motion.parquet",
    ("program", "out"): "+program",
    ("certify", "out"): "+certificates/certificate",
    ("compare", "out"): "+certificates/compared",
    ("identify", "out"): "+robot/identified",
    ("correct", "out"): "+robot/corrected",
    ("frames", "out"): "+robot/frames.json",
    ("structure", "out"): "+structure.json",
}
"""Options that a page fills in; after + a name that must be free."""
TAKEN = {("play", "poses"), ("play", "commands"), ("plan-poses", "rig")}
"""Options that are not required, and taken if the project has the file."""
TAKEN_ALONE = {("certify", "run")}
"""Optional options filled with the project's file if it has only one."""
_SPLIT = re.compile(r"[,;=:\s]")
_FLAG = re.compile(r"--[a-z][a-z0-9-]*")
_WORD = re.compile(r"`([^`]+)`")


@dataclass(frozen=True)
class FieldOf:
    """A field of a form: its option, its value, its choices, its fault; the labels of other options."""

    option: Option
    value: str
    offers: tuple[str, ...]
    error: str = ""
    labels: Mapping[str, str] = field(default_factory=dict)

    def help_text(self, say: Callable[..., str]) -> str:
        """Return the help, with the range; other options in it have their labels on the page."""

        def named(found: re.Match[str]) -> str:
            label = self.labels.get(found[0])
            return found[0] if label is None else say("workbench.quoted", label=say(label))

        text = _WORD.sub(lambda found: say("workbench.quoted", label=found[1]), _FLAG.sub(named, say(self.option.help)))
        # the label is right above it
        text = re.sub(rf"^{re.escape(say(self.option.label))}[:,;] (\w)", lambda found: found[1].upper(), text, flags=re.IGNORECASE)
        low, high = self.option.minimum, self.option.maximum
        if low is None and high is None:
            return text
        if high is None:
            return f"{text} {say('workbench.at_least', low=f'{low:g}')}"
        return f"{text} {say('workbench.range', low='' if low is None else f'{low:g}', high=f'{high:g}')}"


def fields(
    command: str,
    project: Project,
    given: Mapping[str, Any] | None = None,
    error: SettingsError | None = None,
    *,
    reported: Mapping[str, Any] | None = None,
) -> list[FieldOf]:
    """Return the fields of a command: with the given values, else defaults of some, and the project's suggestions for the others."""
    values = given if given is not None else reported or {}
    out = []
    every = options_of(load(command).settings)
    labels = {flag: option.label for option in every for flag in option.flag.split("/") if flag.startswith("--")}
    for option in every:
        if option.name in HIDDEN | INSTEAD.get(command, set()) | set(ALWAYS.get(command, {})):
            continue
        offers = offered(command, option.name, project)
        value = values.get(option.name)
        if value is None and given is None:
            taken = option.required or (command, option.name) in TAKEN or ((command, option.name) in TAKEN_ALONE and len(offers) == 1)
            only = offers[0] if taken and offers and offers[0] not in project.doubted else ""
            known = "" if command == "play" else project.known.get(option.name, "")  # which plays on no bus that others use
            value = only or known or suggested(command, option.name, project) or option.default
        text = "\n".join(map(str, value)) if isinstance(value, list | tuple) else "" if value is None else str(value)
        own = error.text if error is not None and error.option == option.name else ""
        out.append(FieldOf(option, text, offers, own, labels))
    return out


def offered(command: str, name: str, project: Project) -> tuple[str, ...]:
    """Files of the project that suit an option; for a rig, calibrated ones first, except where one is calibrated."""
    kinds = BY_COMMAND.get((command, name), KINDS.get(name, ()))
    found = tuple(sorted((path for kind in kinds for path in project.of(kind)), key=project.doubted.__contains__))
    if name == "rig":
        calibrated = tuple(path for path in project.calibrated() if path not in project.doubted)
        plain = tuple(path for path in found if path not in calibrated)
        return (*plain, *calibrated) if command in ("check", "plan-poses", "capture", "drum", "calibrate") else (*calibrated, *plain)
    return found


def suggested(command: str, name: str, project: Project) -> str:
    """Return a name for an output, or the page's usual value; used names get a number."""
    if (command, name) == ("play", "bus"):
        return own_bus(project.folder)
    text = SUGGESTED.get((command, name), "")
    if not text or not text.startswith("+"):
        return text
    path = Path(text[1:])
    number, free = 1, path
    while (project.folder / free).exists():
        number += 1
        free = path.with_name(f"{path.stem}-{number}{path.suffix}")
    return free.as_posix()


def filled_in(command: str, form: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """Return a form's values: texts by option, lists for repeated options, True and False for switches. A missing switch is off if the form
    has switches (`_form`)."""
    out: dict[str, Any] = {}
    for option in options_of(load(command).settings):
        texts = [text.strip() for text in form.get(option.name, ())]
        if option.kind == "flag":
            if texts or ("_form" in form and option.name not in HIDDEN):
                out[option.name] = bool(texts) and texts[-1] in ("on", "true", "1")
        elif option.kind == "list":
            if lines := [line.strip() for text in texts for line in text.splitlines() if line.strip()]:
                out[option.name] = lines
        elif texts and texts[-1]:
            out[option.name] = texts[-1]
    return out


def defaults(command: str) -> dict[str, Any]:
    """Return the default values of a command, except for switches."""
    return {o.name: o.default for o in options_of(load(command).settings) if o.default and o.kind != "flag"}


def command_words(command: str, given: Mapping[str, Any], folder: Path) -> list[str]:
    """Return the words after `lmeasure` for a filled form.

    SettingsError, with its option, for a missing value, one out of range, or a path out of the project; LMeasureError for a command that
    pages do not run.
    """
    if command in NOT_HERE:
        raise LMeasureError(message("error.is_not_run_from", command=command))
    workflow = load(command)
    given = {**given, **ALWAYS.get(command, {})}
    options = {option.name: option for option in options_of(workflow.settings)}
    for name, value in given.items():
        if name not in options or name in HIDDEN:
            raise SettingsError(name, message("error.is_unknown_here"))
        for text in value if isinstance(value, list) else [value]:
            if isinstance(text, str):
                _confined(options[name], text, folder)
    missing = next((o.name for o in options.values() if o.required and given.get(o.name) in (None, "", [])), None)
    if missing is not None:
        raise SettingsError(missing, message("error.is_missing"))
    # as from a command line: texts, which the model converts to numbers and tuples
    workflow.settings.model_validate(dict(given))
    return command_line(command, workflow.settings, given)


def existing(command: str, given: Mapping[str, Any], folder: Path) -> str:
    """Return the first file of the project that a filled in form would write and that exists; empty where it may be replaced."""
    settings = load(command).settings
    paths = {o.name for o in options_of(settings) if o.kind == "path"}
    requested = settings.model_validate({n: str(folder / v) if n in paths and isinstance(v, str) else v for n, v in given.items()})
    there = (
        () if not isinstance(requested, Writing) or requested.force else requested.paths().outputs
    )  # also inputs from the project that were not named
    return next((os.path.relpath(folder / path, folder) for path in there if os.path.lexists(folder / path)), "")


def _confined(option: Option, text: str, folder: Path) -> None:
    """SettingsError for a text that names, or holds the name of, a file outside the project, or has a part that is longer than a name.
    Options that are no paths may have paths in them, such as replay:FILE."""
    try:
        if option.kind == "path":
            inside(folder, text)
            return
        for part in filter(None, _SPLIT.split(text)):
            if len(os.fsencode(part)) > LARGEST_NAME:
                raise OutsideError(message("error.is_too_long_for", part=part[:60]))
            if "/" in part or "\\" in part or part.startswith((".", "~")) or (folder / part).is_symlink():
                _own_or_device(part, folder)
    except LMeasureError as error:
        raise SettingsError(option.name, reason(error)) from None


def _own_or_device(part: str, folder: Path) -> None:
    """Adapters are devices: their names are no files of the project."""
    if re.fullmatch(r"/dev/(tty|cu\.|serial/by-id/)[\w.\-]+", part):
        return
    if re.fullmatch(r"\.?\d+(\.\d*)?(e-?\d+)?", part):
        return
    inside(folder, part)


def written_down(command: str, given: Mapping[str, Any]) -> str:
    """Return the command line of an unfinished form, which may be wrong."""
    return shlex.join(["lmeasure", *command_line(command, load(command).settings, {**given, **ALWAYS.get(command, {})})])


def of_words(command: str, words: Sequence[str]) -> dict[str, Any]:
    """Return the fields of a form from a job's command line: the inverse of `command_words`."""
    options = options_of(load(command).settings)
    flags = {option.flag.partition("/")[0]: option for option in options}
    model = load(command).settings.model_fields
    flags |= {flag: option for option in options for flag in other_flags(option.name, model[option.name])}
    off = {option.flag.partition("/")[2]: option for option in options if "/" in option.flag}
    places = [o for o in options if "positional" in said_of(load(command).settings.model_fields[o.name])]
    out: dict[str, Any] = {option.name: "on" for option in options if option.kind == "flag" and option.default == "on"}
    rest, plain = as_arguments(words[1:], former_options(load(command).settings)), False
    while rest:
        word = rest.pop(0)
        name, mark, value = word.partition("=")
        if word == "--" and not plain:
            plain = True
        elif plain:
            _place(out, places, word)
        elif word in off:
            out.pop(off[word].name, None)
        elif name in flags:
            option = flags[name]
            text = "on" if option.kind == "flag" else value if mark else rest.pop(0) if rest else ""
            if option.kind == "list":
                out.setdefault(option.name, []).append(text)
            else:
                out[option.name] = text
        else:
            _place(out, places, word)
    return out


def _place(out: dict[str, Any], places: list[Option], word: str) -> None:
    """An argument to the next place that is free."""
    if places and places[0].kind == "list":
        out.setdefault(places[0].name, []).append(word)
    elif places:
        out[places.pop(0).name] = word


def as_event(event: Mapping[str, Any]) -> str:
    """An event as a server sends it to a page."""
    return f"data: {json.dumps(event, ensure_ascii=False)}\n\n"
