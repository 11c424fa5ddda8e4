"""The rig file as a form, and those of its drums and of where its points may be put: one field per value that the file states, and back,
with the file's comments and order kept."""

import copy
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lmeasure.accuracy import Limits, Placement, Scan, axis, box_around, map_zone, tilts
from lmeasure.core import LMeasureError
from lmeasure.io import checked, files
from lmeasure.rig import DrumsFile, rig_from_dict
from lmeasure.text import Message, faults as whole, message, texts
from lmeasure.workbench.project import LARGEST_TEXT, OutsideError, schema_of

UNITS = {"_mm": "mm", "_deg": "deg", "_mm_s": "mm/s", "_rad": "rad", "_s": "s"}
ARROWS = {
    "position_mm": "B",
    "guide_alpha_deg": "α",
    "guide_beta_deg": "u",
    "pulley_radius_mm": "R",
    "tangent_length_mm": "workbench.tangent_length",
    "axial_offset_mm": "axial(k)",
    "groove_pitch_mm": "axial(k)",
    "count_length_mm": "workbench.drum_encoder_k_counts",
    "counts_per_revolution": "workbench.drum_encoder_k_counts",
    "tool": "P",
}
"""Part of the drawing that a value is."""
_NUMBER = re.compile(r"\d+")
FIXED = ("schema", "assumed", "calibration")


def _drums(content: dict[str, Any], name: str) -> object:
    return checked(content, DrumsFile, name)


def _placement(content: dict[str, Any], name: str) -> object:
    return checked(content, Placement, name)


KINDS: dict[str, Callable[[dict[str, Any], str], object]] = {"rig": rig_from_dict, "drum": _drums, "placement": _placement}
"""Files that have a form, by the middle of their schema, and the check of a content."""


class Leaf(NamedTuple):
    """A value of the file: its place as a text, `observation_point.0.position_mm.1`, and the content of its field. within: the table inside
    that of its object; axis: the index in a row of numbers."""

    key: str
    within: str
    label: str
    axis: str
    value: str
    kind: str
    unit: str
    arrow: str
    help: str
    assumed: bool

    def named(self, say: Callable[[str], str]) -> str:
        """Return the name of the field."""
        return " ".join(part for part in (self.within and f"{say(self.within)}:", say(self.label), self.axis) if part)


class Thing(NamedTuple):
    """Owner of values: its kind and its own name."""

    kind: str
    name: str


def read(path: Path) -> tuple[Any, str]:
    """Return the document and the digest of the file, which shows a change by others."""
    if path.stat().st_size > LARGEST_TEXT:
        raise OutsideError(message("error.too_large_for_such", where=path.name))
    document = files.read_toml(path)
    return document, digest(path)


def kind_of(path: Path) -> str:
    """Return the kind of a file among KINDS; empty for none."""
    kind = schema_of(path) if path.suffix == ".toml" and path.is_file() else ""
    return kind if kind in KINDS else ""


def digest(path: Path) -> str:
    """SHA-256 of the file."""
    return files.sha256(path)


def parts(document: Mapping[str, Any]) -> list[tuple[Thing, list[Leaf]]]:
    """Return the values of a rig by their object."""
    guesses = set(document.get("assumed", ()))
    out: list[tuple[Thing, list[Leaf]]] = []
    general = list(_leaves({k: v for k, v in document.items() if not isinstance(v, dict | list)}, "", guesses, ""))
    if general:
        out.append((Thing("", str(document.get("name", "rig"))), general))
    for key, value in document.items():
        if key in FIXED:
            continue
        if isinstance(value, list):
            for i, one in enumerate(value):
                if isinstance(one, dict):
                    name = str(next((one[known] for known in ("name", "channel", "point") if known in one), i + 1))
                    out.append((Thing(_readable(key), name), list(_leaves(one, f"{key}.{i}.", guesses, name))))
        elif isinstance(value, dict):
            out.append((Thing(_readable(key), ""), list(_leaves(value, f"{key}.", guesses, key))))
    return out


def _leaves(table: Mapping[str, Any], before: str, guesses: set[str], owner: str, inside: str = "") -> Iterator[Leaf]:
    for name, value in table.items():
        if not before and name in FIXED:
            continue
        key = f"{before}{name}"
        if isinstance(value, dict):
            yield from _leaves(value, f"{key}.", guesses, owner, _readable(name))
        elif isinstance(value, list):
            if all(isinstance(v, int | float | str) and not isinstance(v, bool) for v in value):
                for i, one in enumerate(value):
                    axis = "xyz"[i] if len(value) == 3 else str(i + 1)
                    yield _leaf(f"{key}.{i}", (inside, _readable(name), axis), one, name, guesses, owner)
        else:
            yield _leaf(key, (inside, _readable(name), ""), value, name, guesses, owner)


def _leaf(key: str, words: tuple[str, str, str], value: Any, name: str, guesses: set[str], owner: str) -> Leaf:
    kind = "flag" if isinstance(value, bool) else "number" if isinstance(value, int | float) else "text"
    text = str(value).lower() if kind == "flag" else repr(value) if kind == "number" else str(value)
    known = "tool" if key.startswith("tool.") else name
    unit = (
        "mm" if known == "tool" else next((unit for end, unit in sorted(UNITS.items(), key=lambda e: -len(e[0])) if name.endswith(end)), "")
    )
    guess = f"{owner}.{name}" in guesses or f"{owner}.drum.{name}" in guesses
    about = f"rig_form.help.{known}"
    return Leaf(key, *words, text, kind, unit, ARROWS.get(known, ""), about if about in texts("en") else "", guess)


