"""The other planners of OMPL (search/planners.py), which are loaded with their first use."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from planner_service.search.planners import BiasedTree, OmplSearch, Settings, Tree
from planner_service.search.problem import SearchProblem, SearchResult

__all__ = [
    "AORRTC",
    "BFMT",
    "BKPIECE1",
    "FMT",
    "KPIECE1",
    "LBKPIECE1",
    "BITstar",
    "InformedRRTstar",
    "RRTstar",
    "SORRTstar",
]

_DEFAULT_CHECKS = 20_000
"""States after which an anytime planner stops improving: about ten times what a first path costs."""


@dataclass(frozen=True)
class _Rewiring(OmplSearch):
    """A planner that rewires its tree for ever shorter paths."""

    range: float = 0.5
    goal_bias: float = 0.05
    checks: int = _DEFAULT_CHECKS

    @property
    def patience(self) -> int | None:  # type: ignore[override]
        """As many states as it may use to improve a path."""
        return self.checks


@dataclass(frozen=True)
class _Batch(Settings):
    """A planner that draws one batch of samples, and a batch of twice the size each time it fails for all goals."""

    samples: int = 100

    def search(self, problem: SearchProblem) -> SearchResult:
        """See ``Planner``."""
        from planner_service.search import ompl

        return ompl.solve_in_batches(problem, type(self).__name__, self.samples)


@dataclass(frozen=True)
class RRTstar(_Rewiring):
    """One tree that is rewired for ever shorter paths (Karaman & Frazzoli, IJRR 30(7), 2011).

    Attributes:
        range: Longest edge of the tree before rewiring, in joint distance (rad).
        goal_bias: Share of the samples that are a goal.
        checks: States after which it ends with its best path; without one it goes on.
    """

    name: ClassVar[str] = "rrtstar"


@dataclass(frozen=True)
class InformedRRTstar(_Rewiring):
    """RRTstar that samples only where a shorter path may run (Gammell, Srinivasa & Barfoot, IROS 2014).

    Attributes:
        range: Longest edge of the tree before rewiring, in joint distance (rad).
        goal_bias: Share of the samples that are a goal.
        checks: States after which it ends with its best path; without one it goes on.
    """

    name: ClassVar[str] = "informedrrtstar"


@dataclass(frozen=True)
class SORRTstar(_Rewiring):
    """InformedRRTstar over batches sorted by promise (Gammell, Barfoot & Srinivasa, IEEE T-RO 34(4), 2018).

    Attributes:
        range: Longest edge of the tree before rewiring, in joint distance (rad).
        goal_bias: Share of the samples that are a goal.
        checks: States after which it ends with its best path; without one it goes on.
    """

    name: ClassVar[str] = "sorrtstar"


@dataclass(frozen=True)
class BITstar(OmplSearch):
    """Batches of samples searched best first, edges judged only on promising paths (Gammell et al., IJRR 39(5), 2020).

    Attributes:
        samples: Samples per batch.
        checks: States after which it ends with its best path; without one it goes on.
    """

    samples: int = 100
    checks: int = _DEFAULT_CHECKS
    name: ClassVar[str] = "bitstar"


@dataclass(frozen=True)
class AORRTC(OmplSearch):
    """RRTConnect repeated with a shrinking bound on the path's length (Wilson et al., arXiv 2505.10542).

    Attributes:
        range: Longest edge, in joint distance (rad).
        checks: States after which it ends with its best path; without one it goes on. OMPL's own
            shortening of a path is not interrupted and may add a few thousand.
    """

    range: float = 0.5
    checks: int = _DEFAULT_CHECKS
    name: ClassVar[str] = "aorrtc"


@dataclass(frozen=True)
class FMT(_Batch):
    """A tree marching through one batch of samples in order of cost (Janson et al., IJRR 34(7), 2015).

    Goals are tried in order; when all fail, the batch is doubled.

    Attributes:
        samples: Free samples of the first batch. Its edges are long: with six joints 100 samples
            cost some 30,000 states, 1000 five times as many.
    """

    name: ClassVar[str] = "fmt"


@dataclass(frozen=True)
class BFMT(_Batch):
    """FMT from both ends at once (Starek et al., IROS 2015).

    Attributes:
        samples: Free samples of the first batch.
    """

    name: ClassVar[str] = "bfmt"


@dataclass(frozen=True)
class KPIECE1(BiasedTree):
    """One tree that grows where a grid of its projection is least covered (Sucan & Kavraki, WAFR 2008).

    Attributes:
        range: Longest edge, in joint distance (rad).
        goal_bias: Share of the extensions that aim at a goal.
    """

    name: ClassVar[str] = "kpiece1"


@dataclass(frozen=True)
class BKPIECE1(Tree):
    """KPIECE1 from both ends at once.

    Attributes:
        range: Longest edge, in joint distance (rad).
    """

    name: ClassVar[str] = "bkpiece1"


@dataclass(frozen=True)
class LBKPIECE1(Tree):
    """BKPIECE1 that judges an edge only once a path needs it.

    Attributes:
        range: Longest edge, in joint distance (rad).
    """

    name: ClassVar[str] = "lbkpiece1"
