"""Faults put into a file of the program, one at a time, and whether its tests see them, for `mutants.py`.

Tests are collected once. For each fault the process is forked, the functions that it changes get their new code where they are, whoever
holds them, caches are emptied, and the tests run: first those that pass the fault's statement, the shortest before others, then the others
of their files; of a few faults, for which it does not pay to look first what each test passes, all in their order. A fault outside of
functions, and one that no test sees in a statement that collecting passes, is put into the file as it is imported, which takes the second
or two that collecting takes. Kernels are not compiled. Nothing is written into the
project.
"""

import ast
import gc
import hashlib
import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import inspect
import json
import math
import os
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from functools import cache, cached_property, partial
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any, NamedTuple

import coverage
import pytest
from mutations import Mutant

ROOT = Path(__file__).parents[1]
MOST_MEMORY = 8 << 30
RECORDED_FROM = 4
"""Faults from which it pays to look first which lines each test passes."""
LIMIT_S = 900.0
WAITED = 8.0
"""Times a limit, which counts what a fork calculates, that one is waited for: a machine that is busy with other things hides no fault."""
IMPORTED = ""
"""In place of a test: lines that are passed while files are imported."""
_Cache = type(cache(lambda: None))
SEEN, UNSEEN, OUTSIDE, BROKEN = range(10, 14)
"""How a fork ends: a test failed; none did; the fault is not in a function that could be exchanged; this program erred itself."""


class Passed(NamedTuple):
    """What tests pass of a file: by line those that do, and how long [s] each takes."""

    lines: dict[str, list[str]]
    seconds: dict[str, float]

    def near(self, mutant: Mutant, text: str) -> list[str]:
        """The tests that pass a fault's statement, the shortest first; all where it is passed in importing."""
        tests = {test for line in _lines(mutant, text) for test in self.lines.get(str(line), ())}
        return self.sorted(set(self.seconds) if IMPORTED in tests else tests)

    def sorted(self, tests: set[str]) -> list[str]:
        """The shortest first."""
        return sorted(tests, key=lambda test: self.seconds[test])

    @property
    def limit_s(self) -> float:
        """Within which a fault must let the tests end."""
        return 20.0 + 5.0 * sum(self.seconds.values())


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


def try_all(mutants: list[Mutant], tests: list[str], *, keep: Path | None, tell: Callable[[Mutant, bool], None]) -> None:
    """Tell of faults of one file, as soon as it is known, whether tests see each. keep: a folder for what tests pass. SystemExit where
    the tests do not pass without a fault."""
    file, plain = ROOT / "lmeasure" / mutants[0].file, mutants[0].file.startswith("kernels/")
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "reported"
        out.touch()
        known = _kept_of(keep or Path(folder), file, tests, plain)
        child = _forked(lambda: _pytest(tests, plain, plugin=_Trials(file, mutants, known, out)))
        done, read, outside = False, 0, []
        while not done:
            done = os.waitpid(child, os.WNOHANG)[0] == child
            written = out.read_text(encoding="utf-8")
            lines = written[: written.rfind("\n") + 1].splitlines()
            for line in lines[read:]:
                number, end = json.loads(line)
                if end == OUTSIDE:
                    outside.append(mutants[number])
                else:
                    tell(mutants[number], end == SEEN)
            read = len(lines)
            time.sleep(0.05)
        if read < len(mutants):
            raise SystemExit(f"tests do not pass without a fault: {' '.join(tests)}")
        for mutant in outside:
            near, limit_s = tests, LIMIT_S
            if known.exists():
                passed = Passed(*json.loads(known.read_text(encoding="utf-8")))
                near, limit_s = passed.near(mutant, file.read_text(encoding="utf-8")), passed.limit_s
            tell(mutant, bool(near) and _end(_forked(partial(_pytest, near, plain, mutant=mutant)), limit_s) != UNSEEN)


def _kept_of(folder: Path, file: Path, tests: list[str], plain: bool) -> Path:
    """Where is kept what the tests pass of a file, until one of them, or anything of the program, is changed."""
    digest = hashlib.sha256(f"{file} {tests} {plain}".encode())
    for path in sorted((ROOT / "lmeasure").rglob("*.py")):
        digest.update(path.read_bytes())
    for name in tests:
        path = ROOT / name.partition("::")[0]
        digest.update(path.read_bytes() if path.suffix == ".py" else b"")
    folder.mkdir(parents=True, exist_ok=True)
    return folder / f"passed-{digest.hexdigest()[:16]}.json"


