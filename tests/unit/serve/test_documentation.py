"""The description of the interface: everything in it is typed and says what it is, and the server keeps to it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from planner_service.records.http.examples import EXAMPLES
from planner_service.records.http.replies import VERBS
from planner_service.serve.app import OPERATIONS
from planner_service.serve.documentation import described
from planner_service.serve.problems import TITLES
from tests.support.served import asked, served

DOCUMENT = described(OPERATIONS)
SCHEMAS: dict[str, Any] = DOCUMENT["components"]["schemas"]


def inside(schema: Any, where: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """A schema and all that it is made of, each with its place."""
    if isinstance(schema, dict):
        yield where, schema
        for name, entry in schema.get("properties", {}).items():
            yield from inside(entry, f"{where}.{name}")
        for key in ("items", "additionalProperties"):
            yield from inside(schema.get(key), f"{where}.{key}")
        for key in ("anyOf", "oneOf", "allOf", "prefixItems"):
            for entry in schema.get(key, ()):
                yield from inside(entry, where)


ALL = [part for name, schema in SCHEMAS.items() for part in inside(schema, name)]
ANSWERS = [
    (f"{method} {path} {status}", reply)
    for path, operations in DOCUMENT["paths"].items()
    for method, operation in operations.items()
    for status, reply in operation["responses"].items()
]


def test_every_model_and_every_field_says_what_it_is() -> None:
    silent = [name for name, schema in SCHEMAS.items() if not schema.get("description")]
    fields = [
        (f"{where}.{name}", entry) for where, schema in ALL for name, entry in schema.get("properties", {}).items()
    ]
    assert len(fields) > 600
    assert silent + [where for where, entry in fields if not entry.get("description")] == []
    vague = [where for where, entry in fields if len(entry["description"]) < 5 or "As of" in entry["description"]]
    assert vague == []


def test_every_parameter_and_every_header_says_what_it_is() -> None:
    operations = [each for path in DOCUMENT["paths"].values() for each in path.values()]
    parameters = [each for operation in operations for each in operation.get("parameters", ())]
    headers = [each for _, reply in ANSWERS for each in reply.get("headers", {}).values()]
    assert len(parameters) > 40
    assert len(headers) > 20
    assert all(each["description"] and each["schema"] for each in [*parameters, *headers])
    assert all(each["summary"] and each["description"] for each in operations)
    assert [each["operationId"] for each in operations if "Attributes:" in each["description"]] == []


def test_no_object_and_no_value_is_untyped() -> None:
    typed = {"type", "$ref", "anyOf", "oneOf", "allOf", "const", "enum"}
    assert [where for where, schema in ALL if not typed & set(schema)] == ["JsonValue.items"]
    objects = [(where, schema) for where, schema in ALL if schema.get("type") == "object"]
    assert [
        where
        for where, schema in objects
        if "properties" not in schema and not isinstance(schema.get("additionalProperties"), dict)
    ] == []
    lists = [(where, schema) for where, schema in ALL if schema.get("type") == "array"]
    assert [where for where, schema in lists if not schema.get("items")] == []
    any_value = {"$ref": "#/components/schemas/JsonValue"}
    anything = {where for where, schema in ALL if any_value.items() <= schema.items() and "JsonValue" not in where}
    sections = {"PlanSections.additionalProperties", "CellPlanRecord.sections.additionalProperties"}
    assert anything == {*sections, "ProblemReply.value", "ProblemReply.name"}


def test_every_answer_has_its_schema() -> None:
    contents = [(where, reply["content"]) for where, reply in ANSWERS if where[-3:] in ("200", "201", "202")]
    assert len(contents) > 30
    assert [where for where, content in contents for each in content.values() if not each.get("schema")] == []


def test_problems_are_described_once() -> None:
    refused = [reply for where, reply in ANSWERS if not where[-3:] < "400"]
    assert len(refused) > 150
    assert all(list(reply) == ["$ref"] for reply in refused)
    responses = DOCUMENT["components"]["responses"]
    assert {reply["$ref"].rpartition("/")[2] for reply in refused} <= set(responses)
    assert set(responses) == {"Problem", *(f"Problem{status}" for status, _ in TITLES.values())}
    assert all(where.endswith("default") or where[-3:] < "400" or where[-3:].isdecimal() for where, _ in ANSWERS)


def test_every_place_that_is_referred_to_is_there() -> None:
    text = json.dumps(DOCUMENT)
    for name in {piece.partition('"')[0] for piece in text.split('"$ref": "#/components/')[1:]}:
        kind, _, key = name.partition("/")
        assert key in DOCUMENT["components"][kind], name


# Examples.


def fits(schema: dict[str, Any], value: Any) -> list[str]:
    """What of a value does not fit a schema of the description."""
    checker = Draft202012Validator({**schema, "components": DOCUMENT["components"]})
    return [f"{error.json_path}: {error.message}"[:300] for error in checker.iter_errors(value)]


def operation_of(name: str) -> tuple[str, str, dict[str, Any]]:
    """Method, path and description of an operation."""
    return next(
        (method.upper(), path, operation)
        for path, operations in DOCUMENT["paths"].items()
        for method, operation in operations.items()
        if operation["operationId"] == name
    )


def test_every_body_has_examples_that_fit_its_schema() -> None:
    bodies = {
        operation["operationId"]: operation["requestBody"]["content"]["application/json"]
        for path in DOCUMENT["paths"].values()
        for operation in path.values()
        if "requestBody" in operation
    }
    assert set(bodies) == set(EXAMPLES) == {*VERBS, "put_scene", "edit_scene"}
    for name, content in bodies.items():
        assert content["examples"], name
        assert [fits(content["schema"], each["value"]) for each in content["examples"].values()] == [
            [] for _ in content["examples"]
        ], name


def test_a_body_that_does_not_fit_is_told_from_one_that_does() -> None:
    body: dict[str, Any] = json.loads(json.dumps(EXAMPLES["plans"]["to a pose of the tool"]))
    schema = {"$ref": "#/components/schemas/PlanBody"}
    body["request"]["planner"]["settings"]["rage"] = 0.7
    assert fits(schema, body)
    body["request"]["planner"]["settings"] = {"range": "wide"}
    assert fits(schema, body)


AFTER = {"place": "pick"}
"""Whose answer ``ID`` is in examples; a plan's if not given."""


