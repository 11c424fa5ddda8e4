"""Follow one value through the code by static analysis: how many files a call passes, and how often it returns to one.

    python benchmarks/trips.py lmeasure.workflows.reconstruct:run_reconstruct [--value settings] [--package FOLDER] [--list]
    python benchmarks/trips.py --table BEFORE [--write]

Calls are followed in the order of the source, each function once. A stay is an uninterrupted series of functions of one file; returns are
stays minus files. Names are resolved through imports, faces (`__init__.pyi`) and re-exports.

Without --value every call is followed that can be resolved; a method is followed where one class of the package alone has it. With --value
a call is followed where an argument or the receiver is the value: the named parameter, an attribute of the value, or an object of the
package that a call with the value returned. A method is followed where the receiver's class is known by annotation or construction.
Functions of the lowest layers (`LOWEST`), which receive arrays and texts instead of the value, are not entered then.

--table compares another state of the sources (`git worktree add BEFORE COMMIT`) with this one; --write keeps the table in results/trips.md.
"""

import ast
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path

from study import options, show

Function = ast.FunctionDef | ast.AsyncFunctionDef
PACKAGE = Path(__file__).parents[1] / "lmeasure"
LOWEST = {"core", "kernels", "text", "linkages", "lcoordinate", "arrays", "catalogue", "causes", "errors", "findings", "interpolation"}
LOWEST |= {"roots", "saying", "se3", "status", "written"}
"""Packages, and modules of the root before there were packages."""
TRIPS = {
    "a run through `reconstruct`": (("trajectory.runs:reconstruct", "trajectory.reconstruction.runs:reconstruct"), "run"),
    "a run folder through `reconstruct_stream`": (
        ("trajectory.stream:reconstruct_stream", "trajectory.reconstruction.runs:reconstruct_stream"), "head",
    ),
    "the options of `lmeasure reconstruct`": (("workflows.reconstruct:run_reconstruct",) * 2, "settings"),
    "every call of `lmeasure reconstruct`": (("workflows.reconstruct:run_reconstruct",) * 2, None),
}  # fmt: skip
"""What is followed from where, before and after, and the parameter that is the value."""


@dataclass
class Module:
    """Functions, classes and imports of a file."""

    name: str
    functions: dict[str, Function] = field(default_factory=dict)
    classes: dict[str, dict[str, Function]] = field(default_factory=dict)
    bodies: dict[str, ast.ClassDef] = field(default_factory=dict)
    imports: dict[str, tuple[str, str]] = field(default_factory=dict)


Class = tuple[Module, str]
Of = tuple[bool, Class | None]
"""Whether an expression is the value, and its class where that is known."""


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
                    module.bodies[node.name] = node
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
        self.owners: dict[str, list[Class]] = defaultdict(list)
        for module in modules.values():
            for cls, methods in module.classes.items():
                for method in methods:
                    self.owners[method].append((module, cls))
        self.seen: set[int] = set()
        self.files: list[str] = []
        self.names: list[str] = []

    def resolve(self, module: str, name: str, depth: int = 8) -> Class | str | None:
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

    def first_visit(self, home: Module, function: Function) -> bool:
        """Keep a function that was not entered before."""
        if id(function) in self.seen:
            return False
        self.seen.add(id(function))
        self.files.append(home.name)
        self.names.append(function.name)
        return True

    def enter(self, home: Module, function: Function) -> None:
        """Follow a function's calls, once."""
        if self.first_visit(home, function):
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

    def reach(self, found: Class | str | None) -> None:
        """Enter a function, or the constructor of a class."""
        if not isinstance(found, tuple):
            return
        home, name = found
        if name in home.functions:
            self.enter(home, home.functions[name])
        for method in ("__init__", "__post_init__"):
            if name in home.classes and method in home.classes[name]:
                self.enter(home, home.classes[name][method])

    @property
    def counts(self) -> tuple[int, int, int]:
        """Files, stays and returns."""
        stays = [file for file, _ in groupby(self.files)]
        return len(set(stays)), len(stays), len(stays) - len(set(stays))


