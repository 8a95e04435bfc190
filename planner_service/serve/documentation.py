"""The description of the interface (OpenAPI): its addresses, and the models of bodies and replies."""

from __future__ import annotations

import re
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from functools import cache
from inspect import getdoc
from typing import Any

from pydantic.json_schema import models_json_schema
from starlette.requests import Request
from starlette.responses import Response

from planner_service.files.docstrings import without_sections
from planner_service.files.release import RELEASE
from planner_service.files.schema import Described, Record
from planner_service.records.http.bodies import EditsBody, SceneBody
from planner_service.records.http.examples import EXAMPLES
from planner_service.records.http.replies import ANSWERS, OTHERS, VERBS, ProblemReply
from planner_service.records.http.robot_by_hash import RobotHash
from planner_service.serve.problems import PROBLEM_JSON, TITLES
from planner_service.serve.server import PlanningServer

__all__ = ["Handler", "Operation", "data", "described", "header", "operation", "query", "reply"]

DESCRIPTION = """Motion planning for a robot arm: every returned plan is proven, every collision check is counted.

Lengths are in metres, angles in radians, times in seconds, masses in kilograms. Poses are in the robot's base frame
unless something else is said. With `Prefer: wait` a request for work is answered at once; else it is accepted with 202,
and its answer will be at `/plans/ID`. [openapi.json](openapi.json) says all of this to programs."""

TAGS: Mapping[str, str] = {
    "Requests": "Work for the planner. That there is no plan is an answer, too.",
    "Answers": "What was asked for: plans, tasks, proofs and their motions.",
    "Scenes": "What stands around the robot, in versions.",
    "Roadmaps": "What was grown for planners to search.",
    "Server": "The robot, and how the server fares.",
}
"""Groups of addresses."""

GROUPS = {"plans": "Answers", "scenes": "Scenes", "roadmaps": "Roadmaps"}
"""By what addresses begin with; requests for work apart."""


Handler = Callable[[PlanningServer, Request], Awaitable[Response]]


@dataclass(frozen=True, eq=False)
class Operation:
    """What one method of one address does.

    Attributes:
        replies: By status, as OpenAPI has them; see ``reply``.
        refused: Statuses of replies that say what is wrong with this request; any may get another one.
        takes: The model of the body.
        public: Whether it needs no token.
        name: Its id; that of the handler if not given.
    """

    method: str
    path: str
    summary: str
    handler: Handler
    replies: Mapping[int, dict[str, Any]]
    refused: tuple[int, ...] = ()
    parameters: tuple[dict[str, Any], ...] = ()
    takes: type[Record] | None = None
    public: bool = False
    name: str = ""

    @property
    def document(self) -> dict[str, Any]:
        """As OpenAPI has it."""
        parameters = [
            _parameter(name, "path", {"type": "string"}) | {"description": IN_PATHS[name]}
            for name in re.findall(r"{(\w+)}", self.path)
        ]
        parameters += self.parameters
        name = self.name or getattr(self.handler, "__name__", "")
        document: dict[str, Any] = {
            "tags": ["Requests" if self.name else GROUPS.get(self.path.split("/")[1], "Server")],
            "summary": self.summary,
            "description": without_sections(getdoc(self.handler) or ""),
            "operationId": name,
        }
        if parameters:
            document["parameters"] = parameters
        if self.takes is not None:
            examples = {key: {"summary": key, "value": value} for key, value in EXAMPLES[name].items()}
            content = {"schema": _schema(self.takes), "examples": examples}
            document["requestBody"] = {"required": True, "content": {"application/json": content}}
        document["responses"] = {
            **{str(status): each for status, each in self.replies.items()},
            **{str(status): {"$ref": f"#/components/responses/Problem{status}"} for status in self.refused},
            "default": {"$ref": "#/components/responses/Problem"},
        }
        return document | ({"security": []} if self.public else {})


IN_PATHS = {
    "plan": "The id of a request, as `Location` and `Content-Location` have it after `/plans/`",
    "name": "The name of a scene",
    "roadmap": "The hash of a roadmap",
}
"""What stands for a part of an address."""


def operation(
    address: str,
    summary: str,
    replies: Mapping[int, dict[str, Any]],
    refused: tuple[int, ...] = (),
    *parameters: dict[str, Any],
    takes: type[Record] | None = None,
    public: bool = False,
) -> Callable[[Handler], Operation]:
    """Makes an operation of its handler; ``address`` is its method and its path."""
    method, path = address.split()
    return lambda handler: Operation(method, path, summary, handler, replies, refused, parameters, takes, public)


