"""Links and joints of a URDF as a tree: which chain is the arm, where its controller has the base and the flange.

Names are those of ROS-Industrial: `base` is the controller's base, `tool0`, or else `flange`, the controller's flange. Where a file has no
such names, the chain begins at its root and ends behind the last axis of the arm: a gripper's fingers are no axes of it.
"""

import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from lmeasure.core import RobotError
from lmeasure.text import message

MOVING = ("revolute", "continuous", "prismatic")
CARRIED = ("floating", "planar")
"""Joints of a vehicle or a free body; the arm begins behind them, and behind a first slide without an end."""
_FLANGES = tuple(
    re.compile(rf"(.*[^a-z0-9])?({word})", re.I)
    for word in ("tool0", "flange", "ee_link|end_effector(_link)?|eef(_link)?|ee", "tcp(_link)?|tool_link|tool_frame")
)
"""Names of links at the end of an arm, the surest name first."""
_FINGER = re.compile(r"finger|knuckle|thumb|jaw|claw", re.I)
_GRIPPER = re.compile(r"gripper", re.I)
_SAME = ("1", "-1", "1.0", "-1.0")
_FORK_DEPTH = 3
"""Axes from which on equal branches are fingers; before it they are arms."""
_ARM = 4
"""Axes from which on a shorter branch may be the arm that is meant."""


@dataclass(frozen=True)
class Mimic:
    """The joint that another one follows, and by how much, as the file writes it."""

    joint: str
    multiplier: str | None
    offset: str | None


@dataclass(frozen=True)
class Branch:
    """A joint of the file and the links that it joins, empty if not stated."""

    name: str
    kind: str
    parent: str
    child: str
    mimic: Mimic | None
    endless: bool = False
    """Whether its limits are so wide that they mean none."""