class ValueTrip(Trip):
    """The functions that receive a value, in order."""

    def __init__(self, modules: dict[str, Module]) -> None:
        super().__init__(modules)
        self._attributes: dict[tuple[str, str], dict[str, Class | None]] = {}

    def follow(self, home: Module, function: Function, value: set[str], own: Class | None = None) -> None:
        """Follow the calls that receive the value, which these parameters are; own: the class of a method."""
        package = home.name.split(".")[1] if "." in home.name else ""
        if package in LOWEST or not self.first_visit(home, function):
            return
        arguments = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
        classes = {a.arg: self.class_in(home, a.annotation) for a in arguments}
        if own is not None and arguments:
            classes[arguments[0].arg] = own
        Body(self, home, value, classes).block(function.body)

    def class_in(self, home: Module, annotation: ast.expr | None) -> Class | None:
        """Find the first class of the package that an annotation names."""
        if isinstance(annotation, ast.Constant) and isinstance(annotation.value, str):
            annotation = ast.parse(annotation.value, mode="eval").body
        for node in ast.walk(annotation) if annotation is not None else ():
            found = self.resolve(home.name, node.id) if isinstance(node, ast.Name) else None
            if isinstance(found, tuple) and found[1] in found[0].classes:
                return found
        return None

    def attributes(self, cls: Class) -> dict[str, Class | None]:
        """Classes of a class's attributes, by its annotations and what its methods assign."""
        home, name = cls
        key = home.name, name
        if key not in self._attributes:
            out = self._attributes[key] = {}
            for node in ast.walk(home.bodies[name]):
                if isinstance(node, ast.AnnAssign):
                    target = node.target
                    attribute = target.attr if isinstance(target, ast.Attribute) else getattr(target, "id", "")
                    out[attribute] = self.class_in(home, node.annotation)
            for method in home.classes[name].values():
                classes = {a.arg: self.class_in(home, a.annotation) for a in (*method.args.args, *method.args.kwonlyargs)}
                for place, assigned in _assignments(method):
                    if isinstance(place, ast.Attribute) and (found := self._constructed(home, assigned, classes)):
                        out.setdefault(place.attr, found)
        return self._attributes[key]

    def _constructed(self, home: Module, assigned: ast.expr, classes: dict[str, Class | None]) -> Class | None:
        assigned = assigned.body if isinstance(assigned, ast.IfExp) else assigned
        if isinstance(assigned, ast.Name):
            return classes.get(assigned.id)
        if not (isinstance(assigned, ast.Call) and isinstance(assigned.func, ast.Name)):
            return None
        found = self.resolve(home.name, assigned.func.id)
        if not isinstance(found, tuple):
            return None
        return found if found[1] in found[0].classes else self.class_in(found[0], found[0].functions[found[1]].returns)