def _readable(name: str) -> str:
    if f"rig_form.name.{name}" in texts("en"):
        return f"rig_form.name.{name}"
    for end in sorted(UNITS, key=len, reverse=True):
        name = name.removesuffix(end)
    return name.replace("_", " ")


def filled(document: Mapping[str, Any], form: Mapping[str, str]) -> tuple[dict[str, Any], list[str]]:
    """Return the content with the form's values, and wrong values of the form; unknown keys are refused."""
    content = copy.deepcopy(dict(document))
    wrong: list[str] = []
    for _, leaves in parts(document):
        for leaf in leaves:
            text = form.get(leaf.key)
            if text is None or text.strip() == leaf.value:
                continue
            try:
                _put(content, leaf.key.split("."), _value(text.strip(), leaf))
            except ValueError:
                wrong.append(message("rig_file.not_a_number", key=leaf.key, text=repr(text.strip())))
    return content, wrong


def _value(text: str, leaf: Leaf) -> Any:
    if leaf.kind == "flag":
        return text == "true"
    if leaf.kind == "text":
        return text
    whole = re.fullmatch(r"[+-]?\d+", text) and re.fullmatch(r"[+-]?\d+", leaf.value)
    return int(text) if whole else float(text.replace(",", ".") if text.count(",") == 1 and "." not in text else text)


def _put(content: Any, way: list[str], value: Any) -> None:
    here = content
    for step in way[:-1]:
        here = here[int(step) if isinstance(here, list) and _NUMBER.fullmatch(step) else step]
    last = way[-1]
    here[int(last) if isinstance(here, list) else last] = value


def save(path: Path, form: Mapping[str, str]) -> list[str]:
    """Write the form's values into the file. If the result would not be valid, return all complaints, and write nothing."""
    document, now = read(path)
    if form.get("_digest") != now:
        return [message("rig_file.changed", name=path.name)]
    content, wrong = filled(document, form)
    wrong = wrong or faults(path, content)
    if not wrong and content != dict(document):
        files.rewrite_toml(path, document.holding(content))
    return wrong


def faults(path: Path, content: Mapping[str, Any]) -> list[str]:
    """Return the contradictions of a file's content with its schema."""
    try:
        KINDS[schema_of(path)](dict(content), path.name)
    except LMeasureError as error:
        return list(whole(error))
    return []


def beside(document: Mapping[str, Any], wrong: list[str]) -> dict[str, str]:
    """Return each fault by the key of the field that it is about."""
    out: dict[str, str] = {}
    places = {place: one for one in wrong if isinstance(one, Message) for place in (one.values.get("where"), one.values.get("key"))}
    for thing, leaves in parts(document):
        for leaf in leaves:
            table, *rest = (word for word in leaf.key.split(".") if not word.isdigit())
            end = ": " + ".".join([f"[{table} {thing.name}]" if rest and thing.name else table, *rest])
            for place in [place for place in places if place == leaf.key or str(place).endswith(end)]:
                out[leaf.key] = places.pop(place)
    return out


def scene(path: Path) -> dict[str, Any]:
    """Points of a rig for the picture in space, mm in the base frame; the tool is drawn at the base's origin."""
    document, _ = read(path)
    rig = rig_from_dict(document, path.name)
    return {
        "points": [{"name": p.name, "position_mm": list(p.position_mm)} for p in rig.observation_point],
        "tool": {name: list(at) for name, at in rig.tool.items()},
        "cables": [{"from": c.from_point, "to": c.to_point} for c in rig.cable],
    }


COARSE = 12
"""Nodes along the longest side of the box of a coarse look."""


def coarse(path: Path, points: Mapping[str, tuple[float, ...]], limit_deg: float = 60.0) -> dict[str, float]:
    """Return the quality of the rig with points at other positions [mm, base frame]: the volume within the limit [mm^3] in a coarse box
    around it, its least worst pressure angle [deg], and the median of its U95 radius [mm]. One orientation, the nominal rig's own
    uncertainty."""
    document, _ = read(path)
    content = copy.deepcopy(dict(document))
    content.pop("calibration", None)
    for point in content.get("observation_point", ()):
        if point.get("name") in points:
            point["position_mm"] = list(points[point["name"]])
    rig = rig_from_dict(content, path.name)
    spans = [(low, high, max((high - low) / COARSE, 1.0)) for low, high, _step in box_around(rig)]
    nodes = axis(*spans[0]), axis(*spans[1]), axis(*spans[2])
    steps = (spans[0][2], spans[1][2], spans[2][2])
    data = map_zone(rig, None, nodes, tilts(0.0, 1, None), scan=Scan(limits=Limits(limit_deg), spacing_mm=steps, workers=1))
    kept = data["in_zone"].values.astype(bool)
    angle = data["worst_pressure_angle_deg"].values
    u95 = data["u95_position_mm"].values[kept]
    return {
        "zone_volume_mm3": float(data.attrs["zone_volume_mm3"]),
        "least_angle_deg": float(np.nanmin(angle)) if np.isfinite(angle).any() else 90.0,
        "median_u95_mm": float(np.median(u95)) if len(u95) else 0.0,
    }
