"""No circles between files: whatever a file imports, at its top or inside a function, does not import that file, by any way round."""

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "lmeasure"


def modules_of(package: Path) -> dict[str, Path]:
    """Files of a package by module name."""
    names = {p: ".".join((package.name, *p.relative_to(package).with_suffix("").parts)) for p in sorted(package.rglob("*.py"))}
    return {name.removesuffix(".__init__"): path for path, name in names.items()}


def imports_of(name: str, text: str, modules: dict[str, Path]) -> set[str]:
    """Modules of the package that a module names in its imports, wherever in the file they stand; its own package is not one."""
    named: set[str] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            named |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}: imports are written in full here"
            # `from package import module` leads to the module, `from module import name` to the module that has the name
            whole = {f"{node.module}.{alias.name}" for alias in node.names}
            named |= {w if w in modules else str(node.module) for w in whole}
    return (named & set(modules)) - {name}


def graph_of(package: Path) -> dict[str, set[str]]:
    """Imported modules by importing module."""
    modules = modules_of(package)
    return {name: imports_of(name, path.read_text(encoding="utf-8"), modules) for name, path in modules.items()}


def test_no_circle_of_imports() -> None:
    graph = graph_of(PACKAGE)
    assert "lmeasure.kernels" in graph["lmeasure.sensors.lengths"]
    TopologicalSorter(graph).prepare()


def test_a_circle_closed_inside_a_function_is_seen(tmp_path: Path) -> None:
    package = tmp_path / "made"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "one.py").write_text("from made import two\n")
    (package / "two.py").write_text("def later():\n    from made.three import VALUE\n")
    (package / "three.py").write_text("import made.one\nVALUE = 1\n")
    with pytest.raises(CycleError, match="cycle"):
        TopologicalSorter(graph_of(package)).prepare()
