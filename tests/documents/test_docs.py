"""The documents: their code runs, their commands print what they say they print, their links lead somewhere.

A ```python block is run, and what it prints must be the ```text block that follows it. A ```console block holds lines
`$ lmeasure ...`, each followed by what it prints; `...` stands for anything. The blocks of one file run in order in one folder that
has the project's data at its place.
"""

import contextlib
import doctest
import io
import pkgutil
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from lmeasure.cli.app import main
from lmeasure.cli.commands import command as command_of
from lmeasure.kernels import lanes, screw
from lmeasure.trajectory.faults import consistency, continuity, redundancy, rest_evidence, rests
from lmeasure.trajectory.reconstruction import screw_method
from lmeasure.workflows import COMMANDS

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
DATA = ("tests/authorities/truth", "tests/authorities/sealed", "tests/authorities/recordings-read", "datasets", "calibration")
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)#]+)(?:#[^)]*)?\)")


@dataclass(frozen=True)
class Block:
    kind: str
    text: str
    line: int


def blocks_of(page: Path) -> list[Block]:
    text = page.read_text(encoding="utf-8")
    return [Block(m[1], m[2], text.count("\n", 0, m.start()) + 2) for m in BLOCK.finditer(text)]


def assert_prints(where: str, expected: str, printed: str) -> None:
    __tracebackhide__ = True
    checker, flags = doctest.OutputChecker(), doctest.ELLIPSIS
    if not checker.check_output(expected, printed, flags):
        pytest.fail(f"{where}\n{checker.output_difference(doctest.Example('', expected), printed, flags)}", pytrace=False)


def printed_by(command: list[str]) -> str:
    """What a command prints. It runs here: starting Python and what it imports for each took longer than most commands do."""
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        patch.setattr("sys.argv", command)
        patch.setattr("sys.stdin", io.StringIO())  # nobody types
        with pytest.raises(SystemExit) as end:
            main()
    # progress goes to standard error too: only a failure's line is part of the page
    return out.getvalue() + (err.getvalue() if end.value.code else "")


def run_commands(block: Block, where: str) -> None:
    for command, expected in re.findall(r"^\$ (.*)\n((?:(?!\$ ).*\n)*)", block.text, re.MULTILINE):
        words = shlex.split(command)
        assert words[0] == "lmeasure", f"{where}: only lmeasure is run here, not {words[0]}"
        printed = printed_by(words)
        # most pages leave out the line that names the command to type next
        printed = printed if "next: " in expected else re.sub(r"^next: .*\n", "", printed, flags=re.MULTILINE)
        assert_prints(f"{where}: $ {command}", expected, printed)


START = ROOT / "docs" / "start.md"
ROLES = re.findall(r"^## (.+)$", START.read_text(encoding="utf-8"), re.MULTILINE)
PAGES_WITH_CODE = [p for p in PAGES if p != START and any(b.kind in {"python", "console"} for b in blocks_of(p))]


