"""Forgeries that are right but for one claim: a motion that rests before it is where it says, a thing named as a link.

A thing is put in the way and all else of the file is proven anew with its contacts allowed; then the file names the
thing where links belong, and no longer says that anything was allowed. Who takes a name for a link has a whole proof.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np

import planner_service as ps
from auditor.sampling import Arm, matrix
from planner_service.records.evidence import with_evidence
from planner_service.records.plan_file import plan_or_task

if TYPE_CHECKING:
    from benchmarks.studies.evidence.forgeries import Forger

__all__ = ["name_as_link", "stop_early"]

Pairs = list[list[str]]

SMALL = 0.004
"""Metres: the radius of a thing that touches what it is put into and, mostly, nothing else."""


def stop_early(forger: Forger) -> None:
    """A motion that rests on its way, in time as it should be, and that claims the whole path and its goal."""
    k = forger.one()
    result, chance = forger.results[k], forger.chance
    points, blends = np.array(result["path"]["waypoints"]), np.array(result["path"]["blends"])
    path = ps.JointPath(points, blends)
    d = path.blends if len(path.blends) else np.zeros(len(points))
    piece = chance.randrange(len(points) - 1)
    begin, after = path.knots[piece] + d[piece], path.knots[piece + 1] - d[piece + 1]
    end = begin + chance.choice((0.1, 0.5, 0.9, 0.999)) * (after - begin)
    forger.put_law(k, ps.JointPath(np.vstack([points[: piece + 1], path(end)]), np.append(d[: piece + 1], 0.0)))
    result["trajectory"]["part"] = [0.0, float(end)]
    if chance.random() < 0.3:
        for claim in forger.claims(k):
            claim["part"] = [0.0, float(end)]


def name_as_link(forger: Forger) -> None:
    """The name of what stands or is held, among links that may touch, hold, carry or come out of a pose."""
    chance, loads, things = forger.chance, forger.loads(), forger.scene["obstacles"]
    links = sorted({shape["link"] for shape in forger.robot["shapes"]})
    ways = ["contacts", "out of a pose"] + ["fingers", "load", "load"] * bool(loads)
    way = chance.choice(ways[:1] if forger.no_path else ways)
    thing = chance.choice(things if way == "load" else [*things, *loads])
    name = thing["name"]
    others = sorted({it["name"] for it in (*things, *loads)} - {name})
    if way in ("fingers", "load"):
        pairs = [[it, name] for it in sorted({it["name"] for it in loads} - {name})]
    else:
        pairs = [[other, name] for other in chance.choice((links, [*links, *others], chance.sample(links, 1)))]
    if not forger.no_path and chance.random() < 0.8:
        _put_in_the_way(forger, thing, {other for other, _ in pairs})
        _prove(forger, pairs)
    robot = forger.robot
    if way == "contacts":
        robot["allowed_contacts"] += [{"links": pair, "reason": "adjacent"} for pair in pairs]
    elif way == "out of a pose":
        points = forger.results[k := forger.one()]["path"]["waypoints"]
        rest, to = chance.choice((points[:2], points[:-3:-1]))
        robot["named_poses"].append({"name": "asleep", "q": rest})
        robot["retreats"].append({"pose": "asleep", "to": to, "pairs": pairs, "reason": "asleep"})
        length = forger.results[k]["path"]["length"]
        step = float(np.linalg.norm(np.subtract(rest, to)))
        stretch = [0.0, step] if rest == points[0] else [length - step, length]
        more = {"s_start": stretch[0], "s_end": stretch[1], "pairs": pairs, "reason": "asleep"}
        exempt = [*forger.results[k]["certificate"]["exempt"], more]
        for claim in forger.claims(k):
            claim["exempt"] = exempt
    if way in ("fingers", "load") and robot["gripper"]:
        robot["gripper"]["links"].append(name)
    if way == "load":
        for it in forger.loads():
            it["touch_links"].append(name)


def _put_in_the_way(forger: Forger, thing: Any, of: set[str]) -> None:
    """Where one of those is at some place of a motion, and mostly small; what is held comes near its hand."""
    chance, robot = forger.chance, forger.robot
    if "touch_links" in thing:
        thing["pose"]["position"] = [chance.gauss(0.0, 0.04) for _ in range(3)]
        return
    segments = forger.segments or [{"result": forger.results[0], "scene": None}]
    carrying = [it for it in segments if of & {held["name"] for held in (it["scene"] or forger.scene)["attached"]}]
    segment = chance.choice(carrying or segments)
    points = np.array(segment["result"]["path"]["waypoints"])
    k = chance.randrange(len(points) - 1)
    arm, q = Arm(robot), points[k] + chance.random() * (points[k + 1] - points[k])
    at = [arm.frames(q)[it["body"]] @ matrix(it["pose"]) for it in robot["shapes"] if it["link"] in of and it["body"]]
    held = (segment["scene"] or forger.scene)["attached"]
    at += [arm.tool(q) @ matrix(it["pose"]) for it in held if it["name"] in of]
    if at:
        thing["pose"]["position"] = chance.choice(at)[:3, 3].tolist()
        if chance.random() < 0.7:
            thing["shape"] = {"kind": "sphere", "radius": SMALL}


def _prove(forger: Forger, pairs: Pairs) -> None:
    """The file with all but these pairs proven anew, if that can be done; then without a word of them."""
    try:
        read = plan_or_task("forged.json", json.dumps(forger.sealed() | {"allowed": pairs}).encode())
        document = json.loads(with_evidence(read).file_text())
    except ps.PlannerServiceError:
        return
    document["allowed"] = []
    forger.take(document)
    for result in forger.results:
        result["certificate"]["allowed"] = []