class Body:
    """Statements of a function in which some names are the value."""

    def __init__(self, trip: ValueTrip, home: Module, value: set[str], classes: dict[str, Class | None]) -> None:
        self.trip, self.home, self.value, self.classes = trip, home, set(value), dict(classes)
        self.inner: dict[str, Function] = {}

    def block(self, statements: list[ast.stmt]) -> None:
        """Follow statements in order."""
        for statement in statements:
            self.statement(statement)

    def statement(self, node: ast.AST) -> None:
        """Follow one statement."""
        if isinstance(node, Function):
            self.inner[node.name] = node
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            pairs = _pairs(targets[0], node.value) if node.value is not None else []
            for target, found in [(target, self.of(value)) for target, value in pairs]:
                self.bind(target, found)
        elif isinstance(node, ast.For):
            self.bind(node.target, self.of(node.iter))
            self.block([*node.body, *node.orelse])
        else:
            for child in ast.iter_child_nodes(node):
                if isinstance(child, ast.withitem):
                    self.bind(child.optional_vars, self.of(child.context_expr))
                elif isinstance(child, ast.expr):
                    self.of(child)
                else:
                    self.statement(child)

    def bind(self, target: ast.AST | None, found: Of) -> None:
        """Take what is assigned to a target."""
        if isinstance(target, ast.Name):
            (self.value.add if found[0] else self.value.discard)(target.id)
            self.classes[target.id] = found[1]
        elif isinstance(target, ast.Tuple | ast.List):
            for part in target.elts:
                self.bind(part, (found[0], None))
        elif isinstance(target, ast.Starred):
            self.bind(target.value, found)

    def of(self, node: ast.AST) -> Of:
        """Follow an expression."""
        if isinstance(node, ast.Name):
            return node.id in self.value, self.classes.get(node.id)
        if isinstance(node, ast.Attribute):
            return self._attribute(node)
        if isinstance(node, ast.Call):
            return self._call(node)
        if isinstance(node, ast.ListComp | ast.SetComp | ast.GeneratorExp | ast.DictComp):
            for generator in node.generators:
                self.bind(generator.target, self.of(generator.iter))
                for condition in generator.ifs:
                    self.of(condition)
            return [self.of(part) for part in ([node.key, node.value] if isinstance(node, ast.DictComp) else [node.elt])][-1]
        parts = [self.of(child) for child in ast.iter_child_nodes(node) if isinstance(child, ast.expr)]
        if isinstance(node, ast.NamedExpr):
            self.bind(node.target, parts[-1])
        if isinstance(node, ast.Subscript):
            return parts[0]
        if isinstance(node, ast.Tuple | ast.List | ast.IfExp | ast.Starred | ast.BoolOp | ast.NamedExpr | ast.Dict):
            parts = parts[1:] if isinstance(node, ast.IfExp) else parts
            return any(is_value for is_value, _ in parts), next((cls for _, cls in parts if cls is not None), None)
        return False, None

    def _attribute(self, node: ast.Attribute) -> Of:
        is_value, cls = self.of(node.value)
        if cls is None:
            return is_value, None
        method = cls[0].classes[cls[1]].get(node.attr)
        if method is None:
            return is_value, self.trip.attributes(cls).get(node.attr)
        if is_value and any("property" in ast.unparse(d) for d in method.decorator_list):
            self.trip.follow(cls[0], method, {"self"}, cls)
        return is_value, self.trip.class_in(cls[0], method.returns)

    def _call(self, node: ast.Call) -> Of:
        called = node.func
        receiver: Of = self.of(called.value) if isinstance(called, ast.Attribute) else (False, None)
        given = [(None, self.of(a)) for a in node.args] + [(k.arg, self.of(k.value)) for k in node.keywords]
        is_value = receiver[0] or any(found[0] for _, found in given)
        if isinstance(called, ast.Name) and called.id == "replace" and given:
            return given[0][1]
        if isinstance(called, ast.Name) and called.id == "partial" and isinstance(node.args[0], ast.Name):
            return self._call(ast.Call(node.args[0], node.args[1:], node.keywords))
        if isinstance(called, ast.Name) and called.id in self.inner:
            function = self.inner[called.id]
            if is_value and id(function) not in self.trip.seen:
                self.trip.seen.add(id(function))
                Body(self.trip, self.home, self.value | _received(function, given), self.classes).block(function.body)
            return is_value, self.trip.class_in(self.home, function.returns)
        home, name, own = self._target(called, receiver[1])
        if home is None:
            return False, None
        if name in home.classes and own is None:
            for method in ("__init__", "__post_init__"):
                if is_value and method in home.classes[name]:
                    constructor = home.classes[name][method]
                    self.trip.follow(home, constructor, {"self"} | _received(constructor, given), (home, name))
            return is_value, (home, name)
        function = home.classes[own[1]][name] if own is not None else home.functions[name]
        made = self.trip.class_in(home, function.returns)
        if is_value:
            self.trip.follow(home, function, _received(function, given) | ({"self"} if receiver[0] else set()), own)
        return is_value and made is not None, made

    def _target(self, called: ast.expr, receiver: Class | None) -> tuple[Module | None, str, Class | None]:
        """Find the module and name of what is called, and the class of a method."""
        found: Class | str | None = None
        if isinstance(called, ast.Name):
            found = self.classes.get("cls") if called.id == "cls" else self.trip.resolve(self.home.name, called.id)
        elif isinstance(called, ast.Attribute):
            known = isinstance(called.value, ast.Name) and called.value.id not in self.classes
            base = self.trip.resolve(self.home.name, called.value.id) if known and isinstance(called.value, ast.Name) else receiver
            if isinstance(base, str):
                found = self.trip.resolve(base, called.attr)
            elif base is not None and called.attr in base[0].classes.get(base[1], {}):
                return base[0], called.attr, base
        return (*found, None) if isinstance(found, tuple) else (None, "", None)


