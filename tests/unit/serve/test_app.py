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
