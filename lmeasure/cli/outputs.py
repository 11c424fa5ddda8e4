"""What each command may write and what it reads: by this table, and `lmeasure.written`, every command is held to the same rule."""

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any, NamedTuple

import typer

Given = dict[str, Any]


class Paths(NamedTuple):
    """Files that a command may write, files that it reads, and where it writes by a rule of its own."""

    outputs: list[Path]
    inputs: list[Path]
    folders: tuple[Path, ...] = ()


def _paths(*found: Path | str | None) -> list[Path]:
    return [Path(path) for path in found if path is not None]


def _in(folder: Path, *names: str) -> list[Path]:
    return [folder / name for name in names]


def _run_folder(folder: Path, *more: str) -> list[Path]:
    """What a run folder holds, as far as it is there: which passes a command will write it does not know yet."""
    there = [path for pattern in ("pass*.csv", "pass*.parquet", "pass*.log") for path in sorted(folder.glob(pattern))]
    first = _in(folder, "pass1.csv", "pass1.parquet", "pass1.events.csv")
    return [*_in(folder, "run.toml", "rig.toml", "calibration.json", *more), *first, *there]


def _passes(folder: Path, passes: int) -> list[Path]:
    return _in(folder, *(f"pass{n}{end}" for n in range(1, passes + 1) for end in (".csv", ".parquet", ".events.csv")))


def _calibrate(g: Given) -> Paths:
    of_folder = _in(g["folder"], "rig.toml", "reference_poses.csv", "counts.csv")
    return Paths([*_in(g["out"], "rig.toml", "calibration.json", "report.html", "poses.csv"), *_paths(g["rerun"])], of_folder)


def _reconstruct(g: Given) -> Paths:
    return Paths(_paths(g["out"], g["rerun"]), [*_run_folder(g["run"]), *_paths(g["rig"], g["start"])])


def _motion(g: Given) -> Paths:
    return Paths(_paths(g["out"]), _paths(g["trajectory"]))


def _zone(g: Given) -> Paths:
    beside = [] if g["path"] is None else [g["out"].with_suffix(".path.csv")]
    report = [] if g["report"] is None else _in(g["report"], "zone.html", "zone.pdf")
    return Paths([*_paths(g["out"], g["rerun"]), *beside, *report], _paths(g["rig"], g["bodies"], g["path"]))


def _place(g: Given) -> Paths:
    return Paths([*_in(g["out"], "placement.json", "rig.toml"), *_paths(g["rerun"])], _paths(g["rig"], g["task"]))


def _plan_poses(g: Given) -> Paths:
    extended = [] if g["extend"] is None else _in(g["extend"], "rig.toml", "reference_poses.csv", "counts.csv")
    return Paths(_paths(g["out"], g["rerun"]), [*_paths(g["rig"]), *extended])


def _program(g: Given) -> Paths:
    if g["ran"] is not None:  # fills in what this command wrote and a person may have changed since: tolerances, names
        return Paths([], [], (g["out"],))
    return Paths(_in(g["out"], "program.toml", "commands.csv", "robodk.csv"), _paths(g["zone"]))


def _drum(g: Given) -> Paths:
    return Paths(_paths(g["out"]), _paths(g["measurements"], g["rig"]))


def _simulate(g: Given) -> Paths:
    campaign = g["out"] / "calibration"
    folders = [*_in(campaign, "rig.toml", "reference_poses.csv", "counts.csv"), *_in(campaign / "true", "rig.toml", "reference_poses.csv")]
    return Paths([*_run_folder(g["out"], "truth.parquet"), *folders, *_paths(g["rerun"])], _paths(g["scenario"]))


def _import(g: Given) -> Paths:
    outputs = [*_run_folder(g["out"]), *_passes(g["out"], len(g["logs"])), *_paths(g["rerun"])]
    return Paths(outputs, [*g["logs"], *_paths(g["rig"], g["start"], g["dbc"])])


def _record(g: Given) -> Paths:
    return Paths(_paths(g["rerun"]), _paths(g["rig"]))


def _compare(g: Given) -> Paths:
    return Paths(_paths(g["out"]), list(g["certificates"]))


def _certify(g: Given) -> Paths:
    zipped = g["out"].resolve()
    packed = _in(zipped.parent, f"{zipped.name}.zip", f"{zipped.name}.zip.sha256") if g["zipped"] else []
    return Paths(packed, _paths(g["trajectory"], g["program"], g["details"], g["key"], g["xsd"]), (g["out"].parent,))


RULES: dict[str, Callable[[Given], Paths]] = {
    "calibrate": _calibrate,
    "reconstruct": _reconstruct,
    "motion": _motion,
    "zone": _zone,
    "place": _place,
    "plan-poses": _plan_poses,
    "program": _program,
    "drum": _drum,
    "simulate": _simulate,
    "import": _import,
    "record": _record,
    "compare": _compare,
    "certify": _certify,
}
OWN_RULE = {"key", "demo", "check", "verify", "view"}
"""Commands that write nothing, or only what they know again by themselves: a key is never written over, a demo has its mark. Likewise
`certify`, which replaces a folder by its manifest."""


def guarded(command: str, function: Callable[..., None]) -> Callable[..., None]:
    """The command's function, held to the rule; leftovers of runs that were broken off are named behind it."""

    @wraps(function)
    def run(**given: Any) -> None:
        from lmeasure.written import left_over, writing

        paths = RULES[command](given)
        with writing(command, paths.outputs, paths.inputs):
            function(**given)
        for path in left_over([*(path.parent for path in paths.outputs), *paths.folders]):
            typer.echo(f"note: {path} was left by a command that was broken off; nothing needs it", err=True)

    return run
