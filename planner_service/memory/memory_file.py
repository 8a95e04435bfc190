"""Memories in JSON files, and in what clients send: with their hash, and refused when read if anything has changed.

What a file says is believed no more than what a plan remembered: each motion in it is a hint, and is proven anew.
"""

from __future__ import annotations

import os
import re
from functools import cached_property
from typing import Annotated, Any, Literal

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files import schema
from planner_service.files.json_reader import MAX_BYTES, read_json
from planner_service.files.json_writer import indented_json
from planner_service.files.reading import as_path
from planner_service.files.schema import Numbers, Record, Text
from planner_service.files.writing import write_whole
from planner_service.memory.memory import MAX_GRIPS, MAX_JOINTS, MAX_MOTIONS, MAX_WAYPOINTS, Memory

__all__ = ["OURS", "MemoryRecord", "load_memory", "save_memory"]

FORMAT, VERSION = "planner-service/memory", 1

OURS = re.compile(rb'\s*\{\s*"format":\s*"planner-service/memory"')
"""How these files begin."""


Waypoints = Annotated[list[Numbers], schema.FirstOnly(), schema.at_most(MAX_WAYPOINTS)]


class RememberedRecord(Record):
    """What is remembered."""

    makes = about = Memory

    joint_names: Annotated[list[Text], schema.FirstOnly(), schema.at_most(MAX_JOINTS)]
    motions: Annotated[list[Waypoints], schema.FirstOnly(), schema.at_most(MAX_MOTIONS)]
    grips: Annotated[list[Numbers], schema.FirstOnly(), schema.at_most(MAX_GRIPS)]


class MemoryRecord(Record):
    """A memory as its file holds it; programs need not look into it, but keep it and send it back as it is.

    Attributes:
        format: Tells memories from other files.
        version: The version of the format.
        hash: SHA-256 of the content.
        memory: The content.
    """

    format: Literal["planner-service/memory"]
    version: Literal[1]
    hash: Text
    memory: RememberedRecord

    @classmethod
    def fields_of(cls, value: Memory) -> dict[str, Any]:
        return {"format": FORMAT, "version": VERSION, "hash": value.hash, "memory": value}

    @cached_property
    def value(self) -> Memory:
        memory: Memory = self.memory.value
        if memory.hash != self.hash:
            raise InvalidRequest("hash", self.hash, f"that of the content, {memory.hash!r}")
        return memory


def save_memory(memory: Memory, path: str | os.PathLike[str]) -> None:
    """Write a memory to a JSON file, whole or not at all.

    Raises:
        InvalidRequest: The file would be too large to be loaded again.
        InvalidFile: It cannot be written.
    """
    text = indented_json(MemoryRecord.of(memory).document()) + "\n"
    if len(text) > MAX_BYTES:
        raise InvalidRequest("memory", f"{len(text):,} bytes", f"one that fits in {MAX_BYTES:,} bytes")
    write_whole(as_path("path", path), text, OURS)


def load_memory(path: str | os.PathLike[str]) -> Memory:
    """The memory in a file.

    Raises:
        InvalidFile: No memory of this version, or not what was written; it lists all problems found.
    """
    source = as_path("path", path)
    document = read_json(source)
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise InvalidFile(source, [f"no memory: expected the format {FORMAT!r}"])
    version = document.get("version")
    if type(version) is not int or version != VERSION:
        shown = repr(version) if "version" in document else "is missing"
        raise InvalidFile(source, [f"version {shown}; this package reads version {VERSION}"])
    memory: Memory = schema.read_record(MemoryRecord, document, source, schema.Reading()).value
    return memory
