"""Jobs are forked from a process that has loaded what they need: as those that are begun alone, and nothing is shared by accident."""

import asyncio
import json
import os
import signal
import sys
from pathlib import Path

import pytest
from bench import until

from lmeasure.workbench import processes
from lmeasure.workbench.processes import Forked, begun, prepared

ENVIRONMENT = {"LMEASURE_EVENTS": "1", "LANGUAGE": "en", "PYTHONUNBUFFERED": "1", "PYTHONIOENCODING": "utf-8"}
INIT = ["init", "--template", "six-cables", "--json"]
PLAY = ["play", "rig.toml", "--json", "--bus"]


@pytest.fixture
def forks() -> None:
    """The prepared process of this one has loaded all."""
    prepared.want()
    until(prepared.ready)


async def outcome(words: list[str], folder: Path, **more: str) -> tuple[type, int, str, str]:
    """What a command was run by, its exit code and what it said, on standard output and error."""
    process = await begun(words, folder, os.environ | ENVIRONMENT | more)
    assert process.stdin is not None
    assert process.stdout is not None
    assert process.stderr is not None
    reported, said = await asyncio.gather(process.stdout.read(), process.stderr.read())
    return type(process), await process.wait(), reported.decode(), said.decode()


ASKED = (["init", "--template", "none"], "ru"), (INIT, "en"), (["zone", "rig.toml", "--x=1"], "en")


def test_a_forked_command_does_what_one_of_its_own_does(tmp_path: Path, forks: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Files, exit codes, both outputs, in both languages; the folder is the job's, and a library's name in it loads nothing."""
    seen = []
    for name in ("forked", "alone"):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "random.py").write_text("raise SystemExit('loaded from the project')")
        answers = [asyncio.run(outcome(words, folder, LANGUAGE=language)) for words, language in ASKED]
        assert {issubclass(answer[0], Forked) for answer in answers} == {name == "forked"}
        files = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
        seen.append(([(code, reported, said.replace("python -m ", "")) for _, code, reported, said in answers], files))
        monkeypatch.setattr(processes, "prepared", processes._Prepared())
    assert seen[0] == seen[1]
    assert [code for code, *_ in seen[0][0]] == [2, 0, 2]
    assert "Недопустимое значение" in seen[0][0][0][2]
    assert {"rig.toml", "drums.toml"} <= set(seen[0][1])


@pytest.fixture
def cells(tmp_path: Path, forks: None) -> Path:
    """A folder with a rig."""
    asyncio.run(outcome(INIT, tmp_path))
    return tmp_path


def signals(pid: int, which: str) -> bool:
    """Whether SIGINT is in a set of a process, SigIgn or SigCgt."""
    mask = next(line for line in Path(f"/proc/{pid}/status").read_text().splitlines() if line.startswith(which))
    return bool(int(mask.split()[1], 16) >> (signal.SIGINT - 1) & 1)


def test_forked_commands_hold_nothing_of_each_other(cells: Path) -> None:
    """Two at work: none has a descriptor of the other's, or of the process that forked them; each hears Ctrl-C, its own input's end, and
    what kills it."""

    async def both() -> None:
        one, other = [await begun([*PLAY, f"udp_multicast:239.74.7.{i}"], cells, os.environ | ENVIRONMENT) for i in (1, 2)]
        assert isinstance(one, Forked)
        assert isinstance(other, Forked)
        for process in (one, other):
            async for line in process.stderr:
                if json.loads(line)["event"] == "cell":
                    break
        held = [{entry.readlink() for entry in Path(f"/proc/{process.pid}/fd").iterdir()} for process in (one, other)]
        assert not {name for name in held[0] & held[1] if "pipe" in str(name) or "socket" in str(name)}, held
        assert [Path(f"/proc/{process.pid}/cwd").readlink() for process in (one, other)] == [cells] * 2
        assert [(signals(process.pid, "SigIgn"), signals(process.pid, "SigCgt")) for process in (one, other)] == [(False, True)] * 2
        one.stdin.close()
        assert await one.wait() in (0, 130)
        other.kill()
        assert await other.wait() == -signal.SIGKILL
        other.terminate()  # which has ended

    asyncio.run(both())


@pytest.mark.slow
def test_without_the_prepared_process_jobs_go_on(cells: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is killed while two work: one works on until its input ends, one until it is ended. The next is begun with nothing loaded."""
    quick = "from lmeasure.cli.app import fork_server as prepared; prepared.load = lambda: None; prepared.main()"
    monkeypatch.setattr(processes, "PREPARED", (sys.executable, "-c", quick))
    mine = processes._Prepared()
    monkeypatch.setattr(processes, "prepared", mine)
    mine.want()
    until(mine.ready)

    async def killed() -> None:
        one, other = [await begun([*PLAY, f"udp_multicast:239.74.7.{i}"], cells, os.environ | ENVIRONMENT) for i in (3, 4)]
        assert isinstance(one, Forked)
        assert isinstance(other, Forked)
        for process in (one, other):
            await process.stderr.readline()
        assert mine._process is not None
        mine._process.kill()
        mine._process.wait()
        one.stdin.close()
        assert await one.stdout.read()
        assert await one.wait() < 0  # nobody knows
        assert other.returncode is None
        other.terminate()
        assert await other.wait() < 0
        for process in (one, other):
            assert not Path(f"/proc/{process.pid}/cmdline").exists() or not Path(f"/proc/{process.pid}/cmdline").read_bytes()
        kind, code, reported, _ = await outcome(["init", "--list", "--json"], cells)
        assert kind is not Forked
        assert code == 0
        assert json.loads(reported)["command"] == "init"

    asyncio.run(killed())
    mine.end()
