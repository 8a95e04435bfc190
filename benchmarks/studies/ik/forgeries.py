"""Forged proofs of inverse kinematics: half of them change one thing by its meaning, half a field or a table's entry.

Whether a forgery that the verifier accepts says something false is decided by another solver, which starts three
hundred times for each pose and knows nothing of intervals: what it finds must be listed, and what is listed must bring
the tool to the goal, within the limits. Honest proofs must be accepted.
"""

from __future__ import annotations

import json
import math
import random
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from rich.table import Table

from auditor.__main__ import judged
from auditor.schema import Invalid, parsed
from auditor.trails import unpacked
from benchmarks.harness.kept import NONE, Kept
from benchmarks.harness.report import Promise, Report, Row, table_of
from benchmarks.studies.evidence.forgeries import change_field, field, leaves, table_of_forgeries
from benchmarks.studies.ik.poses import seeded
from planner_service import InvalidRequest, Pose, PoseGoal, Robot, load_robot
from planner_service.geometry.arrays import FloatArray
from planner_service.kinematics.inverse import ToolChain
from planner_service.records.evidence import packed
from planner_service.records.exports.inverse_file import inverse_document
from planner_service.records.robot import RobotRecord

__all__ = ["FALSE", "run"]

FORGERIES = 5_000
HONEST = 100
"""Random proofs that must be accepted."""

STARTS = 300
"""Of the solver that judges what is accepted."""

TABLES = {"points": 3, "domain": 0, "found": -5, "steps": 6, "sums": 14, "equations": 6, "followed": 5}
"""Columns of the packed tables; minus so many times the joints, 0 for the joints."""

CHAIN = ("joint_names", "bodies", "tool_body", "tool_placement", "continuous")
"""Fields of a robot that a proof is about, beside its limits; of all others together one is changed in turn."""

LIMITS = (("limits", "lower"), ("limits", "upper"))

KNOWN = 5
"""The step that says that a box is where a solution is alone."""

TURN = 2.0 * math.pi

Document = dict[str, Any]
Change = Callable[[Document, random.Random], None]


def bare(name: str) -> Robot:
    """The joints of an arm that move its tool, without shapes: the proof is not about them."""
    whole = load_robot(name)
    return replace(ToolChain.of(whole, whole.home).robot, shapes=(), gripper=None, gripper_width=0.0, retreats=())


def drawn(robot: Robot, rng: np.random.Generator) -> Pose:
    """The tool's pose at a random configuration."""
    return Pose.from_matrix(robot.tool_pose(rng.uniform(*robot.bounds)))


def goals(rng: np.random.Generator) -> Iterator[tuple[str, Robot, PoseGoal]]:
    """Arms and goals without end: poses, with tolerances, with a free axis, places, and poses out of reach."""
    arms = [(name, bare(name)) for name in ("wxai", "ur5", "kinova")]
    planar, wxai = bare("planar2"), arms[0][1]
    five = wxai.locked({"joint_5": 0.3})
    three = wxai.locked({"joint_3": 0.4, "joint_4": 0.1, "joint_5": 0.3})
    while True:
        yield "planar2", planar, PoseGoal(drawn(planar, rng))
        for name, robot in arms:
            yield name, robot, PoseGoal(drawn(robot, rng))
        yield "tolerances", wxai, PoseGoal(drawn(wxai, rng), position_tolerance=1e-4, orientation_tolerance=1e-4)
        yield "free axis", five, PoseGoal(drawn(five, rng), free_axis=(1.0, 0.0, 0.0))
        yield "place", three, PoseGoal(drawn(three, rng), orientation_tolerance=math.pi)
        turned = Pose(drawn(wxai, rng).position, drawn(wxai, rng).quaternion)
        yield "none", wxai, PoseGoal(turned)


def honest_files(count: int, seed: int) -> Iterator[tuple[str, Document]]:
    """Proofs of goals of which nothing is in doubt."""
    made = 0
    for name, robot, goal in goals(np.random.default_rng(seed)):
        if made == count:
            return
        try:
            document = parsed(json.dumps(inverse_document(robot, goal)).encode())
        except InvalidRequest:  # in doubt
            continue
        if name != "none" or not document["q"]:
            made += 1
            yield name, document


# Changes that make a proof claim what is not so, or show it no more.


def _joints(document: Document) -> int:
    return len(document["joints"])


