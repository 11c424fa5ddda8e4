"""A record of links in lines for a person."""

from collections.abc import Iterator
from typing import Any, NamedTuple

from lmeasure.text import ENGLISH, Say

MOST_OTHERS = 5


class Line(NamedTuple):
    """A line, whether it warns, and whether a page has it in a table or a picture too."""

    text: str
    warns: bool = False
    detail: bool = False


def told(record: dict[str, Any]) -> list[str]:
    """A record of `record.described` in lines."""
    return [line.text for line in lines(record)]


def lines(record: dict[str, Any], say: Say = ENGLISH) -> list[Line]:
    """The same in a language, and what kind of line each is."""
    return [*_structure(record, say), *_assemblies(record, say), *_pose(record, say), *_design(record, say)]


def _structure(record: dict[str, Any], say: Say) -> Iterator[Line]:
    number, name, freedoms = record["complex_assemblies"], record["notation"], record["freedoms"]
    if record["redundant"]:
        head = say(
            "{name}: {links} links, {more} more than a pose needs, {freedoms} freedoms",
            name=record["class"],
            links=record["links"],
            more=record["redundant"],
            freedoms=freedoms,
        )
    elif record["degenerate"]:
        head = say("{name}: {freedoms} freedoms, {number} complex assemblies", name=name, freedoms=freedoms, number=number)
    elif record["closed_form"]:
        head = say("{name}: {freedoms} freedoms, {number} complex assemblies, in closed form", name=name, freedoms=freedoms, number=number)
    else:
        head = say(
            "{name}: {freedoms} freedoms, {number} complex assemblies, followed from a start system",
            name=name,
            freedoms=freedoms,
            number=number,
        )
    yield Line(head)
    if record["architecturally_singular"]:
        why = say.told(record["architecturally_singular_reason"])
        yield Line(say("singular at every pose: {why}", why=why), warns=True)


def _assemblies(record: dict[str, Any], say: Say) -> Iterator[Line]:
    if "assemblies" not in record:
        return
    if record["architecturally_singular"]:
        yield Line(say("no lengths tell a pose of it"))
        return
    found, status = record["assemblies"], say.told(record["status"])
    number = say("1 real assembly") if len(found) == 1 else say("{n} real assemblies", n=len(found))
    if record["redundant"]:
        within = record["within_mm"]
        close = (
            say("1 real assembly closes all links within {mm:g} mm", mm=within)
            if len(found) == 1
            else say("{n} real assemblies close all links within {mm:g} mm", n=len(found), mm=within)
        )
        if record["next_misses_mm"] is not None:
            links = ", ".join(record["assemblies_of_links"])
            close += "; " + say("the next one of {links} misses by {mm:.4g} mm", links=links, mm=record["next_misses_mm"])
        yield Line(f"{close}: {status}")
    elif record["complex_assemblies_found"] is None:
        way = say("{number} of the cables over their pulleys, followed from straight ones and from many starts", number=number)
        yield Line(f"{way}: {status}")
    else:
        complex_ones = say("{n} with complex ones of {of}", n=record["complex_assemblies_found"], of=record["complex_assemblies_expected"])
        yield Line(f"{number}, {complex_ones}: {status}")
    for one in found:
        if record["redundant"]:
            doubt = say(", misses by {mm:.2g} mm", mm=one["misses_mm"])
        else:
            doubt = "" if one["certified"] or record["complex_assemblies_found"] is None else say(", not certified")
        yield Line(f"  {_place(one, say)}{doubt}", detail=True)


def _place(one: dict[str, Any], say: Say) -> str:
    place, turn = say.numbers(one["position_mm"], ".4f"), say.numbers(one["quaternion_xyzw"], ".6f")
    return say("({place}) mm, quaternion ({turn})", place=place, turn=turn)


