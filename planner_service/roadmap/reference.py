"""A roadmap known only by its hash, as a plan file refers to the roadmap of its plan."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import ClassVar, NoReturn

from planner_service.errors import InvalidRequest
from planner_service.search.problem import SearchProblem

__all__ = ["RoadmapReference"]


@dataclass(frozen=True)
class RoadmapReference:
    """Names the roadmap of a request; it cannot search.

    Attributes:
        hash: ``Roadmap.hash``, 64 hexadecimal digits.

    Raises:
        InvalidRequest: ``hash`` is something else.
    """

    hash: str
    name: ClassVar[str] = "roadmap"
    patience: ClassVar[int | None] = None

    def __post_init__(self) -> None:
        if not isinstance(self.hash, str) or not re.fullmatch("[0-9a-f]{64}", self.hash):
            raise InvalidRequest("hash", self.hash, "the hash of a roadmap, 64 hexadecimal digits")

    def search(self, problem: SearchProblem) -> NoReturn:
        """Refuse.

        Raises:
            InvalidRequest: Always, naming the roadmap that is needed.
        """
        expected = f"that roadmap itself, by Roadmap.load from the file whose hash is {self.hash}"
        message = f"planner: the hash of a roadmap searches nothing; expected {expected}"
        raise InvalidRequest("planner", self, expected, message=message)