def _table(document: Document, key: str) -> FloatArray:
    columns = TABLES[key] or _joints(document)
    return np.array(unpacked(document[key], "<f8", columns if columns > 0 else -columns * _joints(document)))


def _put(document: Document, key: str, table: FloatArray) -> None:
    document[key] = packed(table, "<f8")


def _off(chance: random.Random, least: float, most: float) -> float:
    return float(chance.choice((-1.0, 1.0)) * 10.0 ** chance.uniform(least, most))


def unlist(document: Document, chance: random.Random) -> None:
    """One solution is not in the list."""
    k = chance.randrange(len(document["q"]))
    for key in ("q", "lower", "upper"):
        del document[key][k]


def list_twice(document: Document, chance: random.Random) -> None:
    k = chance.randrange(len(document["q"]))
    for key in ("q", "lower", "upper"):
        document[key].append(document[key][k])


def list_elsewhere(document: Document, chance: random.Random) -> None:
    """One listed solution is moved, with its box."""
    k = chance.randrange(len(document["q"]))
    off = 10.0 ** chance.uniform(-7.0, 0.0) * np.array([chance.choice((-1.0, 1.0)) for _ in document["q"][k]])
    for key in ("q", "lower", "upper"):
        document[key][k] = (np.array(document[key][k]) + off).tolist()


def widen(document: Document, chance: random.Random) -> None:
    """The box of one is so wide that it is not known how many are in it."""
    k = chance.randrange(len(document["q"]))
    document["lower"][k] = (np.array(document["lower"][k]) - 1.5).tolist()


def forget(document: Document, chance: random.Random) -> None:
    """One solution is nowhere, and where it was alone is said to have none for some other reason."""
    n, found, steps = _joints(document), _table(document, "found"), _table(document, "steps")
    k = chance.randrange(len(found))
    known = (steps[:, 0] == KNOWN) & (steps[:, 1] == k)
    equations, sums = len(_table(document, "equations")), max(1, len(_table(document, "sums")))
    reason = chance.choice((2, 3, 4, 6))
    steps[known, 0] = reason
    steps[known, 1] = chance.randrange(sums if reason == 4 else equations)
    steps[known, 2] = -1 if reason == 4 else chance.randrange(n)
    steps[(steps[:, 0] == KNOWN) & (steps[:, 1] > k), 1] -= 1
    away = (np.array(document["q"]) - found[k, :n]) / TURN
    near = np.abs(away - np.round(away)).max(axis=1) < 1e-6
    for key in ("q", "lower", "upper"):
        document[key] = [row for row, same in zip(document[key], near, strict=True) if not same]
    _put(document, "found", np.delete(found, k, axis=0))
    _put(document, "steps", steps)


def forget_and_cut(document: Document, chance: random.Random) -> None:
    """A cut takes away a solution, and the steps that follow in its box, too."""
    forget(document, chance)
    steps = _table(document, "steps")
    k = chance.choice(np.flatnonzero(steps[:, 0] <= 1).tolist())
    low, high = steps[k, 3:5]
    at = low + (high - low) * chance.random()
    steps[k, 3:5] = (low, at) if chance.random() < 0.5 else (at, high)
    _put(document, "steps", steps)


def forget_and_stop(document: Document, chance: random.Random) -> None:
    forget(document, chance)
    steps = _table(document, "steps")
    _put(document, "steps", steps[: chance.randrange(len(steps))])


def move_the_goal(document: Document, chance: random.Random) -> None:
    document["goal"]["pose"]["position"][chance.randrange(3)] += _off(chance, -6.0, -1.0)


def move_the_tool(document: Document, chance: random.Random) -> None:
    body = document["robot"]["bodies"][document["robot"]["tool_body"]]
    body["placement"][chance.randrange(3)][3] += _off(chance, -6.0, -1.0)


def narrow_a_limit(document: Document, chance: random.Random) -> None:
    """It leaves a listed solution outside."""
    robot, joint = document["robot"], chance.randrange(_joints(document))
    column = robot["joint_names"].index(document["joints"][joint])
    robot["limits"]["upper"][column] = document["q"][-1][joint] - 1e-6


FALSE: tuple[Change, ...] = (
    *(unlist, list_twice, list_elsewhere, widen, forget, forget_and_cut, forget_and_stop),
    *(move_the_goal, move_the_tool, narrow_a_limit),
)


# Others, which may leave what is claimed true.


