"""A record of links in lines for a person."""

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from lmeasure.text import Message, composed, joined, message, settled

MOST_OTHERS = 5


class Line(NamedTuple):
    """A line, whether it warns, and whether a page has it in a table or a picture too."""

    text: Message | str
    warns: bool = False
    detail: bool = False


def described_lines(record: dict[str, Any]) -> list[str]:
    """A record of `record.described` in lines."""
    return [line.text for line in lines(record)]


def lines(record: dict[str, Any]) -> list[Line]:
    """Return the messages, and the kind of each line."""
    return [*_structure(record), *_assemblies(record), *_pose(record), *_design(record)]


def _structure(record: dict[str, Any]) -> Iterator[Line]:
    number, name, freedoms = record["complex_assemblies"], record["notation"], record["freedoms"]
    if record.get("straight_links") is False:
        head = message("structure.rods_of_their_own", name=record["class"], rods=record["rods"], freedoms=freedoms)
    elif record["redundant"]:
        head = message(
            "structure.links_more_than_pose", name=record["class"], links=record["links"], more=record["redundant"], freedoms=freedoms
        )
    elif record["degenerate"]:
        head = message("structure.freedoms_complex_assemblies", name=name, freedoms=freedoms, number=number)
    elif record["closed_form"]:
        head = message("structure.freedoms_complex_assemblies_closed", name=name, freedoms=freedoms, number=number)
    else:
        head = message("structure.freedoms_complex_assemblies_followed", name=name, freedoms=freedoms, number=number)
    yield Line(head)
    if record.get("straight_links"):
        yield Line(message("structure.rods_as_straight_links", rods=record["rods"]))
    if record["architecturally_singular"]:
        why = record["architecturally_singular_reason"]
        yield Line(message("structure.singular_every_pose", why=why), warns=True)


def _assemblies(record: dict[str, Any]) -> Iterator[Line]:
    if "assemblies" not in record:
        return
    if record["architecturally_singular"]:
        yield Line(message("structure.no_lengths_tell_pose"))
        return
    found, status = record["assemblies"], record["status"]
    number = message("structure.1_real_assembly") if len(found) == 1 else message("structure.real_assemblies", n=len(found))
    if record["redundant"]:
        within = record["within_mm"]
        close: str = (
            message("structure.1_real_assembly_closes", mm=within)
            if len(found) == 1
            else message("structure.real_assemblies_close_all", n=len(found), mm=within)
        )
        if record["next_misses_mm"] is not None:
            links = tuple(record["assemblies_of_links"])
            close = joined((close, message("structure.next_one_misses_mm", links=links, mm=record["next_misses_mm"])))
        yield Line(composed("{what}: {status}", what=close, status=status))
    elif record.get("straight_links") is False:
        yield Line(composed("{what}: {status}", what=message("structure.found_from_many_starts", number=number), status=status))
    elif record["complex_assemblies_found"] is None:
        way = message("structure.cables_over_their_pulleys", number=number)
        yield Line(composed("{what}: {status}", what=way, status=status))
    else:
        complex_ones = message("structure.complex_ones", n=record["complex_assemblies_found"], of=record["complex_assemblies_expected"])
        yield Line(composed("{number}, {more}: {status}", number=number, more=complex_ones, status=status))
    for one in found:
        if record["redundant"]:
            doubt: str = message("structure.misses_mm", mm=one["misses_mm"])
        else:
            doubt = "" if one["certified"] or record["complex_assemblies_found"] is None else message("structure.not_certified")
        yield Line(composed("  {place}{doubt}", place=_place(one), doubt=doubt), detail=True)


def _place(one: dict[str, Any]) -> Message:
    place, turn = _row(one["position_mm"]), _row(one["quaternion_xyzw"])
    return message("structure.mm_quaternion", place=place, turn=turn)


def _pose(record: dict[str, Any]) -> Iterator[Line]:
    if "rank" not in record:
        return
    yield Line(_held(record))
    if record["gradient"] is not None:
        yield Line(message("structure.gradient_omega_v", values=_row(record["gradient"])), detail=True)
    yield Line(message("structure.pressure_angles_degrees", values=_row(record["pressure_angles_deg"])), detail=True)
    if "rods" in record:
        yield Line(message("structure.drives_lengths_mm", values=_row(record["lengths_mm"])))
    if "leg_turns_deg" in record:
        yield Line(message("mechanism_line.legs", values=_row(record["leg_turns_deg"].values())))
    if "wrapped" in record:
        over = record["wrapped"]
        angle = over["worst_pressure_angle_deg"]
        yield Line(message("structure.over_pulleys_worst_pressure", held=_held(over), angle=angle))
        if over["u95_position_mm"] is not None:
            u95 = over["u95_position_mm"]
            yield Line(message("structure.counts_1_2_there", mm=u95))
    if "forward" in record:
        reached = record["forward"]
        yield Line(message("structure.forward_not_reached") if reached is None else message("structure.forward", place=_place(reached)))
    others = record.get("other_assemblies")
    if others:
        near, nearest = [one for one in others if one["apart_mm"] <= record["near_mm"]], others[0]["apart_mm"]
        yield Line(message("structure.other_assemblies_same_lengths", n=len(others), mm=nearest))
        for one in near[:MOST_OTHERS]:
            yield Line(message("structure.warning_another_assembly_near", place=_place(one)), warns=True)
    if "singular_pose" in record:
        yield from _singular(record["singular_pose"])
    if "way" in record:
        crossed = record["way"]["singular_at_share"]
        worst = [v for v in record["way"]["mm_per_mm"] if v is not None]
        if crossed:
            where = tuple(message("structure.percent", part=100.0 * share) for share in crossed)
            yield Line(message("structure.way_singular", where=where))
        else:
            yield Line(message("structure.way_never_singular_rim", mm=max(worst)))
    yield from (Line(line) for line in record.get("boundary", {}).get("lines", []))


