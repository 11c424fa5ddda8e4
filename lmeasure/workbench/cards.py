"""Commands of each page, and the order of their options."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lmeasure.core import LMeasureError, SettingsError
from lmeasure.io import read_regular
from lmeasure.workbench import forms
from lmeasure.workbench.project import LARGEST_TEXT, Project
from lmeasure.workflows import command_help

MORE = "workbench.more_options"


@dataclass(frozen=True)
class Page:
    """A page of commands: its title, its purpose, its commands, and the kinds of files that it lists."""

    title: str
    lead: str
    commands: tuple[str, ...]
    kinds: tuple[str, ...]


PAGES = {
    "check": Page("workbench.connect_check", "workbench.channel_cable_way_counts", ("check", "play"), ("rig",)),
    "live": Page("workbench.live", "workbench.see_counts_speeds_faults", ("watch", "record"), ("run",)),
    "calibrate": Page(
        "workbench.calibrate",
        "workbench.plan_reference_poses_read",
        ("plan-poses", "capture", "calibrate"),
        ("poses", "calibration", "record"),
    ),
    "zone": Page("workbench.zone_place", "workbench.where_cell_instrument_can", ("zone", "place"), ("zone",)),
    "runs": Page(
        "workbench.runs", "workbench.from_recorded_counts_log", ("import", "reconstruct", "report", "motion"), ("log", "run", "trajectory")
    ),
    "robot": Page(
        "workbench.robot_certificate",
        "workbench.write_test_certify_was",
        ("program", "simulate", "certify", "key", "verify", "compare", "register", "batch", "qualify", "identify", "correct"),
        ("program", "certificate", "identification", "robot"),
    ),
}
MAKES = {
    "check": "checked",
    "play": "",
    "plan-poses": "poses",
    "capture": "calibration",
    "calibrate": "record",
    "zone": "zone",
    "import": "run",
    "reconstruct": "trajectory",
    "record": "run",
    "program": "program",
    "certify": "certificate",
}
"""Kinds of files that commands make, as far as the way from an empty folder to a certificate goes by them."""


def primary(page: Page, project: Project) -> str:
    """Return the command of a page that is open while the others are folded: the first whose file the project lacks and whose input it
    has, else the last on the way."""
    way = [name for name in page.commands if MAKES.get(name)]
    missing = [name for name in way if not project.of(MAKES[name])]
    ready = [name for name in missing if name not in NEEDS or project.of(NEEDS[name][0])]
    return (ready or missing or way[-1:] or list(page.commands[:1]))[0]


FIRST = {
    "init": ("template", "out"),
    "check": ("rig", "bus", "write"),
    "play": ("rig", "poses", "commands", "exchange"),
    "scan": ("bus", "seconds"),
    "watch": ("rig", "bus", "start"),
    "record": ("rig", "bus", "out", "seconds", "start"),
    "drum": ("measurements", "rig", "out"),
    "plan-poses": ("rig", "out", "poses", "box", "tilt_deg", "u_position_mm", "u_rotation_deg"),
    "capture": ("rig", "poses", "bus", "out", "by", "u_position_mm", "u_rotation_deg", "u_repeatability_mm"),
    "calibrate": ("folder", "out", "solve", "hold_out"),
    "zone": ("rig", "out", "report", "limit_deg", "u95_mm", "x", "y", "z"),
    "place": ("rig", "task", "out"),
    "import": ("logs", "rig", "out", "start", "scan"),
    "reconstruct": ("run", "out"),
    "report": ("run", "out"),
    "motion": ("trajectory", "out"),
    "certify": ("trajectory", "run", "program", "out", "details", "language", "key"),
    "demo": ("out", "robot", "correct", "seed"),
}
TITLES = {
    "init": "workbench.begin_rig",
    "check": "workbench.self_test",
    "play": "workbench.simulated_cell_bus",
    "scan": "workbench.adapters_who_speaks",
    "watch": "workbench.watch_without_recording",
    "record": "workbench.record",
    "plan-poses": "workbench.plan_reference_poses",
    "capture": "workbench.capture_poses",
    "calibrate": "workbench.find_observation_points",
    "zone": "workbench.accuracy_zone",
    "place": "workbench.place_points",
    "import": "workbench.import_logs",
    "reconstruct": "workbench.reconstruct_trajectory",
    "report": "workbench.page_trajectory",
    "motion": "workbench.speed_acceleration",
    "program": "workbench.test_program",
    "simulate": "workbench.simulate",
    "certify": "workbench.certify",
    "verify": "workbench.verify_certificate",
    "compare": "workbench.compare_certificates",
    "identify": "workbench.wrong_robot",
    "correct": "workbench.correct_program",
    "drum": "workbench.drums_from_was_measured",
    "demo": "workbench.simulated_cell",
    "key": "workbench.key_sign",
    "frames": "workbench.base_tool",
    "structure": "workbench.structure",
    "mechanism": "workbench.mechanism",
    "dyads": "workbench.links_poses",
    "register": "workbench.register",
    "batch": "workbench.batch",
    "qualify": "workbench.qualify",
}
VERBS = {
    "init": "workbench.write_rig",
    "check": "workbench.begin_self_test",
    "play": "workbench.play",
    "scan": "workbench.listen",
    "watch": "workbench.watch",
    "record": "workbench.record",
    "plan-poses": "workbench.plan",
    "capture": "workbench.begin",
    "calibrate": "workbench.calibrate",
    "zone": "workbench.map_zone",
    "import": "workbench.import",
    "certify": "workbench.certify",
    "verify": "workbench.verify",
    "drum": "workbench.work_them_out",
    "place": "workbench.search",
}
NEEDS = {
    "check": ("rig", "workbench.there_no_rig_yet"),
    "plan-poses": ("rig", "workbench.there_no_rig_yet"),
    "play": ("rig", "workbench.there_no_rig_yet"),
    "watch": ("rig", "workbench.there_no_rig_yet"),
    "record": ("rig", "workbench.there_no_rig_yet"),
    "capture": ("poses", "workbench.there_no_poses_yet"),
    "zone": ("rig", "workbench.there_no_rig_yet"),
    "reconstruct": ("run", "workbench.there_no_run_yet"),
    "certify": ("trajectory", "workbench.there_no_trajectory_yet"),
    "verify": ("certificate", "workbench.there_no_certificate_yet"),
    "compare": ("certificate", "workbench.there_no_certificate_yet"),
}
ONWARD = {
    "init": (("/rig", "workbench.put_dimensions"),),
    "drum": (("/rig?file={out}", "workbench.look_rig"), ("/check", "workbench.connect_check")),
    "demo": (
        ("/look/{out}/calibration", "workbench.calibrate"),
        ("/zone", "workbench.zone_place"),
        ("/robot", "workbench.robot_certificate"),
    ),
    "simulate": (
        ("/run/calibrate?folder={out}/calibration", "workbench.find_observation_points"),
        ("/run/reconstruct?run={out}", "workbench.reconstruct_trajectory"),
    ),
    "check": (("/calibrate", "workbench.calibrate"),),
    "plan-poses": (("/calibrate#capture", "workbench.capture_poses"),),
    "capture": (("/calibrate#calibrate", "workbench.find_observation_points"),),
    "calibrate": (("/run/zone?rig={out}/rig.toml", "workbench.accuracy_zone"),),
    "zone": (("/run/program?zone={out}", "workbench.largest_cube_test_program"), ("/live", "workbench.live"), ("/runs", "workbench.runs")),
    "place": (("/run/zone?rig={out}/rig.toml", "workbench.accuracy_zone"), ("/rig?file={out}/rig.toml", "workbench.look_rig")),
    "watch": (("/run/record?rig={rig}&bus={bus}&start={start}", "workbench.record"),),
    "record": (("/run/reconstruct?run={out}", "workbench.reconstruct_trajectory"),),
    "import": (("/start/{out}", "workbench.start_pose"), ("/run/reconstruct?run={out}", "workbench.reconstruct_trajectory")),
    "reconstruct": (
        ("/trajectory/{out}", "workbench.look_over_time"),
        ("/run/report?measured={out}", "workbench.page_trajectory"),
        ("/run/certify?trajectory={out}&run={run}", "workbench.certify"),
    ),
    "key": (("/run/certify?key={out}", "workbench.certify"),),
    "certify": (("/run/verify?bundle={out}", "workbench.verify_certificate"), ("/trend", "workbench.certificates_over_time")),
    "register": (("/register?folder={register_dir}", "workbench.register"),),
}
"""Next step after a command; braces contain its settings."""


@dataclass(frozen=True)
class Card:
    """A command on a page. first are the fields that are always visible, more those in groups that open; needs is the reason why it cannot
    be run."""

    command: str
    page: str
    title: str
    help: str
    verb: str
    first: list[forms.FieldOf]
    more: list[tuple[str, list[forms.FieldOf]]]
    needs: str
    error: str


def card(
    command: str,
    project: Project,
    *,
    page: str = "",
    given: Mapping[str, Any] | None = None,
    reported: Mapping[str, Any] | None = None,
    error: SettingsError | str | None = None,
) -> Card:
    """Return the card of a command, with its values or suggestions in the fields, and their faults beside them."""
    wrong = error if isinstance(error, SettingsError) else None
    fields = forms.fields(command, project, given, wrong, reported=reported)
    ahead = [*FIRST.get(command, ()), *(f.option.name for f in fields if f.option.required)]
    first = sorted((f for f in fields if f.option.name in ahead), key=lambda f: ahead.index(f.option.name))
    panels: dict[str, list[forms.FieldOf]] = {}
    for one in fields:
        if one not in first:
            panels.setdefault(one.option.panel or MORE, []).append(one)
    kind, needs = NEEDS.get(command, ("", ""))
    whole = "" if wrong is not None and any(f.error for f in fields) else str(error or "")
    missing = _start(command, project) or (needs if kind and not project.of(kind) else "")
    verb = VERBS.get(command, "workbench.run")
    return Card(command, page, TITLES.get(command, command), command_help(command), verb, first, list(panels.items()), missing, whole)


STARTLESS = "workbench.start_pose_this_run"


def hindered(command: str, given: Mapping[str, Any], folder: Path) -> str:
    """Return why a command cannot be run with its form: its run lacks a start, and no channel can determine it."""
    run = given.get("measured" if command == "report" else "run")
    if command not in ("reconstruct", "certify", "report") or not isinstance(run, str) or given.get("start"):
        return ""
    table = folder / run / "run.toml"
    return STARTLESS if table.is_file() and not _started(folder / run) else ""


def lacking(command: str, given: Mapping[str, Any]) -> tuple[str, str]:
    """Return the option that a form lacks beside those that are always needed, and its value; two empty texts if it lacks none."""
    if command == "plan-poses" and not any(given.get(name) for name in ("box", "extend", "robot")):
        return "box", "workbench.say_where_robot_may"
    return "", ""


def _started(run: Path) -> bool:
    return "[[swivel]]" in _text(run / "rig.toml") or "[start]" in _text(run / "run.toml")


def _start(command: str, project: Project) -> str:
    """Return why a trajectory cannot be certified: every run lacks its start, and no channel can determine it."""
    runs = project.of("run")
    if command not in ("reconstruct", "certify") or not runs or (command == "certify" and project.of("trajectory")):
        return ""
    if any(_started(project.folder / run) for run in runs):
        return ""
    return "workbench.no_run_has_start"


def _text(path: Path) -> str:
    try:
        return read_regular(path, LARGEST_TEXT).decode("utf-8", "replace")
    except (LMeasureError, OSError):
        return ""
