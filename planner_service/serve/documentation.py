"""The description of the interface (OpenAPI), and a page that shows it without anything from other hosts."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from functools import cache
from inspect import getdoc
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import models_json_schema
from starlette.requests import Request
from starlette.responses import Response

from planner_service.files.release import RELEASE
from planner_service.records.http.bodies import EditsBody, SceneBody
from planner_service.records.http.replies import ANSWERS, OTHERS, VERBS, ProblemReply
from planner_service.serve.problems import PROBLEM_JSON
from planner_service.serve.server import PlanningServer

__all__ = [
    "SECURITY",
    "Handler",
    "Operation",
    "described",
    "documentation_page",
    "header",
    "operation",
    "query",
    "reply",
]

DESCRIPTION = "Motion planning for a robot arm: every returned plan is proven, every collision check is counted."

SECURITY = "default-src 'none'; style-src 'unsafe-inline'; frame-ancestors 'none'"
"""The page runs no scripts and loads nothing."""

STYLE = (
    "body{font:16px/1.5 sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}"
    "code,pre{font:14px/1.4 monospace;background:#f4f4f4}pre{padding:1rem;overflow:auto}"
    "h2{margin-top:2rem;font-size:1.1rem}summary{cursor:pointer}"
)


Handler = Callable[[PlanningServer, Request], Awaitable[Response]]


@dataclass(frozen=True, eq=False)
class Operation:
    """What one method of one address does.

    Attributes:
        replies: By status, as OpenAPI has them; see ``reply``.
        refused: Statuses of replies that say what is wrong.
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
    takes: type[BaseModel] | None = None
    public: bool = False
    name: str = ""

    @property
    def document(self) -> dict[str, Any]:
        """As OpenAPI has it."""
        parameters = [
            _parameter(name, "path", {"type": "string", "title": name.capitalize()})
            for name in re.findall(r"{(\w+)}", self.path)
        ]
        parameters += self.parameters
        document: dict[str, Any] = {
            "summary": self.summary,
            "description": getdoc(self.handler),
            "operationId": self.name or getattr(self.handler, "__name__", ""),
        }
        if parameters:
            document["parameters"] = parameters
        if self.takes is not None:
            document["requestBody"] = {
                "required": True,
                "content": {"application/json": {"schema": _schema(self.takes)}},
            }
        replies = {**self.replies, **dict.fromkeys(self.refused, WRONG)}
        document["responses"] = {str(status): each for status, each in replies.items()}
        return document | ({"security": []} if self.public else {})


def operation(
    address: str,
    summary: str,
    replies: Mapping[int, dict[str, Any]],
    refused: tuple[int, ...] = (),
    *parameters: dict[str, Any],
    takes: type[BaseModel] | None = None,
    public: bool = False,
) -> Callable[[Handler], Operation]:
    """Makes an operation of its handler; ``address`` is its method and its path."""
    method, path = address.split()
    return lambda handler: Operation(method, path, summary, handler, replies, refused, parameters, takes, public)


def _schema(model: type[BaseModel]) -> dict[str, Any]:
    return {"$ref": f"#/components/schemas/{model.__name__}"}


def reply(description: str, *models: type[BaseModel], media: str = "application/json") -> dict[str, Any]:
    """A reply that is one of these models, or data of another kind."""
    schemas = [_schema(model) for model in models]
    one: dict[str, Any] = schemas[0] if len(schemas) == 1 else {"anyOf": schemas}
    return {"description": description, "content": {media: {"schema": one} if schemas else {}}}


WRONG = reply("What is wrong", ProblemReply, media=PROBLEM_JSON)


def _parameter(name: str, place: str, schema: Mapping[str, Any]) -> dict[str, Any]:
    return {"name": name, "in": place, "required": place == "path", "schema": dict(schema)}


def header(name: str, description: str) -> dict[str, Any]:
    """A header that a request may have."""
    return _parameter(name, "header", {"type": "string"}) | {"description": description}


def query(name: str, schema: Mapping[str, Any], description: str = "") -> dict[str, Any]:
    """A parameter that an address may have."""
    return _parameter(name, "query", schema) | ({"description": description} if description else {})


@cache
def described(operations: tuple[Operation, ...]) -> dict[str, Any]:
    """The description of an interface: its addresses, and the models of bodies and replies."""
    paths: dict[str, dict[str, Any]] = {}
    for operation in operations:
        paths.setdefault(operation.path, {})[operation.method.lower()] = operation.document
    models: dict[type[BaseModel], None] = dict.fromkeys(
        [*(verb.body for verb in VERBS.values()), SceneBody, EditsBody, *ANSWERS, *OTHERS]
    )
    _, schemas = models_json_schema(
        [(model, "validation") for model in models], ref_template="#/components/schemas/{model}"
    )
    return {
        "openapi": "3.1.0",
        "info": {"title": "planner-service", "description": DESCRIPTION, "version": RELEASE},
        "paths": paths,
        "components": {
            "schemas": dict(sorted(schemas["$defs"].items())),
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
        },
        "security": [{}, {"token": []}],
    }


def documentation_page(document: Mapping[str, Any]) -> str:
    """The description as a page."""
    parts = [f"<h1>{html.escape(document['info']['title'])} {html.escape(document['info']['version'])}</h1>"]
    parts.append(f"<p>{html.escape(document['info']['description'])}</p>")
    parts.append('<p>For programs: <a href="/openapi.json">openapi.json</a></p>')
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            parts.append(_operation(path, method, operation))
    parts.append("<h1>Bodies and replies</h1>")
    for name, schema in document["components"]["schemas"].items():
        text = html.escape(json.dumps(schema, indent=1))
        parts.append(
            f'<details id="{html.escape(name)}"><summary>{html.escape(name)}</summary><pre>{text}</pre></details>'
        )
    head = f'<!doctype html><html lang="en"><meta charset="utf-8"><title>planner-service</title><style>{STYLE}</style>'
    return head + "".join(parts) + "</html>"


def _operation(path: str, method: str, operation: Mapping[str, Any]) -> str:
    lines = [f"<h2><code>{method.upper()} {html.escape(path)}</code> {html.escape(operation['summary'])}</h2>"]
    lines.append(f"<p>{html.escape(operation.get('description', ''))}</p><ul>")
    body = operation.get("requestBody", {}).get("content", {}).get("application/json", {}).get("schema", {})
    if "$ref" in body:
        lines.append(f"<li>takes {_link(body['$ref'])}</li>")
    for parameter in operation.get("parameters", []):
        text = parameter.get("description", "")
        lines.append(f"<li>{parameter['in']} <code>{html.escape(parameter['name'])}</code> {html.escape(text)}</li>")
    for status, reply in operation["responses"].items():
        schemas = [kind.get("schema", {}).get("$ref") for kind in reply.get("content", {}).values()]
        links = ", ".join(_link(ref) for ref in schemas if ref)
        lines.append(f"<li><code>{status}</code> {html.escape(reply['description'])} {links}</li>")
    return "".join([*lines, "</ul>"])


def _link(ref: str) -> str:
    name = html.escape(ref.rpartition("/")[2])
    return f'<a href="#{name}">{name}</a>'