@pytest.mark.slow
def test_a_server_answers_every_example_as_described(tmp_path: Path) -> None:
    answers: list[tuple[str, str, int, dict[str, Any], Any]] = []
    with served(tmp_path, "--robot", "wxai", "--scene", "bin", "--workers", "1") as url:

        def answered(name: str, address: str, body: Any = None) -> dict[str, str]:
            method, _, operation = operation_of(name)
            status, headers, answer = asked(url, method, address, body)
            reply = operation["responses"].get(str(status), {"content": {}})
            answers.append((name, address, status, reply["content"].get("application/json", {}).get("schema"), answer))
            return headers

        found: dict[str, str] = {}
        for name in [*VERBS, "put_scene", "edit_scene"]:
            path = operation_of(name)[1]
            for example in EXAMPLES[name].values():
                earlier = found.get(AFTER.get(name, "plans"), "")
                body = json.loads(json.dumps(example).replace('"ID"', f'"{earlier}"'))
                address = path.replace("{name}", "tried" if name == "put_scene" else "bin")
                headers = answered(name, address, body)
                found.setdefault(name, headers.get("content-location", "").rpartition("/")[2])
        for name in ("plans", "pick_place"):
            answered("get_plan", f"/plans/{found[name]}")
            answered("get_plan", f"/plans/{found[name]}?robot=hash")
            for form in ("json", "joint-trajectory", "robot-trajectory", "display-trajectory"):
                answered("get_trajectory", f"/plans/{found[name]}/trajectory?dt=0.1&format={form}")
            for form in ("follow-joint-trajectory", "lerobot"):
                answered("get_trajectory", f"/plans/{found[name]}/trajectory?dt=0.1&format={form}")
        for name in ("list_plans", "list_scenes", "get_robot", "get_health", "get_ready"):
            answered(name, operation_of(name)[1])
        answered("get_scene", "/scenes/bin")
        problems = [
            asked(url, "GET", "/plans/none"),
            asked(
                url,
                "POST",
                "/plans",
                {**EXAMPLES["plans"]["between named poses"], "scene": "tabel"},
            ),
            asked(url, "POST", "/plans", {"scene": "bin"}),
        ]
    assert [(name, address, status) for name, address, status, _, _ in answers if status not in (200, 201)] == []
    assert [(name, address, fits(schema, answer)[:3]) for name, address, _, schema, answer in answers] == [
        (name, address, []) for name, address, *_ in answers
    ]
    plans = {name: answer for name, _, _, _, answer in answers if name in VERBS}
    assert all(plans[name]["ok"] for name in ("pick", "place", "pick_place", "solve", "order"))
    assert all(plans[name]["result"]["ok"] for name in ("plans", "move_linear", "replan"))
    problem = {"$ref": "#/components/schemas/ProblemReply"}
    assert [(status, fits(problem, answer)) for status, _, answer in problems] == [(404, []), (422, []), (422, [])]
