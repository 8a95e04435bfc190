"""Reading SRDF: pairs of links that may touch, named poses, and planning groups."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element

from planner_service.errors import InvalidFile
from planner_service.files.numerals import plain_float
from planner_service.files.xml_reader import read_xml
from planner_service.robot.groups import PlanningGroup
from planner_service.robot.model import AllowedContact
from planner_service.robot.urdf_model import Urdf, UrdfJoint

__all__ = ["Srdf", "read_srdf", "usable_srdf"]

MAX_STATES = 500
"""Named states."""
ROUNDED = 1e-4
"""rad or m by which a state may exceed a limit, as a quarter turn written as 1.5708 does."""

MAX_NESTED = 20
"""Groups within groups."""

Values = Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Srdf:
    """The allowed contacts and named states of an SRDF.

    Attributes:
        contacts: The ``<disable_collisions>``, reasons included.
        states: Joint positions by the name of the state, without fixed joints. States of several groups with the same
            name are merged, unless they differ in a joint: then each is called "group/state".
        tips: The links at which the chains of its groups end, in the file's order.
        groups: Its groups, in the file's order.
        end_effectors: The joints of the group of each ``<end_effector>``.
    """

    contacts: tuple[AllowedContact, ...] = ()
    states: Mapping[str, Values] = field(default_factory=dict)
    tips: tuple[str, ...] = ()
    groups: tuple[PlanningGroup, ...] = ()
    end_effectors: tuple[tuple[str, ...], ...] = ()


def read_srdf(path: Path, urdf: Urdf) -> Srdf:
    """The disabled pairs and group states of an SRDF for a robot.

    Raises:
        InvalidFile: with every problem found: unknown links or joints, states beyond limits, and so on.
    """
    srdf, problems = usable_srdf(path, urdf)
    if problems:
        raise InvalidFile(path, problems)
    return srdf


def usable_srdf(path: Path, urdf: Urdf) -> tuple[Srdf, list[str]]:
    """What of an SRDF can be used: each pair, state and group without a problem; and the problems of the others.

    Raises:
        InvalidFile: it cannot be read at all.
    """
    root = read_xml(path, "robot")
    problems: list[str] = []
    contacts = _contacts(root, urdf, problems)
    elements = root.findall("group_state")
    if len(elements) > MAX_STATES:
        problems.append(f"{len(elements)} group states; at most {MAX_STATES}")
    states: dict[str, dict[str, Values]] = {}
    for index, element in enumerate(elements[:MAX_STATES]):
        name, group = element.get("name", ""), element.get("group", "")
        if not name.strip() or not group.strip():
            problems.append(f"group_state[{index}] {name!r} of group {group!r}; expected both to have a name")
            continue
        if group in states.setdefault(name, {}):
            problems.append(f"group_state {name!r} of group {group!r} is given twice")
            continue
        wrong = list[str]()
        values = _values(element, f"group_state {name!r}", urdf, wrong)
        problems += wrong
        if not wrong:
            states[name][group] = values
    groups = _groups(root, urdf, problems)
    tips = (chain.get("tip_link", "") for chain in root.iterfind("group/chain"))
    known = {link.name for link in urdf.links}
    hands = [element.get("group") for element in root.findall("end_effector")]
    ends = tuple(group.joints for group in groups if group.name in hands)
    return Srdf(contacts, _named(states), tuple(tip for tip in tips if tip in known), groups, ends), problems


def _groups(root: Element, urdf: Urdf, problems: list[str]) -> tuple[PlanningGroup, ...]:
    """The groups, those that hold other groups included. A group that names what is not there is left out."""
    elements = {element.get("name", ""): element for element in root.findall("group")}
    if len(elements) > MAX_STATES:
        problems.append(f"{len(elements)} groups; at most {MAX_STATES}")
        return ()
    above = {joint.child: joint for joint in urdf.joints}
    joints = {joint.name for joint in urdf.joints}

    def members(name: str, inside: tuple[str, ...]) -> list[str] | None:
        if name in inside:
            circle = " -> ".join((*inside[inside.index(name) :], name))
            problems.append(f"group {name!r} holds itself: {circle}")
            return None
        if name not in elements or len(inside) > MAX_NESTED:
            return None
        found: list[str] = []
        for element in elements[name]:
            more = _members(element) if element.tag != "group" else members(element.get("name", ""), (*inside, name))
            if more is None:
                return None
            found += [joint for joint in more if joint not in found]
        return found

    def _members(element: Element) -> list[str] | None:
        if element.tag == "joint":
            return [element.get("name", "")] if element.get("name") in joints else None
        if element.tag == "link":
            joint = above.get(element.get("name", ""))
            return [] if joint is None else [joint.name]
        if element.tag == "chain":
            link, base, found = element.get("tip_link", ""), element.get("base_link", ""), list[str]()
            while link != base:
                if link not in above:
                    return None
                found.insert(0, above[link].name)
                link = above[link].parent
            return found
        return []

    out = []
    for name, element in elements.items():
        found, chains = members(name, ()), element.findall("chain")
        if name and found is not None:
            out.append(PlanningGroup(name, tuple(found), chains[0].get("tip_link") if len(chains) == 1 else None))
    return tuple(out)


def _contacts(root: Element, urdf: Urdf, problems: list[str]) -> tuple[AllowedContact, ...]:
    links = {link.name for link in urdf.links}
    contacts = []
    for index, element in enumerate(root.iter("disable_collisions")):
        a, b = element.get("link1", ""), element.get("link2", "")
        wrong = [
            f"disable_collisions[{index}]: {link!r} is not a link of the URDF" for link in (a, b) if link not in links
        ]
        if a == b:
            wrong.append(f"disable_collisions[{index}]: {a!r} twice; expected two links")
        problems += wrong
        if wrong:
            continue
        contacts.append(AllowedContact((a, b), element.get("reason") or "disabled in the SRDF"))
    return tuple(contacts)


def _values(state: Element, where: str, urdf: Urdf, problems: list[str]) -> Values:
    """The positions of a state's joints."""
    joints = {joint.name: joint for joint in urdf.joints}
    values: dict[str, float] = {}
    for element in state.findall("joint"):
        name, text = element.get("name", ""), element.get("value", "")
        if name not in joints:
            problems.append(f"{where}: {name!r} is not a joint of the URDF")
        elif name in values:
            problems.append(f"{where}: {name!r} is given twice")
        elif joints[name].kind != "fixed":
            value = _position(joints[name], text)
            low, high = joints[name].lower, joints[name].upper
            if value is None:
                problems.append(f"{where}: {name} = {text!r}; expected a number in [{low:g}, {high:g}]")
            values[name] = value or 0.0
    return values


def _position(joint: UrdfJoint, text: str) -> float | None:
    """The position, moved to the limit if it exceeds it only by rounding."""
    try:
        value = plain_float(text.strip())
    except ValueError:
        return None
    if not joint.lower - ROUNDED <= value <= joint.upper + ROUNDED:
        return None
    return min(max(value, joint.lower), joint.upper)


def _named(states: Mapping[str, Mapping[str, Values]]) -> dict[str, Values]:
    """One entry for each state, or for each of its groups if they differ in a joint."""
    out: dict[str, Values] = {}
    for name, groups in states.items():
        together: dict[str, float] = {}
        agree = True
        for values in groups.values():
            agree &= all(together.get(joint, value) == value for joint, value in values.items())
            together.update(values)
        if not groups:
            continue
        out.update({name: together} if agree else {f"{group}/{name}": values for group, values in groups.items()})
    return out
