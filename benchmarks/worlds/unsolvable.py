"""Stored queries without a plan, drawn once with seed 2026.

- Pockets: a link of few joints stands in a collar of four plates, the goal outside. A flood fill on plates thinned by
  what a grid's steps move the link decided that the start is enclosed, not a proof of the product.
- Tool poses of the WidowX AI of which every configuration collides with a block: its closed form gives all of them.
- Failures for ``explain``: blocks at goals, walls on the way, leans that a constraint forbids; each failed once.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import planner_service as ps
from planner_service.geometry.arrays import FloatArray, read_only
from planner_service.records.request import RequestRecord
from planner_service.records.scene import SceneRecord

__all__ = ["POSES_ROBOT", "BlockedPose", "Pocket", "StoredFailure", "load_failures", "load_pockets", "load_poses"]

FOLDER = Path(__file__).parents[1] / "queries"

POSES_ROBOT = "wxai"


@dataclass(frozen=True, eq=False)
class Pocket:
    """No path leads from ``start`` to ``goal``; the link that is enclosed is moved by the first ``joints`` joints."""

    robot: str
    joints: int
    plates: tuple[ps.Obstacle, ...]
    start: FloatArray
    goal: FloatArray

    @property
    def scene(self) -> ps.Scene:
        return ps.Scene(self.plates)


@dataclass(frozen=True)
class BlockedPose:
    """No configuration of ``pose`` is free: a cube of so many metres is there; ``solutions`` of them are in limits."""

    pose: ps.Pose
    edge: float
    solutions: int

    @property
    def scene(self) -> ps.Scene:
        return ps.Scene((ps.Obstacle("block", ps.Box((self.edge, self.edge, self.edge)), self.pose),))


@dataclass(frozen=True, eq=False)
class StoredFailure:
    """A request without a plan, and what was done to it."""

    kind: str
    robot: str
    scene: ps.Scene
    request: ps.PlanRequest


def _rows(name: str, key: str) -> list[Any]:
    return list(json.loads((FOLDER / f"{name}.json").read_text("utf-8"))[key])


def load_pockets() -> tuple[Pocket, ...]:
    """The stored pockets."""

    def plate(k: int, row: Any) -> ps.Obstacle:
        return ps.Obstacle(f"plate_{k}", ps.Box(row[:3]), ps.Pose(row[3:6], row[6:]))

    return tuple(
        Pocket(
            row["robot"],
            row["joints"],
            tuple(plate(*each) for each in enumerate(row["plates"])),
            read_only(row["start"]),
            read_only(row["goal"]),
        )
        for row in _rows("pockets", "pockets")
    )


def load_poses() -> tuple[BlockedPose, ...]:
    """The stored tool poses."""
    return tuple(BlockedPose(ps.Pose(row[:3], row[3:7]), row[7], row[8]) for row in _rows("blocked_poses", "poses"))


def load_failures() -> tuple[StoredFailure, ...]:
    """The stored failures."""

    def read(row: dict[str, Any]) -> StoredFailure:
        scene, request = SceneRecord.model_validate(row["scene"]), RequestRecord.model_validate(row["request"])
        return StoredFailure(row["kind"], row["robot"], scene.value, request.value)

    return tuple(map(read, _rows("failures", "failures")))
