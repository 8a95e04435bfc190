"""What an explanation holds, as JSON objects and back: proofs that no path exists, and how far a search came."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np

from planner_service.decomposition.no_path import MOST_JOINTS, NoPath
from planner_service.decomposition.walls import Witness
from planner_service.errors import InvalidRequest
from planner_service.files.schema import Count, Joints, Numbers, Record, Text, at_most, of_length
from planner_service.geometry.arrays import read_only
from planner_service.infeasibility.reached import Reached
from planner_service.records.result import PairList
from planner_service.records.scene import Packed, packed, unpacked

__all__ = ["NoPathRecord", "ReachedRecord"]

Few = at_most(MOST_JOINTS)


class NoPathRecord(Record):
    """A ``NoPath``.

    Attributes:
        walls: For each the numbers of its lower and its upper corner, and of its pair: base64 of rows of 2 k + 1
            little-endian 64-bit integers.
        region: For each of its boxes the numbers of its lower and its upper corner: base64 of rows of 2 k
            little-endian 64-bit integers, for k joints.
        witness: For each wall a point of each solid and how deep it lies in it, in metres: base64 of rows of 8
            little-endian 64-bit floats.
        range_lower: Least value of each of these joints, in radians (metres if it slides); of a joint without end a
            whole turn is cut.
        range_upper: Largest value of each, likewise.
        divisions: Into how many parts the range of each is cut.
    """

    about = NoPath

    joints: Annotated[list[Text], Few]
    pairs: PairList
    boxes: Count
    distances: Count
    encloses: Literal["start", "goals"]
    range_lower: Annotated[Numbers, Few]
    range_upper: Annotated[Numbers, Few]
    divisions: Annotated[list[Count], Few]
    region: Packed
    walls: Packed
    witness: Packed

    @classmethod
    def fields_of(cls, value: NoPath) -> dict[str, Any]:
        k, shown = len(value.joints), value.witness
        walls = np.column_stack([value.wall_cells.reshape(-1, 2 * k), value.wall_pairs])
        return super().fields_of(value) | {
            "region": packed(value.region_cells, "<i8"),
            "walls": packed(walls, "<i8"),
            "witness": packed(np.column_stack([shown.centres.reshape(-1, 6), shown.depths]), "<f8"),
        }

    @cached_property
    def value(self) -> NoPath:
        k = len(self.joints)
        for name in ("range_lower", "range_upper", "divisions"):
            if len(getattr(self, name)) != k or k == 0:
                raise InvalidRequest(name, getattr(self, name), f"one number for each of the {k} joints, at least one")
        region, walls = (
            np.asarray(unpacked(name, getattr(self, name), "<i8", columns), dtype=np.int64)
            for name, columns in (("region", 2 * k), ("walls", 2 * k + 1))
        )
        shown = unpacked("witness", self.witness, "<f8", 8)
        if not ((walls[:, -1] >= 0) & (walls[:, -1] < len(self.pairs))).all():
            raise InvalidRequest("walls", walls[:, -1].tolist()[:10], f"numbers of the {len(self.pairs)} pairs")
        if len(shown) != len(walls) or not np.isfinite(shown).all():
            raise InvalidRequest("witness", f"{len(shown)} rows", f"finite numbers for each of {len(walls)} walls")
        return NoPath(
            tuple(self.joints),
            self.arguments["pairs"],
            self.boxes,
            self.distances,
            self.encloses,
            read_only(self.range_lower),
            read_only(self.range_upper),
            np.array(self.divisions, dtype=np.int64),
            region.reshape(-1, 2, k),
            walls[:, :-1].reshape(-1, 2, k),
            walls[:, -1],
            Witness(shown[:, :6].reshape(-1, 2, 3), shown[:, 6:]),
        )


class ReachedRecord(Record):
    """A ``Reached``; a clearance is null where there is nothing to hit.

    Attributes:
        clearance: Proven lower bound of the smallest gap, in metres, of the reached configurations that are nearest
            to the other side; null if there is nothing to hit.
    """

    about = Reached

    nearest: Annotated[list[Joints], of_length(2, "two configurations")]
    gap: float
    tool_gap: float
    clearance: float | None
    milestones: Annotated[list[Count], of_length(2, "two numbers of configurations")]

    @classmethod
    def fields_of(cls, value: Reached) -> dict[str, Any]:
        clearance = None if math.isinf(value.clearance) else value.clearance
        return super().fields_of(value) | {"clearance": clearance}

    @cached_property
    def value(self) -> Reached:
        clearance = math.inf if self.clearance is None else self.clearance
        start, goals = self.milestones
        return Reached(read_only(self.nearest), self.gap, self.tool_gap, clearance, (start, goals))
