"""The compiled proof (native/module.cpp)."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

def instruction_sets() -> list[str]: ...

class EdgeAnswer:
    """The verdict on an edge, unless an end was not ``taken``: the value of an ``EdgeVerdict``, a pair, and where."""

    @property
    def taken(self) -> bool: ...
    @property
    def free(self) -> bool: ...
    @property
    def verdict(self) -> int: ...
    @property
    def pair(self) -> int: ...
    @property
    def s(self) -> float: ...

class Hulls:
    def __init__(self, corners: Sequence[NDArray[np.float64]]) -> None: ...
    def extend(
        self, directions: NDArray[np.float64], hulls: NDArray[np.int64], heights: NDArray[np.float64]
    ) -> None: ...

class Diagram:
    @property
    def asked(self) -> float: ...
    @property
    def rectangles(self) -> float: ...
    def blocked(self, lead: float, delay: float, finest: int, /) -> bytes: ...
    def proven(self, level: int, out: NDArray[np.bool_], /) -> None: ...

class Prover:
    def __init__(
        self,
        terms: Sequence[float],
        dof: int,
        bodies: NDArray[np.float64],
        riders: NDArray[np.float64],
        links: NDArray[np.float64],
        hulls: Sequence[NDArray[np.float64]],
        solids: NDArray[np.float64],
        solid_of: NDArray[np.int64],
        turns: NDArray[np.float64],
        turn_of: NDArray[np.int64],
        positions: NDArray[np.float64],
        pairs: NDArray[np.int64],
        trees: NDArray[np.int64],
        children: NDArray[np.int64],
        blocks: NDArray[np.int64],
        limits: NDArray[np.float64],
        variant: str = "",
    ) -> None: ...
    @property
    def variant(self) -> str: ...
    def prove(
        self,
        waypoints: NDArray[np.float64],
        knots: NDArray[np.float64],
        tangents: NDArray[np.float64],
        breaks: NDArray[np.float64],
        lines: NDArray[np.int64],
        blends: NDArray[np.int64],
        corners: NDArray[np.float64],
        spans: NDArray[np.float64],
        roots: NDArray[np.int64],
        enough: float,
        charge: Callable[[int], None] | None,
        walked: tuple[NDArray[Any], ...] | None,
        /,
    ) -> tuple[int, int, float, int, int, float, float, float, float, bytes]: ...
    def edge(
        self, q1: NDArray[np.float64], q2: NDArray[np.float64], enough: float, nearer: float, slack: float, /
    ) -> EdgeAnswer: ...
    def tubes(
        self,
        starts: NDArray[np.float64],
        ends: NDArray[np.float64],
        room: NDArray[np.float64],
        enough: float,
        nearer: float,
        parts: int,
        each: int,
        /,
    ) -> tuple[int, float, int, float, bool]: ...
    def each(
        self,
        starts: NDArray[np.float64],
        ends: NDArray[np.float64],
        room: NDArray[np.float64],
        enough: float,
        nearer: float,
        out: NDArray[np.bool_],
        /,
    ) -> float: ...
    def diagram(
        self,
        q1: NDArray[np.float64],
        travel1: NDArray[np.float64],
        columns1: NDArray[np.int64],
        q2: NDArray[np.float64],
        travel2: NDArray[np.float64],
        columns2: NDArray[np.int64],
        durations: NDArray[np.float64],
        still: NDArray[np.float64],
        enough: float,
        /,
    ) -> Diagram: ...
    def boxes(
        self,
        starts: NDArray[np.float64],
        ends: NDArray[np.float64],
        room: NDArray[np.float64],
        out: NDArray[np.float64],
        /,
    ) -> None: ...
    def clearances(self, Q: NDArray[np.float64], out: NDArray[np.float64], /) -> None: ...
    def near(self, Q: NDArray[np.float64], pairs: NDArray[np.int64], within: float, /) -> bytes: ...
    def stretch(
        self,
        waypoints: NDArray[np.float64],
        knots: NDArray[np.float64],
        tangents: NDArray[np.float64],
        breaks: NDArray[np.float64],
        lines: NDArray[np.int64],
        blends: NDArray[np.int64],
        corners: NDArray[np.float64],
        start: float,
        end: float,
        pairs: NDArray[np.int64],
        directions: NDArray[np.float64],
        /,
    ) -> bytes: ...
