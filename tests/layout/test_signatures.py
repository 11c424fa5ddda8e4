"""Signatures: what is called with more than four values is called by names."""

import ast
from pathlib import Path

import lmeasure

MOST = 4


def test_public_functions_take_four_positional_arguments_at_most() -> None:
    """Kernels apart, which the compiler calls by position."""
    root, long = Path(lmeasure.__file__).parent, []
    for path in sorted(root.rglob("*.py")):
        if "kernels" in path.parts:
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef) and (not node.name.startswith("_") or node.name == "__init__"):
                own = [a.arg for a in node.args.posonlyargs + node.args.args if a.arg not in {"self", "cls"}]
                long += [f"{path.relative_to(root)}:{node.lineno} {node.name}"] if len(own) > MOST else []
    assert long == []
