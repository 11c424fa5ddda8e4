"""Buses of a project: which is used, and the simulated cell that plays on one."""

from lmeasure.text import typed
from lmeasure.workbench import forms
from lmeasure.workbench.jobs import Job, Jobs


def playing(jobs: Jobs) -> Job | None:
    """The simulated cell that is being played."""
    return next((job for job in jobs.running() if job.command == "play"), None)


def known(jobs: Jobs) -> dict[str, str]:
    """The bus that is used, by the options of commands: that of the cell that is played, with where its robot is at home, else that of the
    last job that had one."""
    cell = playing(jobs)
    last = cell or next((job for job in jobs.all() if job.command in ("check", "capture", "watch", "record", "scan") and _bus(job)), None)
    if last is None or not (bus := _bus(last)) or bus.startswith(("replay:", "simulated:")):
        return {}
    given = forms.of_words(last.command, last.words)
    reported = {"bus": bus, "bus_option": "\n".join(given.get("bus_option", []))}
    state = {} if cell is None else cell.last.get("cell", {})
    if state.get("at") == "home":
        reported["start"] = typed(state["pose"])
    return {key: text for key, text in reported.items() if text}


def _bus(job: Job) -> str:
    """The bus of a job's command line."""
    given = forms.of_words(job.command, job.words)
    return str(given.get("bus", ""))
