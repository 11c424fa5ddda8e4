"""Jobs of a workbench, and a store of results, in a simulated world: processes, disk and clock from one seed; and what must be true after.

The server's code runs as it is. Its processes are played: they write lines, whole ones and torn ones, and end when the seed says so. The
disk fails, or the server is killed, at one of its operations. Another server, or another batch, then finds what is there.
"""

import asyncio
import contextlib
import hashlib
import json
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from simulated_machine import Killed, Machine, content, failing_disk
from worlds import Outcome

from lmeasure.core import LMeasureError
from lmeasure.fleet import Catalogue, Outcome as Kept, Store
from lmeasure.workbench import processes
from lmeasure.workbench.jobs import PASSING, RUNNING, Job, Jobs

WORDS = (["verify", "c"], ["zone", "rig.toml"], ["record", "--rig", "rig.toml"], ["calibrate", "cöl"])
LINES = (
    '{"event": "progress", "done": 0.5}', '{"event": "said", "text": "line\u2028separator"}', "a plain line", "{torn", "[1, 2]", "\x85\x1c",
    '{"event": "asked", "text": "Enter?"}', '{"event": "said", "text": "\\ud800"}', "ü" * 3000, "x" * 70_000, '{"event": 3}', "[" * 5000,
)  # fmt: skip


class Played:
    """A process that the world plays."""

    def __init__(self, pid: int) -> None:
        self.pid, self.returncode = pid, None
        self.stdin, self.stdout, self.stderr = self, asyncio.StreamReader(), asyncio.StreamReader()
        self.stubborn, self.killed = False, False
        self._end: asyncio.Future[int] = asyncio.get_running_loop().create_future()

    @property
    def ended(self) -> bool:
        """Return whether it has ended."""
        return self._end.done()

    def write(self, data: bytes) -> None:
        """Read a typed line."""
        if self.ended:
            raise BrokenPipeError
        self.stderr.feed_data(json.dumps({"event": "said", "text": f"read {data.decode().strip()}"}).encode() + b"\n")

    async def drain(self) -> None:
        """It is read already."""

    def close(self) -> None:
        """End, unless it is stubborn."""
        if not self.stubborn:
            self.end(130)

    def end(self, code: int, result: bytes = b"{}") -> None:
        """End with a code and a document."""
        if not self.ended:
            self.stdout.feed_data(result)
            self.stdout.feed_eof()
            self.stderr.feed_eof()
            self._end.set_result(code)

    def terminate(self) -> None:
        """End by a signal."""
        self.end(-15)

    def kill(self) -> None:
        """End by another one."""
        self.killed = True
        self.end(-9, b"")

    async def wait(self) -> int:
        """Return the code."""
        return await asyncio.shield(self._end)


@dataclass(kw_only=True)
class Workbench(Machine):
    """A server, what it has begun, and what those who look on were told."""

    faults: list[str] = field(default_factory=list)
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    played: list[Played] = field(default_factory=list)
    begun: dict[int, Job] = field(default_factory=dict)
    told: dict[int, list[dict[str, Any]]] = field(default_factory=dict)
    wrong: list[str] = field(default_factory=list)


def drawn(seed: int, kind: type[Workbench] = Workbench) -> Workbench:
    """Return the world of a seed."""
    rng = np.random.default_rng([seed, 52])
    answer = str(rng.choice(["", "killed", "killed", "killed", "full", "part", "error", "interrupted"]))
    number = int(10.0 ** rng.uniform(0.0, 2.2))
    disk = {} if not answer else {number: answer} if answer != "full" else {-number: "", 0: "full"}
    return kind(seed=seed, rng=rng, disk=disk, short=int(rng.choice([10**9, 50])), faults=[f"disk: {answer}"] if answer else [])


