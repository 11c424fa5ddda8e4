"""A record of links in lines for a person."""

from typing import Any

MOST_OTHERS = 5


def told(record: dict[str, Any]) -> list[str]:
    """A record of `record.described` in lines."""
    return [*_structure(record), *_assemblies(record), *_pose(record), *_design(record)]


def _structure(record: dict[str, Any]) -> list[str]:
    if record["redundant"]:
        head = f"{record['class']}: {record['links']} links, {record['redundant']} more than a pose needs, {record['freedoms']} freedoms"
    else:
        how = ", in closed form" if record["closed_form"] else ", followed from a start system"
        number = f"{record['complex_assemblies']} complex assemblies{'' if record['degenerate'] else how}"
        head = f"{record['notation']}: {record['freedoms']} freedoms, {number}"
    if not record["architecturally_singular"]:
        return [head]
    return [head, f"singular at every pose: {record['architecturally_singular_reason']}"]


def _assemblies(record: dict[str, Any]) -> list[str]:
    if "assemblies" not in record:
        return []
    if record["architecturally_singular"]:
        return ["no lengths tell a pose of it"]
    found = record["assemblies"]
    number = f"{len(found)} real {'assembly' if len(found) == 1 else 'assemblies'}"
    if record["redundant"]:
        close = f"{number} {'closes' if len(found) == 1 else 'close'} all links within {record['within_mm']:g} mm"
        rest = "" if record["next_misses_mm"] is None else f"; the next one of {', '.join(record['assemblies_of_links'])} misses by "
        lines = [f"{close}{rest}{'' if not rest else format(record['next_misses_mm'], '.4g') + ' mm'}: {record['status']}"]
    elif record["complex_assemblies_found"] is None:
        lines = [f"{number} of the cables over their pulleys, followed from straight ones and from many starts: {record['status']}"]
    else:
        of = f"{record['complex_assemblies_found']} with complex ones of {record['complex_assemblies_expected']}"
        lines = [f"{number}, {of}: {record['status']}"]
    for one in found:
        if record["redundant"]:
            doubt = f", misses by {one['misses_mm']:.2g} mm"
        else:
            doubt = "" if one["certified"] or record["complex_assemblies_found"] is None else ", not certified"
        lines.append(f"  {_place(one)}{doubt}")
    return lines


def _place(one: dict[str, Any]) -> str:
    place = ", ".join(f"{x:.4f}" for x in one["position_mm"])
    return f"({place}) mm, quaternion ({', '.join(f'{x:.6f}' for x in one['quaternion_xyzw'])})"


def _pose(record: dict[str, Any]) -> list[str]:
    if "rank" not in record:
        return []
    lines = [_held(record)]
    if record["gradient"] is not None:
        lines.append(f"gradient (omega; v): {', '.join(f'{x:.6g}' for x in record['gradient'])}")
    lines.append(f"pressure angles: {', '.join(f'{x:.1f}' for x in record['pressure_angles_deg'])} degrees")
    if "wrapped" in record:
        over = record["wrapped"]
        lines.append(f"over the pulleys: {_held(over)}, worst pressure angle {over['worst_pressure_angle_deg']:.1f} degrees")
        if over["u95_position_mm"] is not None:
            lines.append(f"counts of +-1/2, there and at the zero pose: U95 of the position {over['u95_position_mm']:.4g} mm")
    others = record.get("other_assemblies")
    if others:
        near = [one for one in others if one["apart_mm"] <= record["near_mm"]]
        lines.append(f"other assemblies of the same lengths: {len(others)}, the nearest {others[0]['apart_mm']:.4g} mm away with its turn")
        lines += [f"warning: another assembly is near: {_place(one)}" for one in near[:MOST_OTHERS]]
    if "way" in record:
        crossed = record["way"]["singular_at_share"]
        where = ", ".join(f"{100.0 * share:.1f} %" for share in crossed)
        worst = [v for v in record["way"]["mm_per_mm"] if v is not None]
        lines.append(
            f"on the way: singular at {where} of it"
            if crossed
            else f"on the way: never singular, the rim moves at most {max(worst):.4g} mm by 1 mm"
        )
    lines += record.get("boundary", {}).get("lines", [])
    return lines


def _held(record: dict[str, Any]) -> str:
    det = "" if record["determinant"] is None else f"determinant {record['determinant']:.6g} mm^3, "
    if record["condition"] is None:
        return f"{det}rank {record['rank']}: the links do not hold the platform"
    u95 = f"U95 {record['u95_mm_per_mm']:.4g} mm"
    return f"{det}rank {record['rank']}, condition {record['condition']:.4g}; lengths off by 1 mm: rim {record['mm_per_mm']:.4g} mm, {u95}"


def _design(record: dict[str, Any]) -> list[str]:
    if "design" not in record:
        return []
    made = record["design"]
    lines = []
    for text, sound in zip(made["tetrahedra"], made["clear_as_given"], strict=True):
        lines.append(
            f"tetrahedron {text}: {'never flat within the limits' if sound else 'may be flat, or not be assembled, within the limits'}"
        )
    if made["given"] == made["free"]:
        return [*lines, "no singular pose lies within the limits as they are"]
    for name, (low, high) in made["free"].items():
        a, b = made["given"][name]
        change = "" if (a, b) == (low, high) else f", before {a:g} to {b:g}"
        lines.append(f"  {name}: {low:.4f} to {high:.4f} mm{change}")
    return [*lines, "within these limits nothing is singular, and everything can be assembled"]


def told_list(records: list[dict[str, Any]]) -> list[str]:
    """Every structure in a line each."""
    lines = []
    for r in records:
        how = r["degenerate_reason"] or ("closed form" if r["closed_form"] else "homotopy")
        lines.append(f"{r['notation']:<32} {r['koliskor']}  {r['complex_assemblies']:>2}  {how}")
    return lines
