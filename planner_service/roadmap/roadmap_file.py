"""Roadmaps in npz files: written whole, with their hash; refused when read if anything in them is not as it was."""

from __future__ import annotations

import io
import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner_service.collision import CheckCounts
from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.json_reader import MAX_BYTES as MAX_HEAD
from planner_service.files.json_reader import Node, parse_json
from planner_service.files.reading import as_path
from planner_service.files.writing import write_whole
from planner_service.geometry.point_files import arrays_of
from planner_service.roadmap.graph import Net
from planner_service.roadmap.roadmap import Built, Roadmap
from planner_service.roadmap.validity import Terms
from planner_service.roadmap.verdicts import NOBODY, Knowledge, Verdict

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
    root = Node("", _head(source, array(HEAD, "u")), [])
    if root.at("format").text() != FORMAT or root.problems:
        raise InvalidFile(source, [f"no roadmap: expected the format {FORMAT!r}"])
    if root.at("version").whole() != VERSION:
        found = repr(root.value["version"]) if "version" in root.value else "is missing"
        raise InvalidFile(source, [f"version {found}; this package reads version {VERSION}"])
    try:
        roadmap = _roadmap(root, array)
    except InvalidFile:
        raise
    except InvalidRequest as error:
        root.problem(str(error))
    if root.problems:
        raise InvalidFile(source, root.problems)
    if roadmap.hash != root.at("hash").text():
        raise InvalidFile(source, ["not what was written: its hash differs"])
    return roadmap


def _head(path: Path, codes: NDArray[Any]) -> Any:
    if codes.ndim != 1 or codes.dtype != np.uint8:
        raise InvalidFile(path, [f"no roadmap: {HEAD}: it holds no bytes"])
    if len(codes) > MAX_HEAD:
        raise InvalidFile(path, [f"no roadmap: {HEAD}: more than {MAX_HEAD:,} bytes"])
    try:
        return parse_json(path, codes.tobytes())
    except InvalidFile as error:
        raise InvalidFile(path, [f"no roadmap: {HEAD}: {problem}" for problem in error.problems]) from None


def _roadmap(root: Node, array: Callable[[str, str], NDArray[Any]]) -> Roadmap:
    plain = Roadmap.of(array("milestones", "f"), reach=array("reach", "f"))
    count = len(plain.milestones)
    edges = _edges(array("edges", "iu"), count)
    grown = [item.whole() for item in root.at("grown").items()]
    if len(grown) != 2:
        raise InvalidRequest("grown", grown, "two whole numbers")
    return Roadmap(
        Net.of(plain.milestones, edges, plain.net.reach, (grown[0], grown[1])),
        _knowledge(root.at("milestone_names"), "milestone", count, array),
        _knowledge(root.at("edge_names"), "edge", len(edges), array),
        root.at("terms").optional(_terms),
        _texts(root.at("pending")),
        root.at("built").optional(_built),
        root.at("fallback").flag(),
        root.at("remember").flag(),
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
    return _read_only(edges)


def _knowledge(node: Node, kind: str, count: int, array: Callable[[str, str], NDArray[Any]]) -> Knowledge:
    names = _texts(node)
    verdicts, blockers = array(f"{kind}_verdicts", "iu"), array(f"{kind}_blockers", "iu")
    for name, found, least, most in (
        ("verdicts", verdicts, 0, max(Verdict)),
        ("blockers", blockers, NOBODY, len(names) - 1),
    ):
        if found.shape != (count,) or not ((found >= least) & (found <= most)).all():
            raise InvalidRequest(f"{kind}_{name}", found.shape, f"{count} whole numbers in [{least}, {int(most)}]")
    return Knowledge(verdicts.astype(np.int8), blockers.astype(np.int32), names)


def _read_only(array: NDArray[np.int64]) -> NDArray[np.int64]:
    array.flags.writeable = False
    return array


def _texts(node: Node) -> tuple[str, ...]:
    return tuple(item.text() for item in node.items())


def _pairs(node: Node) -> tuple[tuple[str, str], ...]:
    pairs = []
    for item in node.items():
        names = _texts(item)
        if len(names) != 2:
            item.wrong("two texts")
            continue
        pairs.append((names[0], names[1]))
    return tuple(pairs)


def _terms(node: Node) -> Terms:
    return Terms(
        node.at("robot").text(),
        node.at("robot_hash").text(),
        _texts(node.at("joint_names")),
        node.at("scene").text(),
        node.at("scene_hash").text(),
        _pairs(node.at("obstacles")),
        node.at("attached").text(),
        _pairs(node.at("allowed")),
        node.at("padding").number(),
        node.at("step").text(),
    )


def _built(node: Node) -> Built:
    settings, counts = node.at("settings"), node.at("counts")
    names = settings.value if isinstance(settings.value, dict) else {}
    if names is not settings.value:
        settings.wrong("an object")
    seed = node.at("seed")
    if type(seed.value) is not int or seed.value < 0:
        seed.wrong("a whole number of at least 0")
    return Built(
        node.at("planner").text(),
        {str(name): settings.at(name).whole() for name in names},
        seed.value,
        CheckCounts(counts.at("states").whole(), counts.at("edges").whole(), counts.at("distances").whole()),
    )