def _pose(record: dict[str, Any], say: Say) -> Iterator[Line]:
    if "rank" not in record:
        return
    yield Line(_held(record, say))
    if record["gradient"] is not None:
        yield Line(say("gradient (omega; v): {values}", values=say.numbers(record["gradient"], ".6g")), detail=True)
    yield Line(say("pressure angles: {values} degrees", values=say.numbers(record["pressure_angles_deg"], ".1f")), detail=True)
    if "wrapped" in record:
        over = record["wrapped"]
        angle = over["worst_pressure_angle_deg"]
        yield Line(say("over the pulleys: {held}, worst pressure angle {angle:.1f} degrees", held=_held(over, say), angle=angle))
        if over["u95_position_mm"] is not None:
            u95 = over["u95_position_mm"]
            yield Line(say("counts of +-1/2, there and at the zero pose: U95 of the position {mm:.4g} mm", mm=u95))
    others = record.get("other_assemblies")
    if others:
        near, nearest = [one for one in others if one["apart_mm"] <= record["near_mm"]], others[0]["apart_mm"]
        yield Line(say("other assemblies of the same lengths: {n}, the nearest {mm:.4g} mm away with its turn", n=len(others), mm=nearest))
        for one in near[:MOST_OTHERS]:
            yield Line(say("warning: another assembly is near: {place}", place=_place(one, say)), warns=True)
    if "way" in record:
        crossed = record["way"]["singular_at_share"]
        worst = [v for v in record["way"]["mm_per_mm"] if v is not None]
        if crossed:
            where = ", ".join(f"{say.number(100.0 * share, '.1f')} %" for share in crossed)
            yield Line(say("on the way: singular at {where} of it", where=where))
        else:
            yield Line(say("on the way: never singular, the rim moves at most {mm:.4g} mm by 1 mm", mm=max(worst)))
    yield from (Line(say.told(line)) for line in record.get("boundary", {}).get("lines", []))


def _held(record: dict[str, Any], say: Say) -> str:
    det = "" if record["determinant"] is None else say("determinant {value:.6g} mm^3, ", value=record["determinant"])
    if record["condition"] is None:
        return det + say("rank {rank}: the links do not hold the platform", rank=record["rank"])
    return det + say(
        "rank {rank}, condition {condition:.4g}; lengths off by 1 mm: rim {rim:.4g} mm, U95 {u95:.4g} mm",
        rank=record["rank"],
        condition=record["condition"],
        rim=record["mm_per_mm"],
        u95=record["u95_mm_per_mm"],
    )


def _design(record: dict[str, Any], say: Say) -> Iterator[Line]:
    if "design" not in record:
        return
    made = record["design"]
    for text, sound in zip(made["tetrahedra"], made["clear_as_given"], strict=True):
        if sound:
            yield Line(say("tetrahedron {name}: never flat within the limits", name=text))
        else:
            yield Line(say("tetrahedron {name}: may be flat, or not be assembled, within the limits", name=text))
    one = made["assembly"]
    where = "" if one is None else _place({"position_mm": one[:3], "quaternion_xyzw": one[3:]}, say)
    if made["given"] == made["free"]:
        sound = say("no singular pose lies within the limits as they are")
        yield Line(say("{said} in the assembly at {where}", said=sound, where=where) if where else sound)
        return
    for name, (low, high) in made["free"].items():
        a, b = made["given"][name]
        change = "" if (a, b) == (low, high) else say(", before {low:g} to {high:g}", low=a, high=b)
        yield Line("  " + say("{name}: {low:.4f} to {high:.4f} mm", name=name, low=low, high=high) + change, detail=True)
    sound = say("within these limits nothing is singular, and everything can be assembled")
    yield Line(say("{said} in the assembly at {where}", said=sound, where=where) if where else sound)


def told_list(records: list[dict[str, Any]]) -> list[str]:
    """Every structure in a line each."""
    lines = []
    for r in records:
        how = r["degenerate_reason"] or ("closed form" if r["closed_form"] else "homotopy")
        lines.append(f"{r['notation']:<32} {r['koliskor']}  {r['complex_assemblies']:>2}  {how}")
    return lines
