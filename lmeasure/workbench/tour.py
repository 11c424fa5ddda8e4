"""The tour: what each page is for, one after the other, on the files of the simulated cell where the project has them."""

from typing import Any, NamedTuple
from urllib.parse import urlencode, urlsplit

from lmeasure.workbench.project import Project


class Stop(NamedTuple):
    """A stop: its page, on files of the demo and, where they are not there, without; what is pointed at; what is said of it."""

    address: str
    plain: str
    points_at: str
    text: str


STOPS = (
    Stop("/", "/", ".way", "workbench.this_way_from_left"),
    Stop("/rig?file=cell/campaign/rig.toml", "/rig", "#cable", "workbench.rig_dimensions_go_through"),
    Stop("/check", "/check", "#check", "workbench.real_rig_person_pulls"),
    Stop("/calibrate", "/calibrate", "#calibrate", "workbench.from_counts_reference_poses"),
    Stop("/look/cell/calibration", "/calibrate", "iframe.report", "workbench.page_calibration_verdict_first"),
    Stop("/zone", "/zone", "#zone", "workbench.where_instrument_can_believed"),
    Stop("/runs", "/runs", ".runs", "workbench.was_recorded_run_without"),
    Stop("/trajectory/cell/trajectory.parquet", "/runs", "#along", "workbench.where_robot_went_bands"),
    Stop("/robot", "/robot", "#certify", "workbench.test_program_trajectory_make"),
    Stop("/look/cell/certificate", "/robot", "iframe.report", "workbench.certificate_whoever_gets_drops"),
)


def address(project: Project, number: int) -> str:
    """The address of a stop of the tour in a project."""
    stop = STOPS[number]
    parts = urlsplit(stop.address)
    file = parts.query.removeprefix("file=") or (parts.path[parts.path.index("cell/") :] if "cell/" in parts.path else "")
    here = stop.address if not file or (project.folder / file).exists() else stop.plain
    return f"{here}{'&' if '?' in here else '?'}{urlencode({'tour': number + 1})}"


def shown(project: Project, asked: str) -> dict[str, Any] | None:
    """The stop that an address asks for, 1 the first, with the ways to those before and behind it; None for none."""
    numbers = [str(i + 1) for i in range(len(STOPS))]
    if asked not in numbers:
        return None
    number = numbers.index(asked)
    before = address(project, number - 1) if number else ""
    behind = address(project, number + 1) if number + 1 < len(STOPS) else ""
    return {
        "number": number + 1,
        "of": len(STOPS),
        "text": STOPS[number].text,
        "at": STOPS[number].points_at,
        "before": before,
        "behind": behind,
    }
