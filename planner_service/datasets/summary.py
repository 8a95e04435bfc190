"""What a data set holds, in numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from planner_service.geometry.validation import copied_in

__all__ = ["EpisodesSummary"]


@dataclass(frozen=True)
class EpisodesSummary:
    """The size of a data set.

    Attributes:
        requests: Worlds drawn.
        episodes: Worlds in which every motion has a plan; the others are in the table of failures.
        frames: Frames of all episodes.
        failures: Number of failures by reason.
        motions: Motions of all episodes.
        certified: Motions that are proven: all of them.
        motion_seconds: Time in motion, without the gripper's.
        states: States checked for all requests.
        edges: Edges checked.
        distances: Distance bounds computed.
        new: Requests added by this run.
    """

    requests: int
    episodes: int
    frames: int
    failures: Mapping[str, int]
    motions: int
    certified: int
    motion_seconds: float
    states: int
    edges: int
    distances: int
    new: int

    def __post_init__(self) -> None:
        copied_in(self, "failures")