def lived(world: Workbench, folder: Path) -> Outcome:
    """Let a server live, then judge what another one finds."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    ended = "complete"
    with patch("lmeasure.workbench.jobs._now", lambda: f"{world.now:.0f}"), patch("lmeasure.workbench.jobs.PATIENCE_S", 0.01):
        with failing_disk(world, folder), patch.object(processes, "begun", _begin(world)):
            asyncio.run(_served(world, folder))
        if world.left is not None:
            ended = "killed"
            _lay(world.left, folder)
        world.wrong += _judged(world, folder)
        digest = _digest(content(folder))
        with patch.object(processes, "begun", _begin(world)):
            world.wrong += asyncio.run(_again(folder))
    return Outcome(world.seed, ended, world.now, digest, world.faults, sum(map(len, world.told.values())), world.wrong)


def _lay(left: dict[str, bytes], folder: Path) -> None:
    shutil.rmtree(folder)
    folder.mkdir()
    for name, data in left.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)


def _digest(after: dict[str, bytes]) -> str:
    return hashlib.sha256(b"".join(name.encode() + data for name, data in after.items() if ".part" not in name)).hexdigest()[:16]


def _begin(world: Workbench) -> Any:
    async def begun(words: list[str], folder: Path, environment: Any) -> Played:
        del words, folder, environment
        world.played.append(Played(1000 + len(world.played)))
        world.played[-1].stubborn = bool(world.rng.random() < 0.2)
        return world.played[-1]

    return begun


async def _served(world: Workbench, folder: Path) -> None:
    """Serve two pages of one folder: begin jobs, let them write, type, cancel and end them, until the seed has no more, or a kill."""
    asyncio.get_running_loop().set_exception_handler(lambda loop, about: None)  # tasks of a server that was killed
    servers = [Jobs(folder), Jobs(folder)]
    looking: list[asyncio.Task[None]] = []

    async def look(server: Jobs, job: Job) -> None:
        async for event in server.watch(job):
            if world.left is None:  # a killed server reports nothing
                world.told[job.number].append(event)

    for _ in range(int(world.rng.integers(5, 60))):
        world.now += float(world.rng.choice([1.0, 60.0, -3600.0], p=[0.8, 0.15, 0.05]))
        server = servers[int(world.rng.random() < 0.2)]
        running, action = server.running(), world.rng.random()
        with contextlib.suppress(Killed):
            if action < 0.15 or not running:
                words = WORDS[int(world.rng.integers(len(WORDS)))]
                same = next((job for job in running if job.words == words), None)
                try:
                    job = await server.begin(list(words))
                except LMeasureError:
                    if not world.disk:
                        world.wrong.append("refused without a fault")
                    if not world.played[-1].killed and world.played[-1].pid not in [1000 + n for n in range(len(world.begun))]:
                        world.wrong.append("a process works for a job that nobody knows of")
                    continue
                if same is not None and job is not same:
                    world.wrong.append("the same words began twice")
                if same is None:
                    if job.number in world.begun:
                        world.wrong.append(f"two jobs have the number {job.number}")
                    world.begun[job.number], world.told[job.number] = job, []
                    looking.append(asyncio.create_task(look(server, job)))
            else:
                job = running[int(world.rng.integers(len(running)))]
                process: Any = job.process
                if process.ended:
                    pass
                elif action < 0.6:
                    line = LINES[int(world.rng.integers(len(LINES)))]
                    process.stderr.feed_data(line.encode("utf-8", "surrogatepass") + b"\n")
                elif action < 0.7:
                    await server.type(job, "yes\u2029")
                elif action < 0.8:
                    await server.cancel(job)
                else:
                    process.end(int(world.rng.choice([0, 1, 3, 130])), bytes(world.rng.choice([b'{"summary": []}', b"", b"{torn"])))
        for _ in range(20):
            await asyncio.sleep(0)
        if world.left is not None:
            break
    else:
        for server in servers:
            await server.close()
        for _ in range(50):
            await asyncio.sleep(0)
    for task in [one for one in asyncio.all_tasks() if one is not asyncio.current_task()]:
        task.cancel()
    await asyncio.gather(*looking, return_exceptions=True)


def _judged(world: Workbench, folder: Path) -> Iterator[str]:
    """Compare what another server finds with what was told."""
    found = Jobs(folder)
    if world.left is None and (left := [name for name in content(folder) if ".part" in name]):
        yield f"left: {left}"
    whole = not world.disk or world.left is not None
    for number, job in world.begun.items():
        other = found.jobs.get(number)
        if other is None:
            yield f"job {number} was begun, and is not there"
            continue
        if other.words != job.words or other.state == RUNNING:
            yield f"job {number}: {other.words}, {other.state}"
        told = [event for event in world.told[number] if event.get("event") not in (*PASSING, "end")]
        said = [_plain(event) for event in other.said]
        missing = [event for event in map(_plain, told) if event not in said]
        if missing and whole:
            yield f"job {number}: {len(missing)} lines were told and are not there: {missing[0][:60]}"
        if world.left is None and [one for one in said if one not in list(map(_plain, job.said))]:
            yield f"job {number}: lines that nobody said"
        for event in world.told[number]:
            if event.get("event") == "end" and whole and other.state != event["state"]:
                yield f"job {number} ended {event['state']}, and is {other.state}"
    if world.left is None and (extra := sorted(set(found.jobs) - set(world.begun))):
        yield f"jobs {extra} were not begun"


def _plain(event: dict[str, Any]) -> str:
    return json.dumps(event, sort_keys=True, ensure_ascii=False).encode("utf-8", "replace").decode()


async def _again(folder: Path) -> list[str]:
    """Begin a job with another server, and let it end."""
    server = Jobs(folder)
    job = await server.begin(["verify", "again"])
    process: Any = job.process
    process.end(0)
    for _ in range(50):
        await asyncio.sleep(0)
    return [] if Jobs(folder).jobs[job.number].state == "done" else ["a further job does not end"]


# --- a store


def stored(world: Workbench, folder: Path) -> Outcome:
    """Keep results in a store while the disk fails or the process is killed; a further batch comes to the same results."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    results = {
        f"robot=r{n % 3}/item{n}": {f"{k}.txt": world.rng.bytes(int(world.rng.integers(1, 300))) for k in range(1 + n % 3)}
        for n in range(12)
    }
    ended = "complete"
    for attempt in range(2):
        with failing_disk(world, folder) if attempt == 0 else contextlib.nullcontext():
            try:
                for name, files in results.items():
                    _keep(folder, name, files, again=attempt == 1 and bool(world.rng.random() < 0.5))
            except Killed:
                ended = "killed"
            except OSError as error:
                ended = f"refused: {error.strerror}"
        if world.left is not None and attempt == 0:
            _lay(world.left, folder)
        catalogue = Catalogue(str(folder / "catalogue.sqlite"))
        store = Store(str(folder))
        for one in catalogue.outcomes():
            if store.digest(one.output) != one.sha256:
                world.wrong.append(f"{one.name} is done, and has other bytes")
        for name, files in results.items():
            place = folder / name
            if place.exists() and content(place) != files:
                world.wrong.append(f"{name} is not whole")
        catalogue.close()
    if any(content(folder / name) != files for name, files in results.items()):
        world.wrong.append("the second batch has other results")
    Store(str(folder)).swept()
    after = {name: data for name, data in content(folder).items() if "sqlite" not in name}
    return Outcome(world.seed, ended, 0.0, _digest(after), world.faults, len(results), world.wrong)


def _keep(folder: Path, name: str, files: dict[str, bytes], *, again: bool) -> None:
    """Make a result and keep it, unless it is there."""
    store, catalogue = Store(str(folder)), Catalogue(str(folder / "catalogue.sqlite"))
    robot, _, item = name.partition("/")
    try:
        known = next((one for one in catalogue.outcomes() if one.item == (robot, "d", item)), None)
        if known is not None and not again and store.digest(name) == known.sha256:
            return
        with store.scratch() as scratch:
            made = scratch / "made"
            made.mkdir()
            for file, data in files.items():
                (made / file).write_bytes(data)
            store.keep(made, name)
        catalogue.add([Kept("verify", robot, "d", item, "done", output=name, sha256=store.digest(name))])
    finally:
        catalogue.close()
