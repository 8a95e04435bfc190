"""Checks the evidence in a plan or task file, with numpy and the standard library alone.

    python -m auditor plan.json

Of each motion it works out what stands around it, what is held and how wide the gripper is open from the motion before
(task_rules.py); it measures the clearance that the trail of its proof shows (trails.py), bounds constraints
(verify_constraints.py), and checks that time runs along the curve within the limits (time_law.py). What it did not look
at stands in the last line. That the robot and the scene in the file are those in the room it cannot know: compare the
digests.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from itertools import combinations
from typing import Any

import numpy as np

from auditor.schema import Invalid, check_file, require
from auditor.task_rules import excused, motions, reached
from auditor.time_law import in_time
from auditor.trails import SLACK, Curve, World, digest, shown
from auditor.verify_constraints import kept

__all__ = ["Invalid", "World", "digest", "verify"]

Json = Any

MOST_TURNED = 1000.0  # radians from zero that a joint without end may be at
SEEN = "clearance, limits of joints, their speeds and accelerations, s(t), scenes, loads and the gripper, constraints"
UNSEEN = (
    "padding away from the ends, torques, jerk, the speed of the tool, whether a grasp holds, hashes, start and goals "
    "of a task, which goal, dilation, the gripper's seconds, reports of counts, times, peaks and margins"
)


def verify(document: Json, named: Json = ()) -> Iterator[str]:
    """What a plan file's evidence shows, line by line; Invalid if that is not all that the file claims.

    ``named`` are the pairs that the caller allows to touch. A file that allows any other pair is refused.
    """
    check_file(document)
    require(document.get("ok", True), "a task that failed")
    robot, section, allowed, asked = (document[key] for key in ("robot", "sections", "allowed", "request"))
    section, n, stood = section["evidence"], len(robot["joint_names"]), None
    require(document["version"] == 3, "a file of another version")
    require(section["version"] == 4, f"evidence of version {section['version']}, which is not read: write it anew")
    for part in ("robot", "scene"):
        require(section[part] == digest(document[part]), f"the evidence is for another {part}")
        yield f"{part} {section[part]}"
    for pair in allowed:
        words = "the file lets them touch everywhere; if they may, name them: --allow A B"
        require(set(pair) in map(set, named), f"{' x '.join(pair)}: {words}")
    every, endless = motions(document), np.array(robot.get("continuous") or [False] * n)
    require([len(row) == n for row in (endless, *robot["limits"].values())], "limits of other joints")
    require(len(every) == len(section["proofs"]), "other motions than the evidence is for")
    lower, upper = (
        np.where(endless, most, np.array(robot["limits"][side], float))
        for side, most in (("lower", -MOST_TURNED), ("upper", MOST_TURNED))
    )
    for proof, motion in zip(section["proofs"], every, strict=True):
        name, points, result, claim = motion.name, motion.points, motion.result, motion.claim
        require((points >= lower - SLACK) & (points <= upper + SLACK), f"{name}: a joint leaves its limits")
        same = all(claim[key] == proof[key] for key in ("clearance", "padding", "exempt", "part"))
        same &= proof["motion"] == motion.number and proof["gripper"] == motion.widths
        require(same, f"{name}: the evidence is for another motion, or the certificate claims something else")
        (x, last), alone = proof["moved"], result is None
        require(claim["certified"] and (alone or result["ok"]), f"{name}: a certificate that is none")
        world = World(robot, motion.stand, motion.hold, allowed, section["boxes"], last, alone)
        hands = [World(robot, (), (), (), {}, at) for at in (x, last)]
        fits = (alone or x == last) and stood in (None, x) and all(map(World.stands, hands, motion.widths))
        require(fits, f"{name}: fingers elsewhere")
        curve = Curve(np.column_stack([points, np.linspace(x, last, len(points))]), motion.blends)
        (begin, end), (low, high) = (part or (0.0, curve.length) for part in (motion.part, proof["part"]))
        covers = low <= begin + SLACK and high >= end - SLACK
        require(covers, f"{name}: from s = {begin:.6g} to {end:.6g} it moves, from {low:.6g} to {high:.6g} is proven")
        having = [] if alone else [result, asked or {}, *motion.hold]
        constraints = [constraint for each in having for constraint in each.get("constraints", ())]
        try:
            rules = [*excused(world, curve, motion, robot, proof["exempt"], asked)]
            least = shown(world, proof, curve, low, high)
            for constraint in constraints:
                kept(world, robot, constraint, curve, begin, end)
            paced = [] if alone else in_time(robot, result, asked, Curve(points, motion.blends))
        except (Invalid, LookupError, ValueError) as why:
            raise Invalid(f"{name}: {why.args[0]}") from why
        part = f" from s = {low:.6g} to {high:.6g}" if proof["part"] else ""
        free = f"{1e3 * least:.4f} mm{part}" if least < math.inf else "nothing can collide"
        yield f"{name}: {free}" + f", {len(constraints)} constraints kept" * bool(constraints)
        yield from (f"  {line}" for line in (*paced, *rules))
        yield from (f"  kept: {json.dumps(constraint)}" for constraint in constraints)
        yield from (f"  not judged: {it['name']}, which is held, with {it['touch_links']}" for it in motion.hold)
        yield from (f"  not judged: {a['name']} x {b['name']}, held together" for a, b in combinations(motion.hold, 2))
        stood = last
    yield from (f"never judged: {contact['links']} ({contact['reason']})" for contact in robot["allowed_contacts"])
    yield from (f"never judged: {pair} (allowed by the author, and by who asked)" for pair in allowed)
    yield from reached(document, every[-1])
    others = [f"the section {name}" for name in document["sections"] if name != "evidence"]
    yield f"verified: {SEEN}; not verified: {', '.join([UNSEEN, *others])}"