def _singular(at: dict[str, Any]) -> Iterator[Line]:
    yield Line(message("structure.nearest_singular_pose", place=_place(at), mm=at["away_mm"], rank=at["rank"]))
    for twist in at["lost_twists"]:
        yield Line(message("structure.lost_twist", values=_row(twist)))
    yield Line(message("structure.exit_screw", values=_row(at["gradient"]), form=message(f"structure.topology_{at['topology']}")))
    for twist in at["twists"]:
        yield Line(message("structure.twist_to_singular", values=_row(twist)))
    if at["leads_out"] is None:
        yield Line(message("structure.drives_leading_out_unknown"))
    else:
        for way in ("lengthen", "shorten", "no part"):
            names = tuple(name for name, of in at["leads_out"].items() if of == way)
            if names:
                yield Line(message(f"structure.drives_{way}", names=names))
    if at["extra_drives"] is None:
        yield Line(message("structure.extra_drives_not_of_rods"))
        return
    if not at["extra_drives"]:
        yield Line(message("structure.no_extra_drives"))
    for one in at["extra_drives"][:MOST_OTHERS]:
        drives = tuple(
            message(f"structure.extra_drive_{d['pair']}", link=d["link"], axis=_row(d["axis"]), rates=_row(d["rates"]))
            for d in one["drives"]
        )
        yield Line(message("structure.extra_drives", drives=drives, names=tuple(one["instead_of"]), determinant=one["determinant"]))


def _held(record: dict[str, Any]) -> Message:
    values = {"rim": record["mm_per_mm"], "u95": record["u95_mm_per_mm"], "condition": record["condition"]}
    code = "structure.rank_links_do_not" if record["condition"] is None else "structure.rank_condition_lengths_off"
    rank = message(code, rank=record["rank"], **values)
    if record["determinant"] is None:
        return rank
    return composed("{determinant}{rank}", determinant=message("structure.determinant_mm_3", value=record["determinant"]), rank=rank)


def _row(values: Iterable[float]) -> tuple[float, ...]:
    return tuple(settled(float(value)) for value in values)


def _design(record: dict[str, Any]) -> Iterator[Line]:
    if "design" not in record:
        return
    made = record["design"]
    for text, sound in zip(made["tetrahedra"], made["clear_as_given"], strict=True):
        if sound:
            yield Line(message("structure.tetrahedron_never_flat_within", name=text))
        else:
            yield Line(message("structure.tetrahedron_may_flat_not", name=text))
    one = made["assembly"]
    where = "" if one is None else _place({"position_mm": one[:3], "quaternion_xyzw": one[3:]})
    if made["given"] == made["free"]:
        sound = message("structure.no_singular_pose_lies")
        yield Line(message("structure.assembly", said=sound, where=where) if where else sound)
        return
    for name, (low, high) in made["free"].items():
        a, b = made["given"][name]
        change = "" if (a, b) == (low, high) else message("structure.before", low=a, high=b)
        yield Line(composed("  {what}{change}", what=message("structure.mm", name=name, low=low, high=high), change=change), detail=True)
    sound = message("structure.within_these_limits_nothing")
    yield Line(message("structure.assembly", said=sound, where=where) if where else sound)


def list_lines(records: list[dict[str, Any]]) -> list[str]:
    """Return a line for every structure."""
    lines: list[str] = []
    for r in records:
        how = r["degenerate_reason"] or message("structure.closed_form" if r["closed_form"] else "structure.homotopy")
        values = {"notation": r["notation"], "koliskor": r["koliskor"], "number": r["complex_assemblies"]}
        own = r["variants"]
        variants = {} if not own else {"moved": tuple(own["drives_moved"]), "rods": tuple(own["rods"]), "bent": tuple(own["bent_rods"])}
        more = message("structure.variants", **variants) if variants else ""
        lines.append(composed("{notation:<32} {koliskor}  {number:>2}  {how}{more}", how=how, more=more, **values))
    return lines
