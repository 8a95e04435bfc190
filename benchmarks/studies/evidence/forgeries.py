"""Forged files: their author changed what they mean, and worked out every digest anew.

Whether a forgery that the verifier accepts says something false is decided by ``auditor.sampling``: Pinocchio places
shapes, Coal measures, speeds are differences. A change that leaves the meaning as it is must be accepted. Fields of the
schema are taken in turn, so that each that any file has is hit.
"""

from __future__ import annotations

import json
import math
import random
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from typing import Any

import numpy as np
from rich.table import Table

import planner_service as ps
from auditor.__main__ import judged
from auditor.sampling import no_path_objections, objections
from auditor.schema import Invalid
from auditor.trails import digest, unpacked
from benchmarks.harness.report import Promise, Report, Row, grouped, table_of
from benchmarks.studies.evidence.bundled import change_bundles
from benchmarks.studies.evidence.otherwise_right import name_as_link, stop_early
from benchmarks.studies.evidence.saved_files import Document, saved_files
from planner_service.records.evidence import packed
from planner_service.records.robot import RobotRecord
from planner_service.records.scene import SceneRecord

__all__ = ["Forger", "forged", "meaning", "objections_of", "run", "table_of_forgeries"]

FORGERIES = 20_000
SAMPLES = 80
"""Along each motion of an accepted forgery."""

TASKS = 0.08
"""Share of forgeries of tasks, which take ten times as long."""

SAID = ("path", "trajectory", "certificate", "constraints", "goal_index")
"""Of a result: what sampling looks at."""

Place = tuple[str | int, ...]


