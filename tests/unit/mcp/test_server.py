"""The protocol: typed tools, one call at a time, a short queue, and a client that may send anything."""

from __future__ import annotations

import io
import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import anyio
import jsonschema
import mcp_types as types
import pytest
from mcp import Client

import planner_service as ps
from planner_service.collision import CancelToken
from planner_service.mcp import Session
from planner_service.mcp import server as served
from planner_service.mcp.arguments import DescribeArguments
from planner_service.mcp.session import Answer
from tests.support.agents import asked, command
from tests.support.command import refused

HELLO = {
    "jsonrpc": "2.0",
    "id": 0,
    "method": "initialize",
    "params": {"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "t", "version": "0"}},
}
READY = {"jsonrpc": "2.0", "method": "notifications/initialized"}


@pytest.fixture(scope="module")
def session() -> Session:
    return Session(ps.PlannerService("wxai", "table"))


class Talk(io.RawIOBase):
    """What a client sends: lines, and nothing more once the last answer, or whatever else is awaited, is there."""

    def __init__(self, lines: bytes, heard: Callable[[], bool]) -> None:
        self.lines, self.heard = lines, heard

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        part, self.lines = self.lines[: len(buffer)], self.lines[len(buffer) :]
        buffer[: len(part)] = part
        for _ in range(3000):
            if part or self.heard():
                break
            time.sleep(0.01)
        return len(part)


def spoken(
    session: Session, *messages: bytes, last: int = 8, heard: Callable[[], bool] | None = None
) -> list[dict[str, Any]]:
    """What the server writes to a client that sends these lines, and hangs up after the answer to the ``last``."""
    out = io.StringIO()
    lines = [json.dumps(message).encode() for message in (HELLO, READY)]
    talk = Talk(b"\n".join((*lines, *messages)) + b"\n", heard or (lambda: f'"id":{last},' in out.getvalue()))
    anyio.run(served.answer, session, io.BufferedReader(talk), out)
    return [json.loads(line) for line in out.getvalue().splitlines()]


def call(number: int, tool: object, given: object) -> bytes:
    parameters = {"name": tool, "arguments": given}
    return json.dumps({"jsonrpc": "2.0", "id": number, "method": "tools/call", "params": parameters}).encode()


def test_every_tool_says_what_it_takes_and_answers(session: Session) -> None:
    async def listed(client: Client) -> list[types.Tool]:
        return (await client.list_tools()).tools

    tools = asked(session, listed)
    assert [tool.name for tool in tools] == list(served.TOOLS)
    for tool in tools:
        assert tool.description
        assert tool.annotations is not None
        assert tool.annotations.read_only_hint == (tool.name != "execute")
        for schema in (tool.input_schema, tool.output_schema):
            jsonschema.Draft202012Validator.check_schema(schema or {})
        undescribed = [
            key for key, part in tool.input_schema.get("properties", {}).items() if "description" not in part
        ]
        assert undescribed == []


def test_the_command_answers_over_pipes_and_prints_nothing_else() -> None:
    async def worked() -> tuple[str, dict[str, Any]]:
        async with Client(command(["--scene", "table", "--start", "ready"])) as client:
            plan = await client.call_tool("plan", {"goal": {"named": "home"}})
            assert isinstance(plan.structured_content, dict)
            return client.instructions or "", plan.structured_content

    instructions, plan = anyio.run(worked)
    assert "never instructions" in instructions
    assert plan["plan"] == "plan-1"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--scene", "table", "--execute", "toaster"], "simulator, or trossen=ADDRESS"),
        (["--scene", "table", "--speed", "0.5"], "with --execute only"),
        (["--scene", "tabel"], "did you mean 'table'"),
        (["--scene", "table", "--start", "0,0"], "expected 6"),
    ],
)
def test_the_command_refuses_what_it_cannot_do(options: list[str], said: str) -> None:
    assert said in refused("mcp", *options)


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"{}",
        b"null",
        b"[1, 2, 3]",
        b'{"jsonrpc": "2.0"',
        b"\xff\xfe\x00",
        b"[" * 100_000,
        b'"' + b"x" * 3_000_000 + b'"',
        b'{"jsonrpc": "2.0", "id": {"a": 1}, "method": "tools/call"}',
        b'{"jsonrpc": "2.0", "id": 7, "method": "tools/call", "params": {"name": 5}}',
        b'{"jsonrpc": "2.0", "id": 7, "method": "tools/call", "params": {"name": "plan", "arguments": 5}}',
        b'{"jsonrpc": "2.0", "id": 7, "method": "resources/read", "params": {"uri": "file:///etc/passwd"}}',
        b'{"jsonrpc": "2.0", "id": 7, "method": "no/such"}',
    ],
)
def test_after_any_line_the_next_call_is_answered(session: Session, line: bytes) -> None:
    said = spoken(session, line, call(8, "check", {}))
    (answer,) = [message["result"] for message in said if message.get("id") == 8]
    assert answer["structuredContent"]["free"] is True
    assert not any("root:" in json.dumps(message) for message in said)


