"""The description of the interface in the repository is the server's own."""

from __future__ import annotations

import json
import os
from pathlib import Path
from unittest.mock import Mock

from planner_service.serve.app import create_app
from planner_service.serve.server import PlanningServer

FILE = Path(__file__).parents[3] / "docs" / "reference" / "openapi.json"


def test_the_description_in_the_repository_is_the_servers_own() -> None:
    described = json.dumps(create_app(Mock(spec=PlanningServer)).openapi(), indent=1) + "\n"
    if os.environ.get("WRITE_OUTPUTS"):
        FILE.write_text(described, "utf-8")
    assert FILE.read_text("utf-8") == described


def test_every_answer_has_a_typed_schema() -> None:
    described = create_app(Mock(spec=PlanningServer)).openapi()
    schemas = [
        (path, kind["schema"])
        for path, operations in described["paths"].items()
        for operation in operations.values()
        for status, reply in operation["responses"].items()
        if status.startswith("2")
        for media, kind in reply.get("content", {}).items()
        if media == "application/json"
    ]
    assert len(schemas) > 20
    for path, schema in schemas:
        names = [one["$ref"].rpartition("/")[2] for one in schema.get("anyOf", [schema])]
        assert all("properties" in described["components"]["schemas"][name] for name in names), path
