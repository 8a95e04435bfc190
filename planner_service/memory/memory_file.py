"""Memories in JSON files: written whole with their hash, and refused when read if anything in them has changed.

What a file says is believed no more than what a plan remembered: each motion in it is a hint, and is proven anew.
"""

from __future__ import annotations

import os
import re
from typing import Annotated, Literal

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files import schema
from planner_service.files.json_reader import MAX_BYTES, read_json
from planner_service.files.json_writer import indented_json
from planner_service.files.reading import as_path
from planner_service.files.schema import Record, Rows, Text
from planner_service.files.writing import write_whole
from planner_service.geometry.validation import in_file
from planner_service.memory.memory import MAX_GRIPS, MAX_JOINTS, MAX_MOTIONS, Memory

__all__ = ["OURS", "load_memory", "save_memory"]

FORMAT, VERSION = "planner-service/memory", 1

OURS = re.compile(rb'\s*\{\s*"format":\s*"planner-service/memory"')
"""How these files begin."""


class MemoryRecord(Record):
    """What is remembered."""

    makes = Memory

    joint_names: Annotated[list[Text], schema.FirstOnly(), schema.at_most(MAX_JOINTS)]
    motions: Annotated[list[Rows], schema.FirstOnly(), schema.at_most(MAX_MOTIONS)]
    grips: Annotated[Rows, schema.at_most(MAX_GRIPS)]


class FileRecord(Record):
    """A file of it."""

    format: Literal["planner-service/memory"]
    version: Literal[1]
    hash: Text
    memory: MemoryRecord


def save_memory(memory: Memory, path: str | os.PathLike[str]) -> None:
    """Write a memory to a JSON file, whole or not at all.

    Raises:
        InvalidRequest: The file would be too large to be loaded again.
        InvalidFile: It cannot be written.
    """
    content = MemoryRecord.of(memory).document()
    text = indented_json({"format": FORMAT, "version": VERSION, "hash": memory.hash, "memory": content}) + "\n"
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
    record = in_file(source, lambda: schema.read_record(FileRecord, document, source, schema.Reading()))
    memory: Memory = record.memory.value
    if memory.hash != record.hash:
        raise InvalidFile(source, [f"hash: got {record.hash!r}; expected that of the content, {memory.hash!r}"])
    return memory