@pytest.mark.parametrize("given", [{"joints": [float("nan")] * 6}, {"joints": [10**400] * 6}, {"joints": [[]] * 6}])
def test_numbers_that_are_none_are_refused(session: Session, given: dict[str, Any]) -> None:
    said = spoken(session, call(8, "plan", {"goal": given}), call(9, "check", {}), last=9)
    answers = {message.get("id"): message for message in said}
    assert "result" in answers[9]
    assert 8 not in answers or "error" in answers[8] or answers[8]["result"]["isError"]


@contextmanager
def slow(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[threading.Event, threading.Event, list[bool]]]:
    """A ``describe_scene`` that waits; events for its begin and its end, and whether each call was cancelled."""
    begun, may_end, cancelled = threading.Event(), threading.Event(), list[bool]()
    plain = served.TOOLS["describe_scene"]

    def waiting(session: Session, given: DescribeArguments, cancel: CancelToken) -> Answer:
        begun.set()
        while not (may_end.wait(0.01) or cancel.cancelled):
            pass
        cancelled.append(cancel.cancelled)
        return plain.verb(session, given, cancel)

    kind = served.ToolKind(waiting, plain.takes, plain.answers, plain.text)
    monkeypatch.setitem(served.TOOLS, "describe_scene", kind)
    yield begun, may_end, cancelled
    may_end.set()


def test_a_flood_is_refused_and_what_waited_is_answered(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    with slow(monkeypatch) as (begun, may_end, _):

        async def flood(client: Client) -> list[types.CallToolResult]:
            results: list[types.CallToolResult] = []

            async def one(tool: str) -> None:
                results.append(await client.call_tool(tool, {}))
                if len(results) == 50 - served.MAX_WAITING:
                    may_end.set()

            async with anyio.create_task_group() as tasks:
                tasks.start_soon(one, "describe_scene")
                await anyio.to_thread.run_sync(begun.wait)
                for _ in range(50):
                    tasks.start_soon(one, "check")
            return results

        results = asked(session, flood)
    busy = [r for r in results if r.is_error]
    assert len(results) == 51
    assert len(busy) == 50 - served.MAX_WAITING
    assert all((r.structured_content or {})["refused"] == "BUSY" for r in busy)


def test_a_cancelled_call_ends_and_the_next_is_answered(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    with slow(monkeypatch) as (begun, _, cancelled):

        async def given_up(client: Client) -> types.CallToolResult:
            async with anyio.create_task_group() as tasks:
                tasks.start_soon(client.call_tool, "describe_scene", {})
                await anyio.to_thread.run_sync(begun.wait)
                tasks.cancel_scope.cancel()
            return await client.call_tool("check", {})

        assert not asked(session, given_up).is_error
    assert cancelled == [True]


def test_a_client_that_is_gone_ends_its_call(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    with slow(monkeypatch) as (begun, _, cancelled):
        spoken(session, call(8, "describe_scene", {}), heard=begun.is_set)
    assert cancelled == [True]


def test_an_error_of_ours_is_told_without_its_words(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(session: Session, given: DescribeArguments, cancel: CancelToken) -> Answer:
        raise RuntimeError("secret")

    plain = served.TOOLS["describe_scene"]
    kind = served.ToolKind(broken, plain.takes, plain.answers, plain.text)
    monkeypatch.setitem(served.TOOLS, "describe_scene", kind)
    (answer,) = [m["result"] for m in spoken(session, call(8, "describe_scene", {})) if m.get("id") == 8]
    assert answer["structuredContent"]["refused"] == "INTERNAL_ERROR"
    assert "secret" not in json.dumps(answer)
