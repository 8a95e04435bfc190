"""Reading SRDF: pairs of links that may touch, named poses, planning groups and passive joints."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element

from planner_service.errors import InvalidFile
from planner_service.files.numerals import plain_float
from planner_service.files.xml_reader import read_xml
from planner_service.robot.elements.table import unlisted_words, words_of
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
        contacts: The ``<disable_collisions>``, reasons included, and for the link of a ``<disable_default_collisions>``
            its pairs with all others, without those of an ``<enable_collisions>``.
        states: Joint positions by the name of the state, without fixed joints. States of several groups with the same
            name are merged, unless they differ in a joint: then each is called "group/state".
        tips: The links at which the chains of its groups end, in the file's order.
        groups: Its groups, in the file's order.
        end_effectors: The joints of the group of each ``<end_effector>``.
        passive: The movable joints that no motor moves.
        notes: What was not understood of it, or is not used, without a harm to what was; a line each.
    """

    contacts: tuple[AllowedContact, ...] = ()
    states: Mapping[str, Values] = field(default_factory=dict)
    tips: tuple[str, ...] = ()
    groups: tuple[PlanningGroup, ...] = ()
    end_effectors: tuple[tuple[str, ...], ...] = ()
    passive: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


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
    unlisted = unlisted_words(root, words_of("srdf"))
    problems, notes = [*unlisted.refused], [*unlisted.told]
    if root.get("name") != urdf.name:
        notes.append(f"it is that of robot {root.get('name')!r}, and the URDF's is {urdf.name!r}")
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
    groups = _groups(root, urdf, problems, notes)
    tips = (chain.get("tip_link", "") for chain in root.iterfind("group/chain"))
    known = {link.name for link in urdf.links}
    hands = [element.get("group") for element in root.findall("end_effector")]
    named = {element.get("name") for element in root.findall("group")}
    problems += [f"end_effector: {hand!r} is not a group of the SRDF" for hand in hands if hand not in named]
    ends = tuple(group.joints for group in groups if group.name in hands)
    passive = _passive(root, urdf, problems)
    follow = {joint.name for joint in urdf.joints if joint.mimic is not None}
    free = ", ".join(name for name in passive if name not in follow)
    notes += [f"passive joints are not planned for, and stand as at home: {free}"] if free else []
    chained = tuple(tip for tip in tips if tip in known)
    return Srdf(contacts, _named(states), chained, groups, ends, passive, tuple(dict.fromkeys(notes))), problems


def _passive(root: Element, urdf: Urdf, problems: list[str]) -> tuple[str, ...]:
    joints = {joint.name: joint for joint in urdf.joints}
    virtual = _virtual(root)
    names = list(dict.fromkeys(element.get("name", "") for element in root.findall("passive_joint")))
    wrong = [name for name in names if name not in joints and name not in virtual]
    problems += [f"passive_joint: {name!r} is not a joint of the URDF" for name in wrong]
    return tuple(name for name in names if name in joints and joints[name].kind != "fixed")


def _virtual(root: Element) -> set[str]:
    """Joints that an SRDF puts between the world and the robot, which stands still here."""
    return {element.get("name", "") for element in root.findall("virtual_joint")}


def _groups(root: Element, urdf: Urdf, problems: list[str], notes: list[str]) -> tuple[PlanningGroup, ...]:
    """The groups, those that hold other groups included. One that names what is not there is left out, with a note."""
    elements = {element.get("name", ""): element for element in root.findall("group")}
    given = Counter(element.get("name", "") for element in root.findall("group"))
    problems += [f"group {name!r} is defined {times} times" for name, times in given.items() if times > 1]
    elements = {name: element for name, element in elements.items() if given[name] == 1}
    if len(elements) > MAX_STATES:
        problems.append(f"{len(elements)} groups; at most {MAX_STATES}")
        return ()
    above = urdf.above
    joints = {joint.name for joint in urdf.joints}
    links = {link.name for link in urdf.links}
    virtual = _virtual(root)

    def members(name: str, inside: tuple[str, ...]) -> list[str] | None:
        if name in inside:
            circle = " -> ".join((*inside[inside.index(name) :], name))
            problems.append(f"group {name!r} holds itself: {circle}")
            return None
        if name not in elements or len(inside) > MAX_NESTED:
            if given[name] == 0:
                notes.append(f"group {inside[-1]!r}: {name!r} is not a group of the SRDF")
            return None
        found: list[str] = []
        for element in elements[name]:
            if element.tag == "group":
                more = members(element.get("name", ""), (*inside, name))
            else:
                more = _members(element, f"group {name!r}")
            if more is None:
                return None
            found += [joint for joint in more if joint not in found]
        return found

    def _members(element: Element, where: str) -> list[str] | None:
        name = element.get("name", "")
        if element.tag == "joint" and name not in joints | virtual:
            notes.append(f"{where}: {name!r} is not a joint of the URDF")
            return None
        if element.tag == "joint":
            return [name] if name in joints else []
        if element.tag == "link" and name not in links:
            notes.append(f"{where}: {name!r} is not a link of the URDF")
            return None
        if element.tag == "link":
            joint = above.get(name)
            return [] if joint is None else [joint.name]
        if element.tag == "chain":
            tip, base, found = element.get("tip_link", ""), element.get("base_link", ""), list[str]()
            link = tip
            while link != base:
                if link not in above:
                    notes.append(f"{where}: no chain of joints leads from link {base!r} to {tip!r}")
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
    """The pairs that may touch; as in MoveIt, a disabled pair stays disabled even where another entry enables it."""
    links = [link.name for link in urdf.links]
    disabled = _pairs(root, "disable_collisions", links, problems)
    contacts = [AllowedContact(pair, element.get("reason") or "disabled in the SRDF") for pair, element in disabled]
    checked = {frozenset(pair) for pair, _ in _pairs(root, "enable_collisions", links, problems)}
    checked |= {frozenset(pair) for pair, _ in disabled}
    for index, element in enumerate(root.findall("disable_default_collisions")):
        name = element.get("link", "")
        if name not in links:
            problems.append(f"disable_default_collisions[{index}]: {name!r} is not a link of the URDF")
            continue
        others = [other for other in links if other != name and frozenset((name, other)) not in checked]
        reason = element.get("reason") or f"collisions of {name} are disabled by default in the SRDF"
        contacts += [AllowedContact((name, other), reason) for other in others]
        checked |= {frozenset((name, other)) for other in others}
    return tuple(contacts)


def _pairs(root: Element, tag: str, links: Sequence[str], problems: list[str]) -> list[tuple[tuple[str, str], Element]]:
    """The pairs of links of all elements with that tag."""
    known, found = set(links), []
    for index, element in enumerate(root.findall(tag)):
        a, b = element.get("link1", ""), element.get("link2", "")
        wrong = [f"{tag}[{index}]: {link!r} is not a link of the URDF" for link in (a, b) if link not in known]
        if a == b:
            wrong.append(f"{tag}[{index}]: {a!r} twice; expected two links")
        problems += wrong
        if not wrong:
            found.append(((a, b), element))
    return found


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
