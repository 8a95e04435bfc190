"""The description of the interface (OpenAPI), and a page that shows it without anything from other hosts."""

from __future__ import annotations

import html
import json
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from planner_service.records.http import replies
from planner_service.records.http.bodies import EditsBody, SceneBody
from planner_service.records.http.verbs import ANSWERS, VERBS

__all__ = ["SECURITY", "documentation_page", "with_models"]

SECURITY = "default-src 'none'; style-src 'unsafe-inline'; frame-ancestors 'none'"
"""The page runs no scripts and loads nothing."""

STYLE = (
    "body{font:16px/1.5 sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}"
    "code,pre{font:14px/1.4 monospace;background:#f4f4f4}pre{padding:1rem;overflow:auto}"
    "h2{margin-top:2rem;font-size:1.1rem}summary{cursor:pointer}"
)


def with_models(app: FastAPI) -> Callable[[], dict[str, Any]]:
    """What makes the description of an application, once: its routes, and the models of bodies and replies."""

    @cache
    def described() -> dict[str, Any]:
        document = get_openapi(title=app.title, version=app.version, description=app.description, routes=app.routes)
        models: dict[type[BaseModel], None] = dict.fromkeys(
            [*(verb.body for verb in VERBS.values()), SceneBody, EditsBody, *ANSWERS, *replies.OTHERS]
        )
        _, schemas = models_json_schema(
            [(model, "validation") for model in models], ref_template="#/components/schemas/{model}"
        )
        document["components"] = {
            "schemas": dict(sorted(schemas["$defs"].items())),
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
        }
        document["security"] = [{}, {"token": []}]
        for path in document["paths"].values():
            for operation in path.values():
                for status in ("200", "201", "202", "204", "303", "422"):
                    _tidy(operation["responses"], status)
        return document

    return described


def _tidy(responses: dict[str, Any], status: str) -> None:
    """Drop the schemas that FastAPI adds for replies and mistakes that it does not handle here."""
    content = responses.get(status, {}).get("content", {})
    if content.get("application/json", {}).get("schema") in ({}, {"$ref": "#/components/schemas/HTTPValidationError"}):
        del content["application/json"]
        if status == "422" and not content:
            del responses[status]


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
