"""Roadmaps in npz files: written whole with their hash, and refused when read if anything in them has changed."""

from __future__ import annotations

import io
import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from planner_service.collision import CheckCounts
from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files import schema
from planner_service.files.json_reader import MAX_BYTES as MAX_HEAD
from planner_service.files.json_reader import parse_json
from planner_service.files.reading import as_path
from planner_service.files.schema import Record, Text
from planner_service.files.writing import write_whole
from planner_service.geometry.arrays import frozen
from planner_service.geometry.scans import arrays_of
from planner_service.geometry.validation import in_file
from planner_service.roadmap.graph import Graph
from planner_service.roadmap.roadmap import Built, Roadmap
from planner_service.roadmap.verdicts import UNKNOWN_BLOCKER, Knowledge, Terms, Verdict

__all__ = ["OURS", "SUFFIX", "load_roadmap", "save_roadmap"]

FORMAT, VERSION = "planner-service/roadmap", 1

SUFFIX = ".npz"

OURS = re.compile(rb"PK\x03\x04.{26}head\.npy", re.DOTALL)
"""How roadmap files begin: an archive whose first member is the head."""

MAX_BYTES = 200_000_000
"""A hundred thousand milestones of fourteen joints with seventy edges each."""

HEAD = "head"
"""The array that holds all but the arrays: the bytes of a JSON object."""


def save_roadmap(roadmap: Roadmap, path: str | os.PathLike[str]) -> None:
    """Write a roadmap to an npz file (of that suffix), whole or not at all.

    Raises:
        InvalidRequest: the path does not end in ``.npz``, or the file would be too large to be loaded again.
        InvalidFile: it cannot be written.
    """
    target = as_path("path", path)
    if target.suffix.lower() != SUFFIX:
        raise InvalidRequest("path", os.fspath(path), f"a path that ends in {SUFFIX}")
    head = {"format": FORMAT, "version": VERSION, "hash": roadmap.hash, **roadmap.head}
    text = json.dumps(head, sort_keys=True, allow_nan=False).encode("ascii")
    schema.recorded("roadmap", lambda: HeadRecord.model_validate_json(text))  # what is written can be read
    if len(text) > MAX_HEAD:
        raise InvalidRequest("roadmap", f"{len(text):,} bytes of names", f"at most {MAX_HEAD:,}")
    arrays = {name: _narrow(array) for name, array in roadmap.arrays.items()}
    packed = io.BytesIO()
    np.savez(packed, **{HEAD: np.frombuffer(text, dtype=np.uint8)}, **arrays)  # type: ignore[arg-type]
    if packed.tell() > MAX_BYTES:
        raise InvalidRequest("roadmap", f"{packed.tell():,} bytes", f"one that fits in {MAX_BYTES:,} bytes")
    write_whole(target, packed.getvalue(), OURS)


def _narrow(array: NDArray[Any]) -> NDArray[Any]:
    """Indices of milestones fit into four bytes."""
    return array.astype(np.int32) if array.dtype == np.int64 else array


def load_roadmap(path: str | os.PathLike[str]) -> Roadmap:
    """The roadmap in a file.

    Raises:
        InvalidFile: no roadmap of this version, or not what was written; it lists all problems found.
    """
    source = as_path("path", path)
    if source.suffix.lower() != SUFFIX:
        raise InvalidFile(source, [f"suffix {source.suffix!r}; expected {SUFFIX}"])
    array = arrays_of(source, MAX_BYTES)
    document = _document(source, array(HEAD, "u"))
    head = schema.read_record(HeadRecord, document, source, schema.Reading())
    roadmap = in_file(source, lambda: _roadmap(head, array))
    if roadmap.hash != head.hash:
        raise InvalidFile(source, [f"hash: got {head.hash!r}; expected that of the content, {roadmap.hash!r}"])
    return roadmap


