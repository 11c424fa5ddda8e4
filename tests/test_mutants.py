"""The command that puts faults into the core: what it changes, and that what it excuses is still there."""

import importlib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def mutants() -> Iterator[ModuleType]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "benchmarks")
        yield importlib.import_module("mutants")


SOURCE = '''"""Words - and - more."""
def f(a: int, b: float = 2.0) -> int:
    """Not + this."""
    if not a > 1 and b:  # > or <
        a -= 2
    x[0] = a ** 2 - (b) / 3
    return f"{a + 1}" if a is None else -a + True
'''


def test_one_fault_at_a_time(mutants: ModuleType) -> None:
    found = mutants.mutants_of("f.py", SOURCE)
    assert Counter((m.line, m.change) for m in found) == Counter(
        [
            (2, "2.0 -> 3.0"), (4, "not a > 1 and b -> (not (not a > 1 and b))"), (4, "not -> "), (4, "and -> or"), (4, "> -> >="),
            (4, "> -> <="), (4, "1 -> 2"), (5, "-= -> +="), (5, "2 -> 3"), (6, "x[0] = a ** 2 - (b) / 3 -> pass"), (6, "0 -> 1"),
            (6, "** -> *"), (6, "2 -> 3"), (6, "- -> +"), (6, "/ -> *"), (6, "3 -> 4"), (7, "a is None -> (not (a is None))"),
            (7, "is -> is not"), (7, "- -> "), (7, "+ -> -"), (7, "True -> False"),
        ]
    )  # fmt: skip
    for m in found:
        changed = m.applied(SOURCE)
        assert changed != SOURCE
        assert [i for i, (a, b) in enumerate(zip(SOURCE.split("\n"), changed.split("\n"), strict=True), 1) if a != b] == [m.line]
    assert len({m.applied(SOURCE) for m in found}) == len(found)


def test_what_is_excused_is_there(mutants: ModuleType) -> None:
    """A line that was changed since is looked at again."""
    excused = mutants.equivalents()
    assert excused
    for file in {file for file, _, _ in excused}:
        assert file in mutants.CORE
        keys = {m.key for m in mutants.mutants_of(file, (ROOT / "lmeasure" / file).read_text(encoding="utf-8"))}
        assert {key for key in excused if key[0] == file} <= keys
    assert all(why.strip() for why in excused.values())


def test_files_and_their_tests_are_there(mutants: ModuleType) -> None:
    for file, tests in mutants.CORE.items():
        assert (ROOT / "lmeasure" / file).is_file()
        for name, _, function in (test.partition("::") for test in tests if test.startswith("tests/")):
            assert f"def {function}" in (ROOT / name).read_text(encoding="utf-8")
