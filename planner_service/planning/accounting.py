"""Keeping the books of one call: which stage cost what, what was noted, and how it ended."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from planner_service.certify import Certificate, Certifier, ExemptInterval, Refusal
from planner_service.collision import CancelToken, CheckCounts, CollisionChecker
from planner_service.collision.budget import Cancelled, Ledger, SearchStopped, TimeBoxSpent
from planner_service.concurrency.fair_lock import Turns
from planner_service.concurrency.polling import ask_from_now_on
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import Trajectory
from planner_service.planning.result import Failure, MotionReport, PlanResult, PolishReport, Reason, Stage, StageReport
from planner_service.roadmap import Roadmap
from planner_service.smoothing.smoothing import LEAST_BLEND

T = TypeVar("T")

__all__ = [
    "Entry",
    "Limits",
    "NoPlan",
    "StageBook",
    "blocked_in_words",
    "in_turn",
    "in_words",
    "narrower",
    "not_certified",
]


class NoPlan(Exception):
    """Unwinds from a stage to the end of the call, with the reason."""

    def __init__(self, failure: Failure, certificate: Certificate | None = None) -> None:
        super().__init__(str(failure))
        self.failure = failure
        self.certificate = certificate


@dataclass(frozen=True)
class Limits:
    """What one call may spend; of its states, searching may use ``search_states``."""

    states: int | None
    search_states: int | None
    seconds: float | None
    token: CancelToken | None


def in_turn(turns: Turns, ledger: Ledger, limits: Limits, act: Callable[[], T]) -> T:
    """What ``act`` returns: called when the turn has come, held to the limits from then on, and polled for.

    However it ends, Ctrl-C at any step included, this thread is as before; what undoes it stands twice for that reason.

    Raises:
        SearchStopped: a limit was reached.
    """

    def wanted() -> None:
        if limits.token is not None and limits.token.cancelled:
            raise Cancelled("cancelled while waiting for its turn")

    def limited() -> T:
        try:
            try:
                ledger.let_go()
                deadline = None if limits.seconds is None else time.monotonic() + limits.seconds
                with ledger.limited(states=limits.states, deadline=deadline, token=limits.token):
                    ask_from_now_on(ledger.poll)
                    return act()
            finally:
                ask_from_now_on(None)
                ledger.let_go()
        finally:
            ask_from_now_on(None)
            ledger.let_go()

    return turns.taken(limited, wanted)


class Entry:
    """What a running stage wants to have written down."""

    def __init__(self) -> None:
        self.note = ""
        self.length: float | None = None


class StageBook:
    """The stages of one call as they happen; its result at the end."""

    def __init__(self, checker: CollisionChecker, limits: Limits) -> None:
        self._checker = checker
        self._ledger = checker.ledger
        self._limits = limits
        self._reports: dict[Stage, StageReport] = {}
        self._stage = Stage.ENDPOINTS
        self._hits = checker.ledger.hits.copy()
        self.notes: list[str] = []
        self.deterministic = True
        self.padding = 0.0
        self.attempts = 0
        self.end_trouble = ""
        self.roadmap: Roadmap | None = None
        self.polish: PolishReport | None = None

    @contextmanager
    def during(self, stage: Stage) -> Iterator[Entry]:
        """Charge what the block costs to ``stage``, however it ends; a stage entered again adds up."""
        self._stage = stage
        entry = Entry()
        counts, clock = self._ledger.counts, time.perf_counter()
        try:
            yield entry
        finally:
            spent, seconds = self._ledger.counts - counts, time.perf_counter() - clock
            before = self._reports.get(stage, StageReport(stage, CheckCounts(), 0.0))
            self._reports[stage] = StageReport(
                stage, before.counts + spent, before.seconds + seconds, entry.length, entry.note
            )

    def within_limits(self, turns: Turns, act: Callable[[], T]) -> T:
        """What ``act`` returns: called when the turn has come, and held to the limits from then on.

        Raises:
            NoPlan: a limit was reached.
        """

        def noted() -> T:
            self._hits = self._checker.ledger.hits.copy()
            return act()

        try:
            return in_turn(turns, self._checker.ledger, self._limits, noted)
        except SearchStopped as stopped:
            raise NoPlan(self._stopped(stopped)) from stopped

    @contextmanager
    def apart(self) -> Iterator[None]:
        """Without a turn and without limits, for what asks nothing but the certifier: it is counted here alone."""
        ledger, self._ledger = self._ledger, Ledger()
        try:
            yield
        finally:
            self._ledger = ledger

    def certificate(
        self,
        certifier: Certifier,
        path: JointPath,
        exempt: Sequence[ExemptInterval],
        part: tuple[float, float] | None = None,
        padding: float = 0.0,
    ) -> Certificate:
        """What can be proven of a path, as the CERTIFY stage; its bounds are counted, and the limits hold."""
        ledger = self._ledger

        def charge(bounds: int) -> None:
            ledger.poll()
            ledger.charge_distances(bounds)

        with self.during(Stage.CERTIFY) as entry:
            found = certifier.certify(path, padding=padding, exempt=exempt, part=part, charge=charge)
            entry.note = f"proven: {in_words(found.clearance)}" if found.certified else f"refused: {found.refusal}"
            return found

    def certified(
        self, certifier: Certifier, path: JointPath, exempt: Sequence[ExemptInterval]
    ) -> tuple[JointPath, Certificate]:
        """The path and what is proven of it; blends that cannot be proven are halved, and in the end stops."""
        while True:
            found = self.certificate(certifier, path, exempt)
            less = None if found.refusal is None else narrower(path, found.refusal)
            if less is None:
                return path, found
            path = less
            self.notes.append(f"blends made narrower: {found.refusal}")

    def result(
        self,
        path: JointPath | None = None,
        timed: tuple[Trajectory, MotionReport] | None = None,
        *,
        failure: Failure | None = None,
        goal_index: int | None = None,
        certificate: Certificate | None = None,
    ) -> PlanResult:
        """The books, closed."""
        trajectory, motion = timed or (None, None)
        return PlanResult(
            path=path,
            trajectory=trajectory,
            failure=failure,
            stages=self._stages,
            goal_index=goal_index,
            attempts=self.attempts,
            padding=self.padding,
            deterministic=self.deterministic,
            certificate=certificate,
            motion=motion,
            notes=tuple(self.notes),
            roadmap=self.roadmap,
            polish=self.polish,
        )

    def with_plan(self, plan: PlanResult) -> PlanResult:
        """A plan made meanwhile, with what these books have beside it; they take over what it cost."""
        for report in plan.stages:
            before = self._reports.get(report.stage, StageReport(report.stage, CheckCounts(), 0.0))
            counts, seconds = before.counts + report.counts, before.seconds + report.seconds
            self._reports[report.stage] = replace(report, counts=counts, seconds=seconds)
        self.attempts += plan.attempts
        self.deterministic &= plan.deterministic
        return replace(
            plan,
            stages=self._stages,
            attempts=self.attempts,
            deterministic=self.deterministic,
            notes=(*self.notes, *plan.notes),
        )

    @property
    def _stages(self) -> tuple[StageReport, ...]:
        return tuple(self._reports[stage] for stage in Stage if stage in self._reports)

    def gave_up(self) -> Failure:
        """The failure of a search that ended by itself without a path."""
        return self._unknown(Reason.PLANNING_FAILED, "the search gave up")

    def _stopped(self, stopped: SearchStopped) -> Failure:
        if isinstance(stopped, Cancelled):
            self.deterministic = False
            return Failure(self._stage, Reason.PREEMPTED, str(stopped))
        if isinstance(stopped, TimeBoxSpent):
            self.deterministic = False
            return self._unknown(Reason.TIMED_OUT, f"the time limit of {self._limits.seconds:g} s passed")
        return self._unknown(
            Reason.CHECK_BUDGET_EXHAUSTED,
            f"no path within the {self._limits.states:,} checks that may be made"
            + (f", {self._limits.search_states:,} of them by a search" if self._stage is Stage.SEARCH else ""),
        )

    def _unknown(self, reason: Reason, what: str) -> Failure:
        """A failure that proves nothing, with what the search kept running into."""
        hits = self._checker.ledger.hits - self._hits
        total = sum(hits.values())
        worst = sorted(hits.items(), key=lambda item: (-item[1], item[0]))[:5]
        blocked = tuple((a, b, count / total) for (a, b), count in worst)
        detail = f"{what}; whether a path exists is unknown{blocked_in_words(blocked)}{self.end_trouble}"
        return Failure(self._stage, reason, detail, blocked_by=blocked)


def not_certified(certificate: Certificate) -> Failure:
    """The failure of a path that could not be proven."""
    return Failure(Stage.CERTIFY, Reason.NOT_CERTIFIED, f"not proven free: {certificate.refusal}")


def narrower(path: JointPath, refusal: Refusal, first: int = 0) -> JointPath | None:
    """The path with the blends halved, from waypoint ``first`` on, that lie where it was refused; None if none does."""
    if refusal.spent:
        return None
    before, after = path.knots - path.blends, path.knots + path.blends
    meant = (path.blends > 0.0) & (np.arange(len(before)) >= first) & (before <= refusal.s) & (after >= refusal.s)
    if not np.any(meant):
        return None
    widths = np.where(meant, path.blends / 2.0, path.blends)
    return path.with_blends(np.where(widths < LEAST_BLEND, 0.0, widths))


def in_words(clearance: float) -> str:
    """A proven clearance in metres, in words; rounded down."""
    if clearance == math.inf:
        return "nothing to touch"
    return f"{math.floor(clearance * 1e5) / 100:.2f} mm clear" if clearance < 0.1 else f"{clearance:.3f} m clear"


def blocked_in_words(blocked: tuple[tuple[str, str, float], ...]) -> str:
    """The pairs most in the way, as the end of a sentence."""
    if not blocked:
        return ""
    return "; most in the way: " + ", ".join(f"{a} x {b} ({share:.0%})" for a, b, share in blocked[:3])
