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
    Stop(
        "/",
        "/",
        ".way",
        "This is the way, from left to right: each step says whether it is done, and the next one has a frame. "
        "Nothing here is more than a folder of plain files.",
    ),
    Stop(
        "/rig?file=cell/campaign/rig.toml",
        "/rig",
        "#cable",
        "A rig is its dimensions. Go through the fields below: the arrow of each lights up in the drawing. Points "
        "can be dragged in space, and the zone follows.",
    ),
    Stop(
        "/check",
        "/check",
        "#check",
        "On a real rig a person pulls one cable after the other, and the counters tell which is which. What is "
        "wrong is red and mended by one click. The simulated cell was built right.",
    ),
    Stop(
        "/calibrate",
        "/calibrate",
        "#calibrate",
        "From counts at reference poses comes where the observation points really are, with the uncertainty of each.",
    ),
    Stop(
        "/look/cell/calibration",
        "/calibrate",
        "iframe.report",
        "The page of a calibration: the verdict first, then what the data can and cannot tell.",
    ),
    Stop(
        "/zone",
        "/zone",
        "#zone",
        "Where the instrument can be believed: within a largest pressure angle and a largest U95. Sliders on its "
        "page show what other limits would leave.",
    ),
    Stop("/runs", "/runs", ".runs", "What was recorded. A run without its start pose goes no further: counters only tell differences."),
    Stop(
        "/trajectory/cell/trajectory.parquet",
        "/runs",
        "#along",
        "Where the robot went, with bands that hold 95 %. Move the slider, come nearer, jump to gaps.",
    ),
    Stop(
        "/robot",
        "/robot",
        "#certify",
        "A test program and a trajectory make a certificate of ISO 9283: sealed, and signed where there is a key.",
    ),
    Stop(
        "/look/cell/certificate",
        "/robot",
        "iframe.report",
        "The certificate. Whoever gets it drops its folder or zip on the page before: every byte is looked at and "
        "every figure computed again.",
    ),
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
