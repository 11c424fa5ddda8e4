"""Commands, each once: settings in, result out; command lines, pages and scripts are their faces.

A workflow `zone` is `ZoneSettings`, a model of its options, and `run_zone(settings, progress)`, which reads, calls the stages, writes every
file, and gives a `Result`. It is known by its line in `JOBS` and loaded at its first use.
"""

from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, NamedTuple

from lmeasure.text import LANGUAGES, Message, texts

if TYPE_CHECKING:
    from lmeasure.workflows.flow import Result
    from lmeasure.workflows.settings import CommandSettings

JOBS: dict[str, dict[str, str]] = {
    "Try it": {
        "workbench": "Open the same tools in your browser, for one project folder.",
        "demo": "Calibrate, record, reconstruct and map a simulated cell on a virtual CAN bus, and compare with the truth.",
        "play": (
            "Simulate a cell on a CAN bus of this machine, for check, capture and record. Your lines move its robot and cables.\n\n"
            "Lines: pull NAME [MM], let NAME, turn NAME, go POSE, home, run."
        ),
        "docs": "Open the documentation in your browser, and build it first where its pages have changed.",
        "warm": "Compile everything that later commands would compile while you wait. It takes about a minute, once for each version.",
        "simulate": "Simulate the counts of the instrument along a motion, and write the true poses too.",
    },
    "Build and calibrate a rig": {
        "init": "Write a rig.toml to start from. It explains how to measure each dimension, and what a millimetre of error costs.",
        "schema": "Print the JSON Schema of an input file, for completion and checks in your editor.",
        "place": "Find the best positions of observation and attachment points for the robot's region.",
        "drum": "Compute the drums of a rig file from radii, distances and the full-wind count.",
        "scan": "List the CAN adapters of this machine, or listen to a bus and list senders, rates and changing bytes.",
        "check": "Run the self-test: find the channel of each cable, its sign, counts per turn, stroke and slack.",
        "plan-poses": "Choose the reference poses with the smallest length uncertainty over a zone, and show the gain of each.",
        "capture": (
            "Record the counts at each reference pose over a bus, into a calibration folder.\n\n"
            "Lines: Enter records, undo deletes the last reading, skip excludes a pose, go POSE changes the order, return goes back to the "
            "first pose, status, trust, quit. Run the same command to continue after a stop."
        ),
        "calibrate": "Solve for the observation points from counts at reference poses, and report unobservable parameters.",
        "check-instrument": (
            "Check a calibrated instrument in minutes, without a tracker: returns, revisits, reversal, drift and known distances, and find "
            "moved parts."
        ),
        "zone": "Map the region within the limits, and U95 of the measured position in it.",
    },
    "Measure a motion": {
        "watch": "Show counts, speeds, faults and the pose from a bus live, without recording.",
        "record": "Record a pass of the motion: all frames, and the decoded counts.",
        "import": (
            "Import log files of CAN frames into a run folder.\n\n"
            "A log does not contain the start pose, at which the counters were zeroed. State it with --start FILE, or with --position-mm "
            "and --quaternion-xyzw. You can also state it later; poses need it."
        ),
        "reconstruct": "Reconstruct the gripper's trajectory and its uncertainty from recorded counts, by the screw method.",
        "motion": "Smooth a trajectory by local cubics and write velocity, acceleration and jerk with their uncertainties.",
        "report": "Write the report of a trajectory: path, uncertainty, excluded samples, and speed.",
        "inspect": "Show any file of lmeasure, or a log of a known format, in a page: what it is, and a picture of it.",
        "view": "Open a 3-D recording in the rerun viewer or a browser: the rig in space, and curves over time.",
    },
    "Test a robot": {
        "program": "Write the test program of ISO 9283: poses and paths of the cube, with cycles, speeds and loads.",
        "certify": (
            "Certify a robot according to ISO 9283: certificate.json, certificate.pdf, report.html and all inputs in one sealed folder."
        ),
        "verify": (
            "Check every file's hash and recompute every result of a certificate.\n\n"
            "Exit code 0: all equal; 1: differences, one per line; 3: no differences, but some items could not be compared."
        ),
        "compare": ("Compare certificates or two calibrations: differences beyond the uncertainty, moved parts, exchangeability."),
        "register": "Keep calibrations, checks and certificates over years: drift, control charts, next calibration, recall, audit trail.",
        "batch": "Do one command for many folders, files or rows of a table, here or on a cluster; what is done is not done again.",
        "qualify": "Qualify this installation before use (ISO/IEC 17025, 7.11): files, reference data, formulas, coverage, certificates.",
        "key": "Make an Ed25519 key. Keep FILE; give FILE.pub to people who verify.",
        "identify": "Calibrate a robot's kinematic model from joint values and measured poses, and predict its accuracy after correction.",
        "correct": "Correct a robot's program with a kinematic calibration: change its targets, and keep every other byte.",
        "frames": "Calibrate robot base and target (robot-world / hand-eye, AX = YB) from poses of both.",
    },
    "Theory of mechanisms": {
        "structure": "Determine the structure of six links, the assembly modes of their lengths, and the distance to singular poses.",
        "mechanism": "Analyse a mechanism: joint values at a pose, distance to singular poses, workspace, pictures.",
        "dyads": "Find links between ball joints that guide a body through given poses, by least squares and by minimax.",
    },
}
"""Commands by the job that they belong to, in the order in which they are listed, with their help."""
COMMANDS = {name: text for commands in JOBS.values() for name, text in commands.items()}


MODULES = {
    "certify": ("verify", "compare", "key", "qualify"),
    "record": ("watch", "scan", "check"),
    "init": ("place", "drum", "schema"),
    "calibrate": ("check-instrument",),
    "reconstruct": ("motion", "import"),
    "inspect": ("report", "view"),
    "identify": ("frames",),
    "correct": ("program",),
    "structure": ("dyads",),
    "demo": ("simulate", "warm", "docs", "workbench"),
    "capture": ("play",),
}
"""Modules that hold other commands beside the one of their name."""


class Workflow(NamedTuple):
    """A command: its name, its help, the model of its settings, and its work `run(settings, progress)`."""

    name: str
    help: str
    settings: "type[CommandSettings]"
    run: "Callable[..., Result]"


def load(name: str) -> Workflow:
    """Return the workflow of a command; KeyError for another name."""
    text = COMMANDS[name]
    home = next((own for own, others in MODULES.items() if name in others), name)
    module = import_module(f"lmeasure.workflows.{home.replace('-', '_')}")
    settings = "".join(word.capitalize() for word in name.split("-"))
    return Workflow(name, text, getattr(module, f"{settings}Settings"), getattr(module, f"run_{name.replace('-', '_')}"))


def help_of(command: str, name: str, text: str) -> Message:
    """Return the help of an option: its own, or that of all options of its name."""
    own = f"cli.{command}.{name}"
    return Message(own if any(own in texts(language) for language in LANGUAGES) else f"cli.option.{name}", template=text)


def command_help(command: str) -> Message:
    """Return the help of a command."""
    return Message(f"cli.{command}.help", template=COMMANDS[command])


def job_name(text: str) -> Message:
    """Return the name of a job, to which several commands belong."""
    return Message(f"cli.job.{'_'.join(text.lower().split())}", template=text)


def panel_of(text: str) -> Message:
    """Return the name of a group of options."""
    return Message(f"cli.panel.{'_'.join(text.lower().split())}", template=text)