@pytest.mark.slow
@pytest.mark.parametrize("role", ROLES)
def test_the_commands_of_a_role_run_in_an_empty_folder(role: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    section = re.split(r"^## ", START.read_text(encoding="utf-8"), flags=re.MULTILINE)[1 + ROLES.index(role)]
    monkeypatch.chdir(tmp_path)
    commands = re.findall(r"^\$ (.*)$", section, re.MULTILINE)
    assert commands
    for command in commands:
        monkeypatch.setattr("sys.argv", shlex.split(command))
        with pytest.raises(SystemExit) as end:
            main()
        assert end.value.code == 0, command


@pytest.mark.parametrize("page", PAGES_WITH_CODE, ids=lambda p: p.name)
def test_code_and_commands_print_what_the_page_says(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for folder in DATA:
        if (ROOT / folder).exists():
            shutil.copytree(ROOT / folder, tmp_path / folder)
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": page.stem}
    blocks = blocks_of(page)
    for block, following in zip(blocks, [*blocks[1:], None], strict=True):
        where = f"{page.relative_to(ROOT)}, line {block.line}"
        if block.kind == "console":
            run_commands(block, where)
        elif block.kind == "python":
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed):
                exec(compile("\n" * (block.line - 1) + block.text, str(page), "exec"), names)
            expected = following.text if following is not None and following.kind == "text" else ""
            assert_prints(where, expected, printed.getvalue())


def test_the_tutorial_and_the_conventions_are_run() -> None:
    assert {"tutorial.md", "conventions.md"} <= {p.name for p in PAGES_WITH_CODE}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_every_command_line_names_a_command_and_options_that_there_are(page: Path) -> None:
    """Those too that no page shows the output of, in blocks of any kind and within lines."""
    text = page.read_text(encoding="utf-8")
    shown = [block.text for block in blocks_of(page) if block.kind != "python"] + re.findall(r"`([^`\n]+)`", BLOCK.sub("", text))
    for line in "\n".join(shown).replace("\\\n", " ").split("\n"):
        words = re.match(r"\s*(?:\$ )?(?:[A-Z_]+=\S+ )*(?:lmeasure|python3 run\.py) ([a-z][a-z-]*)(.*)", line)
        if words is None or words[1] in ("test", "docs"):  # of the launcher
            continue
        assert words[1] in COMMANDS, line
        known = (
            {option for parameter in command_of(words[1]).params for option in parameter.opts} | {"--help"} | command_of(words[1]).former
        )
        requested = set(re.findall(r"(?<!\S)--[a-z][\w-]*", words[2].partition(" #")[0]))
        assert requested <= known, f"{line}: {sorted(requested - known)}"


def test_pictures_are_those_of_the_program(tmp_path: Path) -> None:
    """Drawn again, they are the committed ones, up to a tenth of a pixel in any number (rounding of another machine)."""
    subprocess.run([sys.executable, str(ROOT / "docs" / "draw_pictures.py"), str(tmp_path)], check=True)
    number = re.compile(r"-?\d+(?:\.\d+)?")
    every = sorted(tmp_path.iterdir())
    assert [p.name for p in every] == sorted(p.name for p in (ROOT / "docs" / "images").glob("*.svg")) != []
    for drawn in every:
        new, old = (p.read_text(encoding="utf-8") for p in (drawn, ROOT / "docs" / "images" / drawn.name))
        assert number.sub("0", new) == number.sub("0", old)
        assert [float(x) for x in number.findall(new)] == pytest.approx([float(x) for x in number.findall(old)], abs=0.11)


CONSTANTS = {
    "faults.md": [
        f"{continuity.STEP_MM:g} mm for a cable that sticks and slips",
        f"({['', '', '', '', '', 'five'][int(continuity.RUSH)]} times the motion's acceleration)",
        f"one count for {continuity.STANDS_S:g} s",
        f"same attachment point moves by {continuity.STANDS_MM:g} mm",
        f"Return within {continuity.BRIDGED_S:g} s",
        f"{rest_evidence.BACK_COUNTS:g} counts, or three scatters of the others up to {rest_evidence.BACK_MM:g} mm",
        f"confirm its count within {consistency.BACK_MM:g} mm",
    ],
    "method.md": [f"cable change of more than {screw.STRIDE_MM:g} mm"],
    "trajectory.md": [
        f"reach {screw.TOLERANCE_MM:.0e} mm",
        f"Logs of {screw_method.COMPILING_PAYS:,} samples and more run in {lanes.WIDTH} lanes",
        f"From a worst pressure angle of {screw_method.NEARLY:g} degrees",
        f"no length moves by more than {rests.STILL_MM:g} mm in {rests.VISIT_LAG_S:g} s, for {rests.LEAST_S:g} s",
        f"all cables but one agree within {rests.NEAR_MM:g} mm",
        f"({rest_evidence.SIGNIFICANCE:.0e} per run, shared by all channels and moments)",
        f"by more than {redundancy.CLOSED_COUNTS:g} counts, {redundancy.CLOSED_MM:g} mm and",
    ],
}


@pytest.mark.parametrize("page", CONSTANTS)
def test_constants_are_those_of_the_program(page: str) -> None:
    text = " ".join((ROOT / "docs" / page).read_text(encoding="utf-8").split())
    for said in CONSTANTS[page]:
        # as written in a text: 1e-3
        assert re.sub(r"e-0+", "e-", said) in text


CITED = re.compile(r"\[([^\]]*\d[^\]]*)\]\(((?:\.\./)*(?:benchmarks/results/\w+|docs/tutorial)\.md)\)")


def cited(page: Path) -> list[tuple[str, Path]]:
    """Figures of a page that link to a page of results, or to the tutorial, which is run, as `[5 mm](docs/tutorial.md)`."""
    return [(" ".join(said.split()), page.parent / target) for said, target in CITED.findall(page.read_text(encoding="utf-8"))]


@pytest.mark.parametrize("page", [p for p in PAGES if cited(p)], ids=lambda p: str(p.relative_to(ROOT)))
def test_figures_that_link_to_results_stand_there(page: Path) -> None:
    """As they are written, or each of several by itself."""
    for said, results in cited(page):
        text = " ".join(results.read_text(encoding="utf-8").split())
        parts = [said] if said in text else re.split(", | to | and ", said)
        for part in parts:
            stands = re.search(rf"(?<![\w.,]){re.escape(part)}(?!\w|[.,]\d)", text)
            assert stands, f"{page.name}: {part} does not stand in {results.name}"


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_lead_to_files(page: Path) -> None:
    for target in LINK.findall(page.read_text(encoding="utf-8")):
        if not target.startswith(("http://", "https://")):
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_names_in_the_glossary_are_those_of_the_code() -> None:
    text = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
    names = re.findall(r"`(lmeasure(?:\.\w+)+)`", text)
    assert len(names) > 15
    for name in names:
        pkgutil.resolve_name(name)