def _body(document: Document, chance: random.Random) -> Any:
    return chance.choice(document["robot"]["bodies"])


def widen_a_limit(document: Document, chance: random.Random) -> None:
    """A range that was not searched."""
    robot, joint = document["robot"], chance.randrange(_joints(document))
    side, sign = chance.choice((("lower", -1.0), ("upper", 1.0)))
    robot["limits"][side][robot["joint_names"].index(document["joints"][joint])] += sign * 10 ** chance.uniform(-6, 1)


def turn_an_axis(document: Document, chance: random.Random) -> None:
    body = _body(document, chance)
    body["axis"] = [-x for x in body["axis"]] if chance.random() < 0.5 else chance.sample(body["axis"], 3)


def move_a_link(document: Document, chance: random.Random) -> None:
    _body(document, chance)["placement"][chance.randrange(3)][chance.randrange(4)] += _off(chance, -9.0, 0.0)


def change_a_joint(document: Document, chance: random.Random) -> None:
    """A joint that slides, mimics, goes round, or moves more."""
    body, kind = _body(document, chance), chance.randrange(4)
    if kind == 0:
        body["prismatic"] = not body["prismatic"]
    elif kind == 1:
        body["multiplier"] = chance.choice((-1.0, 2.0, 0.5, 1.0 + 1e-9))
    elif kind == 2:
        document["robot"]["continuous"] = [chance.random() < 0.5 for _ in document["robot"]["joint_names"]]
    else:
        body["q_index"] = chance.randrange(_joints(document))


def turn_the_goal(document: Document, chance: random.Random) -> None:
    document["goal"]["pose"]["quaternion_wxyz"][chance.randrange(4)] += _off(chance, -9.0, 0.0)


def change_the_room(document: Document, chance: random.Random) -> None:
    """The goal's tolerances, or its free axis."""
    room, kind = document["goal"]["room"], chance.randrange(3)
    if kind == 0:
        room["position_tolerance"] += 10.0 ** chance.uniform(-12.0, -1.0)
    elif kind == 1:
        room["orientation_tolerance"] = chance.choice((math.pi, 10.0 ** chance.uniform(-12.0, 0.0)))
    else:
        room["free_axis"] = chance.choice((None, [1.0, 0.0, 0.0], [0.0, 0.6, 0.8]))


def empty_the_list(document: Document, chance: random.Random) -> None:
    """All solutions are gone, from the list or from the proof, too; maybe one step discards all."""
    for key in ("q", "lower", "upper"):
        document[key] = []
    if chance.random() < 0.7:
        document["found"] = packed(np.zeros((0, 5 * _joints(document))), "<f8")
        if chance.random() < 0.7:
            step = [chance.choice((2, 3, 4, 6)), chance.randrange(12), chance.choice((-1, 0, 1)), 0.0, 0.0, 0.0]
            _put(document, "steps", np.array([[8.0, 0.0, 0.0, 0.0, 0.0, 0.0], step]))


def change_steps(document: Document, chance: random.Random) -> None:
    """Left out, doubled, swapped, or in another order."""
    steps, kind = _table(document, "steps"), chance.randrange(4)
    i, j = chance.randrange(len(steps)), chance.randrange(len(steps))
    if kind == 0:
        steps = np.delete(steps, range(i, min(len(steps), i + chance.choice((1, 1, 2, 5)))), axis=0)
    elif kind == 1:
        steps = np.insert(steps, j, steps[i], axis=0)
    elif kind == 2:
        steps[[i, j]] = steps[[j, i]]
    else:
        steps = steps[::-1]
    _put(document, "steps", steps)


def cut_more(document: Document, chance: random.Random) -> None:
    """One cut takes away more, or what a split leaves out is wider."""
    steps = _table(document, "steps")
    some = np.flatnonzero(np.isin(steps[:, 0], (0, 1, 7)))
    if len(some):
        k, share = int(chance.choice(some.tolist())), 10.0 ** chance.uniform(-6.0, 0.0)
        low, high = steps[k, 3:5]
        by = share * ((high - low) if steps[k, 0] < 7 else 1.0)
        steps[k, 3:5] = (low + by, high) if chance.random() < 0.5 else (low, high - by)
        if steps[k, 0] == 7:
            steps[k, 3:5] = (low - by, high) if chance.random() < 0.5 else (low, high + by)
    _put(document, "steps", steps)


