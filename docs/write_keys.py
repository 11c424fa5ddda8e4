"""Writes what is made of the models: the JSON Schemas that come along, and the lists of keys in rig.md and files.md.

python docs/write_keys.py
"""

import json
import re
from pathlib import Path

from lmeasure.io import FILE_KINDS
from lmeasure.io.schemas import keys_of, schema_of, tables_of

ROOT = Path(__file__).parents[1]
PAGES = {"rig.md": ("rig", "drums", "placement", "bodies"), "files.md": ("run", "scenario", "program", "details", "robot", "structure")}
MARK = re.compile(r"(<!-- keys of (\w+), made by docs/write_keys.py -->\n).*?(<!-- end of keys -->)", re.DOTALL)


def schema_text(name: str) -> str:
    """A schema as it is shipped."""
    return json.dumps(schema_of(name), indent=1, ensure_ascii=False) + "\n"


def listed(name: str) -> str:
    """The keys of a kind of file, a section for each table."""
    parts = []
    told: set[str] = set()
    several = bool(FILE_KINDS[name].others)
    for path, model in (table for whole in FILE_KINDS[name].load() for table in tables_of(whole)):
        header = f"[[{path.removesuffix('[]').replace('[]', '')}]]" if path.endswith("[]") else f"[{path.replace('[]', '')}]"
        told_by = ("decoder", "type", "kind") if several else ("decoder", "type")
        kind = next((f" with `{k} = {v}`" for k, v, *_ in keys_of(model) if k in told_by), "")
        title = f"`{header}`{kind}" if path else f"`{FILE_KINDS[name].file}`{kind}, outside of tables"
        if title in told:
            continue
        told.add(title)
        about = " ".join((model.__doc__ or "").split())
        rows = [f"| `{key}` | {held} | {default} | {text} |" for key, held, default, text in keys_of(model)]
        parts.append("\n".join([f"### {title}", "", about, "", "| key | holds | default | what it is |", "|---|---|---|---|", *rows, ""]))
    return "\n".join(parts)


def page(text: str) -> str:
    """A page with its lists of keys as the models are."""
    return MARK.sub(lambda found: f"{found[1]}\n{listed(found[2])}\n{found[3]}", text)


if __name__ == "__main__":
    for kind in FILE_KINDS:
        (ROOT / "lmeasure" / "io" / "schemas" / f"{kind}.json").write_text(schema_text(kind), encoding="utf-8")
    for name in PAGES:
        path = ROOT / "docs" / name
        path.write_text(page(path.read_text(encoding="utf-8")), encoding="utf-8")
