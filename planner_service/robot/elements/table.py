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
from functools import lru_cache
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from planner_service.files.toml_reader import read_tables

__all__ = ["Effect", "Rule", "Unlisted", "unlisted_words", "words_of"]

MAX_BYTES = 100_000
"""Of a table's file."""

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


@dataclass(frozen=True, eq=False)
class Rule:
    """How an element, its attributes and the elements inside it are read.

    Attributes:
        attributes: Effect and reason by name.
        children: By tag; a rule may be that of several elements.
        closed: Whether what is not listed inside is looked at: not if the whole element is for another program, or
            something else reads and judges it.
        extensible: Whether other programs may add elements of their own, which get a warning and are not refused.
        looks: Whether what is inside only says what a link looks like: then nothing in it is refused.
        one_child: Whether it holds exactly one element: the reader itself refuses any other.
    """

    effect: Effect
    why: str
    attributes: dict[str, tuple[Effect, str]] = field(default_factory=dict)
    children: dict[str, Rule] = field(default_factory=dict)
    closed: bool = False
    extensible: bool = False
    looks: bool = False
    one_child: bool = False


@lru_cache
def words_of(kind: str) -> Rule:
    """The rule of the outermost element of a format: ``urdf``, ``srdf``, ``mjcf`` or ``sdf``.

    Its words are in the TOML file of that name, the outermost element first. There a table is an element: its
    ``effect`` (``read`` if not given) and ``why``, its ``attributes``, and the elements inside, ``elements`` of which
    nothing more is said and those that it ``holds``, each with a table of its own: ``[element.tag]``, else ``[tag]``;
    ``tag:name`` has the table ``[name]``. A row is an effect, words with spaces between them, and why.
    """
    tables = read_tables(Path(__file__).with_name(f"{kind}.toml"), MAX_BYTES)
    return _rule(tables, next(iter(tables.values())), {})


def _rule(tables: Mapping[str, Any], table: Mapping[str, Any], made: dict[int, Rule]) -> Rule:
    """The rule of a table; ``made`` are those begun, as an element may hold its own kind."""
    if id(table) not in made:
        flags = {name: table.get(name, False) for name in ("extensible", "looks", "one_child")}
        rule = Rule(Effect[table.get("effect", "read").upper()], table.get("why", ""), closed=True, **flags)
        made[id(table)] = rule
        for effect, names, why in table.get("attributes", ()):
            rule.attributes.update(dict.fromkeys(names.split(), (Effect[effect.upper()], why)))
        for word in table.get("holds", "").split():
            tag, _, name = word.partition(":")
            rule.children[tag] = _rule(tables, table.get(tag) or tables[name or tag], made)
        for effect, names, why in table.get("elements", ()):
            rule.children.update(dict.fromkeys(names.split(), Rule(Effect[effect.upper()], why)))
    return made[id(table)]


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
