"""An agent's side of the tools: the SDK's own client, connected in this process or over pipes."""

from __future__ import annotations

import sys
from collections.abc import Awaitable, Callable, Sequence
from typing import Any, TypeVar

import anyio
import mcp_types as types
from mcp import Client
from mcp.client.stdio import StdioServerParameters

from planner_service.mcp import Session
from planner_service.mcp.server import server_of

T = TypeVar("T")


def asked(session: Session, work: Callable[[Client], Awaitable[T]]) -> T:
    """What ``work`` returns of a client that is connected to a session."""

    async def connected() -> T:
        async with Client(server_of(session), mode="legacy") as client:
            return await work(client)

    return anyio.run(connected)


def called(session: Session, tool: str, **arguments: Any) -> types.CallToolResult:
    """The result of one call."""

    async def one(client: Client) -> types.CallToolResult:
        return await client.call_tool(tool, arguments)

    return asked(session, one)


def answered(session: Session, tool: str, **arguments: Any) -> dict[str, Any]:
    """The fields of the answer to one call, which is no refusal."""
    result = called(session, tool, **arguments)
    assert not result.is_error, result.content
    assert isinstance(result.structured_content, dict)
    return result.structured_content


def refused(session: Session, tool: str, **arguments: Any) -> dict[str, Any]:
    """The fields of the refusal of one call."""
    result = called(session, tool, **arguments)
    assert result.is_error, result.content
    assert isinstance(result.structured_content, dict)
    return result.structured_content


def words(result: types.CallToolResult) -> str:
    """Every text of a result, and its fields as Python prints them."""
    return "\n".join(part.text for part in result.content if isinstance(part, types.TextContent))


def command(options: Sequence[str]) -> StdioServerParameters:
    """How a client starts the server."""
    return StdioServerParameters(command=sys.executable, args=["-m", "planner_service", "mcp", *options])
