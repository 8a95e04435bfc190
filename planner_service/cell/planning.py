"""How motions of several arms are brought together: each alone, in turns, or all as one.

Each arm is planned with the others away, and starts as early as the proof between the motions allows, in the best of
all orders. If none is proven, an arm may also stop on its way and wait there. If that does not do, arms are planned
around those that are through and those that wait. If that does not do either, or takes much longer than the longest
motion alone, all are planned as one robot that shares a clock, and the shorter motion is taken.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations, islice, permutations
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from planner_service.cell.clocks import Between, Clock, Turned, best_start, tolerated
from planner_service.cell.goals import goals_of, together
from planner_service.cell.result import CellPlan, OwnClock
from planner_service.cell.services import Services
from planner_service.cell.waits import HALVINGS, Passing, can_pass, waiting
from planner_service.collision import CancelToken
from planner_service.geometry.arrays import FloatArray
from planner_service.planning.request import PlanRequest
from planner_service.planning.result import Failure, PlanResult, Reason, Stage
from planner_service.scene.names import Names

__all__ = ["plan_arms"]

NEAR = 1.15
"""How many times as long as the longest of the arms' own plans motions may take without others being looked for."""

COMBINATIONS = 4
"""Of goals of several arms to which plans are tried."""

SLOWER, SLOWEST = 1.1, 10.0
"""How much slower than it seems to need a motion on a shared clock is made, and at most."""

ROOMIER = (0.01, 0.03)
"""Metres of padding with which it is planned where it tolerates no delay otherwise."""


class _Schedule(NamedTuple):
    """Motions, when each starts, what is proven between each two, and when all are through."""

    plans: Mapping[str, PlanResult]
    starts: dict[str, float]
    pairs: dict[tuple[str, str], Between]
    end: float


def plan_arms(
    services: Services,
    requests: Mapping[str, PlanRequest],
    standing: Mapping[str, FloatArray],
    delay: float,
    cancel: CancelToken | None,
) -> CellPlan:
    """Motions of arms, each of which may be ``delay`` seconds late.

    Args:
        standing: Where arms without a request stand; at home if not named.
    """
    return _Planning(services, requests, standing, delay, cancel).plan()


