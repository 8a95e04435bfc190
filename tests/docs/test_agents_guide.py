"""The guide to agents shows what tools answer, and the client settings it gives work.

``WRITE_OUTPUTS=1`` in the environment writes the outputs of today into the page.
"""

from __future__ import annotations

import json
import os
import re
import sys
from pathlib import Path
from typing import Any

import anyio
import pytest
from mcp import Client
from mcp.client.stdio import StdioServerParameters

from planner_service.mcp.server import TOOLS
from tests.docs.test_docs import with_outputs_of_today

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

PAGE = Path(__file__).parents[2] / "docs" / "guides" / "agents.md"


@pytest.fixture
def page(monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    return PAGE.read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_guide_to_agents_shows_its_answers(page: str, capsys: pytest.CaptureFixture[str]) -> None:
    today = with_outputs_of_today(str(PAGE), page.replace("```console", "```shell"), capsys)
    today = today.replace("```shell", "```console")
    if "WRITE_OUTPUTS" in os.environ:  # to take over what changed on purpose; read the diff
        PAGE.write_text(today, encoding="utf-8")
    assert page.splitlines() == today.splitlines()


def test_what_clients_are_told_starts_a_server_with_all_tools(page: str) -> None:
    told: list[Any] = [json.loads(text) for text in re.findall(r"```json\n(.*?)```", page, re.DOTALL)]
    told += [tomllib.loads(text) for text in re.findall(r"```toml\n(.*?)```", page, re.DOTALL)]
    servers = [server for document in told for (server,) in (part.values() for part in document.values())]
    assert len(servers) == 3
    assert all(server["command"] == "planner-service" for server in servers)
    (arguments,) = {tuple(server["args"]) for server in servers}

    async def tools() -> list[str]:
        async with Client(StdioServerParameters(command="planner-service", args=list(arguments))) as client:
            return [tool.name for tool in (await client.list_tools()).tools]

    assert anyio.run(tools) == list(TOOLS)


def test_the_guide_has_every_tool(page: str) -> None:
    assert re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE) == list(TOOLS)
