"""Which commands stand on which page, and which of their options come first."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lmeasure.core import LMeasureError, SettingsError
from lmeasure.io import read_regular
from lmeasure.workbench import forms
from lmeasure.workbench.project import LARGEST_TEXT, Project
from lmeasure.workflows import COMMANDS

MORE = "More options"


@dataclass(frozen=True)
class Page:
    """A page of commands: its title, what it is for, its commands, and the kinds of files that it lists."""

    title: str
    lead: str
    commands: tuple[str, ...]
    kinds: tuple[str, ...]


PAGES = {
    "check": Page(
        "Connect and check",
        "Which channel is which cable, which way it counts and how much it has to give: a person pulls, the counters tell.",
        ("check", "play"),
        ("rig",),
    ),
    "live": Page(
        "Live", "See counts, speeds, faults and the pose as they come; record a pass of the motion.", ("watch", "record"), ("run",)
    ),
    "calibrate": Page(
        "Calibrate",
        "Plan reference poses, read the counts at each, and find where the observation points are, with what the data can and cannot tell.",
        ("plan-poses", "capture", "calibrate"),
        ("poses", "calibration", "record"),
    ),
    "zone": Page(
        "Zone and place",
        "Where in the cell the instrument can be believed, and where its points had better stand.",
        ("zone", "place"),
        ("zone",),
    ),
    "runs": Page(
        "Runs",
        "From recorded counts, or the log of another program, to a trajectory with its uncertainty.",
        ("import", "reconstruct", "report", "motion"),
        ("log", "run", "trajectory"),
    ),
    "robot": Page(
        "Robot and certificate",
        "Write the test, certify what was measured, verify what was certified, find out what is wrong with the robot.",
        ("program", "simulate", "certify", "key", "verify", "compare", "identify", "correct"),
        ("program", "certificate", "identification", "robot"),
    ),
}
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
    "init": "Begin a rig",
    "check": "Self-test",
    "play": "A simulated cell on a bus",
    "scan": "Adapters and who speaks",
    "watch": "Watch without recording",
    "record": "Record",
    "plan-poses": "Plan reference poses",
    "capture": "Capture the poses",
    "calibrate": "Find the observation points",
    "zone": "Accuracy zone",
    "place": "Place the points",
    "import": "Import logs",
    "reconstruct": "Reconstruct the trajectory",
    "report": "Page of a trajectory",
    "motion": "Speed and acceleration",
    "program": "Test program",
    "simulate": "Simulate",
    "certify": "Certify",
    "verify": "Verify a certificate",
    "compare": "Compare certificates",
    "identify": "What is wrong with the robot",
    "correct": "Correct a program",
    "drum": "Drums from what was measured",
    "demo": "A simulated cell",
    "key": "A key to sign with",
    "frames": "Base and tool",
    "structure": "Structure",
    "mechanism": "Mechanism",
    "dyads": "Links for poses",
}
VERBS = {
    "init": "Write the rig",
    "check": "Begin the self-test",
    "play": "Play it",
    "scan": "Listen",
    "watch": "Watch",
    "record": "Record",
    "plan-poses": "Plan",
    "capture": "Begin",
    "calibrate": "Calibrate",
    "zone": "Map the zone",
    "import": "Import",
    "certify": "Certify",
    "verify": "Verify",
    "drum": "Work them out",
    "place": "Search",
}
NEEDS = {
    "check": ("rig", "There is no rig yet: begin one on the page Rig."),
    "plan-poses": ("rig", "There is no rig yet: begin one on the page Rig."),
    "play": ("rig", "There is no rig yet: begin one on the page Rig."),
    "watch": ("rig", "There is no rig yet: begin one on the page Rig."),
    "record": ("rig", "There is no rig yet: begin one on the page Rig."),
    "capture": ("poses", "There are no poses yet: plan them first."),
    "zone": ("rig", "There is no rig yet: begin one on the page Rig."),
    "reconstruct": ("run", "There is no run yet: record or import one."),
    "certify": ("trajectory", "There is no trajectory yet: reconstruct a run first."),
    "verify": ("certificate", "There is no certificate yet."),
    "compare": ("certificate", "There is no certificate yet."),
}
ONWARD = {
    "init": (("/rig", "Put in its dimensions"),),
    "drum": (("/rig?file={out}", "Look at the rig"), ("/check", "Connect and check")),
    "demo": (("/?tour=1", "Take the tour"), ("/zone", "Zone and place"), ("/robot", "Robot and certificate")),
    "simulate": (
        ("/run/calibrate?folder={out}/calibration", "Find the observation points"),
        ("/run/reconstruct?run={out}", "Reconstruct the trajectory"),
    ),
    "check": (("/calibrate", "Calibrate"),),
    "plan-poses": (("/calibrate#capture", "Capture the poses"),),
    "capture": (("/calibrate#calibrate", "Find the observation points"),),
    "calibrate": (("/run/zone?rig={out}/rig.toml", "Accuracy zone"),),
    "zone": (("/run/program?zone={out}", "Its largest cube as a test program"), ("/live", "Live"), ("/runs", "Runs")),
    "place": (("/run/zone?rig={out}/rig.toml", "Accuracy zone"), ("/rig?file={out}/rig.toml", "Look at the rig")),
    "watch": (("/run/record?rig={rig}&bus={bus}&start={start}", "Record"),),
    "record": (("/run/reconstruct?run={out}", "Reconstruct the trajectory"),),
    "import": (("/start/{out}", "Start pose"), ("/run/reconstruct?run={out}", "Reconstruct the trajectory")),
    "reconstruct": (
        ("/trajectory/{out}", "Look at it over time"),
        ("/run/report?measured={out}", "Page of a trajectory"),
        ("/run/certify?trajectory={out}&run={run}", "Certify"),
    ),
    "key": (("/run/certify?key={out}", "Certify"),),
    "certify": (("/run/verify?bundle={out}", "Verify a certificate"), ("/trend", "Certificates over time")),
}
"""What comes after a command; in braces stands what it was asked."""


@dataclass(frozen=True)
class Card:
    """A command on a page. first are the fields that are always seen, more those in groups that open; needs says why it cannot be run."""

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
    told: Mapping[str, Any] | None = None,
    error: SettingsError | str | None = None,
) -> Card:
    """The card of a command, with what was given in its fields, or what is told of some of them, and what is wrong with it beside them."""
    wrong = error if isinstance(error, SettingsError) else None
    fields = forms.fields(command, project, given, wrong, told=told)
    ahead = [*FIRST.get(command, ()), *(f.option.name for f in fields if f.option.required)]
    first = sorted((f for f in fields if f.option.name in ahead), key=lambda f: ahead.index(f.option.name))
    panels: dict[str, list[forms.FieldOf]] = {}
    for one in fields:
        if one not in first:
            panels.setdefault(one.option.panel or MORE, []).append(one)
    kind, needs = NEEDS.get(command, ("", ""))
    whole = "" if wrong is not None and any(f.error for f in fields) else str(error or "")
    missing = _start(command, project) or (needs if kind and not project.of(kind) else "")
    verb = VERBS.get(command, "Run it")
    return Card(command, page, TITLES.get(command, command), COMMANDS[command], verb, first, list(panels.items()), missing, whole)


STARTLESS = "The start pose of this run is not stated: state it on the run's page, no step can do without it."


def hindered(command: str, given: Mapping[str, Any], folder: Path) -> str:
    """Why a command cannot be run with what its form says: the run that it names lacks its start, and no channel can tell it."""
    run = given.get("measured" if command == "report" else "run")
    if command not in ("reconstruct", "certify", "report") or not isinstance(run, str) or given.get("start"):
        return ""
    table = folder / run / "run.toml"
    return STARTLESS if table.is_file() and not _started(folder / run) else ""


def lacking(command: str, given: Mapping[str, Any]) -> tuple[str, str]:
    """The option that a form lacks beside those that are always needed, and what is told of it; two empty texts where it lacks none."""
    if command == "plan-poses" and not any(given.get(name) for name in ("box", "extend", "robot")):
        return "box", "Say where the robot may go: a box, or a calibration that is extended."
    return "", ""


def _started(run: Path) -> bool:
    return "[[swivel]]" in _text(run / "rig.toml") or "[start]" in _text(run / "run.toml")


def _start(command: str, project: Project) -> str:
    """What keeps a trajectory from being certified: every run lacks its start, and no channel can tell it."""
    runs = project.of("run")
    if command not in ("reconstruct", "certify") or not runs or (command == "certify" and project.of("trajectory")):
        return ""
    if any(_started(project.folder / run) for run in runs):
        return ""
    return "No run has its start pose: state it on the run's page, no step can do without it."


def _text(path: Path) -> str:
    try:
        return read_regular(path, LARGEST_TEXT).decode("utf-8", "replace")
    except (LMeasureError, OSError):
        return ""
