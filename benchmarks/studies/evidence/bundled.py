"""Forgeries of what is looked at together: cells of a cloud in boxes, and runs of pieces as bundles."""

from __future__ import annotations

import base64
import random
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np

from auditor.trails import packed_cells, unpacked
from planner_service.records.evidence import packed

if TYPE_CHECKING:
    from benchmarks.studies.evidence.forgeries import Forger

__all__ = ["change_bundles"]


def change_bundles(forger: Forger) -> None:
    """Cells, boxes, runs and their order: some left out, moved, doubled, swapped or cut off."""
    chance, proof = forger.chance, forger.proofs[forger.one()]
    boxes, clouds = (
        forger.section["boxes"],
        [it["shape"] for it in forger.scene["obstacles"] if "packed" in it["shape"]],
    )
    ways = ["run"] + ["box", "box"] * bool(boxes) + ["cell"] * bool(clouds) + ["crowd", "crowd"] * ("crowd" in proof)
    way = chance.choice(ways)
    if way == "box":
        name = chance.choice(sorted(boxes))
        changed = changed_rows(unpacked(boxes[name], "<f8", 6), chance)
        if chance.random() < 0.3:
            changed[chance.randrange(len(changed)), chance.randrange(6)] += chance.choice((-0.02, 0.02, 0.05, 1e-3))
        boxes[name] = cut(packed(changed, "<f8"), chance)
    elif way == "cell":
        cloud = chance.choice(clouds)
        cells = changed_rows(packed_cells(cloud), chance)
        if chance.random() < 0.5:
            cells[chance.randrange(len(cells)), chance.randrange(3)] += chance.choice((-1, 1, 5))
        steps = np.diff(cells, axis=0, prepend=np.zeros((1, 3), np.int64)).T
        cloud["packed"] = cut(packed(steps, "<i4"), chance)
    elif way == "crowd":
        proof["crowd"] = cut(packed(changed_rows(unpacked(proof["crowd"], "<i4", 1), chance), "<i4"), chance)
    else:
        pairs = unpacked(proof["pairs"], "<i4", 3).copy()
        at = chance.choice(np.flatnonzero(pairs[:, 2] > 1).tolist() or [0])
        pairs[at, chance.choice((1, 2))] += chance.choice((-1, 1, 7, 64))
        proof["pairs"] = packed(pairs, "<i4")


def changed_rows(rows: Any, chance: random.Random) -> Any:
    """The rows, one of them left out, there twice or in the place of another, or two of them swapped."""
    i, j = chance.randrange(len(rows)), chance.randrange(len(rows))
    kind, rows = chance.randrange(5), rows.copy()
    if kind == 0:
        return np.delete(rows, i, axis=0)
    if kind == 1:
        return np.insert(rows, i, rows[j], axis=0)
    if kind == 2:
        rows[i] = rows[j]
    elif kind == 3:
        rows[[i, j]] = rows[[j, i]]
    return rows


def cut(text: str, chance: random.Random) -> str:
    """Mostly the same; else the table cut off, or with something behind it."""
    data = base64.b64decode(text)
    if chance.random() < 0.9:
        return text
    return base64.b64encode(chance.choice((data[:-6], data[: len(data) // 2], data + zlib.compress(b"more")))).decode()