def _document(path: Path, codes: NDArray[Any]) -> dict[str, Any]:
    """The JSON object in a file; InvalidFile if it is another file, or of another version."""
    if codes.ndim != 1 or codes.dtype != np.uint8:
        raise InvalidFile(path, [f"no roadmap: {HEAD}: it holds no bytes"])
    if len(codes) > MAX_HEAD:
        raise InvalidFile(path, [f"no roadmap: {HEAD}: more than {MAX_HEAD:,} bytes"])
    try:
        document = parse_json(path, codes.tobytes())
    except InvalidFile as error:
        raise InvalidFile(path, [f"no roadmap: {HEAD}: {problem}" for problem in error.problems]) from None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise InvalidFile(path, [f"no roadmap: expected the format {FORMAT!r}"])
    version = document.get("version")
    if type(version) is not int or version != VERSION:
        shown = repr(version) if "version" in document else "is missing"
        raise InvalidFile(path, [f"version {shown}; this package reads version {VERSION}"])
    return document


# The head, declared.

Texts = Annotated[list[Text], schema.FirstOnly()]
Pairs = Annotated[list[schema.NamePair], schema.FirstOnly()]


class TermsRecord(Record, makes=Terms):
    """``Terms``."""

    joint_names: Texts
    obstacles: Pairs
    allowed: Pairs


class CostRecord(Record):
    """``CheckCounts``."""

    makes = CheckCounts

    states: schema.Count
    edges: schema.Count
    distances: schema.Count


class BuiltRecord(Record):
    """``Built``."""

    makes = Built

    planner: Text
    settings: dict[Text, schema.Count]
    seed: Annotated[int, Field(ge=0)]
    counts: CostRecord


class HeadRecord(Record):
    """All of a roadmap but its arrays."""

    format: Literal["planner-service/roadmap"]
    version: Literal[1]
    hash: Text
    terms: TermsRecord | None
    pending: Texts
    built: BuiltRecord | None
    fallback: bool
    remember: bool
    grown: Annotated[list[schema.Count], schema.of_length(2, "two whole numbers")]
    milestone_names: Texts
    edge_names: Texts


# The roadmap, put together.


def _roadmap(head: HeadRecord, array: Callable[[str, str], NDArray[Any]]) -> Roadmap:
    plain = Roadmap.of(array("milestones", "f"), reach=array("reach", "f"))
    count = len(plain.milestones)
    edges = _edges(array("edges", "iu"), count)
    milestones, added = head.grown
    return Roadmap(
        Graph.of(plain.milestones, edges, plain.graph.reach, (milestones, added)),
        _knowledge(tuple(head.milestone_names), "milestone", count, array),
        _knowledge(tuple(head.edge_names), "edge", len(edges), array),
        None if head.terms is None else head.terms.value,
        tuple(head.pending),
        None if head.built is None else head.built.value,
        head.fallback,
        head.remember,
    )


def _edges(found: NDArray[Any], count: int) -> NDArray[np.int64]:
    """Edges as they were written."""
    expected = f"each edge once, as two different milestones of {count}, the smaller index first"
    if found.ndim != 2 or found.shape[1] != 2 or not ((found >= 0) & (found < count)).all():
        raise InvalidRequest("edges", found.shape, expected)
    edges = found.astype(np.int64)
    number = edges[:, 0] * count + edges[:, 1]
    if not (edges[:, 0] < edges[:, 1]).all() or len(np.unique(number)) != len(number):
        raise InvalidRequest("edges", found.shape, expected)
    return frozen(edges)


def _knowledge(names: tuple[str, ...], kind: str, count: int, array: Callable[[str, str], NDArray[Any]]) -> Knowledge:
    """What is known of the milestones, or of the edges."""
    verdicts, blockers = array(f"{kind}_verdicts", "iu"), array(f"{kind}_blockers", "iu")
    for name, numbers, least, most in (
        ("verdicts", verdicts, 0, max(Verdict)),
        ("blockers", blockers, UNKNOWN_BLOCKER, len(names) - 1),
    ):
        if numbers.shape != (count,) or not ((numbers >= least) & (numbers <= most)).all():
            raise InvalidRequest(f"{kind}_{name}", numbers.shape, f"{count} whole numbers in [{least}, {int(most)}]")
    return Knowledge(verdicts.astype(np.int8), blockers.astype(np.int32), names)