def _forked(run: Callable[[], int]) -> int:
    """The process that runs it, in a group of its own, and ends with what it gives; what it prints is not heard."""
    child = os.fork()
    if child:
        return child
    code = BROKEN
    try:
        os.setsid()
        quiet = os.open(os.devnull, os.O_WRONLY)
        os.dup2(quiet, 1)
        os.dup2(quiet, 2)
        code = run()
    finally:
        os._exit(code)


def _end(child: int, limit_s: float) -> int:
    """How a fork ends; what hangs, or ends by itself, is seen."""
    resource.prlimit(child, resource.RLIMIT_CPU, (math.ceil(limit_s), math.ceil(limit_s) + 5))
    until = time.monotonic() + WAITED * limit_s
    while time.monotonic() < until:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            code = os.waitstatus_to_exitcode(status)
            if code == BROKEN:
                raise SystemExit("a fork could not run its tests")
            return code if code in (UNSEEN, OUTSIDE) else SEEN
        time.sleep(0.002)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return SEEN


def _pytest(tests: list[str], plain: bool, *, plugin: Any = None, mutant: Mutant | None = None) -> int:
    """Run tests in this process, by the plugin, or with a fault that is put into its file as it is imported."""
    resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, MOST_MEMORY))
    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT))
    with tempfile.TemporaryDirectory() as folder:
        os.environ |= {"HYPOTHESIS_STORAGE_DIRECTORY": folder, "PYTHONPATH": str(ROOT)}
        if plain:
            os.environ["NUMBA_DISABLE_JIT"] = "1"
        sys.dont_write_bytecode = True
        if mutant is not None:
            sys.meta_path.insert(0, _Finder(mutant))
        options = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "--hypothesis-seed=0"]
        code = int(pytest.main([*options, *tests], plugins=[] if plugin is None else [plugin]))
    return UNSEEN if code == pytest.ExitCode.OK else SEEN


class _Finder(importlib.abc.MetaPathFinder):
    """Imports a file with a fault in it."""

    def __init__(self, mutant: Mutant) -> None:
        self.mutant = mutant
        parts = ("lmeasure", *mutant.file.removesuffix(".py").split("/"))
        self.name = ".".join(parts)

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> importlib.machinery.ModuleSpec | None:
        """Of that file alone."""
        if name != self.name:
            return None
        file = str(ROOT / "lmeasure" / self.mutant.file)
        return importlib.util.spec_from_file_location(name, file, loader=_Loader(self.mutant, name, file))


class _Loader(importlib.machinery.SourceFileLoader):
    def __init__(self, mutant: Mutant, name: str, file: str) -> None:
        super().__init__(name, file)
        self.mutant = mutant

    def get_code(self, fullname: str) -> CodeType:
        return compile(self.mutant.applied(Path(self.path).read_text(encoding="utf-8")), self.path, "exec")


class _Trials:
    """A plugin of pytest that runs what was collected once for each fault, in a fork."""

    def __init__(self, file: Path, mutants: list[Mutant], known: Path, out: Path) -> None:
        self.file, self.mutants, self.known, self.out = file, mutants, known, out
        self.recorder = None if known.exists() else _Recorder(file)

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        if session.testsfailed:
            raise session.Interrupted("not collected")
        items = {item.nodeid: item for item in session.items}
        passed, text, collecting = None, self.file.read_text(encoding="utf-8"), set[str]()
        if self.recorder is not None:
            recorder, known = self.recorder, self.known
            if len(self.mutants) >= RECORDED_FROM and _end(_forked(lambda: recorder.record(list(items.values()), known)), 3600.0) != UNSEEN:
                raise session.Interrupted("tests do not pass without a fault")
            recorder.coverage.stop()
            collecting = set(recorder.lines())
        if self.known.exists():
            passed = Passed(*json.loads(self.known.read_text(encoding="utf-8")))
            collecting = {line for line, tests in passed.lines.items() if IMPORTED in tests}
        sound: set[str] = set()
        name = ".".join(("lmeasure", *self.file.relative_to(ROOT / "lmeasure").with_suffix("").parts))
        for number, mutant in enumerate(self.mutants):
            order, limit_s = list(items), LIMIT_S
            if passed is not None:
                near, limit_s = passed.near(mutant, text), passed.limit_s
                files = {test.partition("::")[0] for test in near}
                order = near + passed.sorted({test for test in passed.seconds if test.partition("::")[0] in files} - set(near))
            end, failed = UNSEEN, self.out.with_name("failed")
            failed.write_text("", encoding="utf-8")
            if order:
                some = [items[test] for test in order]
                end = _end(_forked(partial(_tried, mutant, name, text, some, failed)), limit_s)
            if end == UNSEEN and collecting.intersection(map(str, _lines(mutant, text))):
                end = OUTSIDE
            test = failed.read_text(encoding="utf-8")
            if passed is None and end == SEEN and test and test not in sound:
                if _end(_forked(partial(_run, [items[test]], failed)), limit_s) != UNSEEN:
                    raise session.Interrupted("tests do not pass without a fault")
                sound.add(test)
            with self.out.open("a", encoding="utf-8") as out:
                out.write(json.dumps([number, end]) + "\n")
        return True


