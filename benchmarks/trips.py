"""Follow one value through the code by static analysis: how many files a call passes, and how often it returns to one.

    python benchmarks/trips.py lmeasure.workflows.reconstruct:run [PACKAGE_FOLDER]

Calls are followed in the order of the source, each function once. A stay is an uninterrupted series of functions of one file; returns are
stays less files. Names are resolved through imports, faces (`__init__.pyi`) and re-exports; a method is followed where one class of the
package alone has it, or where a name is annotated with its class.
"""

import argparse
import ast
from collections import defaultdict
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path

Function = ast.FunctionDef | ast.AsyncFunctionDef
PACKAGE = Path(__file__).parents[1] / "lmeasure"


@dataclass
class Module:
    """Functions, classes and imports of a file."""

    name: str
    functions: dict[str, Function] = field(default_factory=dict)
    classes: dict[str, dict[str, Function]] = field(default_factory=dict)
    imports: dict[str, tuple[str, str]] = field(default_factory=dict)


def read_modules(package: Path) -> dict[str, Module]:
    """Parse every module; the stub of a face replaces its module's imports."""
    out = {}
    for path in sorted(package.rglob("*.py")):
        parts = path.relative_to(package.parent).with_suffix("").parts
        is_face = parts[-1] == "__init__"
        name = ".".join(parts[:-1] if is_face else parts)
        module = out[name] = Module(name)
        sources = [path, *([stub] if (stub := path.with_suffix(".pyi")).exists() else [])]
        for tree in (ast.parse(source.read_text(encoding="utf-8")) for source in sources):
            for node in tree.body:
                if isinstance(node, Function):
                    module.functions[node.name] = node
                if isinstance(node, ast.ClassDef):
                    module.classes[node.name] = {f.name: f for f in node.body if isinstance(f, Function)}
            for found in ast.walk(tree):
                if isinstance(found, ast.ImportFrom):
                    inside = f"{name}.{found.module}" if found.module else name
                    origin = inside if found.level else found.module or ""
                    module.imports.update({alias.asname or alias.name: (origin, alias.name) for alias in found.names})
    return out


class Trip:
    """The functions that a call reaches, in order."""

    def __init__(self, modules: dict[str, Module]) -> None:
        self.modules = modules
        self.owners: dict[str, list[tuple[Module, str]]] = defaultdict(list)
        for module in modules.values():
            for cls, methods in module.classes.items():
                for method in methods:
                    self.owners[method].append((module, cls))
        self.seen: set[int] = set()
        self.files: list[str] = []

    def resolve(self, module: str, name: str, depth: int = 8) -> tuple[Module, str] | str | None:
        """Find where a name is defined: module and name, or the dotted name of a module."""
        if module not in self.modules or not depth:
            return None
        home = self.modules[module]
        if name in home.functions or name in home.classes:
            return home, name
        if name in home.imports:
            found = self.resolve(*home.imports[name], depth - 1)
            if found is not None:
                return found
            whole = ".".join(home.imports[name])
            return whole if whole in self.modules else None
        return f"{module}.{name}" if f"{module}.{name}" in self.modules else None

    def enter(self, home: Module, function: Function) -> None:
        """Follow a function's calls, once."""
        if id(function) in self.seen:
            return
        self.seen.add(id(function))
        self.files.append(home.name)
        for node in ordered_calls(function):
            self.call(home, node.func)

    def call(self, home: Module, called: ast.expr) -> None:
        """Follow one call."""
        if isinstance(called, ast.Name):
            self.reach(self.resolve(home.name, called.id))
        elif isinstance(called, ast.Attribute):
            base = self.resolve(home.name, called.value.id) if isinstance(called.value, ast.Name) else None
            if isinstance(base, str):
                self.reach(self.resolve(base, called.attr))
            elif isinstance(base, tuple) and called.attr in base[0].classes.get(base[1], {}):
                self.enter(base[0], base[0].classes[base[1]][called.attr])
            elif len(owners := self.owners[called.attr]) == 1:
                module, cls = owners[0]
                self.enter(module, module.classes[cls][called.attr])

    def reach(self, found: "tuple[Module, str] | str | None") -> None:
        """Enter a function, or the constructor of a class."""
        if not isinstance(found, tuple):
            return
        home, name = found
        if name in home.functions:
            self.enter(home, home.functions[name])
        for method in ("__init__", "__post_init__"):
            if name in home.classes and method in home.classes[name]:
                self.enter(home, home.classes[name][method])


def ordered_calls(function: Function) -> list[ast.Call]:
    """Return the calls of a function in the order in which they are evaluated."""
    out: list[ast.Call] = []

    def visit(node: ast.AST) -> None:
        for child in ast.iter_child_nodes(node):
            visit(child)
        if isinstance(node, ast.Call):
            out.append(node)

    for statement in function.body:
        visit(statement)
    return out


def trip(start: str, package: Path = PACKAGE) -> tuple[int, int, int]:
    """Return files, stays and returns of a call "module:function"."""
    modules = read_modules(package)
    module, _, name = start.partition(":")
    way = Trip(modules)
    way.reach((modules[module], name))
    stays = [file for file, _ in groupby(way.files)]
    return len(set(stays)), len(stays), len(stays) - len(set(stays))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("start")
    parser.add_argument("package", nargs="?", type=Path, default=PACKAGE)
    asked = parser.parse_args()
    print("files {}, stays {}, returns {}".format(*trip(asked.start, asked.package)))
