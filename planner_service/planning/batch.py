"""Many plans at once: requests go to an engine's workers, results come back in their order."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import chain, count, islice
from typing import TYPE_CHECKING

from planner_service.errors import InvalidRequest, shown
from planner_service.geometry.validation import items
from planner_service.memory import NOTHING
from planner_service.planning.request import PlanRequest
from planner_service.planning.result import Failure, Origin, PlanResult, Reason, Stage
from planner_service.presentation.progress import bar
from planner_service.roadmap import Roadmap
from planner_service.search.planners import RRTConnect

if TYPE_CHECKING:
    from planner_service.parallel import Answers, Engine, Lost

__all__ = ["GRACE", "Batch", "Interrupted"]

GRACE = 10.0
"""Seconds over its time limit after which a plan is ended from outside, as it hangs somewhere without looking at the
clock. A worker's first plan among thousands of obstacles builds what it needs before its clock starts."""

Item = tuple[PlanRequest, int | None]
"""A request, and which of the roadmaps that were sent to the workers is its planner; None if it has its own planner."""


class Interrupted(KeyboardInterrupt):
    """Ctrl-C while many plans were made. The workers have been ended.

    Attributes:
        results: The results that were finished, by the index of their request.
    """

    def __init__(self, results: dict[int, PlanResult]) -> None:
        super().__init__(f"{len(results)} results were finished")
        self.results = results


@dataclass(frozen=True, eq=False)
class _Plans:
    """The work sent to the workers: the ``plan`` method of one service, with all that the service is made of."""

    plan: Callable[[PlanRequest], PlanResult]
    roadmaps: tuple[Roadmap, ...]

    def prepare(self) -> None:
        """Do nothing: the service was built when the method arrived, and plans prepare their roadmap themselves."""

    def __call__(self, item: Item) -> PlanResult:
        request, roadmap = item
        if roadmap is not None:
            request = replace(request, planner=self.roadmaps[roadmap])
        return replace(self.plan(request), roadmap=None, known=NOTHING, learned=None)


@dataclass(frozen=True)
class Batch:
    """What ``plan_many`` and ``plan_stream`` of a service run.

    Attributes:
        plan: The service's.
        require: Raises for a request that ``plan`` refuses, without planning.
        origin: What the result of a request is given as its origin, in this process.
    """

    plan: Callable[[PlanRequest], PlanResult]
    require: Callable[[PlanRequest], object]
    origin: Callable[[PlanRequest], Origin]

    def results(
        self,
        requests: Iterable[PlanRequest],
        engine: Engine | None,
        progress: bool | None,
        finished: Mapping[int, PlanResult] | None,
    ) -> list[PlanResult]:
        """See ``PlannerService.plan_many``."""
        requests = items("requests", requests, PlanRequest, "a PlanRequest")
        results = _checked_results({} if finished is None else finished, len(requests))
        left = [index for index in range(len(requests)) if index not in results]
        answers = self._started([requests[index] for index in left], engine, numbers=left)
        try:
            with closing(answers), bar("plans", progress) as report:
                for place, answer in answers:
                    results[left[place]] = self._result(answer, requests[left[place]])
                    if report is not None:
                        report(len(results), len(requests))
        except KeyboardInterrupt:
            late = {left[k]: self._result(answer, requests[left[k]]) for k, answer in answers.finished.items()}
            raise Interrupted(dict(sorted((results | late).items()))) from None
        return [results[index] for index in sorted(results)]

    def stream(self, requests: Iterable[PlanRequest], engine: Engine | None) -> Generator[PlanResult, None, None]:
        """See ``PlannerService.plan_stream``."""
        sent = deque[PlanRequest]()
        return self._handed_out(self._started(requests, engine, sent.append), sent)

    def _handed_out(self, answers: Answers[PlanResult], sent: deque[PlanRequest]) -> Generator[PlanResult, None, None]:
        with closing(answers):
            for _, answer in answers:
                yield self._result(answer, sent.popleft())

    def _result(self, answer: PlanResult | Lost, request: PlanRequest) -> PlanResult:
        return replace(_result(answer), origin=self.origin(request))

    def _started(
        self,
        requests: Iterable[PlanRequest],
        engine: Engine | None,
        taken: Callable[[PlanRequest], object] = lambda _: None,
        numbers: Iterable[int] | None = None,
    ) -> Answers[PlanResult]:
        """The answers as they come. All requests of a sequence are checked now; of an iterator only the first.

        Args:
            numbers: What a message calls each request; 0, 1, 2, ... if None.
        """
        from planner_service.parallel import Processes

        named = zip(count() if numbers is None else numbers, _iterated(requests), strict=False)
        checked = (self._checked(index, request) for index, request in named)
        first = list(checked if isinstance(requests, Sequence) else islice(checked, 1))
        places: dict[int, int] = {}
        roadmaps = [r.planner for r in first if isinstance(r.planner, Roadmap)]
        for roadmap in roadmaps:
            places.setdefault(id(roadmap), len(places))
        sent = {places[id(roadmap)]: roadmap for roadmap in roadmaps}
        work = _Plans(self.plan, tuple(sent.values()))
        items = (_item(request, places, taken) for request in chain(first, checked))
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
            message = f"{name}.{error}"
            raise InvalidRequest(f"{name}.{error.field}", error.value, error.expected, message=message) from error
        return request


def _checked_results(finished: Mapping[int, PlanResult], count: int) -> dict[int, PlanResult]:
    """The results that an earlier call had finished, if they can be of so many requests."""
    expected = f"results by the index of their request, 0 to {count - 1}, such as interrupted.results"
    if not isinstance(finished, Mapping):
        raise InvalidRequest("finished", finished, expected)
    for index, result in finished.items():
        if type(index) is not int or not 0 <= index < count or not isinstance(result, PlanResult):
            raise InvalidRequest(f"finished[{shown(index)}]", result, expected)
    return dict(finished)


def _iterated(requests: Iterable[PlanRequest]) -> Iterator[PlanRequest]:
    try:
        return iter(requests)
    except TypeError:
        raise InvalidRequest("requests", requests, "several PlanRequests") from None


def _item(request: PlanRequest, places: Mapping[int, int], taken: Callable[[PlanRequest], object]) -> Item:
    """A request as it is sent: without its roadmap, if the workers have that already; ``taken`` is called with it."""
    taken(request)
    place = places.get(id(request.planner))
    return (request, None) if place is None else (replace(request, planner=RRTConnect()), place)


def _limit(item: Item) -> float | None:
    seconds = item[0].time_limit
    return None if seconds is None else seconds + GRACE


def _result(answer: PlanResult | Lost) -> PlanResult:
    from planner_service.parallel import Lost

    if isinstance(answer, Lost):
        late = f"{answer.detail}, {GRACE:g} s after its time limit; whether a path exists is unknown"
        reason, detail = (Reason.TIMED_OUT, late) if answer.over_limit else (Reason.WORKER_LOST, answer.detail)
        return PlanResult(None, None, Failure(Stage.ENDPOINTS, reason, detail), (), deterministic=False)
    return answer
