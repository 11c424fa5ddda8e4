"""The faults that may be put into a file of Python, one at a time: an operator, comparison, constant, condition or statement changed.

The `strict=True` of a `zip` stays: without it nothing else comes wherever all are as long as each other, and where they are not the program
with it fails, so that no input that it has a result for could tell the two apart. So does the 1 of a reshape to -1, as any negative number
says the same to NumPy.
"""

import ast
import itertools
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace

ARITHMETIC = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*", ast.FloorDiv: "*", ast.Mod: "*", ast.Pow: "*"}
COMPARED = {
    ast.Lt: ("<=", ">="), ast.LtE: ("<", ">"), ast.Gt: (">=", "<="), ast.GtE: (">", "<"), ast.Eq: ("!=",), ast.NotEq: ("==",),
    ast.Is: ("is not",), ast.IsNot: ("is",), ast.In: ("not in",), ast.NotIn: ("in",),
}  # fmt: skip
AUGMENTED = {ast.Add: "-=", ast.Sub: "+=", ast.Mult: "/=", ast.Div: "*=", ast.BitOr: "&=", ast.BitAnd: "|="}
_TOKENS = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.FloorDiv: "//", ast.Mod: "%", ast.Pow: "**",
    ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=", ast.Is: "is", ast.IsNot: "is not",
    ast.In: "in", ast.NotIn: "not in",
}  # fmt: skip


@dataclass(frozen=True)
class Mutant:
    """A fault: what stands from start to end of a file's text (offsets in characters), in that line, and what is put in its place."""

    file: str
    line: int
    source: str
    start: int
    end: int
    old: str
    new: str
    which: int = 1
    """Of the changes of one line that read alike."""

    @property
    def key(self) -> tuple[str, str, str]:
        """What names it whatever its line's number: file, line's text, the change."""
        return self.file, self.source, self.change

    @property
    def change(self) -> str:
        """The change, as it is written of it."""
        return f"{' '.join(self.old.split())} -> {self.new}" + (f" ({self.which})" if self.which > 1 else "")

    def applied(self, text: str) -> str:
        """The file's text with the fault."""
        return text[: self.start] + self.new + text[self.end :]


def _says_strict(call: ast.AST, keyword: ast.keyword) -> bool:
    """Whether it is the strict=True of a zip."""
    return ast.unparse(keyword) == "strict=True" and isinstance(call, ast.Call) and ast.unparse(call.func) == "zip"


def _says_the_rest(call: ast.AST, argument: ast.AST) -> bool:
    """Whether it is the -1 of a reshape: any other negative number says the same."""
    return isinstance(call, ast.Call) and ast.unparse(call.func).endswith(".reshape") and ast.unparse(argument) == "-1"


def mutants_of(file: str, text: str) -> list[Mutant]:
    """All faults of a file, in its order."""
    lines = text.splitlines(keepends=True)
    begins = [0]
    for line in lines:
        begins.append(begins[-1] + len(line))

    def place(line: int, column: int) -> int:
        # columns of ast count bytes
        return begins[line - 1] + len(lines[line - 1].encode()[:column].decode())

    def made(node: ast.expr | ast.stmt, start: int, end: int, new: str) -> Mutant:
        return Mutant(file, node.lineno, lines[node.lineno - 1].strip(), start, end, text[start:end], new)

    def span(node: ast.expr | ast.stmt) -> tuple[int, int]:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return place(node.lineno, node.col_offset), place(node.end_lineno, node.end_col_offset)

    def between(left: ast.expr, right: ast.expr, tokens: str, new: str, node: ast.expr) -> Iterator[Mutant]:
        """The operator that stands between two operands, brackets and comments apart."""
        start, end = span(left)[1], span(right)[0]
        at = text[start:end].find(tokens)
        if at >= 0 and "#" not in text[start : start + at]:
            yield made(node, start + at, start + at + len(tokens), new)

    def faults(node: ast.AST) -> Iterator[Mutant]:
        match node:
            case ast.BinOp(left, op, right) if type(op) in ARITHMETIC:
                yield from between(left, right, _TOKENS[type(op)], ARITHMETIC[type(op)], node)
            case ast.Compare(left, ops, comparators):
                for one, compared, other in zip([left, *comparators], ops, comparators, strict=False):
                    for new in COMPARED[type(compared)]:
                        yield from between(one, other, _TOKENS[type(compared)], new, node)
            case ast.BoolOp(op, values):
                tokens = ("and", "or") if isinstance(op, ast.And) else ("or", "and")
                for one, other in itertools.pairwise(values):
                    yield from between(one, other, *tokens, node)
            case ast.UnaryOp(op) if isinstance(op, ast.USub | ast.Not | ast.Invert):
                start = span(node)[0]
                yield made(node, start, start + (3 if isinstance(op, ast.Not) else 1), "")
            case ast.Constant(value) if isinstance(value, bool):
                yield made(node, *span(node), str(not value))
            case ast.Constant(value) if isinstance(value, int):
                yield made(node, *span(node), str(value + 1))
            case ast.Constant(value) if isinstance(value, float):
                yield made(node, *span(node), repr(1.5 * value if value else 1.0))
            case ast.If(test) | ast.While(test) | ast.IfExp(test):
                yield made(test, *span(test), f"(not ({ast.get_source_segment(text, test)}))")
            case ast.AugAssign(target, op, value) if type(op) in AUGMENTED:
                start, end = span(target)[1], span(value)[0]
                at = text[start:end].find("=") + start + 1
                yield made(node, at - 2, at, AUGMENTED[type(op)])
            case ast.Expr(ast.Call()) | ast.Assign([ast.Subscript() | ast.Attribute()]):
                yield made(node, *span(node), "pass")
            case ast.Continue() | ast.Break():
                yield made(node, *span(node), "pass")

    out: list[Mutant] = []

    def visit(node: ast.AST) -> None:
        out.extend(faults(node))
        for name, value in ast.iter_fields(node):
            # types, decorators and texts are no numerics; f-strings hold messages
            if name in {"annotation", "returns", "decorator_list", "type_comment"} or isinstance(node, ast.JoinedStr):
                continue
            for child in value if isinstance(value, list) else [value]:
                if not isinstance(child, ast.AST) or (isinstance(child, ast.keyword) and _says_strict(node, child)):
                    continue
                if _says_the_rest(node, child):
                    out.extend(faults(child))
                else:
                    visit(child)

    visit(ast.parse(text))
    seen: Counter[tuple[int, str]] = Counter()
    apart = []
    for m in sorted(out, key=lambda m: (m.start, m.end, m.new)):
        seen[m.line, m.change] += 1
        apart.append(replace(m, which=seen[m.line, m.change]))
    return apart
