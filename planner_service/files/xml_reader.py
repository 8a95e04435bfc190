"""Reading XML safely: UTF-8 only, no document type, no entities, and caps on depth, elements and names."""

from __future__ import annotations

import reprlib
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

from planner_service.errors import InvalidFile
from planner_service.files.reading import read_bytes

__all__ = ["MAX_XML_BYTES", "Malformed", "parse_xml", "read_xml"]

MAX_XML_BYTES = 10_000_000
"""Ten times the largest URDF seen in the wild."""
MAX_DEPTH = 64
"""URDF nests five deep, COLLADA about ten."""
MAX_ELEMENTS = 500_000
"""An element takes a few hundred bytes of memory, and four bytes of a file."""
MAX_NAME = 500
"""Characters of a name, which messages repeat."""


class Malformed(Exception):
    """The content of a file is not what it should be; the message says why."""


def read_xml(path: Path, root_tag: str) -> ElementTree.Element:
    """The root element of a UTF-8 XML file without DTD or entities, at most 10 MB.

    Raises:
        InvalidFile: unreadable, too large, too deep, a name too long, not UTF-8, not well-formed, or another root.
    """
    content = read_bytes(path, MAX_XML_BYTES)
    try:
        root = parse_xml(content)
    except Malformed as error:
        raise InvalidFile(path, [str(error)]) from None
    if root.tag != root_tag:
        raise InvalidFile(path, [f"the root element is <{root.tag}>; expected <{root_tag}>"])
    return root


def parse_xml(content: bytes) -> ElementTree.Element:
    """The root element of a UTF-8 XML text without DTD or entities.

    Raises:
        Malformed: too deep, too many elements, a name of more than 500 characters, not UTF-8 or not well-formed.
    """
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise Malformed("not UTF-8 text") from None
    for mark in ("<!DOCTYPE", "<!ENTITY"):
        if mark in text.upper():
            raise Malformed(f"{mark} is not allowed: write the file without a document type or entities")
    parser, tree = expat.ParserCreate(), _Limited()  # prefixes stay as they are: their names may be long, and many
    parser.buffer_text = True
    parser.StartElementHandler, parser.EndElementHandler = tree.start, tree.end
    parser.CharacterDataHandler = tree.data
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise Malformed(f"not well-formed XML: {error}") from None
    return tree.close()


class _Limited(ElementTree.TreeBuilder):
    def __init__(self) -> None:
        super().__init__()
        self.depth = self.count = 0

    def start(self, tag: str, attrs: dict[str, str], /) -> ElementTree.Element:
        self.depth += 1
        self.count += 1
        if self.depth > MAX_DEPTH:
            raise Malformed(f"elements nested deeper than {MAX_DEPTH}")
        if self.count > MAX_ELEMENTS:
            raise Malformed(f"more than {MAX_ELEMENTS:,} elements")
        if len(attrs.get("name", "")) > MAX_NAME:
            raise Malformed(f"the name {reprlib.repr(attrs['name'])} is longer than {MAX_NAME} characters")
        return super().start(tag, attrs)

    def end(self, tag: str, /) -> ElementTree.Element:
        self.depth -= 1
        return super().end(tag)
