"""A table of the elements and attributes of a file format, and what a file has beyond it.

A reader that looks for the words it knows drops all others in silence, and with them what they meant: another pose,
another shape, a tighter limit. So each format has a table of all its words. A word that is in none is refused where it
could change geometry, motion or limits, and gets a warning where it belongs to another program.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from enum import Enum
from xml.etree.ElementTree import Element

__all__ = ["Effect", "Row", "Rule", "Unlisted", "markdown_table", "rows_of", "rule", "unlisted_words"]

MAX_SHOWN = 40
"""Characters of a value or a text in a message."""
NAMED = ("body", "geom", "site")
"""Elements that messages call by their names alone, wherever they are nested in one another."""


class Effect(Enum):
    """What a reader does with an element or attribute."""

    READ = "read"
    NONE = "no effect"
    WARNED = "no effect, with a warning"
    REFUSED = "refused"


@dataclass(frozen=True)
class Rule:
    """What becomes of an element, of its attributes, and of the elements inside.

    Attributes:
        attributes: Effect and reason by name.
        children: By tag; a rule may be that of several elements.
        closed: Whether what is not listed inside is looked at: not if the whole element is for another program.
        extensible: Whether other programs may add elements of their own, which get a warning and are not refused.
        looks: Whether what is inside only says what a link looks like: then nothing in it is refused.
        has_text: Whether its text is read, or has no effect.
        one_child: Whether it holds exactly one element: the reader itself refuses any other.
    """

    effect: Effect
    why: str = ""
    attributes: Mapping[str, tuple[Effect, str]] = field(default_factory=dict)
    children: Mapping[str, Rule] = field(default_factory=dict)
    closed: bool = True
    extensible: bool = False
    looks: bool = False
    has_text: bool = False
    one_child: bool = False


Words = tuple[Effect, str, str]
"""An effect, the attributes that it is of with spaces between them, and why."""


def rule(
    effect: Effect,
    why: str = "",
    *attributes: Words,
    children: Mapping[str, Rule] | None = None,
    extensible: bool = False,
    looks: bool = False,
    has_text: bool = False,
    one_child: bool = False,
    whole: bool = False,
) -> Rule:
    """A rule; one without an effect on planning, and without anything listed inside, may hold what it will.

    Args:
        whole: The same of an element that something else reads and judges.
    """
    given = {name: (what, reason) for what, names, reason in attributes for name in names.split()}
    inside = children or {}
    closed = not whole and (effect is Effect.READ or bool(given or inside))
    return Rule(effect, why, given, inside, closed, extensible, looks, has_text, one_child)


@dataclass(frozen=True)
class Row:
    """A line of the table for people: ``word`` is ``<tag>`` or an attribute, ``inside`` the elements that it is in."""

    word: str
    inside: str
    effect: Effect
    why: str


def rows_of(tag: str, root: Rule) -> list[Row]:
    """Each element and attribute once, in the order of the table; a rule that several elements share, once for all."""
    places: dict[int, list[str]] = {}
    order: list[tuple[str, Rule]] = []

    def visit(name: str, inside: str, item: Rule) -> None:
        key = id(item)
        places.setdefault(key, [])
        if f"<{inside}>" not in places[key]:
            places[key].append(f"<{inside}>")
        if not any(known is item for _, known in order):
            order.append((name, item))
            for child, below in item.children.items():
                visit(child, name, below)

    visit(tag, "", root)
    out = []
    for name, item in order:
        inside = ", ".join(place for place in places[id(item)] if place != "<>")
        tags = _tags(item, order) or [name]
        out.append(Row(", ".join(f"<{each}>" for each in tags), inside, item.effect, item.why))
        grouped: dict[tuple[Effect, str], list[str]] = {}
        for attribute, what in item.attributes.items():
            grouped.setdefault(what, []).append(attribute)
        holder = ", ".join(f"<{each}>" for each in tags)
        out += [Row(", ".join(names), holder, effect, why) for (effect, why), names in grouped.items()]
    return out


def markdown_table(tag: str, root: Rule) -> str:
    """The table as Markdown, for the documentation."""
    lines = ["| element or attribute | inside | effect | why |", "| --- | --- | --- | --- |"]
    for row in rows_of(tag, root):
        word = ", ".join(f"`{each}`" for each in row.word.split(", "))
        inside = ", ".join(f"`{each}`" for each in row.inside.split(", ") if each)
        lines.append(f"| {word} | {inside} | {row.effect.value} | {row.why.replace('<', '&lt;')} |")
    return "\n".join(lines) + "\n"


def _tags(item: Rule, order: Iterable[tuple[str, Rule]]) -> list[str]:
    """The tags that a rule has in the elements that hold it."""
    return list(dict.fromkeys(tag for _, above in order for tag, below in above.children.items() if below is item))


@dataclass(frozen=True)
class Unlisted:
    """What a file has that is not read: ``refused`` keeps it from being used, ``told`` does not. A line each."""

    refused: tuple[str, ...]
    told: tuple[str, ...]


def unlisted_words(root: Element, table: Rule, *, as_seen: bool = False) -> Unlisted:
    """The elements, attributes and texts of a file that its table refuses, warns about or does not list.

    A word that occurs in many places is one line, which names the first of them.

    Args:
        as_seen: Whether what links look like is checked, too: then words in there are refused as elsewhere.
    """
    walk = _Walk(as_seen)
    walk.element(root, table, "", looks=False)
    return Unlisted(tuple(walk.lines(walk.refused)), tuple(walk.lines(walk.told)))


Places = dict[tuple[str, str, str], list[str]]


class _Walk:
    """Collects what is not listed, by element and word, with the places where it is."""

    def __init__(self, as_seen: bool) -> None:
        self.as_seen = as_seen
        self.refused: Places = {}
        self.told: Places = {}

    def lines(self, found: Places) -> Iterator[str]:
        for (_, _, text), places in found.items():
            more = f" (and in {len(places) - 1:,} more places)" if len(places) > 1 else ""
            yield f"{places[0]}: {text}{more}"

    def add(self, where: str, element: Element, word: str, text: str, *, refused: bool) -> None:
        found = self.refused if refused else self.told
        found.setdefault((str(element.tag), word, text), []).append(where)

    def element(self, element: Element, item: Rule, inside: str, *, looks: bool) -> None:
        where = _where(element, inside)
        looks = (looks or item.looks) and not self.as_seen
        if not item.closed:
            return
        for name, value in element.attrib.items():
            self.attribute(element, item, where, name, value, looks=looks)
        self.texts(element, item, where, looks=looks)
        for child in element:
            below = item.children.get(str(child.tag))
            if below is None and item.one_child:
                continue
            if below is None:
                self.unknown(child, item, where, looks=looks)
            elif below.effect is Effect.REFUSED:
                self.add(where, element, child.tag, f"<{child.tag}>: {below.why}", refused=not looks)
            else:
                if below.effect is Effect.WARNED:
                    self.add(where, element, child.tag, f"<{child.tag}> has no effect: {below.why}", refused=False)
                self.element(child, below, where, looks=looks)

    def attribute(self, element: Element, item: Rule, where: str, name: str, value: str, *, looks: bool) -> None:
        what = item.attributes.get(name)
        if what is not None:
            effect, why = what
            if effect is Effect.WARNED:
                self.add(where, element, name, f"{name}={_shown(value)} has no effect: {why}", refused=False)
            elif effect is Effect.REFUSED:
                self.add(where, element, name, f"{name}={_shown(value)}: {why}", refused=not looks)
            return
        prefix, colon, local = name.partition(":")
        if prefix == "xmlns":
            return  # declares what a prefix stands for
        if colon and local not in item.attributes:
            text = f"{name}={_shown(value)} belongs to another program, and has no effect"
            self.add(where, element, name, text, refused=False)
        else:
            known = [each for each, (effect, _) in item.attributes.items() if effect is Effect.READ]
            text = f"unknown attribute {name}={_shown(value)}{_instead(local or name, known)}"
            self.add(where, element, name, text, refused=not looks)

    def unknown(self, child: Element, item: Rule, where: str, *, looks: bool) -> None:
        tag = str(child.tag)
        _, colon, local = tag.partition(":")
        known = [each for each, below in item.children.items() if below.effect is Effect.READ]
        meant = _meant(local or tag, known)
        foreign = meant is None and (bool(colon) or item.extensible) and not _holds(child, known)
        named = f" {child.get('name')!r}" if child.get("name") else ""
        if foreign:
            text = f"<{tag}>{named} is not known, and has no effect"
        else:
            text = f"unknown element <{tag}>{named}{_instead(local or tag, known)}"
        self.add(where, child, tag, text, refused=not (foreign or looks))

    def texts(self, element: Element, item: Rule, where: str, *, looks: bool) -> None:
        if item.has_text:
            return
        found = [element.text, *(child.tail for child in element)]
        words = " ".join(" ".join(text.split()) for text in found if text and not text.isspace())
        if words:
            leaf = not item.children
            text = f"text {_shown(words)} has no meaning here"
            self.add(where, element, "", text, refused=leaf and not looks)


def _where(element: Element, inside: str) -> str:
    """How a message calls an element: by its name, or as a part of what has one."""
    tag, name = str(element.tag), element.get("name")
    top = inside.startswith("<") and " " not in inside
    if name and (top or (tag in NAMED and inside.startswith(NAMED))) and inside:
        return f"{tag} {name!r}"
    return f"<{tag}>" if top or not inside else f"{inside} <{tag}>"


def _shown(value: str) -> str:
    return repr(value if len(value) <= MAX_SHOWN else f"{value[:MAX_SHOWN]}...")


def _meant(word: str, known: Iterable[str]) -> str | None:
    """The listed word that was probably meant."""
    folded = {each.casefold(): each for each in known}
    near = get_close_matches(word[:MAX_SHOWN].casefold(), folded, n=1, cutoff=0.75)
    return folded[near[0]] if near else None


def _instead(word: str, known: Iterable[str]) -> str:
    names = list(known)
    meant = _meant(word, names)
    if meant is not None:
        return f"; did you mean {meant}?"
    return f"; expected {', '.join(names)}" if names else "; expected nothing here"


def _holds(element: Element, known: Iterable[str]) -> bool:
    """Whether an unknown element holds elements that would be read if they were not inside it."""
    names = set(known)
    return any(child.tag in names for child in element.iter() if child is not element)
