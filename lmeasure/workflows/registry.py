"""What each command does, once: settings in, result out; command lines, pages and scripts are faces of it.

A workflow is a module with `Settings`, a model of what it is asked, and `run(settings, progress)`, which reads, calls the stages, writes
every file, and gives a `Result`. It is known by its line in `JOBS`; nothing of it is loaded before it is asked for.
"""

from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

from lmeasure.text import LANGUAGES, Message, texts

if TYPE_CHECKING:
    from lmeasure.workflows.flow import Result
    from lmeasure.workflows.settings import Asked

JOBS: dict[str, dict[str, str]] = {
    "Try it": {
        "workbench": "Open the workbench: the whole job in a browser of this machine, over a project folder.",
        "demo": "Calibrate, record, reconstruct and map a simulated cell over a virtual CAN bus, and compare with the truth.",
        "play": (
            "Play a simulated cell on a bus of this machine: a robot and a hand that do what is typed, for check, capture and record.\n\n"
            "Lines typed while it runs: pull NAME [MM], let NAME, turn NAME, go POSE, home, run."
        ),
        "simulate": "Simulate the instrument along a motion: what its counters would record, with the true poses beside it.",
    },
    "Build and calibrate a rig": {
        "init": "Write a rig.toml to begin with, every dimension explained: how it is measured and what a millimetre of error costs.",
        "schema": "Print the JSON Schema of a file that is written by hand, for editors that complete and check it.",
        "place": "Search places for observation and attachment points that make the instrument best where the robot works.",
        "drum": "Fill the drums of a rig file from radii, distances and the full-wind count.",
        "scan": "List the CAN adapters of this machine, or listen to a bus: who speaks, how often, and which bytes move.",
        "check": "Walk through the self-test: which channel is which cable, direction, counts per turn, stroke and slack.",
        "plan-poses": "Choose reference poses that leave the least uncertainty in the lengths over a zone, and say what each brings.",
        "capture": (
            "Go through reference poses and read the counts at each: a calibration folder, over a bus.\n\n"
            "Lines typed while it runs: Enter reads, undo takes back the last reading, skip leaves a pose out, go POSE changes the order, "
            "return goes back to the first pose, status, trust, quit. Broken off, the same command goes on."
        ),
        "calibrate": "Find the observation points from recorded counts at reference poses, with what the data can and cannot tell.",
        "check-instrument": (
            "Check a calibrated instrument in minutes, without a tracker: returns, revisits, reversal, drift, known distances, and what "
            "has moved if they do not close."
        ),
        "zone": "Map where every pressure angle stays within the limit, and the 95 % radius of the measured position.",
    },
    "Measure a motion": {
        "watch": "Watch what comes over a bus: counts, speeds, faults and the pose, before anything is recorded.",
        "record": "Record a pass of the motion: every frame as it came, and the counts decoded from it.",
        "import": (
            "Read log files of CAN frames into a run folder.\n\n"
            "The start pose, at which the counters were zeroed, stands in no log: give it by --start FILE, or by --position-mm and "
            "--quaternion-xyzw; without them it is unknown, and poses can be had only when it is stated later."
        ),
        "reconstruct": "Reconstruct the gripper's trajectory from recorded counts, with its uncertainty, by the screw method.",
        "motion": "Smooth a trajectory by local cubics and write velocity, acceleration and jerk with their uncertainties.",
        "report": "Draw the page of a trajectory: where it went, how well that is known, what was left out, and how fast it was.",
        "inspect": "Show any file of lmeasure, or a log of a known format, in a page: what it is, and a picture of it.",
        "view": "Open a recording in the rerun viewer, or in a browser: the rig in space, and every figure over time.",
    },
    "Test a robot": {
        "program": "Write the test program of ISO 9283: poses and paths of the cube, with cycles, speeds and loads.",
        "certify": (
            "Certify a robot by ISO 9283: certificate.json, certificate.pdf, report.html and copies of all inputs in one sealed folder."
        ),
        "verify": (
            "Look at every byte of a certificate's folder and compute every figure again.\n\n"
            "Exit 0: all the same; 1: every difference on a line; 3: nothing differs, but something could not be compared, named."
        ),
        "compare": (
            "Compare certificates, or two calibrations: what differs beyond the instrument's uncertainty, what has moved, exchangeability."
        ),
        "register": "Keep calibrations, checks and certificates over years: drift, control charts, next calibration, recall, audit trail.",
        "qualify": "Qualify this installation before use (ISO/IEC 17025, 7.11): files, reference data, formulas, coverage, certificates.",
        "key": "Make an Ed25519 key: FILE stays with you, FILE.pub goes to those who verify.",
        "identify": "Find what is wrong with a robot from joint values and what an instrument measured at them, and how good it could be.",
        "correct": "Correct a robot's program by an identification: its targets are rewritten, all else stays byte for byte.",
        "frames": "Find where a robot stands in an instrument's frame and how a target sits on its flange, from poses of both (AX = YB).",
    },
    "Theory of mechanisms": {
        "structure": "Name the structure of six links, find all assemblies of their lengths, and what a pose has of a singular one.",
        "mechanism": "Study a mechanism: joints at a pose, how near it is to a singular one, its workspace, its pictures.",
        "dyads": "Find links between ball joints for poses that a body shall take, by least squares and by minimax.",
    },
}
"""Commands by the job that they belong to, in the order in which they are listed, with their help."""
COMMANDS = {name: text for commands in JOBS.values() for name, text in commands.items()}


class Workflow(NamedTuple):
    """A command: its name, its help, the model of what it is asked, and its work `run(settings, progress)`."""

    name: str
    help: str
    settings: "type[Asked]"
    run: "Callable[..., Result[Any]]"


def load(name: str) -> Workflow:
    """The workflow of a command; KeyError for what is none."""
    text = COMMANDS[name]
    # a keyword of Python names no module
    module = import_module(f"lmeasure.workflows.{'import_log' if name == 'import' else name.replace('-', '_')}")
    return Workflow(name, text, module.Settings, module.run)


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
