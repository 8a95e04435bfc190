"""Whether what is taken can be set down, and be taken again from there, as far as that shows without a search."""

from __future__ import annotations

from planner_service.geometry.arrays import FloatArray
from planner_service.service import PlannerService
from planner_service.tasks.contacts import Contact, placed_poses
from planner_service.tasks.inspector import Inspector, Rank, Visit
from planner_service.tasks.motions import Motions, NoMotion
from planner_service.tasks.task import ChoiceStage, ContactStage, Stage
from planner_service.tasks.ways import OUT_OF_REACH, Way, Ways

__all__ = ["LookAhead"]

DEPTH = 3
"""Contacts that follow each other with one object, and are looked at together: a release, a new grasp, its release."""


class LookAhead:
    """Which contacts are dead ends, and all ways that were looked at."""

    def __init__(self, motions: Motions, inspector: Inspector) -> None:
        self._motions, self._inspector = motions, inspector
        self._ways: dict[tuple[int, PlannerService], Ways] = {}
        self._seen: dict[tuple[int, PlannerService], Visit | None] = {}
        self._reaching: set[Contact] = set()
        self._dead_ends: dict[Contact, tuple[Visit, str]] = {}

    def ways_of(self, stage: ContactStage, service: PlannerService) -> Ways:
        """The ways of a contact in a world: the same for the same."""
        key = (id(stage), service)
        if key not in self._ways:
            self._ways[key] = Ways(self._motions, stage, service)
        return self._ways[key]

    def require(self, rest: tuple[Stage, ...], way: Way, visit: Visit) -> None:
        """Refuse a way of which it is known, or costs no check to know, that it is a dead end.

        Args:
            rest: The stages after it.

        Raises:
            NoMotion: What follows has no way; ``visit`` was told.
        """
        contact, stage = way.contact, visit.stage
        assert isinstance(stage, ContactStage)
        following = _following(rest, stage.act.step.object)
        if following and contact not in self._dead_ends:
            self._find(following, way, visit)
        if contact in self._dead_ends:
            ahead, why = self._dead_ends[contact]
            visit.leads_to(ahead)
            told = f"way {way.number}: {why}"
            if told not in visit.tried:
                visit.refuse(stage.act, why, told, Rank.AHEAD)
            raise NoMotion(why)

    def _find(self, following: list[tuple[ContactStage, tuple[Stage, ...]]], way: Way, visit: Visit) -> None:
        """Note that a contact is a dead end, if that is known or the arm reaches none of the next places."""
        contact = way.contact
        if contact.takes:
            if contact in self._reaching:
                return
            self._reaching.add(contact)
            seen = [self._out_of_reach(stage, contact, visit) for stage, _ in following]
        else:
            seen = [self._seen.get((id(stage), contact.after)) for stage, _ in following]
        found = [each for each in seen if each is not None]
        if len(found) == len(following):
            self._dead_ends[contact] = found[0], _told(following[0][0], found[0])

    def _out_of_reach(self, stage: ContactStage, contact: Contact, visit: Visit) -> Visit | None:
        """The visit that finds all places of what is taken out of reach; None if one is not."""
        service, step = visit.service, stage.act.step
        still = service.robot.unwound(visit.q)
        held = contact.tool.inverse() @ service.scene.obstacle(step.object).pose
        tools = [pose @ held.inverse() for pose in placed_poses(service, step)]
        if any(len(self._motions.solutions(service.robot, tool, still)) for tool in tools):
            return None
        found = Visit(self._inspector, stage, service, visit.q)
        found.begins("", len(tools))
        found.unreached |= dict(enumerate(tools, start=1))
        for number in found.unreached:
            found.refuse(stage.act, OUT_OF_REACH, f"way {number}: {OUT_OF_REACH}")
        return found

    def look(self, rest: tuple[Stage, ...], way: Way, visit: Visit, depth: int = DEPTH) -> None:
        """Refuse a way after which what is carried could not be set down, or what was set down not be taken again.

        Raises:
            NoMotion: The next contact with the object has no way without a search, and no alternative to it has.
        """
        stage = visit.stage
        assert isinstance(stage, ContactStage)
        following = _following(rest, stage.act.step.object) if depth else []
        if not following:
            return
        seen: list[Visit] = []
        for next_stage, later in following:
            found = self._seen_from(next_stage, later, way.contact.after, way.end, depth - 1)
            if found is None:
                return
            seen.append(found)
        visit.leads_to(seen[0])
        why = _told(following[0][0], seen[0])
        self._dead_ends[way.contact] = seen[0], why
        visit.refuse(stage.act, why, f"way {way.number}: {why}", Rank.AHEAD)
        raise NoMotion(why)

    def _seen_from(
        self, stage: ContactStage, rest: tuple[Stage, ...], service: PlannerService, q: FloatArray, depth: int
    ) -> Visit | None:
        """None if a contact has a way as far as can be told without a search, else the visit that found none."""
        key = (id(stage), service)
        if key not in self._seen:
            visit, ways = Visit(self._inspector, stage, service, q), self.ways_of(stage, service)
            self._seen[key] = visit
            for way in ways(q, visit):
                turned = way.turned(service.robot, q)
                try:
                    self.require(rest if depth else (), turned, visit)
                    ways.lines(turned, visit)
                    self.look(rest, turned, visit, depth)
                except NoMotion:
                    continue
                self._seen[key] = None
                break
        return self._seen[key]


def _told(stage: ContactStage, ahead: Visit) -> str:
    """Why what follows has no plan, in words."""
    return f"then {stage.act.step} has no way: {'; '.join(ahead.tried[:1])}"


def _following(stages: tuple[Stage, ...], name: str) -> list[tuple[ContactStage, tuple[Stage, ...]]]:
    """The next contact with an object, of each alternative, and what comes after it; none where it says no place."""
    for k, stage in enumerate(stages):
        if isinstance(stage, ChoiceStage):
            return [each for branch in stage.branches for each in _following((*branch, *stages[k + 1 :]), name)]
        if isinstance(stage, ContactStage) and stage.act.step.object == name:
            return [] if stage.connect is None else [(stage, stages[k + 1 :])]
    return []
