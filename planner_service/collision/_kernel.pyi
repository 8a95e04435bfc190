"""The compiled kernel (native/module.cpp)."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Found = tuple[int, float, int]
Doubt = tuple[int, float, list[float], list[int]]

def instruction_sets() -> list[str]: ...

class Kernel:
    def __init__(
        self,
        joints: NDArray[np.float64],
        places: NDArray[np.float64],
        solids: NDArray[np.float64],
        runs: NDArray[np.int64],
        pairs: NDArray[np.int64],
        hulls: Sequence[NDArray[np.float64]],
        margin: float,
        variant: str = "",
    ) -> None: ...
    @property
    def variant(self) -> str: ...
    def candidates(self, Q: NDArray[np.float64], /) -> tuple[list[int], list[int]]: ...
    def first(self, Q: NDArray[np.float64], start: int, stop: int, /) -> Found | Doubt | None: ...
    def edge(
        self, a: Sequence[float], b: Sequence[float], ends: int, segments: int, start: int, stop: int, /
    ) -> Found | Doubt | None: ...
    def agree(
        self, lower: Sequence[float], upper: Sequence[float], reach: Sequence[float], rules: list[tuple[bool, float]], /
    ) -> None: ...
    def state(self, q: object, /) -> Literal[True] | Found | Doubt | None: ...
    def ask(
        self, q1: object, q2: object, known: int, glance: int, many: int, /
    ) -> int | Found | tuple[int, int, int, int, int] | None: ...
    def samples(self, a: Sequence[float], b: Sequence[float], segments: int, /) -> list[list[float]]: ...
    def near(
        self, Q: NDArray[np.float64], within: float, /
    ) -> tuple[
        NDArray[np.int64],
        NDArray[np.int64],
        NDArray[np.float64],
        NDArray[np.float64],
        NDArray[np.float64],
        int,
    ]: ...
