"""Poses as JSON objects, and records that say by their kind what they are."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from planner_service.files.schema import Record, Vector3, Vector4
from planner_service.geometry.shapes import Pose

__all__ = ["KindRecord", "PoseRecord"]


class PoseRecord(Record):
    """A ``Pose``."""

    makes = Pose

    position: Vector3
    quaternion: Vector4 = Field(alias="quaternion_wxyz")


class KindRecord(Record):
    """One of several kinds of value; ``kind`` says which."""

    @property
    def arguments(self) -> dict[str, Any]:
        return {name: value for name, value in super().arguments.items() if name != "kind"}