def trust_too_much(document: Document, chance: random.Random) -> None:
    """The region where a solution is said to be alone is larger, or its box is smaller or elsewhere."""
    found, n = _table(document, "found"), _joints(document)
    one = found[chance.randrange(len(found))].reshape(5, n)
    by, kind = chance.choice((1.01, 1.5, 4.0, 50.0)), chance.randrange(3)
    if kind == 0:
        one[3:] = one[0] + by * (one[3:] - one[0])
    elif kind == 1:
        one[1:3] = one[0] + (one[1:3] - one[0]) / by
    else:
        one += _off(chance, -12.0, 0.5)
    _put(document, "found", found)


def change_a_table(document: Document, chance: random.Random) -> None:
    """One number of what is packed."""
    key = chance.choice(list(TABLES))
    table = _table(document, key)
    if table.size:
        k = chance.randrange(table.size)
        table.flat[k] += chance.choice((1.0, -1.0, _off(chance, -12.0, 0.0), -2.0 * table.flat[k]))
    _put(document, key, table)


OTHERS: tuple[Change, ...] = (
    *(widen_a_limit, turn_an_axis, move_a_link, change_a_joint, turn_the_goal, change_the_room, empty_the_list),
    *(change_steps, cut_more, trust_too_much, change_a_table),
)
CHANGES = (*FALSE, *OTHERS)


