"""Jobs: commands as processes, their output as it comes, and their state after the server is gone.

A job is a folder, PROJECT/.workbench/jobs/NUMBER: `asked.json` (command line, when), `said.jsonl` (every line that stays) and, once it
ended, `end.json` (exit code, the document of `--json`). One without an end whose process is gone was interrupted.
"""

import asyncio
import contextlib
import json
import os
import shlex
import shutil
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from lmeasure.core import LMeasureError
from lmeasure.io import not_written, read_regular
from lmeasure.workbench import processes
from lmeasure.workbench.project import OWN

RUNNING, DONE, FAILED, CANCELLED, INTERRUPTED = "running", "done", "failed", "cancelled", "interrupted"
PASSING = ("progress", "state", "live", "cell", "moved", "capture", "scan")
"""Kinds of events that are not written to disk: the last of each kind is kept."""
SCHEDULED = ("batch", "zone")
"""Commands that take a scheduler."""
PATIENCE_S = 8.0
CANCELLED_CODE = 130
KEPT_LINES = 2000
LARGEST = 2**26
"""Bytes of a file of an earlier job."""


@dataclass
class Job:
    """One job. watchers are the queues of the listeners; last contains the last of each passing event."""

    number: int
    command: str
    words: list[str]
    begun: str
    folder: Path
    state: str = RUNNING
    ended: str = ""
    result: dict[str, Any] | None = None
    said: list[dict[str, Any]] = field(default_factory=list)
    last: dict[str, dict[str, Any]] = field(default_factory=dict)
    process: processes.Process | None = None
    cancelling: bool = False
    watchers: set["asyncio.Queue[dict[str, Any]]"] = field(default_factory=set)

    @property
    def line(self) -> str:
        """The command line that does the same."""
        return shlex.join(["lmeasure", *self.words])

    def about(self) -> dict[str, Any]:
        keys = ("number", "command", "line", "begun", "ended", "state", "result")
        return {key: getattr(self, key) for key in keys} | {"progress": self.last.get("progress")}

    def tell(self, event: dict[str, Any]) -> None:
        """Keep an event and send it to all listeners."""
        if event.get("event") in PASSING:
            self.last[str(event["event"])] = event
        else:
            if event.get("event") == "asked":
                self.last["asked"] = event
            self.said.append(event)
            with contextlib.suppress(OSError):
                _append(self.folder / "said.jsonl", json.dumps(event, ensure_ascii=False).encode("utf-8", "replace") + b"\n")
        for queue in self.watchers:
            # a slow reader misses transient events, never the end
            if queue.qsize() < KEPT_LINES or event.get("event") not in PASSING:
                queue.put_nowait(event)


