"""Many plans at once: requests go to an engine's workers, results come back in their order."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import chain, islice

from planner_service.errors import InvalidRequest
from planner_service.geometry.shapes import items
from planner_service.parallel import Answers, Engine, Lost, Processes
from planner_service.planners import RRTConnect
from planner_service.planning.request import PlanRequest
from planner_service.planning.result import Failure, Origin, PlanResult, Reason, Stage
from planner_service.presentation.progress import bar
from planner_service.roadmap import Roadmap

__all__ = ["GRACE", "Batch", "Interrupted"]

GRACE = 10.0
"""Seconds over its time limit after which a plan is ended from outside: it hangs where it cannot look at the clock. A
worker's first plan among thousands of obstacles builds what it needs before its clock starts."""

Item = tuple[PlanRequest, int | None]
"""A request, and which of the roadmaps that were sent before is its planner; None for one of its own."""


class Interrupted(KeyboardInterrupt):
    """Ctrl-C while many plans were made. Its workers have been ended.

    Attributes:
        results: Those that were finished, by the index of their request.
    """

    def __init__(self, results: dict[int, PlanResult]) -> None:
        super().__init__(f"{len(results)} results were finished")
        self.results = results


@dataclass(frozen=True, eq=False)
class _Plans:
    """The work: plans of one service, whose method crosses with all that it is made from."""

    plan: Callable[[PlanRequest], PlanResult]
    roadmaps: tuple[Roadmap, ...]

    def prepare(self) -> None:
        """The service was built when the method arrived; roadmaps are prepared by the plans, before their clocks."""

    def __call__(self, item: Item) -> PlanResult:
        request, roadmap = item
        if roadmap is not None:
            request = replace(request, planner=self.roadmaps[roadmap])
        return replace(self.plan(request), roadmap=None)


@dataclass(frozen=True)
class Batch:
    """What ``plan_many`` and ``plan_stream`` of a service do.

    Attributes:
        plan: The service's.
        require: Refuses a request that ``plan`` refuses, without planning.
        origin: Where the result of a request comes from, seen from here.
    """

    plan: Callable[[PlanRequest], PlanResult]
    require: Callable[[PlanRequest], None]
    origin: Callable[[PlanRequest], Origin]

    def results(
        self, requests: Iterable[PlanRequest], engine: Engine | None, progress: bool | None
    ) -> list[PlanResult]:
        """See ``PlannerService.plan_many``."""
        asked = items("requests", requests, PlanRequest, "a PlanRequest")
        answers, results = self._started(asked, engine), list[PlanResult]()
        try:
            with closing(answers), bar("plans", progress) as told:
                for index, answer in answers:
                    results.append(self._result(answer, asked[index]))
                    if told is not None:
                        told(len(results), len(asked))
        except KeyboardInterrupt:
            late = {index: self._result(answer, asked[index]) for index, answer in answers.finished.items()}
            raise Interrupted(dict(enumerate(results)) | late) from None
        return results

    def stream(self, requests: Iterable[PlanRequest], engine: Engine | None) -> Generator[PlanResult, None, None]:
        """See ``PlannerService.plan_stream``."""
        asked = deque[PlanRequest]()
        return self._handed_out(self._started(requests, engine, asked.append), asked)

    def _handed_out(self, answers: Answers[PlanResult], asked: deque[PlanRequest]) -> Generator[PlanResult, None, None]:
        with closing(answers):
            for _, answer in answers:
                yield self._result(answer, asked.popleft())

    def _result(self, answer: PlanResult | Lost, request: PlanRequest) -> PlanResult:
        return replace(_result(answer), origin=self.origin(request))

    def _started(
        self,
        requests: Iterable[PlanRequest],
        engine: Engine | None,
        taken: Callable[[PlanRequest], None] = lambda _: None,
    ) -> Answers[PlanResult]:
        """The answers; all requests of a sequence are checked, and searched for roadmaps, now; else the first."""
        checked = (self._checked(index, request) for index, request in enumerate(_iterated(requests)))
        at_hand = list(checked if isinstance(requests, Sequence) else islice(checked, 1))
        places: dict[int, int] = {}
        roadmaps = [r.planner for r in at_hand if isinstance(r.planner, Roadmap)]
        for roadmap in roadmaps:
            places.setdefault(id(roadmap), len(places))
        sent = {places[id(roadmap)]: roadmap for roadmap in roadmaps}
        work = _Plans(self.plan, tuple(sent.values()))
        items = (_item(request, places, taken) for request in chain(at_hand, checked))
        chosen: Engine = Processes() if engine is None else engine
        if isinstance(chosen, type) or not callable(getattr(chosen, "run", None)):
            raise InvalidRequest("engine", engine, "an engine such as Processes(), or None")
        return chosen.run(work, items, limit=_limit)

    def _checked(self, index: int, request: PlanRequest) -> PlanRequest:
        name = f"requests[{index}]"
        if not isinstance(request, PlanRequest):
            raise InvalidRequest(name, request, "a PlanRequest")
        try:
            self.require(request)
        except InvalidRequest as error:
            told = f"{name}.{error}"
            raise InvalidRequest(f"{name}.{error.field}", error.value, error.expected, message=told) from error
        return request


def _iterated(requests: Iterable[PlanRequest]) -> Iterator[PlanRequest]:
    try:
        return iter(requests)
    except TypeError:
        raise InvalidRequest("requests", requests, "several PlanRequests") from None


def _item(request: PlanRequest, places: Mapping[int, int], taken: Callable[[PlanRequest], None]) -> Item:
    """A request without its roadmap, if that was sent before; told as taken when it goes to a worker."""
    taken(request)
    place = places.get(id(request.planner))
    return (request, None) if place is None else (replace(request, planner=RRTConnect()), place)


def _limit(item: Item) -> float | None:
    seconds = item[0].time_limit
    return None if seconds is None else seconds + GRACE


def _result(answer: PlanResult | Lost) -> PlanResult:
    if isinstance(answer, Lost):
        late = f"{answer.detail}, {GRACE:g} s after its time limit; whether a path exists is unknown"
        reason, detail = (Reason.TIMED_OUT, late) if answer.over_limit else (Reason.WORKER_LOST, answer.detail)
        return PlanResult(None, None, Failure(Stage.ENDPOINTS, reason, detail), (), deterministic=False)
    return answer