def run(queries: int | None, seed: int, robot: str | None = None, kept: Kept = NONE) -> Report:
    """Forge so many proofs, and check a fiftieth as many honest ones, whichever arm is asked for."""
    count = FORGERIES if queries is None else queries
    honest, files = list[Row](), list[tuple[str, Document]]()
    for name, document in honest_files(HONEST if queries is None else max(8, queries // 50), seed):
        honest.append({"kind": "honest", "file": name, "why": _why(document), "false": "", "changed": False})
        if len(files) < 16:
            files.append((name, document))
    forged = list(_forged(files, count, random.Random(f"inverse {seed}")))
    false, refused = [row for row in forged if row["false"]], [row for row in honest if row["why"]]
    promises = (
        Promise(
            f"no forged proof is accepted that says what is not so, of {len(forged):,}", f"{len(false)}", not false
        ),
        Promise(f"honest ones are accepted, of {len(honest)}", f"{len(honest) - len(refused)}", not refused),
    )
    odd = [*false, *refused]
    tables = (_by_kind(forged), *([_odd(odd)] if odd else []))
    return Report("ik forgeries", (*honest, *forged), tables, promises)


def _forged(files: Sequence[tuple[str, Document]], count: int, chance: random.Random) -> Iterator[Row]:
    places: list[dict[Any, list[Any]]] = []
    for _, document in files:
        by_field: dict[Any, list[Any]] = {}
        for place in leaves(document):
            counts = (
                place[0] != "robot" or place[1] in CHAIN or place[1:3] in (("limits", "lower"), ("limits", "upper"))
            )
            by_field.setdefault(field(place) if counts else ("robot",), []).append(place)
        places.append(by_field)
    turns: Counter[Any] = Counter()
    for number in range(count):
        k = chance.randrange(len(files))
        name, honest = files[k]
        document, kind = deepcopy(honest), "field"
        if number % 2:
            change = CHANGES[turns["kind"] % len(CHANGES)]
            turns["kind"] += 1
            kind = change.__name__
            try:
                change(document, chance)
            except (IndexError, ValueError):  # a proof without what this changes, such as solutions
                document, kind = deepcopy(honest), "field"
        if kind == "field":
            fields = list(places[k])
            change_field(document, chance.choice(places[k][fields[turns[k] % len(fields)]]), chance)
            turns[k] += 1
        yield _judged(kind, name, document, honest)


def _why(document: Document) -> str:
    """Why the verifier refuses a file; empty if it accepts it."""
    try:
        list(judged(document))
    except Invalid as refused:
        return str(refused)[:160] or "refused"
    return ""


def _judged(kind: str, name: str, document: Document, honest: Document) -> Row:
    try:
        document = json.loads(json.dumps(document, allow_nan=False))
    except ValueError:
        return {"kind": kind, "file": name, "why": "no file", "false": "", "changed": True}
    why, changed, false = _why(document), document != honest, ""
    if not why and changed:
        try:
            said = {"robot": _meant(document["robot"], honest["robot"]), "goal": document["goal"]}
            false = _objection(document, *_reached(json.dumps(said, sort_keys=True)))
        except Exception as error:  # what cannot be read must not be accepted
            false = f"cannot be judged: {type(error).__name__}, {error}"
    return {"kind": kind, "file": name, "why": why, "false": false, "changed": changed}


def _objection(document: Document, robot: Robot, goal: PoseGoal, found: Sequence[FloatArray]) -> str:
    """What is not so of what a file says; empty if nothing is found."""
    q, low, high = (np.array(document[key], float).reshape(-1, robot.n) for key in ("q", "lower", "upper"))
    lower, upper = robot.bounds
    endless = np.array(robot.continuous or [False] * robot.n)
    slack = 1e-9 * (1.0 + np.abs(lower))
    if np.any(~endless & ((q < lower - slack) | (q > upper + slack))):
        return "beyond the limits"
    for row in q:
        off, turned = _away(robot, goal, row)
        if off > goal.position_tolerance + 1e-8 or turned > goal.orientation_tolerance + 1e-7:
            return f"the tool is {off:.1e} m and {turned:.1e} rad away"
    if np.any(low > high) or len({tuple(np.round(row, 7)) for row in q}) < len(q):
        return "stands twice"
    for row in found:
        middle = (low + high) / 2
        away = row - middle
        away = np.where(endless, away - TURN * np.round(away / TURN), away)
        if not np.any(np.all(np.abs(away) <= (high - low) / 2 + 1e-9, axis=1)):
            return f"not listed: {np.round(row, 6).tolist()}"
    return ""


@lru_cache(maxsize=64)
def _reached(said: str) -> tuple[Robot, PoseGoal, list[FloatArray]]:
    """The arm and the goal of a file, and configurations that the other solver finds for it."""
    document = json.loads(said)
    robot = _robot(document["robot"])
    arm = ToolChain.of(robot, robot.home).robot
    at, room = document["goal"]["pose"], document["goal"]["room"] or {}
    goal = PoseGoal(Pose(tuple(at["position"]), tuple(at["quaternion_wxyz"])), **room)
    return arm, goal, list(seeded(arm, goal, np.random.default_rng(0), STARTS))


def _meant(said: Document, honest: Document) -> Document:
    """An honest robot whose chain of bodies and whose limits are as said; a proof is about no more."""
    record = deepcopy(honest)
    for key in CHAIN:
        record.pop(key, None)
        record |= {key: said[key]} if key in said else {}
    record["bodies"] = [honest["bodies"][0], *record["bodies"][1:]]  # the base, whose frame is all that there is
    record["limits"] |= {key: said["limits"][key] for key in ("lower", "upper")}
    for pose in record["named_poses"]:
        pose["q"] = said["limits"]["lower"]
    for key in ("dynamics", "link_frames", "locked_joints"):
        record.pop(key, None)
    return record


def _robot(record: Document) -> Robot:
    try:
        return RobotRecord.model_validate(record).value
    except InvalidRequest as error:
        if error.field != "hash":
            raise
        return RobotRecord.model_validate(record | {"hash": error.expected.split()[-1]}).value


def _away(robot: Robot, goal: PoseGoal, q: FloatArray) -> tuple[float, float]:
    """Metres and radians by which a goal is missed."""
    T = robot.tool_pose(q)
    off = float(np.linalg.norm(T[:3, 3] - np.array(goal.pose.position)))
    if goal.orientation_tolerance >= math.pi:
        return off, 0.0
    if goal.free_axis is not None:
        have, want = T[:3, :3] @ np.array(goal.free_axis), goal.pose.rotation @ np.array(goal.free_axis)
        return off, math.atan2(float(np.linalg.norm(np.cross(have, want))), float(have @ want))
    turned = float(np.linalg.norm(T[:3, :3] - goal.pose.rotation)) / math.sqrt(8.0)
    return off, 2.0 * math.asin(min(1.0, turned))


def _by_kind(rows: Sequence[Row]) -> Table:
    caption = (
        "Accepted and true: another name of the arm, a step that is not needed, a number that may be a little off."
    )
    return table_of_forgeries("Forged proofs of inverse kinematics", rows, caption)


def _odd(rows: Sequence[Row]) -> Table:
    lines = [{key: str(row[key]) for key in ("kind", "file", "why", "false")} for row in rows[:40]]
    return table_of("Accepted and refuted, or honest and refused", lines)
