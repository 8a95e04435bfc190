"""What a server can be asked for: each verb with the body that it takes and the answer that it gives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from planner_service.files.schema import Record
from planner_service.records.http import bodies, replies
from planner_service.records.plan_file import PlanRecord, TaskRecord

__all__ = ["ANSWERS", "VERBS", "Verb"]


@dataclass(frozen=True)
class Verb:
    """A kind of request for work.

    Attributes:
        body: The model of what is sent.
        answers: The models of what comes back, one of them.
    """

    summary: str
    body: type[bodies.Body]
    answers: tuple[type[Record], ...]

    @property
    def is_task(self) -> bool:
        """Whether the answer is a task file."""
        return TaskRecord in self.answers

    @property
    def is_file(self) -> bool:
        """Whether the answer is a plan file or a task file, also if the request is not carried out."""
        return self.is_task or PlanRecord in self.answers


VERBS: Mapping[str, Verb] = {
    "plans": Verb("Plan a motion", bodies.PlanBody, (PlanRecord,)),
    "certify": Verb(
        "Prove that a path, or a finished plan or task, is free",
        bodies.CertifyBody,
        (replies.CertificateReply, replies.ProofReply),
    ),
    "check": Verb("Check configurations and straight edges", bodies.CheckBody, (replies.CheckReply,)),
    "pick": Verb("Plan to take an object", bodies.PickBody, (TaskRecord,)),
    "place": Verb("Plan to set a carried object down", bodies.PlaceBody, (TaskRecord,)),
    "pick_place": Verb("Plan a whole pick-and-place", bodies.PickPlaceBody, (TaskRecord,)),
    "move_linear": Verb("Plan straight motions of the tool", bodies.MoveLinearBody, (PlanRecord,)),
    "replan": Verb("Plan a new motion for a robot that is moving", bodies.ReplanBody, (PlanRecord,)),
    "explain": Verb("Explain why there is no plan, and what would help", bodies.ExplainBody, (replies.ExplainReply,)),
    "roadmaps": Verb("Grow a roadmap", bodies.RoadmapBody, (replies.RoadmapReply,)),
}
"""By route and kind."""

ANSWERS = tuple(dict.fromkeys(model for verb in VERBS.values() for model in verb.answers))
"""All of their models."""
