"""Who is to run alone does, and whoever comes later waits for him."""

import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from alone import BEFORE_OTHERS, alone_or_beside, may_go_before, turn

fcntl = pytest.importorskip("fcntl")


def test_one_that_waits_to_be_alone_comes_before_later_ones(tmp_path: Path) -> None:
    reported: list[str] = []
    leave, first_is_in = threading.Event(), threading.Event()

    def first() -> None:
        with alone_or_beside(tmp_path, alone=False):
            first_is_in.set()
            leave.wait(30.0)
            reported.append("first out")

    def other(name: str, alone: bool) -> None:
        with alone_or_beside(tmp_path, alone):
            reported.append(f"{name} in")
        reported.append(f"{name} out")

    threads = [threading.Thread(target=first), threading.Thread(target=other, args=("alone", True))]
    threads[0].start()
    assert first_is_in.wait(30.0)
    with alone_or_beside(tmp_path, alone=False):
        reported.append("beside")  # two that need not be alone
    threads[1].start()
    while not _held(tmp_path / "gate.lock"):
        time.sleep(0.001)
    threads.append(threading.Thread(target=other, args=("later", False)))
    threads[2].start()
    leave.set()
    for thread in threads:
        thread.join(30.0)
    assert reported.index("beside") < reported.index("first out") < reported.index("alone in") < reported.index("later in")


def test_what_a_live_test_starts_goes_before_others_and_later_tests_do_not(tmp_path: Path) -> None:
    if not may_go_before():
        pytest.skip("may not go before others")
    usual = os.getpriority(os.PRIO_PROCESS, 0)
    with turn(tmp_path, live=True):
        started = subprocess.run([sys.executable, "-c", "import os; print(os.nice(0))"], capture_output=True, text=True, check=True)
    assert int(started.stdout) == BEFORE_OTHERS
    assert os.getpriority(os.PRIO_PROCESS, 0) == usual


def _held(path: Path) -> bool:
    with path.open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False