class Tree:
    """The joints of a file by the links that they join."""

    def __init__(self, path: Path, branches: Sequence[Branch]) -> None:
        self.path, self.branches = path, tuple(branches)
        self.by_name = {b.name: b for b in branches}
        self._above: dict[str, list[Branch]] = defaultdict(list)
        self._below: dict[str, list[Branch]] = defaultdict(list)
        for branch in branches:
            if branch.parent and branch.child:
                self._above[branch.child].append(branch)
                self._below[branch.parent].append(branch)

    def tip(self, requested: str | None) -> str:
        """Return the link at which the chain ends: the requested one, else the flange; RobotError for several candidates."""
        if requested is not None:
            if requested not in self._above:
                joint = self.by_name.get(requested)
                known = message("robots.ends_of_chains", links=", ".join(self._leaves()))
                if joint:
                    known = message("robots.is_a_joint", link=repr(joint.child))
                raise RobotError(message("error.no_chain_of_joints_leads", where=self.path, requested=requested, known=known))
            return requested
        for branch in self.branches:
            for end, link in (("parent", branch.parent), ("child", branch.child)):
                if not link:
                    raise RobotError(message("error.joint_link_is_missing", where=self.path, name=branch.name, end=end))
            if branch.kind not in (*MOVING, *CARRIED, "fixed"):
                raise RobotError(message("error.joint_type_is_none_of", where=self.path, name=branch.name, kind=branch.kind))
        named = self._named()
        return named or self._found()

    def chain(self, tip: str, base: str | None) -> tuple[str, list[Branch], list[Branch]]:
        """Return the link that is the base, the fixed joints from where the chain begins to that link, and the joints of the chain to the
        tip. By default the base is a link `base` that is fixed before the first axis, else where the chain begins."""
        whole = self._up(tip)
        begin = next((i for i, b in enumerate(whole) if not (b.kind == "fixed" or b.kind in CARRIED or b.endless)), len(whole))
        vehicle = [i for i, b in enumerate(whole[:begin]) if b.kind in (*CARRIED, "prismatic")]
        if vehicle:  # the arm is mounted on it
            whole = whole[vehicle[-1] + 1 :]
        if base is None:
            start = whole[0].parent if whole else tip
            first = next((i for i, b in enumerate(whole) if b.kind != "fixed"), len(whole))
            on_way = [start, *(b.child for b in whole[:first])]
            base = next((link for link in self._rigid(on_way) if self._is_base(link, on_way)), None)
            return (start, [], whole) if base is None else (base, self._fixed_way(start, base), whole)
        links = [whole[0].parent, *(b.child for b in whole)] if whole else [tip]
        for k in range(len(links) - 1, -1, -1):
            way = self._fixed_way(links[k], base)
            if way or links[k] == base:
                return base, way, whole[k:]
        raise RobotError(message("error.link_is_not_fixed", where=self.path, base=base, tip=tip, links=", ".join(links)))

    def fixed_to(self, link: str, name: str) -> Branch | None:
        """Return the fixed joint that holds the link `name` directly at another."""
        return next((b for b in self._below[link] if b.kind == "fixed" and b.child == name), None)

    def leader(self, name: str) -> tuple[str, list[Mimic]]:
        """Return the joint that a joint follows in the end, and how, one after the other."""
        way: list[Mimic] = []
        seen = {name}
        while name in self.by_name and (mimic := self.by_name[name].mimic) is not None:
            way.append(mimic)
            if mimic.joint not in self.by_name or mimic.joint in seen:
                why = message("robots.follows_itself" if mimic.joint in seen else "robots.no_joint_of_file")
                raise RobotError(message("error.joint_follows_mimic", where=self.path, name=name, joint=mimic.joint, why=why))
            name = mimic.joint
            seen.add(name)
        return name, way

    def _up(self, tip: str) -> list[Branch]:
        """The joints from a root to a link."""
        chain: list[Branch] = []
        link = tip
        while self._above.get(link):
            if len(self._above[link]) > 1:
                raise RobotError(message("error.link_is_the_child", where=self.path, link=link))
            if len(chain) > len(self.branches):
                raise RobotError(message("error.no_chain_of_joints_leads_from", where=self.path, tip=tip))
            chain.append(self._above[link][0])
            link = chain[-1].parent
        return chain[::-1]

    def _rigid(self, links: Sequence[str]) -> list[str]:
        """Links, and all that are fixed to them below."""
        out = list(dict.fromkeys(links))
        for link in out:
            out += [b.child for b in self._below[link] if b.kind == "fixed" and b.child not in out]
        return out

    def _is_base(self, link: str, on_way: Sequence[str]) -> bool:
        """Return whether a link is called `base`, or `X_base` beside the chain's own `X_base_link`."""
        return link == "base" or (link.endswith("base") and f"{link}_link" in on_way)

    def _fixed_way(self, start: str, end: str) -> list[Branch]:
        """The fixed joints from a link down to another; none where it is the same, or not fixed below it."""
        way: list[Branch] = []
        while end != start:
            above = self._above.get(end, [])
            if len(above) != 1 or above[0].kind != "fixed" or len(way) > len(self.branches):
                return []
            way.append(above[0])
            end = above[0].parent
        return way[::-1]

    def _leaves(self) -> list[str]:
        return sorted({b.child for b in self.branches if b.child and not self._below[b.child]})[:12]

    def _moves(self, branch: Branch) -> bool:
        """Return whether a joint is an axis of an arm: it moves, follows none, and is no finger."""
        return branch.kind in MOVING and branch.mimic is None

    def _finger(self, branch: Branch) -> bool:
        """Return whether a joint moves a finger, by its name or that of its link, or a gripper that has no fingers behind."""
        if branch.kind not in MOVING:
            return False
        if _FINGER.search(branch.name) or _FINGER.search(branch.child):
            return True
        if not _GRIPPER.search(branch.name):
            return False
        links = [branch.child]
        for link in links:  # grows, and ends: a ring is not gone through twice
            links += [b.child for b in self._below.get(link, []) if b.child not in links]
        return not any(b.kind in MOVING and _FINGER.search(b.name + b.child) for link in links for b in self._below.get(link, []))

    def _named(self) -> str | None:
        """Return the link with the name of a flange."""
        for pattern in _FLANGES:
            found: dict[tuple[str, ...], list[str]] = {}
            for link in self._above:
                if not pattern.fullmatch(link) or len(self._above[link]) != 1:
                    continue
                chain = self._up(link)
                axes = [b for b in chain if self._moves(b)]
                if axes and not any(self._finger(b) for b in axes[1:]):
                    found.setdefault(tuple(b.name for b in chain if b.kind in MOVING), []).append(link)
            longest = [axes for axes in found if not any(axes == other[: len(axes)] and axes != other for other in found)]
            if len(longest) > 1:
                self._ambiguous([found[axes][0] for axes in longest])
            if longest:
                return min(found[longest[0]], key=lambda link: len(self._up(link)))
        return None

    def _found(self) -> str:
        """The link behind the last axis of the arm, by the shape of the tree."""
        heights = self._heights(fingers=False)
        if not any(heights.values()):
            heights = self._heights(fingers=True)
        roots = [link for link in self._below if not self._above.get(link)]
        tallest = max((heights.get(link, 0) for link in roots), default=0)
        if tallest == 0:
            raise RobotError(message("error.no_chain_of_joints", where=self.path))
        begin = [link for link in roots if heights.get(link, 0) == tallest]
        if len(begin) > 1:
            self._ambiguous([self._descended(link, heights, strict=False) for link in begin])
        return self._descended(begin[0], heights, strict=True)

    def _heights(self, *, fingers: bool) -> dict[str, int]:
        """Return by link the most axes of one chain below it, with or without those behind fingers."""
        order = [link for link in self._below if not self._above.get(link)]
        for link in order:  # grows: every link is behind the one above it
            order += [b.child for b in self._below.get(link, []) if len(self._above[b.child]) == 1]
        out: dict[str, int] = {}
        for link in reversed(order):
            out[link] = max((self._height(b, out, fingers) for b in self._below.get(link, [])), default=0)
        self._with_fingers = fingers
        return out

    def _height(self, branch: Branch, heights: dict[str, int], fingers: bool) -> int:
        if self._finger(branch) and not fingers:
            return 0
        return int(self._moves(branch)) + heights.get(branch.child, 0)

    def _descended(self, link: str, heights: dict[str, int], *, strict: bool) -> str:
        """The link that ends the arm that begins at a link; where branches are as good as each other the first, or RobotError if strict."""
        depth, behind, gone = 0, link, {link}
        while True:
            below = [b for b in self._below.get(link, []) if b.child not in gone]  # a ring is not gone through twice
            live = sorted(((self._height(b, heights, self._with_fingers), b) for b in below), key=lambda pair: -pair[0])
            several = [pair for pair in live if pair[0] > 0]
            if not several:
                return self._end(behind)
            (most, branch), second = several[0], several[1][0] if len(several) > 1 else 0
            if depth >= 2 and most == 1 and any(self._twins(branch, b) for _, b in live):
                return link
            if second and depth >= max(most + 1, _FORK_DEPTH) and (second == most or (depth > _ARM and second >= most - 1)):
                return link
            if strict and (second == most or (second >= _ARM and second >= most - 2)):
                same = [b for height, b in several if height >= second]
                self._ambiguous([self._descended(b.child, heights, strict=False) for b in same])
            depth += int(self._moves(branch))
            link = branch.child
            gone.add(link)
            behind = link if branch.kind in MOVING else behind

    def _twins(self, branch: Branch, other: Branch) -> bool:
        """Return whether two joints are the fingers of a gripper: alike, and one moves as far as the other."""
        mimic = other.mimic
        return mimic is not None and mimic.joint == branch.name and branch.kind == other.kind and mimic.multiplier in (None, *_SAME)

    def _end(self, link: str) -> str:
        """Behind the last axis: the link that holds fingers, else the one that fixed joints and followers of the arm's axes lead to, where
        there is one such link."""
        axes = {b.name for b in self._up(link) if self._moves(b)}
        while True:
            fixed = self._rigid([link])
            below = [b for end in fixed for b in self._below[end]]
            following = [b for b in below if b.kind in MOVING and b.mimic and not self._finger(b) and self.leader(b.name)[0] in axes]
            if len(following) != 1:
                break
            link = following[0].child
        holding = [end for end in fixed if any(self._finger(b) for b in self._below[end])]
        ends = [end for end in fixed if not any(b.kind == "fixed" for b in self._below[end])]
        return next((found[0] for found in (holding, ends) if len(found) == 1), link)

    def _ambiguous(self, ends: Sequence[str]) -> None:
        counted = [f"{end!r} ({sum(b.kind in MOVING for b in self._up(end))} joints)" for end in ends]
        raise RobotError(message("error.several_chains_could_be", where=self.path, counted=", ".join(counted)))