class _Planning:
    """One call: what it has tried, and what that cost."""

    def __init__(
        self,
        services: Services,
        requests: Mapping[str, PlanRequest],
        standing: Mapping[str, FloatArray],
        delay: float,
        cancel: CancelToken | None,
    ) -> None:
        self._services, self._requests, self._delay, self._cancel = services, requests, delay, cancel
        home = services.joined({})
        self._idle = {
            name: standing.get(name, home[list(part.columns)])
            for name, part in services.parts.items()
            if name not in requests
        }
        self._starts = {name: _inside(services, name, request.start) for name, request in requests.items()}
        self._start = services.joined({**self._idle, **self._starts})
        self._padding = max(request.padding for request in requests.values())
        self._tried: list[PlanResult] = []
        self._asked: list[Between] = []
        self._notes: tuple[str, ...] = ()
        self._known: dict[tuple[str, str], Between] = {}  # of the arms' own plans

    def plan(self) -> CellPlan:
        """The motions, or why there are none."""
        trouble = self._start_trouble()
        if trouble is not None:
            return self._failed(trouble)
        plans: Mapping[str, PlanResult] = {name: self._planned(name, self._idle) for name in self._requests}
        for name, plan in plans.items():
            if plan.failure is not None:
                return self._failed(replace(plan.failure, detail=f"{name}: {plan.failure.detail}"))
        goals: Mapping[str, FloatArray] = {name: plan.unwrap()[0].waypoints[-1] for name, plan in plans.items()}
        if len(goals) > 1 and not self._free(goals):
            plans, goals = self._other_goals(plans, goals)
        longest = max(plan.unwrap()[1].duration for plan in plans.values())
        found = self._own_clocks(plans, goals, NEAR * longest)
        if found is not None and found.duration <= NEAR * longest:
            return found
        together = self._together(goals)
        return together if found is None or (together.ok and together.duration < found.duration) else found

    def _free(self, goals: Mapping[str, FloatArray]) -> bool:
        """Whether all arms can stand at some goals."""
        return self._services.whole.checker.state_is_free(self._services.joined({**self._idle, **goals}))

    def _other_goals(
        self, plans: Mapping[str, PlanResult], goals: Mapping[str, FloatArray]
    ) -> tuple[Mapping[str, PlanResult], Mapping[str, FloatArray]]:
        """Plans to other goals of the requests, at which arms do not touch; the same if there are none."""
        every = {
            name: goals_of(part.robot, self._requests[name], goals[name])
            for name, part in self._services.parts.items()
            if name in self._requests
        }
        for chosen in islice(together(every, self._starts, self._free), COMBINATIONS):
            changed = {name: q for name, q in chosen.items() if not np.array_equal(q, goals[name])}
            others = {name: self._planned(name, self._idle, q) for name, q in changed.items()}
            if all(plan.failure is None for plan in others.values()):
                names = " and ".join(changed)
                self._notes = (f"{names}: another goal than the nearest, at which arms would touch",)
                return {**plans, **others}, chosen
        return plans, goals

    def _own_clocks(
        self, plans: Mapping[str, PlanResult], goals: Mapping[str, FloatArray], enough: float
    ) -> CellPlan | None:
        """The arms' own plans, or if these cannot be brought together, plans in turns; None if none are proven.

        Args:
            enough: Seconds; where a turn takes no longer, others are not looked at.
        """
        orders = list(permutations(plans))
        schedule = self._best_of(orders, plans)
        if schedule is not None:
            return self._done(schedule, ())
        found = list[_Schedule | None]()
        for order in orders:
            turn = self._in_turn(order, plans, goals)
            found.append(None if turn is None else self._schedule(order, turn, {}))
            if found[-1] is not None and found[-1].end <= enough:
                break
        schedule = self._best(found)
        if schedule is None:
            return None
        return self._done(schedule, ("each arm is planned around those that are through, and those that wait",))

    def _start_trouble(self) -> Failure | None:
        """That two arms touch, or an arm that stands and the scene; of one that moves, its plan tells the rest."""
        checker = self._services.whole.checker
        names = Names(self._services.robot, self._services.scene)
        arm_of = {names.link(link): name for name, part in self._services.parts.items() for link in part.moving}
        for a, b in sorted(checker.touching(self._start)):
            arms = {arm_of[label] for label in (a, b) if label in arm_of}
            if len(arms) != 1 or not arms <= self._requests.keys():
                return Failure(Stage.ENDPOINTS, Reason.START_IN_COLLISION, f"{a} x {b} touch at the start")
        return None

    def _planned(self, name: str, standing: Mapping[str, FloatArray], goal: FloatArray | None = None) -> PlanResult:
        request = self._requests[name] if goal is None else replace(self._requests[name], goal=goal)
        plan = self._services.alone(name, standing).plan(request, cancel=self._cancel)
        self._tried.append(plan)
        return plan

    def _in_turn(
        self, order: Sequence[str], own: Mapping[str, PlanResult], goals: Mapping[str, FloatArray]
    ) -> dict[str, PlanResult] | None:
        """Each arm planned with those before it at their goals, those after it at their starts; None if one fails.

        Its own plan stays where that is proven apart from all of them.
        """
        plans = {}
        for k, name in enumerate(order):
            if all(self._clear(name, other, -1) for other in order[:k]) and all(
                self._clear(name, other, 0) for other in order[k + 1 :]
            ):
                plans[name] = own[name]
                continue
            through = {other: goals[other] for other in order[:k]}
            waiting = {other: self._starts[other] for other in order[k + 1 :]}
            plans[name] = self._planned(name, {**self._idle, **through, **waiting}, goals[name])
            if plans[name].failure is not None:
                return None
        return plans

    def _clear(self, name: str, other: str, end: int) -> bool:
        """Whether an arm's own plan is proven apart from another arm at its start (0) or its end (-1)."""
        if (name, other) in self._known:
            return bool(self._known[name, other].proven(HALVINGS)[:, end].all())
        return (other, name) in self._known and bool(self._known[other, name].proven(HALVINGS)[end].all())

    def _best_of(self, orders: Sequence[Sequence[str]], plans: Mapping[str, PlanResult]) -> _Schedule | None:
        """The schedule that ends first: at once if that is proven; None where they cannot pass at all."""
        known, clocks = self._known, {name: self._clock(name, plan) for name, plan in plans.items()}
        between = [self._between(a, b, clocks, known) for a, b in combinations(plans, 2)]
        ends = max(clock.duration for clock in clocks.values())
        if not any(len(each.in_the_way(0.0, self._delay)) for each in between):
            return _Schedule(plans, dict.fromkeys(plans, 0.0), known, ends)
        if not all(map(can_pass, known.values())):  # no order and no stop helps
            return None
        found = [self._schedule(order, plans, known) for order in orders]
        if self._best(found) is None:
            found += [self._passing(order, plans, known) for order in orders]
        return self._best(found)

    def _schedule(
        self, order: Sequence[str], plans: Mapping[str, PlanResult], known: dict[tuple[str, str], Between]
    ) -> _Schedule | None:
        """The earliest starts of arms in an order, those before being kept; None if one has none.

        Args:
            known: What is proven between each two of these plans; more is added.
        """
        clocks = {name: self._clock(name, plan) for name, plan in plans.items()}
        latest = sum(clock.duration for clock in clocks.values()) + len(order) * self._delay
        starts: dict[str, float] = {}
        for name in order:
            pairs = [(self._between(other, name, clocks, known), start) for other, start in starts.items()]
            wait = best_start(pairs, self._delay, latest)
            if wait is None:
                return None
            starts[name] = wait
        return _Schedule(plans, starts, known, max(starts[name] + clocks[name].duration for name in order))

    def _passing(
        self, order: Sequence[str], plans: Mapping[str, PlanResult], known: dict[tuple[str, str], Between]
    ) -> _Schedule | None:
        """As ``_schedule``, where arms may stop on their way for those before them."""
        clocks = {name: self._clock(name, plan) for name, plan in plans.items()}
        timed, starts = dict[str, PlanResult](), dict[str, float]()
        for name in order:
            others = [
                Passing(
                    self._between(other, name, clocks, known), plans[other].unwrap()[1], timed[other].unwrap()[1], start
                )
                for other, start in starts.items()
            ]
            ends = [start + timed[other].unwrap()[1].duration for other, start in starts.items()]
            latest = max(ends, default=0.0) + clocks[name].duration + 2.0 * self._delay
            found = waiting(
                plans[name], self._services.part(name).robot, self._requests[name].pace, others, self._delay, latest
            )
            if found is None:
                return None
            timed[name], starts[name] = found
        pairs = {
            (a, b): known[a, b] if timed[a] is plans[a] and timed[b] is plans[b] else self._between_anew(a, b, timed)
            for a, b in known
        }
        proven = all(
            not len(between.in_the_way(starts[b] - starts[a], self._delay)) for (a, b), between in pairs.items()
        )
        end = max(starts[name] + timed[name].unwrap()[1].duration for name in order)
        return _Schedule(timed, starts, pairs, end) if proven else None

    def _between_anew(self, a: str, b: str, plans: Mapping[str, PlanResult]) -> Between:
        certifier = self._services.between(a, b, self._start)
        clocks = [self._clock(name, plans[name]) for name in (a, b)]
        between = Between(certifier, clocks[0], clocks[1], self._start, self._padding)
        self._asked.append(between)
        return between

    def _between(
        self, a: str, b: str, clocks: Mapping[str, Clock], known: dict[tuple[str, str], Between]
    ) -> Between | Turned:
        """What is proven between two arms, seen from the first: one diagram serves both ways."""
        if (b, a) in known:
            return Turned(known[b, a])
        if (a, b) not in known:
            certifier = self._services.between(a, b, self._start)
            known[a, b] = Between(certifier, clocks[a], clocks[b], self._start, self._padding)
            self._asked.append(known[a, b])
        return known[a, b]

    def _clock(self, name: str, plan: PlanResult) -> Clock:
        return Clock.of(plan.unwrap()[1], self._services.part(name).columns)

    @staticmethod
    def _best(schedules: Sequence[_Schedule | None]) -> _Schedule | None:
        return min((each for each in schedules if each is not None), key=lambda each: each.end, default=None)

    def _done(self, schedule: _Schedule, notes: tuple[str, ...]) -> CellPlan:
        lates = [
            tolerated(between, schedule.starts[second] - schedule.starts[first], self._delay)
            for (first, second), between in schedule.pairs.items()
        ]
        clocks = [
            OwnClock((name,), schedule.plans[name], start, (tuple(self._services.part(name).columns),))
            for name, start in sorted(schedule.starts.items(), key=lambda item: item[1])
        ]
        return self._result(clocks, min(lates, default=math.inf), None, notes)

    def _together(self, goals: Mapping[str, FloatArray]) -> CellPlan:
        """All arms as one robot; how late each may be is proven as for clocks of their own."""
        request = self._shared_request(goals)
        if isinstance(request, Failure):
            return self._failed(request)
        first = request
        best, columns = 0.0, tuple(tuple(self._services.part(name).columns) for name in self._requests)
        for padding in (first.padding, *(each for each in ROOMIER if each > first.padding)):
            slower, notes = 1.0, ["all arms are planned as one robot and share a clock"]
            while slower <= SLOWEST:
                plan = self._services.whole.plan(_paced(request, padding, slower), cancel=self._cancel)
                self._tried.append(plan)
                if plan.failure is not None:
                    break
                late = self._shared_clock(plan)
                if late >= self._delay:
                    clock = OwnClock(tuple(self._requests), plan, 0.0, columns)
                    return self._result([clock], late, None, tuple(notes))
                best = max(best, late)
                slower *= SLOWER * self._delay / late if late > 0.0 else math.inf
                notes[1:] = [f"{slower:.1f} times as slow as it could be, so that arms may be late"]
            if plan.failure is not None and padding == first.padding:
                return self._failed(replace(plan.failure, detail=f"all arms as one: {plan.failure.detail}"))
        detail = f"no motion was found that tolerates {self._delay:g} s of delay; one tolerates {best:.3f} s"
        return self._failed(Failure(Stage.CERTIFY, Reason.NOT_CERTIFIED, detail))

    def _shared_request(self, goals: Mapping[str, FloatArray]) -> PlanRequest | Failure:
        """What is asked of all arms as one robot: as slow as the slowest, with the most padding.

        What one arm keeps, its tool's speed, constraints or torques, is not asked of another robot: there is none then.
        """
        asked = list(self._requests.values())
        first = asked[0]
        for name, request in self._requests.items():
            if len(asked) > 1 and (
                request.constraints or request.max_tool_speed is not None or request.pace.keeps_torques
            ):
                detail = (
                    f"no motions on clocks of their own are proven, and what {name} keeps is not planned for all as one"
                )
                return Failure(Stage.SEARCH, Reason.PLANNING_FAILED, detail)
            if request.timing != first.timing:
                detail = f"no motions on clocks of their own are proven, and {name} has another timing law"
                return Failure(Stage.SEARCH, Reason.PLANNING_FAILED, detail)
        return replace(
            first,
            start=self._start,
            goal=self._services.joined({**self._idle, **goals}),
            velocity_scale=min(request.velocity_scale for request in asked),
            acceleration_scale=min(request.acceleration_scale for request in asked),
            padding=self._padding,
        )

    def _shared_clock(self, plan: PlanResult) -> float:
        """The delay that arms that share a clock tolerate."""
        trajectory, clocks = plan.unwrap()[1], dict[str, Clock]()
        for name in self._requests:
            own = self._services.part(name).columns
            clocks[name] = Clock.of(trajectory, own, own)
        lates = []
        for a, b in combinations(clocks, 2):
            certifier = self._services.between(a, b, self._start)
            between = Between(certifier, clocks[a], clocks[b], self._start)  # padding is kept at samples of the search
            self._asked.append(between)
            proven = self._delay > 0.0 and not len(between.in_the_way(0.0, self._delay))
            lates.append(tolerated(between, 0.0, self._delay if proven else 0.0))
        return min(lates)

    def _failed(self, failure: Failure) -> CellPlan:
        return self._result([], 0.0, failure, ())

    def _result(
        self, clocks: Sequence[OwnClock], late: float, failure: Failure | None, notes: tuple[str, ...]
    ) -> CellPlan:
        rectangles, bounds = (sum(getattr(each, what) for each in self._asked) for what in ("rectangles", "bounds"))
        return CellPlan(
            tuple(clocks), late, failure, self._start, rectangles, bounds, tuple(self._tried), (*self._notes, *notes)
        )


def _inside(services: Services, name: str, given: ArrayLike) -> FloatArray:
    """A start within the limits, as a plan clamps it."""
    q = np.asarray(given, dtype=np.float64)
    limits = services.part(name).robot.around(q).limits
    return np.clip(q, limits.lower, limits.upper)


def _paced(request: PlanRequest, padding: float, slower: float) -> PlanRequest:
    """A request with more padding, and its motion slower along the same path."""
    scales = request.velocity_scale / slower, request.acceleration_scale / slower**2
    return replace(request, padding=padding, velocity_scale=scales[0], acceleration_scale=scales[1])