def _tried(mutant: Mutant, name: str, text: str, items: list[pytest.Item], failed: Path) -> int:
    """Whether the tests, run one after the other until one fails, see a fault."""
    module = importlib.import_module(name)  # it may be imported by a test only
    before, after = (compile(t, str(module.__file__), "exec") for t in (text, mutant.applied(text)))
    held = {(f.__qualname__, f.__code__.co_firstlineno): f for f in _functions(vars(module), module.__name__)}
    changed = list(_changed(before, after, held))
    if None in changed or not changed:
        return OUTSIDE
    for function, code in filter(None, changed):
        function.__code__ = code
    gc.unfreeze()  # which hides what is frozen from the next line
    for one in gc.get_objects():
        if isinstance(one, _Cache) and one.__module__.partition(".")[0] == "lmeasure":
            one.cache_clear()
    gc.freeze()
    return _run(items, failed)


def _run(items: list[pytest.Item], failed: Path) -> int:
    """Until one fails, which is told, or breaks what runs it, as memory that is out does."""
    try:
        for item, after in zip(items, [*items[1:], None], strict=True):
            failed.write_text(item.nodeid, encoding="utf-8")
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=after)
            if item.session.testsfailed:
                return SEEN
    except BaseException:
        return SEEN
    return UNSEEN


def _functions(names: Mapping[str, Any], module: str) -> Iterator[FunctionType]:
    """Functions of a module or of a class of it, whatever they are wrapped in."""
    for value in list(names.values()):
        yield from (one for one in _unwrapped(value) if one.__module__ == module)
        if inspect.isclass(value) and value.__module__ == module:
            yield from _functions(vars(value), module)


def _unwrapped(value: Any) -> Iterator[FunctionType]:
    """The functions that something holds."""
    if isinstance(value, FunctionType):
        yield value
    held = (value.fget, value.fset) if isinstance(value, property) else (value.func,) if isinstance(value, cached_property) else ()
    for one in (*held, getattr(value, "__func__", None), getattr(value, "__wrapped__", None)):
        if one is not None:
            yield from _unwrapped(one)


def _changed(
    before: CodeType, after: CodeType, held: dict[tuple[str, int], FunctionType]
) -> Iterator[tuple[FunctionType, CodeType] | None]:
    """Functions that are changed, with their new code; None for what is not in one."""
    if _own(before) != _own(after):
        yield None
        return
    for a, b in zip(_parts(before), _parts(after), strict=True):
        if _all(a) != _all(b):
            function = held.get((a.co_qualname, a.co_firstlineno))
            if function is not None and len(function.__code__.co_freevars) == len(b.co_freevars):
                yield function, b
            elif "." not in a.co_qualname and a.co_name[:1].isupper():  # the body of a class
                yield from _changed(a, b, held)
            else:
                yield None


def _parts(code: CodeType) -> list[CodeType]:
    return [c for c in code.co_consts if isinstance(c, CodeType)]


def _own(code: CodeType) -> tuple[Any, ...]:
    """What a code is, but for its lines and what is within."""
    constants = tuple((type(c), repr(c)) for c in code.co_consts if not isinstance(c, CodeType))
    return code.co_code, code.co_names, code.co_varnames, constants


def _all(code: CodeType) -> tuple[Any, ...]:
    return (*_own(code), *(_all(part) for part in _parts(code)))


class _Recorder:
    """Tells which lines of a file each test passes, and how long it takes."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self.seconds: dict[str, float] = {}
        self.coverage = coverage.Coverage(data_file=None, include=[str(file)], config_file=False)
        self.coverage.start()

    def record(self, items: list[pytest.Item], out: Path) -> int:
        """Run the tests; whether all pass."""
        for item, after in zip(items, [*items[1:], None], strict=True):
            began = time.perf_counter()
            self.coverage.switch_context(item.nodeid)
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=after)
            self.coverage.switch_context(IMPORTED)
            self.seconds[item.nodeid] = time.perf_counter() - began
            if item.session.testsfailed:
                return SEEN
        self.coverage.stop()
        out.write_text(json.dumps([self.lines(), self.seconds]), encoding="utf-8")
        return UNSEEN

    def lines(self) -> dict[str, list[str]]:
        """Tests that passed each line so far."""
        found = self.coverage.get_data().contexts_by_lineno(str(self.file))
        return {str(line): tests for line, tests in found.items()}
