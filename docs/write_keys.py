"""Write the JSON Schemas of the models, and the tables of keys in rig.md and files.md.

python docs/write_keys.py
"""

import json
import re
from pathlib import Path

from lmeasure.io import FILE_KINDS
from lmeasure.io.schemas import keys_of, prose, schema_of, tables_of
from lmeasure.rig import TYPICAL_SIZES

ROOT = Path(__file__).parents[1]
PAGES = {
    "rig.md": ("rig", "drums", "placement", "bodies"),
    "files.md": ("run", "scenario", "program", "details", "robot", "structure"),
    "assumed-sizes.md": (),
}
SIZES = re.compile(r"(<!-- typical sizes, made by docs/write_keys.py -->\n).*?(<!-- end of sizes -->)", re.DOTALL)
MARK = re.compile(r"(<!-- keys of (\w+), made by docs/write_keys.py -->\n).*?(<!-- end of keys -->)", re.DOTALL)


def schema_text(name: str) -> str:
    """Return the text of a shipped schema."""
    return json.dumps(schema_of(name), indent=1, ensure_ascii=False) + "\n"


def listed(name: str) -> str:
    """Return the keys of a kind of file, one section per table."""
    tables = list(dict.fromkeys(table for whole in FILE_KINDS[name].load() for table in tables_of(whole)))
    words = ("decoder", "type", "kind") if FILE_KINDS[name].others else ("decoder", "type")
    kinds: dict[str, str] = {}
    parts: dict[str, str] = {}
    for path, model in tables:
        header = f"[[{path.removesuffix('[]').replace('[]', '')}]]" if path.endswith("[]") else f"[{path.replace('[]', '')}]"
        kind = next((f" with `{key} = {value}`" for key, value, *_ in keys_of(model) if key in words), "")
        if not kind and path and len([1 for other, _ in tables if other == path]) > 1:
            # one of several tables of this name, by the kind of the table around it
            kind = kinds.get(path.removesuffix("[]").rpartition(".")[0], "")
        kinds[path] = kind
        title = f"`{header}`{kind}" if path else f"`{FILE_KINDS[name].file}`{kind}, keys outside tables"
        rows = [f"| `{key}` | {values} | {default} | {text} |" for key, values, default, text in keys_of(model)]
        head = ["| key | type | default | meaning |", "|---|---|---|---|"]
        parts.setdefault(title, "\n".join([f"### {title}", "", prose(model.__doc__), "", *head, *rows, ""]))
    return "\n".join(parts.values())


def sizes() -> str:
    """Return the table of typical sizes."""
    rows = [f"| {s.what} | `{s.key}` | {s.size} | {s.reason} | {s.stated_size} |" for s in TYPICAL_SIZES.values()]
    return "\n".join(["| error | key | typical size | why | reached by measurement |", "|---|---|---|---|---|", *rows])


def page(text: str) -> str:
    """Return a page with the keys of the current models and the current typical sizes."""
    text = SIZES.sub(lambda found: f"{found[1]}\n{sizes()}\n\n{found[2]}", text)
    return MARK.sub(lambda found: f"{found[1]}\n{listed(found[2])}\n{found[3]}", text)


if __name__ == "__main__":
    for kind in FILE_KINDS:
        (ROOT / "lmeasure" / "io" / "schemas" / f"{kind}.json").write_text(schema_text(kind), encoding="utf-8")
    for name in PAGES:
        path = ROOT / "docs" / name
        path.write_text(page(path.read_text(encoding="utf-8")), encoding="utf-8")
