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
            "structure.links_more_than_pose", name=record["class"], links=record["links"], more=record["redundant"], freedoms=freedoms
        )
    elif record["degenerate"]:
        head = say("structure.freedoms_complex_assemblies", name=name, freedoms=freedoms, number=number)
    elif record["closed_form"]:
        head = say("structure.freedoms_complex_assemblies_closed", name=name, freedoms=freedoms, number=number)
    else:
        head = say("structure.freedoms_complex_assemblies_followed", name=name, freedoms=freedoms, number=number)
    yield Line(head)
    if record["architecturally_singular"]:
        why = say.message(record["architecturally_singular_reason"])
        yield Line(say("structure.singular_every_pose", why=why), warns=True)


def _assemblies(record: dict[str, Any], say: Say) -> Iterator[Line]:
    if "assemblies" not in record:
        return
    if record["architecturally_singular"]:
        yield Line(say("structure.no_lengths_tell_pose"))
        return
    found, status = record["assemblies"], say.message(record["status"])
    number = say("structure.1_real_assembly") if len(found) == 1 else say("structure.real_assemblies", n=len(found))
    if record["redundant"]:
        within = record["within_mm"]
        close = (
            say("structure.1_real_assembly_closes", mm=within)
            if len(found) == 1
            else say("structure.real_assemblies_close_all", n=len(found), mm=within)
        )
        if record["next_misses_mm"] is not None:
            links = ", ".join(record["assemblies_of_links"])
            close += "; " + say("structure.next_one_misses_mm", links=links, mm=record["next_misses_mm"])
        yield Line(f"{close}: {status}")
    elif record["complex_assemblies_found"] is None:
        way = say("structure.cables_over_their_pulleys", number=number)
        yield Line(f"{way}: {status}")
    else:
        complex_ones = say("structure.complex_ones", n=record["complex_assemblies_found"], of=record["complex_assemblies_expected"])
        yield Line(f"{number}, {complex_ones}: {status}")
    for one in found:
        if record["redundant"]:
            doubt = say("structure.misses_mm", mm=one["misses_mm"])
        else:
            doubt = "" if one["certified"] or record["complex_assemblies_found"] is None else say("structure.not_certified")
        yield Line(f"  {_place(one, say)}{doubt}", detail=True)


def _place(one: dict[str, Any], say: Say) -> str:
    place, turn = say.numbers(one["position_mm"], ".4f"), say.numbers(one["quaternion_xyzw"], ".6f")
    return say("structure.mm_quaternion", place=place, turn=turn)


def _pose(record: dict[str, Any], say: Say) -> Iterator[Line]:
    if "rank" not in record:
        return
    yield Line(_held(record, say))
    if record["gradient"] is not None:
        yield Line(say("structure.gradient_omega_v", values=say.numbers(record["gradient"], ".6g")), detail=True)
    yield Line(say("structure.pressure_angles_degrees", values=say.numbers(record["pressure_angles_deg"], ".1f")), detail=True)
    if "wrapped" in record:
        over = record["wrapped"]
        angle = over["worst_pressure_angle_deg"]
        yield Line(say("structure.over_pulleys_worst_pressure", held=_held(over, say), angle=angle))
        if over["u95_position_mm"] is not None:
            u95 = over["u95_position_mm"]
            yield Line(say("structure.counts_1_2_there", mm=u95))
    others = record.get("other_assemblies")
    if others:
        near, nearest = [one for one in others if one["apart_mm"] <= record["near_mm"]], others[0]["apart_mm"]
        yield Line(say("structure.other_assemblies_same_lengths", n=len(others), mm=nearest))
        for one in near[:MOST_OTHERS]:
            yield Line(say("structure.warning_another_assembly_near", place=_place(one, say)), warns=True)
    if "way" in record:
        crossed = record["way"]["singular_at_share"]
        worst = [v for v in record["way"]["mm_per_mm"] if v is not None]
        if crossed:
            where = ", ".join(f"{say.number(100.0 * share, '.1f')} %" for share in crossed)
            yield Line(say("structure.way_singular", where=where))
        else:
            yield Line(say("structure.way_never_singular_rim", mm=max(worst)))
    yield from (Line(say.message(line)) for line in record.get("boundary", {}).get("lines", []))


def _held(record: dict[str, Any], say: Say) -> str:
    det = "" if record["determinant"] is None else say("structure.determinant_mm_3", value=record["determinant"])
    if record["condition"] is None:
        return det + say("structure.rank_links_do_not", rank=record["rank"])
    return det + say(
        "structure.rank_condition_lengths_off",
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
            yield Line(say("structure.tetrahedron_never_flat_within", name=text))
        else:
            yield Line(say("structure.tetrahedron_may_flat_not", name=text))
    one = made["assembly"]
    where = "" if one is None else _place({"position_mm": one[:3], "quaternion_xyzw": one[3:]}, say)
    if made["given"] == made["free"]:
        sound = say("structure.no_singular_pose_lies")
        yield Line(say("structure.assembly", said=sound, where=where) if where else sound)
        return
    for name, (low, high) in made["free"].items():
        a, b = made["given"][name]
        change = "" if (a, b) == (low, high) else say("structure.before", low=a, high=b)
        yield Line("  " + say("structure.mm", name=name, low=low, high=high) + change, detail=True)
    sound = say("structure.within_these_limits_nothing")
    yield Line(say("structure.assembly", said=sound, where=where) if where else sound)


def told_list(records: list[dict[str, Any]]) -> list[str]:
    """Every structure in a line each."""
    lines = []
    for r in records:
        how = r["degenerate_reason"] or ("closed form" if r["closed_form"] else "homotopy")
        lines.append(f"{r['notation']:<32} {r['koliskor']}  {r['complex_assemblies']:>2}  {how}")
    return lines