class Forger:
    """A file that is changed; ``True`` from a change says that the meaning is the same."""

    def __init__(self, document: Document, others: Sequence[Document], chance: random.Random) -> None:
        self.chance, self.others = chance, others
        self.take(deepcopy(document))

    def take(self, document: Document) -> None:
        """This one in place of the file."""
        self.document, self.robot, self.scene = document, document["robot"], document["scene"]
        self.no_path = "encloses" in self.document
        self.segments = self.document.get("segments", [])
        self.section = self.document["sections"]["evidence"] if not self.no_path else {"proofs": []}
        self.results = [segment["result"] for segment in self.segments] or [self.document.get("result")]
        proofs = self.section["proofs"]
        self.proofs = [proof for proof in proofs if proof["gripper"][0] == proof["gripper"][1]]

    def sealed(self) -> Document:
        """The file with its hashes and digests made right."""
        for part, record in (("robot", RobotRecord), ("scene", SceneRecord)):
            try:
                record.model_validate(self.document[part]).value  # noqa: B018
            except ps.InvalidRequest as error:
                if error.field == "hash":
                    self.document[part]["hash"] = error.expected.split()[-1]
            except (KeyError, TypeError, ValueError):  # no robot or scene any more
                pass
        if not self.no_path:
            for part in ("robot", "scene"):
                self.section[part] = digest(self.document[part])
        return self.document

    def one(self) -> int:
        return self.chance.randrange(len(self.results))

    def loads(self) -> list[Any]:
        """What is held, at the start and in each scene."""
        return [*self.scene["attached"], *(it for s in self.segments if s["scene"] for it in s["scene"]["attached"])]

    def scale(self) -> float:
        return float(self.chance.choice((-1.0, 1.0)) * 10.0 ** self.chance.uniform(-4.0, 0.5))

    def claims(self, k: int) -> list[Any]:
        return [self.results[k]["certificate"], self.proofs[k]]

    def renumber(self) -> None:
        """Numbers of the motions in the order of the proofs."""
        number = -1
        for proof in self.section["proofs"]:
            alone = proof["gripper"][0] != proof["gripper"][1]
            number += not alone
            proof["motion"] = number + alone

    def put_path(self, k: int, points: Any) -> None:
        """Another path with a law of its own and the trail stretched along it."""
        try:
            path = ps.JointPath(np.array(points))
            self.put_law(k, path)
        except (ps.InvalidRequest, ValueError):
            return
        waypoints, blends = path.waypoints.tolist(), path.blends.tolist()
        self.results[k]["path"] = {"length": path.length, "waypoints": waypoints, "blends": blends}
        s = unpacked(self.proofs[k]["s"], "<f8", 1)[:, 0]
        if len(s) and s[-1] > 0.0:
            self.proofs[k]["s"] = packed(s * (path.length / s[-1]), "<f8")

    def put_law(self, k: int, path: ps.JointPath) -> None:
        """Another law, which runs along a path from rest to rest within the limits."""
        result, limits = self.results[k], self.robot["limits"]
        scales = self.document["request"] or {"velocity_scale": 1.0, "acceleration_scale": 1.0}
        most = {key: np.array(values) for key, values in limits.items()}
        most["velocity"] = most["velocity"] * scales["velocity_scale"]
        most["acceleration"] = most["acceleration"] * scales["acceleration_scale"]
        trajectory = ps.Trapezoidal().time_path(path, ps.JointLimits(**most))
        result["trajectory"] |= {"durations": trajectory.durations.tolist(), "duration": trajectory.duration}
        result["trajectory"] |= {"coefficients": trajectory.coefficients.tolist()}
        result["motion"]["duration"] = trajectory.duration

    def rows(self, k: int) -> Any:
        return unpacked(self.proofs[k]["rows"], "<i4", 9).copy()

    def put_rows(self, k: int, rows: Any) -> None:
        self.proofs[k]["rows"] = packed(rows, "<i4")

    # Motions.

    def swap(self) -> None:
        """Motions of a task, or obstacles, or waypoints."""
        if len(self.segments) > 1 and self.chance.random() < 0.7:
            i, j = self.chance.sample(range(len(self.segments)), 2)
            self.segments[i], self.segments[j] = self.segments[j], self.segments[i]
            if self.chance.random() < 0.5:
                self.section["proofs"].sort(key=lambda proof: {i: j, j: i}.get(proof["motion"], proof["motion"]))
                self.renumber()
        elif len(self.scene["obstacles"]) > 1 and self.chance.random() < 0.5:
            i, j = self.chance.sample(range(len(self.scene["obstacles"])), 2)
            key = self.chance.choice(("shape", "pose"))
            one, two = self.scene["obstacles"][i], self.scene["obstacles"][j]
            one[key], two[key] = two[key], one[key]
        else:
            k = self.one()
            self.put_path(k, self.results[k]["path"]["waypoints"][::-1])

    def drop(self) -> None:
        """A motion, an obstacle, a shape or a waypoint."""
        kind = self.chance.choice(("motion", "obstacle", "shape", "waypoint", "obstacle"))
        if kind == "motion" and len(self.segments) > 1:
            k = self.chance.randrange(len(self.segments))
            del self.segments[k]
            proofs = self.section["proofs"]
            self.section["proofs"] = [proof for proof in proofs if proof["motion"] != k]
            self.renumber()
        elif kind == "shape":
            del self.robot["shapes"][self.chance.randrange(len(self.robot["shapes"]))]
        elif kind == "waypoint":
            k = self.one()
            points = self.results[k]["path"]["waypoints"]
            if len(points) > 2:
                del points[self.chance.randrange(1, len(points) - 1)]
                self.put_path(k, points)
        elif self.scene["obstacles"]:
            del self.scene["obstacles"][self.chance.randrange(len(self.scene["obstacles"]))]

    def merge(self) -> None:
        """Two motions of a task, or the pieces of one, into one."""
        if len(self.segments) > 1:
            k = self.chance.randrange(len(self.segments) - 1)
            points = [self.results[j]["path"]["waypoints"] for j in (k, k + 1)]
            self.put_path(k, [*points[0], *points[1][1:]])
            del self.segments[k + 1]
            self.section["proofs"] = [proof for proof in self.section["proofs"] if proof["motion"] != k + 1]
            self.renumber()
        else:
            points = self.results[0]["path"]["waypoints"]
            self.put_path(0, [points[0], points[-1]])

    def cut(self) -> None:
        """A motion short, with its claim and its trail as far as it goes."""
        k = self.one()
        points = np.array(self.results[k]["path"]["waypoints"])
        share = self.chance.uniform(0.2, 0.999)
        points[-1] = points[-2] + share * (points[-1] - points[-2])
        if self.chance.random() < 0.5:
            self.put_path(k, points)
        else:
            part = [0.0, share * self.results[k]["path"]["length"]]
            for claim in self.claims(k):
                claim["part"] = part

    def splice(self) -> None:
        """A detour into a motion."""
        k = self.one()
        points = np.array(self.results[k]["path"]["waypoints"])
        at = self.chance.randrange(1, len(points))
        aside = (points[at - 1] + points[at]) / 2 + np.array([self.chance.gauss(0.0, 0.2) for _ in points[0]])
        self.put_path(k, np.insert(points, at, aside, axis=0))

    def retime(self) -> None:
        """Faster, or otherwise in time."""
        law, kind = self.results[k := self.one()]["trajectory"], self.chance.randrange(4)
        if not law["durations"]:
            return
        if kind == 0:
            factor = self.chance.choice((0.5, 0.9, 0.99, 0.9999, 1.5))
            law["durations"] = [h * factor for h in law["durations"]]
            law["coefficients"] = [[c / factor**p for p, c in enumerate(row)] for row in law["coefficients"]]
            law["duration"] = sum(law["durations"])
            self.results[k]["motion"]["duration"] = law["duration"]
        elif kind == 1:
            row, column = self.chance.choice(law["coefficients"]), self.chance.randrange(4)
            row[column] += self.scale()
        elif kind == 2:
            at = self.chance.randrange(len(law["durations"]))
            del law["durations"][at], law["coefficients"][at]
            law["duration"] = self.results[k]["motion"]["duration"] = sum(law["durations"])
        else:
            law["part"] = [self.chance.uniform(0.0, 0.3), self.results[k]["path"]["length"]]

    # Solids.

    def shrink(self) -> None:
        """A solid of the robot, of what stands or is held."""
        group = self.chance.choice(("robot", "scene", "held", "finger"))
        solids = [shape["shape"] for shape in self.robot["shapes"]]
        if group == "scene":
            solids = [it["shape"] for it in self.scene["obstacles"]]
        elif group == "held":
            solids = [it["shape"] for it in self.loads()]
        elif group == "finger":
            solids = [it["shape"] for it in (self.robot["gripper"] or {"closed": []})["closed"]]
        if solids:
            solid, by = self.chance.choice(solids), self.chance.choice((0.1, 0.5, 0.9, 0.99, 1.2, 3.0))
            for key in ("radius", "length", "resolution", "cell"):
                if key in solid:
                    solid[key] *= by
            if "size" in solid:
                solid["size"] = [by * x for x in solid["size"]]

    def move(self) -> None:
        """What stands, is held, or is part of the robot."""
        poses = [it["pose"] for it in (*self.scene["obstacles"], *self.loads())]
        poses += [
            it["pose"] for s in self.segments if s["scene"] for it in s["scene"]["obstacles"] if isinstance(it, dict)
        ]
        if self.chance.random() < 0.3 or not poses:
            poses = [shape["pose"] for shape in self.robot["shapes"]]
        self.chance.choice(poses)["position"][self.chance.randrange(3)] += self.scale()

    def rename(self) -> None:
        """One thing as another one is called."""
        named = [*self.scene["obstacles"], *self.loads()]
        if named:
            links = [shape["link"] for shape in self.robot["shapes"]]
            names = [*links, *(it["name"] for it in named), "new", "a (object)", "base"]
            self.chance.choice(named)["name"] = self.chance.choice(names)

    # What is exempt, and the worlds.

    def exempt(self) -> None:
        """Pairs on stretches, whole or longer, with a depth or without."""
        k = self.one()
        result, length = self.results[k], self.results[k]["path"]["length"]
        names = [shape["link"] for shape in self.robot["shapes"]]
        names += [it["name"] for it in (*self.scene["obstacles"], *self.scene["attached"])]
        own = result["certificate"]["exempt"]
        if own and self.chance.random() < 0.5:
            changed = deepcopy(own)
            each = self.chance.choice(changed)
            kind = self.chance.randrange(4)
            if kind == 0:
                each["s_end"] = min(length, each["s_end"] + abs(self.scale()))
            elif kind == 1:
                each["s_start"] = max(0.0, each["s_start"] - abs(self.scale()))
            elif kind == 2:
                each["pairs"] = [self.chance.sample(names, 2)]
            else:
                each["depth"] = self.chance.choice((None, 0.001, 0.01, 0.09, (each.get("depth") or 0.0) + 1e-4))
        else:
            begin, end = sorted(self.chance.uniform(0.0, length) for _ in range(2))
            begin = self.chance.choice((0.0, begin))
            depth = self.chance.choice((None, 0.0005, 0.003, 0.05))
            more = {"s_start": begin, "s_end": end, "pairs": [self.chance.sample(names, 2)], "reason": "meant"}
            changed = [*own, more | ({} if depth is None else {"depth": depth})]
        for claim in self.claims(k):
            claim["exempt"] = changed

    def change_robot(self) -> None:
        """What it may touch, its limits, its joints, its ways out."""
        kind, robot = self.chance.randrange(7), self.robot
        links = sorted({shape["link"] for shape in robot["shapes"]})
        if kind == 0 and len(links) > 1:
            robot["allowed_contacts"].append({"links": self.chance.sample(links, 2), "reason": "adjacent"})
        elif kind == 1:
            limits = robot["limits"][self.chance.choice(("lower", "upper", "velocity", "acceleration"))]
            limits[self.chance.randrange(len(limits))] *= self.chance.choice((0.5, 0.9, 1.1, 3.0, -1.0))
        elif kind == 2:
            body = self.chance.choice(robot["bodies"][1:])
            body["axis"] = [-x for x in body["axis"]]
        elif kind == 3:
            body = self.chance.choice(robot["bodies"][1:])
            body["prismatic"] = not body["prismatic"]
        elif kind == 4:
            robot["continuous"] = [self.chance.random() < 0.5 for _ in robot["joint_names"]]
        elif kind == 5:
            body = self.chance.choice(robot["bodies"][1:])
            body["placement"][self.chance.randrange(3)][3] += self.scale()
        elif len(links) > 1:
            pose = self.chance.choice(robot["named_poses"])
            pairs = [self.chance.sample(links, 2)]
            robot["retreats"].append({"pose": pose["name"], "to": pose["q"], "pairs": pairs, "reason": "asleep"})

    def change_world(self) -> None:
        """What a motion says that stands around it, what the file allows, one more thing in the way."""
        kind = self.chance.randrange(4)
        if kind == 0 and self.segments:
            segment = self.chance.choice(self.segments)
            segment["scene"] = {"obstacles": [], "attached": (segment["scene"] or self.scene)["attached"]}
        elif kind == 1:
            names = [shape["link"] for shape in self.robot["shapes"]] + [it["name"] for it in self.scene["obstacles"]]
            self.document["allowed"] = [sorted(self.chance.sample(names, 2))]
        elif kind == 2 and self.segments:
            self.chance.choice(self.segments)["scene"] = None
        else:
            at = {"position": [self.chance.gauss(0.2, 0.3) for _ in range(3)], "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0]}
            ball = {"name": "ball", "shape": {"kind": "sphere", "radius": 0.05}, "pose": at}
            self.scene["obstacles"].insert(self.chance.choice((0, len(self.scene["obstacles"]))), ball)

    def change_load(self) -> None:
        """What is held: who may touch it, since when, with which constraints."""
        held = self.loads()
        kind, links = self.chance.randrange(4), [shape["link"] for shape in self.robot["shapes"]]
        if kind == 0 and held:
            self.chance.choice(held)["touch_links"].append(self.chance.choice(links))
        elif kind == 1 and held:
            self.chance.choice(held).pop("constraints", None)
        elif kind == 2 and self.segments:
            carried = [s for s in self.segments if s["scene"] and s["scene"]["attached"]]
            if carried:
                self.chance.choice(carried)["scene"]["attached"] = []
        elif held:
            self.chance.choice(held)["pose"]["position"][self.chance.randrange(3)] += self.scale()

    def change_gripper(self) -> None:
        """Its widths, its fingers, its kind."""
        kind, grip = self.chance.randrange(5), self.robot["gripper"]
        if kind == 0 and self.segments:
            segment = self.chance.choice(self.segments)
            if segment["gripper_width"] is not None:
                segment["gripper_width"] += self.scale() * 0.02
        elif kind == 1 and self.section["proofs"]:
            proof = self.chance.choice(self.section["proofs"])
            proof["moved"] = [x + self.scale() * 0.01 for x in proof["moved"]]
        elif kind == 2 and self.segments:
            self.chance.choice(self.segments)["gripper"] = None
        elif kind == 3 and grip:
            grip["kind"] = self.chance.choice(("parallel", "revolute", "vacuum"))
        else:
            self.robot["gripper_width"] += self.scale() * 0.02

    def change_constraint(self) -> None:
        """Fewer, tighter or others."""
        lists = [result["constraints"] for result in self.results if result.get("constraints")]
        lists += [(self.document["request"] or {}).get("constraints", [])]
        lists = [each for each in lists if each]
        new = {"kind": "joint range", "joint": self.robot["joint_names"][0], "lower": -0.1, "upper": 0.1}
        if not lists or self.chance.random() < 0.2:
            self.results[self.one()]["constraints"] = [new]
            return
        constraints = self.chance.choice(lists)
        each = self.chance.choice(constraints)
        if self.chance.random() < 0.3:
            constraints.remove(each)
        elif each["kind"] == "tool region" and each["tilt"] is not None:
            each["tilt"] *= self.chance.choice((0.01, 0.5, 0.9, 1.1))
        else:
            side = self.chance.choice(("lower", "upper"))
            each[side] = [None if x is None else x * 0.1 for x in each[side]] if each["kind"] == "tool region" else 0.0

    # Trails and claims.

    def change_trail(self) -> None:
        """Rows, directions, pairs and places of a proof."""
        k, kind = self.one(), self.chance.randrange(8)
        rows, proof = self.rows(k), self.proofs[k]
        if not len(rows):
            return
        at = self.chance.randrange(len(rows))
        if kind == 0:
            self.put_rows(k, rows[[self.chance.random() > 0.02 for _ in rows]])
        elif kind == 1:
            self.put_rows(k, rows[rows[:, 0] != rows[at, 0]])
        elif kind == 2:
            rows[at, 2] = rows[:, 2].max()
            self.put_rows(k, np.delete(rows, [j for j in range(len(rows)) if rows[j, 0] == rows[at, 0] and j != at], 0))
        elif kind == 3:
            off = np.array([self.chance.gauss(0.0, 0.5) for _ in range(6)])
            n = (rows[at, 3:] / 2.0**30 + off).reshape(2, 3)
            rows[at, 3:] = np.rint(n / np.linalg.norm(n, axis=1)[:, None] * 2**30).ravel()
            self.put_rows(k, rows)
        elif kind == 4:
            rows[:, 3:] = np.clip(rows[:, 3:] * self.chance.uniform(1.001, 1.9), -(2**31), 2**31 - 1)
            self.put_rows(k, rows)
        elif kind == 5:
            pairs = unpacked(proof["pairs"], "<i4", 3).copy()
            pairs[self.chance.randrange(len(pairs)), self.chance.randrange(3)] += self.chance.choice((-1, 1, 7))
            proof["pairs"] = packed(pairs, "<i4")
        elif kind == 6:
            s = unpacked(proof["s"], "<f8", 1)[:, 0].copy()
            s[self.chance.randrange(len(s))] += self.chance.gauss(0.0, 0.02)
            proof["s"] = packed(np.sort(np.clip(s, 0.0, s.max())), "<f8")
        else:
            other = self.chance.choice([each for each in self.others if "encloses" not in each])
            proof |= {key: other["sections"]["evidence"]["proofs"][0][key] for key in ("s", "pairs", "rows")}

    def raise_claim(self) -> None:
        """More clearance than is shown, in the certificate, the proof or both."""
        claims = self.claims(self.one())
        for claim in self.chance.choice((claims, claims[:1], claims[1:])):
            if claim["clearance"] is not None:
                claim["clearance"] += 10.0 ** self.chance.uniform(-6.0, -1.0)

    def change_form(self) -> None:
        """Keys, versions, formats."""
        kind, other = self.chance.randrange(4), deepcopy(self.chance.choice(self.others))
        if kind == 0:
            self.document["format"] = self.chance.choice(("planner-service/plan", "planner-service/task", "plan", None))
        elif kind == 1:
            self.document["version"] = self.chance.choice((1, 2, 4, True, "3"))
        elif kind == 2:
            for key in other.keys() - self.document.keys():
                self.document[key] = other[key]
        else:
            key = self.chance.choice(sorted(other))
            if key in self.document and other[key] != self.document[key]:
                self.document[key] = other[key]

    # What means the same.

    def same(self) -> bool:
        """Another order of keys, a smaller claim, rows in another order, one more section, whole numbers as such."""
        kind = self.chance.randrange(5)
        if kind == 0:
            self.document = _shuffled(self.document, self.chance)
            self.section = self.document["sections"]["evidence"]
        elif kind == 1:
            k = self.one()
            share = self.chance.uniform(0.1, 0.999)
            for claim in self.claims(k):
                if claim["clearance"] is not None and claim["clearance"] * share > max(claim["padding"], 2e-6):
                    claim["clearance"] *= share
        elif kind == 2:
            k = self.one()
            rows = self.rows(k)
            self.put_rows(k, rows[self.chance.sample(range(len(rows)), len(rows))])
        elif kind == 3:
            self.document["sections"]["others"] = {"anything": [1, 2, None]}
        else:
            self.scene["description"], self.document["made_with"] = "told otherwise", {"by": "somebody"}
        return True


def _shuffled(value: Any, chance: random.Random) -> Any:
    if isinstance(value, dict):
        keys = chance.sample(sorted(value), len(value))
        return {key: _shuffled(value[key], chance) for key in keys}
    return [_shuffled(entry, chance) for entry in value] if isinstance(value, list) else value


KINDS: tuple[Callable[[Forger], bool | None], ...] = (
    *(Forger.swap, Forger.drop, Forger.merge, Forger.cut, Forger.splice, Forger.retime, Forger.shrink, Forger.move),
    *(Forger.rename, Forger.exempt, Forger.change_robot, Forger.change_world, Forger.change_load),
    *(Forger.change_gripper, Forger.change_constraint, Forger.change_trail, Forger.raise_claim, Forger.change_form),
    *(stop_early, name_as_link, change_bundles, Forger.same),
)
OF_NO_PATH = (
    *(Forger.shrink, Forger.move, Forger.rename, Forger.change_robot, Forger.change_form, Forger.drop),
    name_as_link,
)


Judge = Callable[[str, str, bool, Forger, Document], Row]
"""Of the kind of a forgery, its file, whether it means the same, itself, and the file as it was."""


def leaves(value: Any, at: Place = ()) -> Iterator[Place]:
    """Places of all values that are neither objects nor lists, and of empty ones."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    found = False
    for key, entry in items:
        found = True
        yield from leaves(entry, (*at, key))
    if not found:
        yield at


def field(place: Place) -> Place:
    """The field that a place belongs to, whichever entry of a list it is in."""
    return tuple(key for key in place if isinstance(key, str))


def change_field(document: Document, place: Place, chance: random.Random) -> None:
    """Another value in the place of one: a number moved, a word from elsewhere, a table with one byte changed."""
    holder = document
    for key in place[:-1]:
        holder = holder[key]  # type: ignore[index]
    value = holder[place[-1]]  # type: ignore[index]
    new: Any = chance.choice((0.0, 1, "x", None, [], {}))
    if isinstance(value, bool):
        new = not value
    elif isinstance(value, int | float):
        step = chance.choice((0.05, -0.05, 1e-5, 1.0, -1.0))
        new = value + (step if isinstance(value, float) else chance.choice((-1, 1, 7)))
        if chance.random() < 0.1:
            new = chance.choice((str(value), -value, math.inf, None, 1e300))
    elif isinstance(value, str) and len(value) > 60:
        at = chance.randrange(len(value))
        new = value[:at] + chance.choice("AQz9+") + value[at + 1 :]
    elif isinstance(value, str):
        new = chance.choice(("table", "link_1", value + "x", value.upper(), ""))
    holder[place[-1]] = new  # type: ignore[index]


def run(queries: int | None, seed: int) -> Report:
    """Forge so many files: half of them by kinds in turn, the other half field by field."""
    chance, count = random.Random(f"forgeries {seed}"), queries or FORGERIES
    files = list(saved_files(seed))
    hit: set[Place] = set()
    rows = tuple(forged(files, count, chance, hit, _judged))
    fields = {field(place) for _, document in files for place in leaves(document)}
    missed = sorted(".".join(map(str, each)) for each in fields - hit)
    accepted = [row for row in rows if row["false"]]
    refused = [row for row in rows if row["right"] and row["why"]]
    promises = (
        Promise(f"no forgery of {len(rows):,} is accepted that sampling refutes", f"{len(accepted)} are", not accepted),
        Promise("none that means the same is refused", f"{len(refused)} are", not refused),
        Promise(f"every one of {len(fields)} fields is changed", f"{', '.join(missed[:5]) or 'all'}", not missed),
    )
    tables = [_table(rows)]
    if accepted or refused:
        tables.append(_odd([*accepted, *refused]))
    return Report("evidence", rows, tuple(tables), promises)


def forged(
    files: Sequence[tuple[str, Document]], count: int, chance: random.Random, hit: set[Place], judge: Judge
) -> Iterator[Row]:
    """What a judge says of so many forgeries; the fields that were changed are added to ``hit``."""
    everything = [document for _, document in files]
    light = [(name, document) for name, document in files if "segments" not in document]
    heavy = [(name, document) for name, document in files if "segments" in document]
    places = {name: list(leaves(document)) for name, document in files}
    by_field: dict[str, dict[Place, list[Place]]] = {
        name: {field(place): [] for place in places[name]} for name in places
    }
    for name, each in places.items():
        for place in each:
            by_field[name][field(place)].append(place)
    turns: Counter[str] = Counter()
    once = sorted({(chosen, name) for name, fields in by_field.items() for chosen in fields})
    first = dict(once)  # each field of all files once before they come in turn
    for number in range(count):
        name, document = chance.choice(heavy if chance.random() < TASKS else light)
        if number % 2:
            fields = list(by_field[name])
            chosen = fields[turns[name] % len(fields)]
            turns[name] += 1
            if first:
                chosen, name = first.popitem()
                document = dict(files)[name]
            forger = Forger(document, everything, chance)
            change_field(forger.document, chance.choice(by_field[name][chosen]), chance)
            hit.add(chosen)
            kind, right = "field", False
        else:
            forger = Forger(document, everything, chance)
            kinds = OF_NO_PATH if forger.no_path else KINDS
            change = kinds[turns[f"kind {forger.no_path}"] % len(kinds)]
            turns[f"kind {forger.no_path}"] += 1
            kind = change.__name__
            try:
                right = bool(change(forger))
            except (KeyError, IndexError, TypeError, ValueError):  # a file without what this changes
                right = False
        yield judge(kind, name, right, forger, document)


def _judged(kind: str, name: str, right: bool, forger: Forger, base: Document) -> Row:
    try:
        document = json.loads(json.dumps(forger.sealed()))
    except (KeyError, TypeError, ValueError):  # no JSON, or no file any more
        return {"kind": kind, "file": name, "right": False, "why": "no file", "false": "", "changed": True}
    changed = document != base
    try:
        list(judged(document))
        why = ""
    except Invalid as refused:
        why = str(refused)[:160] or "refused"
    false = ""
    if not why and meaning(document) != meaning(base):
        false = "; ".join(objections_of(document)[:3])
    return {"kind": kind, "file": name, "right": right, "why": why, "false": false, "changed": changed}


def meaning(document: Document) -> Any:
    """What sampling looks at: forgeries that leave it as it is are as true as the file was."""
    if "encloses" in document:
        return document
    segments = document.get("segments") or [{"result": document["result"]}]
    said = [
        {key: segment.get(key) for key in ("name", "gripper_width", "gripper", "scene")}
        | {key: segment["result"].get(key) for key in SAID}
        for segment in segments
    ]
    return [document[key] for key in ("robot", "scene", "allowed", "request")], said


def objections_of(document: Document) -> list[str]:
    """What sampling finds, for a plan or task or for a proof of no path."""
    try:
        return no_path_objections(document) if "encloses" in document else objections(document, SAMPLES)
    except Exception as error:  # what nobody else can read must not be accepted
        return [f"cannot be judged: {type(error).__name__}, {error}"]


def _table(rows: Sequence[Row]) -> Table:
    caption = (
        "true: Pinocchio and Coal find nothing false in what the changed file says, such as a plan in a world with one "
        "obstacle less, or another number in a report that is named as not verified"
    )
    return table_of_forgeries("Forged files", rows, caption)


def table_of_forgeries(title: str, rows: Sequence[Row], caption: str) -> Table:
    """Of each kind of forgery how many files were refused, and what is so of those that were accepted."""
    lines = [
        {
            "forgery": kind.replace("_", " "),
            "files": f"{len(group):,}",
            "refused": f"{sum(bool(row['why']) for row in group):,}",
            "accepted, unchanged": f"{sum(not row['why'] and not row['changed'] for row in group):,}",
            "accepted, true": f"{sum(not row['why'] and row['changed'] and not row['false'] for row in group):,}",
            "accepted, refuted": f"{sum(bool(row['false']) for row in group):,}",
        }
        for kind, group in grouped(rows, "kind").items()
    ]
    return table_of(title, lines, caption=caption)


def _odd(rows: Sequence[Row]) -> Table:
    lines = [{key: str(row[key]) for key in ("kind", "file", "why", "false")} for row in rows[:40]]
    return table_of("Accepted and refuted, or right and refused", lines)
