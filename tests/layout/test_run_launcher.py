"""run.py, the launcher: what it decides, that an interrupted set-up heals, and (slow) a real installation in a copy of the project."""

import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
NONE: frozenset[str] = frozenset()
TEST = frozenset({"test"})
EVERYWHERE = ["-n", str(min((os.cpu_count() or 1) + 1, 8)), "--dist", "worksteal"]


@pytest.fixture
def launcher(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """run.py as a module of a project in a folder of its own, without uv."""
    spec = importlib.util.spec_from_file_location("run_launcher", ROOT / "run.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    (tmp_path / "pyproject.toml").write_text("[project]\nname = 'lmeasure'\n")
    monkeypatch.setattr(module, "ROOT", tmp_path)
    monkeypatch.setattr(module, "VENV", tmp_path / ".venv")
    monkeypatch.setattr(module.shutil, "which", lambda name: None)
    return module


class Machine:
    """Stands in for the operating system: keeps the commands, and an environment that works once it was installed into."""

    def __init__(self, module: ModuleType, fail_at: str = "") -> None:
        self.module, self.fail_at = module, fail_at
        self.commands: list[list[str]] = []

    def call(self, command: list[str], **options: Any) -> int:
        self.commands.append(command)
        if self.fail_at and self.fail_at in command:
            return 1
        if "venv" in command:
            Path(command[-1]).mkdir(exist_ok=True)
        if "--editable" in command:
            (self.module.VENV / "installed").touch()
        return 0

    def works(self) -> bool:
        return (self.module.VENV / "installed").exists()

    @property
    def steps(self) -> list[str]:
        return ["venv" if "venv" in c else "uv" if c[-1] == "uv" else "install" for c in self.commands]


@pytest.fixture
def machine(launcher: ModuleType, monkeypatch: pytest.MonkeyPatch) -> Machine:
    it = Machine(launcher)
    monkeypatch.setattr(launcher.subprocess, "call", it.call)
    monkeypatch.setattr(launcher, "works", it.works)
    monkeypatch.setattr(launcher, "pip_settings", lambda pip: "")
    return it


@pytest.mark.parametrize(
    ("arguments", "extras", "command"),
    [
        ([], NONE, ["lmeasure", "demo"]),
        (["test"], TEST, ["pytest", *EVERYWHERE]),
        (["test", "-k", "wrap"], TEST, ["pytest", *EVERYWHERE, "-k", "wrap"]),
        (["test", "pyproject.toml"], TEST, ["pytest", "pyproject.toml"]),
        (["test", "-x", "pyproject.toml::test_a", "--pdb"], TEST, ["pytest", "-x", "pyproject.toml::test_a", "--pdb"]),
        (["calibrate", "folder", "--out", "test"], NONE, ["lmeasure", "calibrate", "folder", "--out", "test"]),
        (["--no-browser"], frozenset(), ["lmeasure", "demo", "--no-browser"]),
        (["--version", "--json"], frozenset(), ["lmeasure", "--version", "--json"]),
        (["docs", "--no-browser"], frozenset({"docs"}), ["python", "docs/build_site.py", "--no-browser"]),
        (["--help"], NONE, ["lmeasure", "--help"]),
        (["workbench", "cell"], frozenset({"workbench"}), ["lmeasure", "workbench", "cell"]),
    ],
)
def test_arguments(launcher: ModuleType, arguments: list[str], extras: frozenset[str], command: list[str]) -> None:
    requested, made = launcher.plan(arguments)
    assert (requested, [word.removeprefix(f"{launcher.ROOT}{os.sep}") for word in made]) == (extras, command)


def test_a_minute_of_tests_names_tests_that_there_are(launcher: ModuleType) -> None:
    extras, command = launcher.plan(["test", "-x", "--fast"])
    assert (extras, command) == (TEST, ["pytest", *EVERYWHERE, *launcher.FAST, "-x"])
    for file, _, function in (name.partition("::") for name in launcher.FAST):
        assert f"def {function}(" in (ROOT / file).read_text(encoding="utf-8") if function else (ROOT / file).exists()


def test_stamp_comes_back_and_anything_else_is_no_stamp(launcher: ModuleType, tmp_path: Path) -> None:
    path = tmp_path / "stamp.json"
    assert launcher.read_stamp(path) == {}
    launcher.write_stamp(path, launcher.identity(), TEST)
    assert launcher.read_stamp(path) == {**launcher.identity(), "extras": ["test"]}
    for text in ("", "{", "[]", "{}", '{"extras": 1}'):
        path.write_text(text)
        assert launcher.read_stamp(path) == {}


@pytest.mark.parametrize(
    ("change", "extras", "left"),
    [
        ({}, NONE, "nothing"), ({}, TEST, "install"), ({"pyproject": "other"}, NONE, "install"), ({"python": "3.99.0"}, NONE, "rebuild"),
        ({"folder": "/elsewhere"}, NONE, "rebuild"),
    ],
)  # fmt: skip
def test_what_is_left_to_do(launcher: ModuleType, change: dict[str, str], extras: frozenset[str], left: str) -> None:
    made_from = launcher.identity()
    assert launcher.todo({**made_from, "extras": []}, {**made_from, **change}, extras) == left
    assert launcher.todo({}, made_from, extras) == "rebuild"


def test_extras_are_added_and_kept(launcher: ModuleType, machine: Machine) -> None:
    launcher.set_up(NONE)
    launcher.set_up(TEST)
    assert machine.steps == ["venv", "uv", "install", "uv", "install"]
    assert machine.commands[-1][-1] == f"{launcher.ROOT}[test]"
    launcher.set_up(NONE)
    launcher.set_up(TEST)
    assert len(machine.commands) == 5
    (launcher.ROOT / "pyproject.toml").write_text("[project]\nname = 'lmeasure'\nversion = '2'\n")
    launcher.set_up(NONE)
    assert machine.commands[-1][-1] == f"{launcher.ROOT}[test]"


@pytest.mark.parametrize("fail_at", ["venv", "install"])
def test_interrupted_set_up_is_begun_again(launcher: ModuleType, machine: Machine, fail_at: str) -> None:
    machine.fail_at = fail_at
    with pytest.raises(launcher.SetUpError, match="exit 1"):
        launcher.set_up(NONE)
    assert not (launcher.VENV / "lmeasure-set-up.json").exists()
    machine.fail_at = ""
    machine.commands.clear()
    launcher.set_up(NONE)
    assert machine.steps == ["venv", "uv", "install"]


def replace_by_a_file(folder: Path) -> None:
    shutil.rmtree(folder)
    folder.touch()


@pytest.mark.parametrize(
    "damage",
    [
        lambda venv: (venv / "installed").unlink(),
        shutil.rmtree,
        replace_by_a_file,
        lambda venv: (venv / "lmeasure-set-up.json").write_text("{"),
    ],
)
def test_broken_environment_is_rebuilt(launcher: ModuleType, machine: Machine, damage: Callable[[Path], object]) -> None:
    launcher.set_up(NONE)
    damage(launcher.VENV)
    launcher.set_up(NONE)
    assert machine.steps == ["venv", "uv", "install"] * 2
    assert machine.works()


def test_uv_is_used_when_there(launcher: ModuleType, machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(launcher.shutil, "which", {"uv": "/opt/uv"}.get)
    launcher.set_up(TEST)
    environment, installation = machine.commands
    assert "--without-pip" in environment
    assert installation[:4] == ["/opt/uv", "pip", "install", "--python"]
    assert installation[-2:] == ["--editable", f"{launcher.ROOT}[test]"]


def test_failure_is_one_line(launcher: ModuleType, machine: Machine) -> None:
    machine.fail_at = "install"
    with pytest.raises(SystemExit, match=r"^run\.py: the installation failed \(exit 1\)[^\n]*$"):
        launcher.main([])
    (launcher.ROOT / "pyproject.toml").unlink()
    with pytest.raises(SystemExit, match=r"^run\.py: [^\n]*pyproject\.toml: No such file or directory$"):
        launcher.main([])


def test_an_older_python_is_told_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "version_info", (3, 10, 13, "final", 0))
    with pytest.raises(SystemExit, match=r"^run\.py: lmeasure needs Python 3\.11 or newer; this is Python 3\.10 [^\n]*$"):
        exec((ROOT / "run.py").read_text(encoding="utf-8"), {"__name__": "old"})


@pytest.mark.slow
def test_fresh_copy_installs_runs_and_repeats(tmp_path: Path) -> None:
    """A real installation, with the registry that pip is set to; then a repeat that installs nothing."""
    project = tmp_path / "project"
    ignored = shutil.ignore_patterns(".*", "*.egg-info", "tests", "__pycache__")
    shutil.copytree(ROOT, project, ignore=ignored)
    environment = {k: v for k, v in os.environ.items() if k != "VIRTUAL_ENV"}

    def run_py() -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "run.py", "--version"]
        return subprocess.run(command, cwd=project, env=environment, capture_output=True, text=True, check=True)

    first, second = run_py(), run_py()
    assert first.stdout == second.stdout
    assert first.stdout.startswith("lmeasure ")
    assert first.stderr.splitlines()[0] == "run.py: setting up lmeasure: about a minute the first time"
    assert len(first.stderr.splitlines()) == 2
    assert second.stderr == ""


def test_a_failed_step_shows_the_end_of_its_output(launcher: ModuleType, capfd: pytest.CaptureFixture[str]) -> None:
    launcher.VENV.mkdir()
    with pytest.raises(launcher.SetUpError, match=r"the installation failed \(exit 3\); all of its output is in .*set-up\.log"):
        launcher.call([sys.executable, "-c", "print(*range(100), sep='\\n'); raise SystemExit(3)"], "the installation")
    assert capfd.readouterr().err.split() == [str(n) for n in range(80, 100)]
    assert (launcher.VENV / "set-up.log").read_text().split() == [str(n) for n in range(100)]


def test_pip_installs_where_uv_cannot(launcher: ModuleType, machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(launcher, "pip_settings", lambda pip: ":env:.proxy='http://proxy'")
    launcher.set_up(NONE)
    assert machine.steps == ["venv", "install"]
    assert machine.commands[-1][1:4] == ["-m", "pip", "install"]


@pytest.mark.parametrize(
    ("settings", "options"),
    [
        ("", []),
        ("global.index-url='https://a/simple'\n:env:.timeout='60'", ["--index-url", "https://a/simple"]),
        ("global.constraint='/c.txt'\nglobal.find-links='/a /b'", ["--constraint", "/c.txt", "--find-links", "/a", "--find-links", "/b"]),
        ("global.extra-index-url='/a'", ["--extra-index-url", "/a", "--index-strategy", "unsafe-best-match"]),
        ("global.client-cert='/c.pem'", None),
    ],
)
def test_settings_of_pip_hold_for_uv(launcher: ModuleType, settings: str, options: list[str] | None) -> None:
    assert launcher.uv_options(settings) == options
