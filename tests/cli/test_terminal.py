"""`check` and `capture` on a terminal of their own, as a person sees them: a pty, drawn by a terminal emulator."""

import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from lmeasure.cli import progress as terminal
from lmeasure.io.tables import read_table
from lmeasure.rig import Rig, rig_from_dict, write_rig
from lmeasure.simulation import cell_rig

pty = pytest.importorskip("pty")
pyte = pytest.importorskip("pyte")
fcntl = pytest.importorskip("fcntl")
termios = pytest.importorskip("termios")

HERE = Path(__file__).parents[1]
from capture_bench import nominal_of, some_poses, write_inputs  # noqa: E402
from simulated_cell import Person, cell, exchanged  # noqa: E402

PATIENCE_S = 60.0


class Terminal:
    """A terminal of so many columns with a command on it; screen is what stands there, with what has gone off its top."""

    def __init__(self, words: list[str], folder: Path, columns: int, language: str) -> None:
        self.columns = columns
        self.screen = pyte.HistoryScreen(columns, 40, history=1000)
        self._stream, self._own = pyte.Stream(self.screen), pty.openpty()
        import struct

        fcntl.ioctl(self._own[1], termios.TIOCSWINSZ, struct.pack("HHHH", 40, columns, 0, 0))
        environment = os.environ | {"LANG": f"{language}.UTF-8", "LANGUAGE": "", "LC_ALL": "", "PYTHONUTF8": "1", "TERM": "xterm"}
        environment = {k: v for k, v in environment.items() if k not in {"COLUMNS", "LINES"}}

        def controlling() -> None:
            os.setsid()
            fcntl.ioctl(0, termios.TIOCSCTTY, 0)

        ends: dict[str, Any] = dict.fromkeys(("stdin", "stdout", "stderr"), self._own[1])
        self.process = subprocess.Popen(
            [sys.executable, "-m", "lmeasure", *words], cwd=folder, env=environment, preexec_fn=controlling, **ends
        )
        self.begun = self.modes()
        self.wide = self._error = False
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        import codecs

        decoder = codecs.getincrementaldecoder("utf-8")("replace")
        while True:
            try:
                part = os.read(self._own[0], 4096)
            except OSError:
                return
            for letter in decoder.decode(part):
                # a letter that is drawn when the line is full goes on to the next by itself; errors are one line, however long
                if self.screen.cursor.x >= self.columns and letter.isprintable():
                    self._error |= self.screen.display[self.screen.cursor.y].startswith("lmeasure: ")
                    self.wide |= not self._error
                self._stream.feed(letter)

    def modes(self) -> list[Any]:
        """How the terminal is set."""
        return list(termios.tcgetattr(self._own[1])[:4])

    def lines(self) -> list[str]:
        """All lines there have been, the state last."""
        gone = ["".join(row[x].data for x in range(self.columns)).rstrip() for row in list(self.screen.history.top)]
        return [*gone, *(line.rstrip() for line in self.screen.display if line.strip())]

    def text(self) -> str:
        """The same, each sentence whole."""
        return " ".join(" ".join(self.lines()).split())

    def until(self, text: str, times: int = 1) -> None:
        """Wait for a text."""
        end = time.monotonic() + PATIENCE_S
        while self.text().count(text) < times:
            assert time.monotonic() < end, f"{text!r} never came:\n" + "\n".join(self.lines())
            assert self.process.poll() is None or self.text().count(text) >= times, "\n".join(self.lines())
            time.sleep(0.05)

    def type(self, text: str) -> None:
        """As a person does, a letter after the other."""
        for letter in text:
            os.write(self._own[0], letter.encode())
            time.sleep(0.02)

    def close(self) -> int:
        """The exit code."""
        code = self.process.wait(PATIENCE_S)
        time.sleep(0.2)
        return code


@contextmanager
def on_terminal(words: list[str], folder: Path, columns: int, language: str) -> Iterator[Terminal]:
    shown = Terminal(words, folder, columns, language)
    try:
        yield shown
    finally:
        shown.process.kill()
        shown.process.wait()


def two_cables() -> Rig:
    data = cell_rig(3).to_dict()
    for point in data["observation_point"]:
        point["drum"]["max_cable_speed_mm_s"] = 1e6
    data["observation_point"], data["cable"] = data["observation_point"][:2], data["cable"][:2]
    return rig_from_dict(data)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[tuple[Person, list[str]]]:
    """A cell of two cables whose plugs are exchanged, as a command is told of its bus."""
    rig = two_cables()
    write_inputs(tmp_path, nominal_of(rig), some_poses(3))
    (tmp_path / "elsewhere").mkdir()
    write_rig(tmp_path / "elsewhere" / "rig.toml", rig_from_dict(exchanged(rig, 0, 1)))
    bus = {"channel": f"239.74.{random.randrange(1, 255)}.{random.randrange(1, 255)}", "port": random.randrange(20000, 60000)}
    reported = ["--bus", f"udp_multicast:{bus['channel']}", "--bus-option", f"port={bus['port']}"]
    with cell(
        tmp_path, tmp_path / "elsewhere" / "rig.toml", Path("planned.csv"), {"interface": "udp_multicast", "hop_limit": 0, **bus}
    ) as one:
        yield one, reported