def _schema(model: type[Described]) -> dict[str, Any]:
    return {"$ref": f"#/components/schemas/{model.__name__}"}


def reply(said: str, *models: type[Described], media: str = "application/json", **headers: str) -> dict[str, Any]:
    """A reply that is one of these models, or else a text or bytes of another media type.

    Args:
        headers: What its headers say; an underscore in a name stands for a hyphen.
    """
    schemas = [_schema(model) for model in models] or [data(media)]
    one: dict[str, Any] = schemas[0] if len(schemas) == 1 else {"anyOf": schemas}
    document = {"description": said, "content": {media: {"schema": one}}}
    text = {"schema": {"type": "string"}}
    told = {name.replace("_", "-"): {"description": words, **text} for name, words in headers.items()}
    return document | ({"headers": told} if told else {})


def data(media: str) -> dict[str, Any]:
    """The schema of a text or of bytes of a media type."""
    is_text = media.startswith("text/") or media.endswith("/xml")
    return {"type": "string"} if is_text else {"type": "string", "format": "binary"}


def _parameter(name: str, place: str, schema: Mapping[str, Any]) -> dict[str, Any]:
    return {"name": name, "in": place, "required": place == "path", "schema": dict(schema)}


def header(name: str, description: str, example: str = "") -> dict[str, Any]:
    """A header that a request may have."""
    document = _parameter(name, "header", {"type": "string"}) | {"description": description}
    return document | ({"example": example} if example else {})


def query(name: str, schema: Mapping[str, Any], description: str) -> dict[str, Any]:
    """A parameter that an address may have."""
    return _parameter(name, "query", schema) | {"description": description}


@cache
def described(operations: tuple[Operation, ...]) -> dict[str, Any]:
    """The description of an interface: its addresses, and the models of bodies and replies."""
    paths: dict[str, dict[str, Any]] = {}
    for operation in operations:
        paths.setdefault(operation.path, {})[operation.method.lower()] = operation.document
    return {
        "openapi": "3.1.0",
        "info": {"title": "planner-service", "description": DESCRIPTION, "version": RELEASE},
        "tags": [{"name": name, "description": said} for name, said in TAGS.items()],
        "paths": paths,
        "components": {
            "schemas": _schemas(),
            "responses": dict(_problems()),
            "securitySchemes": {
                "token": {
                    "type": "http",
                    "scheme": "bearer",
                    "description": "The content of the server's `--token-file`; without that no token is needed.",
                }
            },
        },
        "security": [{}, {"token": []}],
    }


def _schemas() -> dict[str, Any]:
    models: dict[type[Described], None] = dict.fromkeys(
        [*(verb.body for verb in VERBS.values()), SceneBody, EditsBody, *ANSWERS, *OTHERS, RobotHash]
    )
    place = "#/components/schemas/{model}"
    _, found = models_json_schema([(model, "validation") for model in models], ref_template=place)
    schemas: dict[str, Any] = dict(sorted(found["$defs"].items()))
    for name in ("PlanRecord", "TaskRecord"):
        fields = schemas[name]["properties"]
        robots = [{"$ref": place.format(model=model)} for model in ("RobotRecord", "RobotHash")]
        fields["robot"] = {"anyOf": robots, "description": "The robot, or with `?robot=hash` its hash alone."}
        fields["sections"] = {
            "$ref": place.format(model="PlanSections"),
            "description": fields["sections"]["description"],
        }
    any_value = {"$ref": place.format(model="JsonValue")}
    schemas["JsonValue"] = {
        "description": "Any JSON value.",
        "anyOf": [
            *({"type": kind} for kind in ("null", "boolean", "number", "string")),
            {"type": "array", "items": {"description": "Any JSON value."}},  # compilers refuse a list of itself
            {"type": "object", "additionalProperties": any_value},
        ],
    }
    return schemas


def _problems() -> Mapping[str, Any]:
    """A response for each status of a problem, and one for any."""
    content = {PROBLEM_JSON: {"schema": _schema(ProblemReply)}}
    statuses = sorted({status for status, _ in TITLES.values()})
    problems = {"Problem": {"description": "Another problem, such as a token that is missing", "content": content}}
    for status in statuses:
        titles = [title for each, title in TITLES.values() if each == status]
        problems[f"Problem{status}"] = {"description": "; or: ".join(titles), "content": content}
    return problems
