"""A copy of the project in which faults are put, one at a time, and in which tests are run, for `mutants.py`."""

import ast
import hashlib
import json
import os
import resource
import shutil
import signal
import sys
import time
from collections.abc import Generator
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import coverage
import pytest
from mutations import Mutant

ROOT = Path(__file__).parents[1]
MOST_MEMORY = 8 << 30
IMPORTED = ""
"""In place of a test: lines that are passed while files are imported."""


class Passed(NamedTuple):
    """What tests pass: by file of the package and line those that do, and how long [s] each takes."""

    lines: dict[str, dict[str, list[str]]]
    seconds: dict[str, float]

    def of(self, mutant: Mutant, text: str) -> list[str]:
        """The tests that pass a fault's statement, the shortest first; all where it is passed in importing."""
        lines = self.lines.get(mutant.file, {})
        tests = {test for line in _lines(mutant, text) for test in lines.get(str(line), ())}
        return sorted(self.seconds if IMPORTED in tests else tests, key=lambda test: self.seconds[test])


def _lines(mutant: Mutant, text: str) -> range:
    """Lines of the innermost statement around a fault, of a compound one those of its head."""
    found = range(mutant.line, mutant.line + 1)
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.stmt) and node.end_lineno and node.lineno <= mutant.line <= node.end_lineno:
            body = getattr(node, "body", None)
            last = body[0].lineno - 1 if body else node.end_lineno
            if mutant.line <= last:
                found = range(node.lineno, max(last, node.lineno) + 1)
    return found


class _Recorder:
    """A plugin of pytest that tells which lines each test passes, and how long it takes."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.seconds: dict[str, float] = {}
        self.coverage = coverage.Coverage(data_file=None, include=[f"{root}/lmeasure/*"], config_file=False)
        self.coverage.start()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, Any, Any]:
        self.coverage.switch_context(item.nodeid)
        try:
            return (yield)
        finally:
            self.coverage.switch_context(IMPORTED)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.seconds[report.nodeid] = self.seconds.get(report.nodeid, 0.0) + report.duration

    def write(self, path: Path) -> None:
        self.coverage.stop()
        data, package = self.coverage.get_data(), self.root / "lmeasure"
        lines = {str(Path(name).relative_to(package)): data.contexts_by_lineno(name) for name in data.measured_files()}
        path.write_text(json.dumps([lines, self.seconds]), encoding="utf-8")


class _Failure:
    """A plugin of pytest that tells which test failed."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self.path.write_text(report.nodeid, encoding="utf-8")