def test_a_person_checks_and_captures_on_a_narrow_terminal(tmp_path: Path, bench: tuple[Person, list[str]]) -> None:
    person, bus = bench
    with on_terminal(["check", "--rig", "rig.toml", *bus, "--no-turns", "--write", "wired.toml"], tmp_path, 60, "en_GB") as shown:
        shown.until("Leave all cables at rest, then press Enter")
        shown.until("mm: ch1 +0.0")
        for cable in ("c1", "c2"):
            shown.until(f"Cable {cable} at")
            shown.until(f"Pull cable {cable} out by about 100 mm and hold it, then press Enter")
            person.do(f"Pull cable {cable} out")
            wrong, right = ("ch2", "ch1") if cable == "c1" else ("ch1", "ch2")
            shown.until(f"{wrong} moves instead of {right}")
            shown.until(f"{wrong} +100.0")  # it is seen by itself; a key that comes too late does no harm
            shown.until(f"Let cable {cable} return")
            person.do(f"Let cable {cable} return")
            shown.until(f"Cable {cable}: channel")
            time.sleep(0.6)
            shown.type("\r")
        assert shown.close() == 1
        assert shown.modes() == shown.begun
        assert not shown.wide, shown.lines()
        assert "c1 ch1 ch2 +1 100.0" in shown.text()
        assert "fault: cable c1: channel ch2 moved, but the rig has channel ch1" in shown.text()
    given = ["--poses", "planned.csv", *bus, "--out", "campaign", "--dwell-s", "0.3", "--settle-s", "0.1", "--by", "key"]
    with on_terminal(["capture", "wired.toml", *given], tmp_path, 60, "ru_RU") as shown:
        for answer in ("0\r", "nobody knows\r", "0\r", "\r"):  # what is no number is asked again
            shown.until("если неизвестно):")
            time.sleep(0.5)
            shown.type(answer)
        shown.until("поза 1 (1 из 3)")
        shown.until("покой")
        shown.type("\r")
        shown.until("считано: отсчётов")
        shown.until("поза 2 (2 из 3)")
        person.do("pose 2 (2 of 3)")
        shown.until("движение")
        shown.until("покой")
        time.sleep(1.0)
        shown.type("tak")  # what is typed stands at the end of the line that is renewed, and can be mended
        shown.until("> tak")
        shown.type("\x7f\x7fake\r")
        shown.until("поза 3 (3 из 3)")
        shown.type("undo\r")
        shown.until("отменено: считывание позы 2 (осталось 1)")
        shown.until("поза 2 (2 из 3)", times=2)
        shown.type("\r")
        shown.until("поза 3 (3 из 3)", times=2)
        os.kill(shown.process.pid, signal.SIGINT)  # what Ctrl-C sends
        assert shown.close() == 1
        assert shown.modes() == shown.begun
        assert not shown.wide, shown.lines()
        assert "Тажекомандапродолжит" in "".join(shown.text().split())
        # no state is left over behind the lines that stay
        assert not any("> " in line for line in shown.lines())
    assert list(dict.fromkeys(read_table(tmp_path / "campaign" / "counts.csv").text("pose"))) == ["1", "2"]


def test_no_line_is_wider_than_it_may_be() -> None:
    long = "  U95 by now: lengths 0.29 mm rms, 2.1 at worst (c2), position 0.62. 7 of 30 parameters still have their nominal value"
    lines = terminal.fitted(long, 40)
    assert all(len(line) <= 40 for line in lines)
    assert " ".join(line.strip() for line in lines) == long.strip()
    assert lines[0].startswith("  U95")
    assert lines[1].startswith("      ")
    assert terminal.fitted("a\n\nb", 40) == ["a", "", "b"]
    assert terminal.fitted("pose 1: x 5.9  y 225.2  z -177.9", 25) == ["pose 1: x 5.9  y 225.2", "    z -177.9"]
    assert all(len(line) <= 20 for line in terminal.fitted(f"{'x' * 50} y", 20))
    # half a number would be another number
    assert terminal.cut("ch1 +12345 ch2 +67890", 16) == "ch1 +12345 ch2…"
    assert terminal.cut("ch1 +12345 ch2 +67890", 11) == "ch1 +12345…"
    assert terminal.cut("ch1 +12345", 10) == "ch1 +12345"
