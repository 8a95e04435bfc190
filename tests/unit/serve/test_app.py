"""The description of the interface in the repository is the server's own."""

from __future__ import annotations

import json
import os
from pathlib import Path

from planner_service.serve.app import OPERATIONS
from planner_service.serve.documentation import described

FILE = Path(__file__).parents[3] / "docs" / "reference" / "openapi.json"


def test_the_description_in_the_repository_is_the_servers_own() -> None:
    text = json.dumps(described(OPERATIONS), indent=1) + "\n"
    if os.environ.get("WRITE_OUTPUTS"):
        FILE.write_text(text, "utf-8")
    assert FILE.read_text("utf-8") == text