class Copy:
    """A copy of the project in which faults are put."""

    def __init__(self, folder: Path, quick: bool) -> None:
        self.quick = quick
        """Whether kernels are compiled without being optimised, since they are compiled often."""
        self.root = folder / "project"
        self.kept = folder / "kept"
        shutil.rmtree(self.root, ignore_errors=True)
        shutil.copytree(ROOT, self.root, ignore=shutil.ignore_patterns(".git", ".venv", "__pycache__", "*.egg-info", ".*_cache", "build"))
        self.kept.mkdir(exist_ok=True)
        self._failed = self.kept / "failed.txt"
        package = [p.read_bytes() for p in sorted((self.root / "lmeasure").rglob("*.py"))]
        self._package = hashlib.sha256(b"".join(package)).hexdigest()

    def runs(self, tests: list[str], limit_s: float, *, plain: bool = False, record: Path | None = None) -> bool:
        """Whether the tests pass in time, in a fork of this process, which has loaded all libraries and nothing of the project. plain:
        nothing is compiled; record: the file that is to tell what they pass."""
        self._failed.unlink(missing_ok=True)
        child = os.fork()
        if not child:
            os.setsid()
            self._become_pytest(tests, plain, record)
        until = time.monotonic() + limit_s
        while time.monotonic() < until:
            done, status = os.waitpid(child, os.WNOHANG)
            if done:
                return os.waitstatus_to_exitcode(status) == 0
            time.sleep(0.02)
        os.killpg(child, signal.SIGKILL)
        os.waitpid(child, 0)
        return False

    def _become_pytest(self, tests: list[str], plain: bool, record: Path | None) -> NoReturn:
        code = 1
        try:
            quiet = os.open(os.devnull, os.O_WRONLY)
            os.dup2(quiet, 1)
            os.dup2(quiet, 2)
            resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, MOST_MEMORY))
            os.chdir(self.root)
            os.environ |= {"PYTHONPATH": str(self.root), "PYTHONDONTWRITEBYTECODE": "1", "XDG_CACHE_HOME": str(self.kept)}
            os.environ |= {"NUMBA_DISABLE_JIT": "1"} if plain else {"NUMBA_OPT": "0"} if self.quick else {}
            sys.dont_write_bytecode = True
            sys.path[0] = str(self.root)
            options = ["-x", "-q", "-p", "no:cacheprovider", "--hypothesis-seed=0", "-W", "ignore:Cannot cache compiled"]
            recorder = _Recorder(self.root) if record else None
            code = int(pytest.main([*options, *tests], plugins=[recorder] if recorder else [_Failure(self._failed)]))
            if record and recorder and code in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED):
                recorder.write(record)
                code = 0
        finally:
            os._exit(code)

    def passed(self, tests: list[str], longest_s: float, *, plain: bool = False) -> Passed:
        """What the tests pass without a fault, kept file by file; SystemExit where they fail or take longer than that."""
        end = tests.index("-k") if "-k" in tests else len(tests)
        lines: dict[str, dict[str, list[str]]] = {}
        seconds: dict[str, float] = {}
        for name in tests[:end]:
            some = [name, *tests[end:]]
            record = self._kept_of("passed", some, plain)
            if not record.exists() and not self.runs(some, longest_s, plain=plain, record=record):
                raise SystemExit(f"tests do not pass without a fault within {longest_s:g} s: {' '.join(some)}")
            found = Passed(*json.loads(record.read_text(encoding="utf-8")))
            seconds |= found.seconds
            for file, by_line in found.lines.items():
                for line, those in by_line.items():
                    lines.setdefault(file, {}).setdefault(line, []).extend(those)
        return Passed(lines, seconds)

    def failed(self) -> list[str]:
        """The test that failed in the last run."""
        return [line for line in self._failed.read_text(encoding="utf-8").splitlines() if line] if self._failed.exists() else []

    def _kept_of(self, what: str, tests: list[str], plain: bool) -> Path:
        """The file that keeps something of these tests until they or the package are changed."""
        known = hashlib.sha256(f"{self._package} {tests} {plain}".encode())
        for name in tests:
            path = self.root / name.partition("::")[0]
            known.update(path.read_bytes() if path.suffix == ".py" and path.is_file() else b"")
        return self.kept / f"{what}-{known.hexdigest()[:16]}.json"

    def killed(self, mutant: Mutant, tests: list[str], longest_s: float, *, plain: bool = False, recorded: bool = False) -> bool:
        """Whether the tests see the fault: they fail, and what failed passes without it. recorded: first those are run that pass its
        statement, then, for what is made once for several tests, all; of what is compiled it cannot be told."""
        path = self.root / "lmeasure" / mutant.file
        text = path.read_text(encoding="utf-8")
        ast.parse(mutant.applied(text))  # what is no Python is no fault
        if not recorded:
            if not self._seen(mutant, text, tests, longest_s, plain=plain):
                return False
            # where nothing failed, it was not in time, or nothing could be imported
            which = self.failed() or tests
            if not self.runs(which, longest_s, plain=plain):
                raise SystemExit(f"tests do not pass without a fault within {longest_s:g} s: {' '.join(which)}")
            return True
        passed = self.passed(tests, longest_s, plain=plain)
        near = passed.of(mutant, text)
        limit_s = 20.0 + 5.0 * sum(passed.seconds.values())
        if not near:
            return False
        return self._seen(mutant, text, near, limit_s, plain=plain) or (
            len(near) < len(passed.seconds) and self._seen(mutant, text, tests, limit_s, plain=plain)
        )

    def _seen(self, mutant: Mutant, text: str, tests: list[str], limit_s: float, *, plain: bool = False) -> bool:
        path = self.root / "lmeasure" / mutant.file
        before = {p.name for p in self._compiled()}
        try:
            path.write_text(mutant.applied(text), encoding="utf-8")
            return not self.runs(tests, limit_s, plain=plain)
        finally:
            path.write_text(text, encoding="utf-8")
            for folder in self._compiled() if self.quick else ():
                if folder.name not in before:
                    shutil.rmtree(folder)

    def _compiled(self) -> list[Path]:
        return list((self.kept / "lmeasure").glob("kernels-*"))