def _received(function: Function, given: list[tuple[str | None, Of]]) -> set[str]:
    """Return the parameters of a function that receive the value."""
    names = [a.arg for a in (*function.args.posonlyargs, *function.args.args)]
    positional = iter(names[1:] if names[:1] in (["self"], ["cls"]) else names)
    more = function.args.vararg.arg if function.args.vararg else ""
    received = [(next(positional, more) if name is None else name, found[0]) for name, found in given]
    return {name for name, is_value in received if is_value}


def _assignments(function: Function) -> Iterator[tuple[ast.expr, ast.expr]]:
    for node in ast.walk(function):
        if isinstance(node, ast.Assign):
            yield from _pairs(node.targets[0], node.value)


def _pairs(target: ast.expr, value: ast.expr) -> list[tuple[ast.expr, ast.expr]]:
    """Return targets and values of an assignment, part by part where both are tuples."""
    if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple) and len(target.elts) == len(value.elts):
        return list(zip(target.elts, value.elts, strict=True))
    return [(target, value)]


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


def trip(start: str, value: str | None = None, package: Path = PACKAGE) -> Trip:
    """Follow a call "module:function", or the value that its parameter is."""
    modules = read_modules(package)
    module, _, name = start.partition(":")
    home = modules[module]
    if value is None:
        way = Trip(modules)
        way.enter(home, home.functions[name])
        return way
    of_value = ValueTrip(modules)
    of_value.follow(home, home.functions[name], {value})
    return of_value


def table(before: Path) -> str:
    """Return files, stays and returns of every trip of `TRIPS`, before and after."""
    lines = ["| what is followed | files | stays | returns |", "|---|---|---|---|"]
    for what, (starts, value) in TRIPS.items():
        pairs = zip(starts, (before / "lmeasure", PACKAGE), strict=True)
        both = [trip(f"lmeasure.{start}", value, package).counts for start, package in pairs]
        lines.append(f"| {what} | {' | '.join(f'{a} -> {b}' for a, b in zip(*both, strict=True))} |")
    return "\n".join(lines)


def main() -> None:
    """Print the counts of one trip, or the table."""
    parser = options(__doc__)
    parser.add_argument("start", nargs="?", default="lmeasure.workflows.reconstruct:run_reconstruct")
    parser.add_argument("--value", help="parameter that is the value")
    parser.add_argument("--package", type=Path, default=PACKAGE)
    parser.add_argument("--list", action="store_true", help="print the stays")
    parser.add_argument("--table", type=Path, metavar="BEFORE", help="folder of the sources to compare with")
    args = parser.parse_args()
    if args.table is not None:
        show(args, f"# Trips of one value\n\n`python benchmarks/trips.py --table BEFORE --write`\n\n{table(args.table)}", "trips")
        return
    way = trip(args.start, args.value, args.package)
    print("files {}, stays {}, returns {}".format(*way.counts))
    for file, names in groupby(zip(way.files, way.names, strict=True), key=lambda stay: stay[0]) if args.list else ():
        print(f"  {file}: {', '.join(name for _, name in names)}")


if __name__ == "__main__":
    main()
