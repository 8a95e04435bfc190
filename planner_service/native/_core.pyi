"""The compiled core (module.cpp)."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

def instruction_sets() -> list[str]:
    """Those this processor can run, the fastest last."""

class _Check:
    """What is known of a configuration or an edge: one of the four is True.

    Attributes:
        refused: It was not checked: it is not in the form the kernel takes, or outside the joint limits.
        free: All of it is.
        colliding: A pair surely overlaps, by more than 0.1 mm.
        undecided: FCL decides: a pair is neither proven apart nor proven to overlap. Or not all rows were checked.
        fraction: Where on the edge it collides or is undecided, 0 to 1; 0 for a configuration of no edge.
        pair: Number of the first pair that collides, or that may.
    """

    @property
    def refused(self) -> bool: ...
    @property
    def free(self) -> bool: ...
    @property
    def colliding(self) -> bool: ...
    @property
    def undecided(self) -> bool: ...
    @property
    def fraction(self) -> float: ...
    @property
    def pair(self) -> int: ...

class RowCheck(_Check):
    """The first row that is not free, if there is one.

    Attributes:
        row: Its number.
        q: The configuration.
        pairs: Numbers of the first pair that may collide and of some more, in their order.
    """

    @property
    def row(self) -> int: ...
    @property
    def q(self) -> list[float]: ...
    @property
    def pairs(self) -> list[int]: ...

class EdgeCheck(_Check):
    """How far an edge was checked.

    Attributes:
        judged: Rows found free, and the one that collides.
        ends: Ends that were to be judged: 1 for the first, 2 for the second, 3 for both.
        segments: Equal parts the edge is split into.
        rows: Where the rows that were to be judged end.
        next: The row to go on with if the edge is undecided.
    """

    @property
    def judged(self) -> int: ...
    @property
    def ends(self) -> int: ...
    @property
    def segments(self) -> int: ...
    @property
    def rows(self) -> int: ...
    @property
    def next(self) -> int: ...

class NearArrays:
    """What ``NearPairs`` holds, and how many pairs were measured."""

    @property
    def rows(self) -> NDArray[np.int64]: ...
    @property
    def pairs(self) -> NDArray[np.int64]: ...
    @property
    def distances(self) -> NDArray[np.float64]: ...
    @property
    def points(self) -> NDArray[np.float64]: ...
    @property
    def gradients(self) -> NDArray[np.float64]: ...
    @property
    def measured(self) -> int: ...

class CollisionKernel:
    """Checks configurations of one robot in one scene. Nothing in it changes once it is configured.

    Args:
        joints, places, solids, runs, pairs, hulls: See ``build_kernel``.
        margin: Metres by which a pair must be proven apart.
        variant: One of ``instruction_sets()``; the fastest if empty.
    """

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
    def variant(self) -> str:
        """The instruction set it uses."""

    def configure(
        self,
        lower: Sequence[float],
        upper: Sequence[float],
        reach: Sequence[float],
        *,
        motion_steps: Sequence[float],
        joint_steps: Sequence[float],
        coarse_segments: int,
    ) -> None:
        """Set what ``check_state`` and ``check_edge`` need: joint limits, and the steps, of which the finest holds.

        Args:
            coarse_segments: Segments between two samples of a coarse check.
        """

    def check_state(self, q: ArrayLike, /) -> RowCheck:
        """Check one configuration; refused unless it is a tuple or an array of n floats within the limits."""

    def check_edge(self, q1: ArrayLike, q2: ArrayLike, known: int, samples: int, max_rows: int) -> EdgeCheck:
        """Check an edge; refused unless its ends are as in ``check_state`` and it has at most 1,000,000 segments.

        Args:
            known: Ends that are not judged, the value of a ``Known``.
            samples: Which samples are judged, the value of a ``Samples``.
            max_rows: How many rows to judge at most; the edge is undecided if there are more.
        """

    def check_rows(self, Q: NDArray[np.float64], start: int, stop: int, /) -> RowCheck:
        """Check rows [start, stop) of Q (m, n)."""

    def check_edge_rows(
        self, a: Sequence[float], b: Sequence[float], ends: int, segments: int, start: int, stop: int, /
    ) -> RowCheck:
        """Check rows [start, stop) of an edge: the ends to judge (1 for a, 2 for b), then the interior."""

    def candidates(self, Q: NDArray[np.float64], /) -> tuple[list[int], list[int]]:
        """Rows of Q (m, n) and numbers of their pairs that are not proven apart, sorted by row, then pair."""

    def samples(self, a: Sequence[float], b: Sequence[float], segments: int, /) -> list[list[float]]:
        """The interior of an edge in the order in which it is judged."""

    def near(self, Q: NDArray[np.float64], within: float, /) -> NearArrays:
        """All pairs nearer than ``within`` metres at rows of Q (m, n), by row. Equal bits on every processor."""