class Jobs:
    """All jobs of a project, oldest first."""

    def __init__(self, folder: Path, language: str = "en", scheduler: str | None = None) -> None:
        self.folder, self.language, self.scheduler = folder, language, scheduler
        self.home = folder / OWN / "jobs"
        self.jobs: dict[int, Job] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._beginning = asyncio.Lock()
        for path in sorted(self.home.glob("[0-9]*")):
            if (job := _read(path)) is not None:
                self.jobs[job.number] = job

    def all(self) -> list[Job]:
        """The newest first."""
        return [self.jobs[number] for number in sorted(self.jobs, reverse=True)]

    def running(self) -> list[Job]:
        """Those that still work."""
        return [job for job in self.all() if job.state == RUNNING]

    async def begin(self, words: list[str]) -> Job:
        """Begin a command in the project folder; words are those after `lmeasure`, in which no path is absolute. A running one, requested
        again by another page or a second click, is that job. With a stated scheduler, commands for many processes use it. LMeasureError if
        its folder cannot be written."""
        if self.scheduler is not None and words[0] in SCHEDULED and "--scheduler" not in words:
            words = [words[0], "--scheduler", self.scheduler, *words[1:]]
        async with self._beginning:
            same = next((job for job in self.running() if job.words == words), None)
            try:
                return same or await self._begin(words)
            except OSError as error:
                raise LMeasureError(not_written(self.home, error)) from error

    async def _begin(self, words: list[str]) -> Job:
        number = max(self.jobs, default=0) + 1
        folder = self.home / f"{number:04}"
        while True:  # another workbench may have the same folder open
            try:
                folder.mkdir(parents=True)
                break
            except FileExistsError:
                number += 1
                folder = self.home / f"{number:04}"
        job = Job(number, words[0], words, _now(), folder)
        environment = os.environ | {"LMEASURE_EVENTS": "1", "LANGUAGE": self.language, "PYTHONUNBUFFERED": "1", "PYTHONIOENCODING": "utf-8"}
        begin = words.index("--") if "--" in words else len(words)
        job.process = await processes.begun([*words[:begin], "--json", *words[begin:]], self.folder, environment)
        requested = {"number": number, "command": job.command, "words": words, "begun": job.begun, "process": job.process.pid}
        try:
            _write(folder / "asked.json", requested)
        except OSError:
            # the job would be lost
            job.process.kill()
            await job.process.wait()
            shutil.rmtree(folder, ignore_errors=True)
            raise
        self.jobs[number] = job
        task = asyncio.create_task(self._follow(job))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return job

    async def type(self, job: Job, text: str) -> bool:
        """Send a line to a job that reads answers; False if it does not read any more."""
        if job.process is None or job.process.stdin is None or job.state != RUNNING:
            return False
        job.last.pop("asked", None)
        try:
            job.process.stdin.write(" ".join(text.split()).encode() + b"\n")
            await job.process.stdin.drain()
        except (OSError, RuntimeError):
            return False
        job.tell({"event": "typed", "text": text})
        return True

    async def cancel(self, job: Job) -> None:
        """End a job as Ctrl-C would: its recording is kept."""
        if job.process is None or job.state != RUNNING:
            return
        job.cancelling = True
        if job.process.stdin is not None:
            job.process.stdin.close()
        try:
            await asyncio.wait_for(asyncio.shield(job.process.wait()), PATIENCE_S)
        except TimeoutError:
            with contextlib.suppress(ProcessLookupError):
                job.process.terminate()

    async def close(self) -> None:
        """End all jobs; the server stops."""
        await asyncio.gather(*(self.cancel(job) for job in self.running()))
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=PATIENCE_S)

    async def watch(self, job: Job) -> AsyncIterator[dict[str, Any]]:
        """Yield all output so far, the last of each passing event, then further output until the end."""
        queue: asyncio.Queue[dict[str, Any]] = asyncio.Queue()
        before = [*job.said, *(event for kind, event in job.last.items() if kind != "asked")]
        job.watchers.add(queue)
        try:
            for event in before:
                yield event
            if job.state != RUNNING:
                yield {"event": "end", "state": job.state}
                return
            while True:
                event = await queue.get()
                yield event
                if event["event"] == "end":
                    return
        finally:
            job.watchers.discard(queue)

    async def _follow(self, job: Job) -> None:
        process = job.process
        if process is None or process.stderr is None or process.stdout is None:
            return
        reported = asyncio.create_task(process.stdout.read())
        async for raw in _lines(process.stderr):
            text = raw.decode("utf-8", "replace").rstrip()
            try:
                event = json.loads(text)
            except (ValueError, RecursionError):
                event = None
            if not isinstance(event, dict) or "event" not in event:
                event = {"event": "said", "text": text}
            job.tell(event)
        code = await process.wait()
        try:
            job.result = json.loads((await reported).decode("utf-8", "replace"))
        except (ValueError, RecursionError):
            job.result = None
        failed = CANCELLED if job.cancelling or code in (CANCELLED_CODE, -2) else FAILED
        # a recording ended by its button is done
        job.state = DONE if code == 0 else failed
        job.ended = _now()
        # on a full disk, readers still receive the end
        with contextlib.suppress(OSError):
            _write(job.folder / "end.json", {"state": job.state, "ended": job.ended, "code": code, "result": job.result})
        job.tell({"event": "end", "state": job.state})
        processes.prepared.want()  # for the next


async def _lines(stream: asyncio.StreamReader) -> AsyncIterator[bytes]:
    """Yield lines until the end; of one that is longer than the stream allows only the rest."""
    while True:
        try:
            line = await stream.readline()
        except ValueError:
            continue
        if not line:
            return
        yield line


def _read(folder: Path) -> Job | None:
    """A job of an earlier server."""
    try:
        requested = json.loads(read_regular(folder / "asked.json", LARGEST))
        job = Job(
            int(requested["number"]), str(requested["command"]), [str(w) for w in requested["words"]], str(requested["begun"]), folder
        )
    except (LMeasureError, OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    with contextlib.suppress(LMeasureError, OSError):
        for line in read_regular(folder / "said.jsonl", LARGEST).split(b"\n"):
            with contextlib.suppress(ValueError, RecursionError):  # the last line of a server that was killed
                event = json.loads(line)
                job.said += [event] if isinstance(event, dict) else []
    try:
        end = json.loads(read_regular(folder / "end.json", LARGEST))
        job.state, job.ended, job.result = str(end["state"]), str(end["ended"]), end["result"]
    except (LMeasureError, OSError, ValueError, KeyError, TypeError, RecursionError):
        job.state = INTERRUPTED
    return job


def _append(path: Path, line: bytes) -> None:
    """Append a whole line, or nothing."""
    with path.open("ab", buffering=0) as file:
        size, left = file.tell(), memoryview(line)
        try:
            while left:
                left = left[file.write(left) :]
        except OSError:
            file.truncate(size)
            raise


def _write(path: Path, content: dict[str, Any]) -> None:
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.write_text(json.dumps(content, ensure_ascii=False, indent=1), encoding="utf-8")
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
