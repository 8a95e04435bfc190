"""What a file may hold: every key is known and every value of its kind, or the file proves nothing.

A kind is ``num`` (finite), ``int``, ``text``, ``flag``, ``null``, ``any``, ``=word``, a number n for n numbers, the
name of an object, or several of these with ``|`` between them; ``kind*`` is a list and ``kind*n`` a list of n. An
object has its keys, a ``?`` after those that may be missing, and those of the objects named among them.
"""

from __future__ import annotations

import json
import math
import re
from typing import Any

import numpy as np

Json = Any

CELL = "planner-service/cell-plan"
MOST_BYTES, LARGEST = 200_000_000, 1e12
TABLE = """
claim clearance:num|null padding:num exempt:exempt* part:2|null
counts states:int edges:int distances:int projections?:int
world obstacles:text|obstacle* attached:attached*
file format:text version:int made_with:any robot:robot scene:scene allowed:text*2* edge_step:any request:request|null
    sections:any
planner-service/plan file result:result
planner-service/task file task:text ok:flag failure:null counts:counts choosing:counts seconds:num notes:text*
    segments:segment* steps?:step*
planner-service/cell-plan format:text version:int made_with:any arms:placed|member* failure:null tolerates:num|null
    still:num* clocks:clock* rectangles:int distances:int counts:counts notes:text* scene:scene robots:robot*
    sections:any
placed name:text robot:int base:pose carried?:attached* at_tool?:at_tool
member name:text robot:int joints:text* tool?:text carried?:attached* at_tool?:at_tool
at_tool arm:text pose:pose
clock arms:text* start:num request:request|null result:result
step step:text tried:int failed:int reasons:reason*
reason reason:text times:int
planner-service/no-path format:text version:int robot:robot scene:scene allowed:text*2* start:num* goals:num** moved:num
    boxes:any faces:any joints:text* range:num** divisions:int* encloses:text region:text walls:text pairs:text*2*
    centres:text
planner-service/inverse format:text version:int robot:robot joints:text* goal:tool q:num** lower:num** upper:num**
    points:text domain:text found:text steps:text sums:text equations:text followed:text
pose position:3 quaternion_wxyz:4
box kind:=box size:3
sphere kind:=sphere radius:num
cylinder kind:=cylinder radius:num length:num
capsule kind:=capsule radius:num length:num
mesh kind:=mesh vertices:text
compound kind:=compound parts:part*
cloud kind:=cloud resolution:num cells?:text packed?:text
heights kind:=heights cell:num floor:num columns:int heights:text
part shape:convex pose:pose
region kind:=tool-region name:text frame:pose lower:num|null*3 upper:num|null*3 tilt:num|null turn:num|null tool:pose
    link:text|null relative_to:text|null
range kind:=joint-range joint:text lower:num upper:num
obstacle name:text shape:solid pose:pose
attached obstacle touch_links:text* constraints?:constraint* mass?:num|null
scene name:text description:text hash:text obstacles:obstacle* attached:attached*
robot name:text hash:text joint_names:text* limits:limits named_poses:named_pose* base_links:text* tool_frame:text
    tool_body:int tool_placement:4*4 bodies:body* shapes:link_shape* allowed_contacts:contact* gripper:gripper|null
    gripper_width:num retreats:retreat* inverse:text settle_time:num link_frames?:link_frame* continuous?:flag*
    dynamics?:dynamics|null locked_joints?:locked*
limits lower:num* upper:num* velocity:num* acceleration:num* jerk:num*
named_pose name:text q:num*
body name:text parent:int placement:4*4 axis:3 prismatic:flag q_index:int multiplier?:num
link_frame link:text body:int pose:pose
link_shape link_frame shape:convex
contact links:text*2 reason:text
gripper joints:text* links:text* lower:num upper:num closed:link_shape* directions:3* approach:3 closing:3 kind?:text
    turns?:turn** tips?:text* across?:3 positions?:2 radius?:num
turn axis:3 point:3 ratio:num
retreat pose:text to:num* pairs:text*2* reason:text
dynamics effort:num* links:inertia*
inertia link_frame mass:num tensor:6
locked name:text position:num
request start:num* goals:joints|tool* planner:choice timing:choice polish:choice|null seed:int max_checks:int
    retries:int|null padding:num velocity_scale:num acceleration_scale:num blend:num start_tolerance:num
    time_limit:num|null max_tool_speed:num|null constraints?:constraint* payload?:payload|null torque_scale?:num
    evidence?:flag start_overlap?:num improve?:int
choice name:text settings:any
joints joints:num*
tool pose:pose room:room|null
room position_tolerance:num orientation_tolerance:num free_axis:3|null candidates:int
payload mass:num com:3 inertia:6
segment name:text gripper_width:num|null gripper:fingers|null timing:choice|null scene:world|null result:result
    wait?:num
fingers start_width:num end_width:num seconds:num certificate:certificate travel?:num|null
result ok:flag failure:null goal_index:int|null attempts:int padding:num deterministic:flag notes:text* counts:counts
    stages:stage* certificate:certificate motion:motion polish:any path:path trajectory:law constraints?:constraint*
    near_ends?:near_end* improvement?:any
near_end s_start:num s_end:num pairs:text*2*
exempt near_end reason:text depth?:num|null
stage counts stage:text seconds:num length:num|null note:text
certificate claim certified:flag distances:int refusal:null allowed:text*2* kept?:kept*
kept name:text bounds:bound*
bound quantity:text bound:num tolerance:num unit:text
motion peaks:peaks tool_speed:num duration:num settle_time:num stop_duration:num|null
peaks velocity:peak acceleration:peak jerk:peak torques?:peak*
peak ratio:num|null joint:int time:num
path length:num waypoints:num** blends:num*
law duration:num dilation:num durations:num* coefficients:4* part:2|null
evidence version:int robot:text scene:text boxes:any proofs:proof*
cell_evidence version:int robots:text* scene:text moved:num* boxes:any proofs:arm_proof* between:pair_proof*
arm_proof claim s:text pairs:text rows:text crowd?:text
pair_proof arms:text*2 clearance:num|null times:text*2 pairs:text rows:text
proof claim motion:int gripper:2 moved:2 s:text pairs:text rows:text crowd?:text
"""
ONE_OF = {
    "convex": "box|sphere|cylinder|capsule|mesh",
    "solid": "box|sphere|cylinder|capsule|mesh|compound|cloud|heights",
    "constraint": "region|range",
}
TYPES = {"text": str, "flag": bool, "null": type(None)}


def _objects() -> dict[str, dict[str, str]]:
    shapes: dict[str, dict[str, str]] = {}
    for entry in re.split(r"\n(?=\S)", TABLE.strip()):
        name, *words = entry.split()
        shapes[name] = {}
        for key, _, kind in (word.partition(":") for word in words):
            shapes[name] |= {key: kind.replace("-", " ")} if kind else shapes[key]
    return shapes


SHAPES = _objects()


class Invalid(Exception):
    """Why a file proves nothing, in words; and of a trail all that is not shown: s, gap, s, and two names."""


def require(holds: Any, why: str) -> None:
    if not np.all(holds):
        raise Invalid(why)


def parsed(data: bytes) -> Json:
    """The content of a file; Invalid for a key that stands twice in an object, and for numbers that are none."""
    require(len(data) <= MOST_BYTES, f"a file of more than {MOST_BYTES:,} bytes")

    def once(pairs: list[tuple[str, Json]]) -> Json:
        if len(dict(pairs)) < len(pairs):
            raise Invalid(f"a key stands twice: {sorted(key for key, _ in pairs)}")
        return dict(pairs)

    return json.loads(data, object_pairs_hook=once, parse_constant=lambda word: require(False, f"{word} is no number"))


def check_file(document: Json) -> None:
    """Raise Invalid unless a document is one of the files that are known, whole and with nothing else."""
    form, files = str(isinstance(document, dict) and document.get("format")), [name for name in SHAPES if "/" in name]
    require(form in files, f"format: got {form:.60}; expected one of {', '.join(files)}")
    check(document, form, "")
    for robot in [document["robot"]] if "robot" in document else document["robots"]:
        for k, name in enumerate(robot["joint_names"]):
            moved = [body for body in robot["bodies"] if body["q_index"] == k]
            own = [
                one for one in moved if one.get("multiplier", 1.0) == 1.0 and (len(moved) == 1 or one["name"] == name)
            ]
            require(len(own) == 1, f"joint {name}: expected one body that it moves by itself, not only by mimics")
    if "sections" in document:
        has = isinstance(document["sections"], dict) and "evidence" in document["sections"]
        require(has, "sections: no evidence; planner-service certify FILE --evidence OUT adds it")
        kind = "cell_evidence" if form == CELL else "evidence"
        check(document["sections"]["evidence"], kind, "sections.evidence")


def check(value: Json, kind: str, where: str) -> None:
    """Raise Invalid, naming the place, unless a value is of a kind."""
    one, star, count = kind.rpartition("*")
    if star:
        if not isinstance(value, list) or count not in ("", str(len(value))):
            raise Invalid(f"{where}: expected a list{' of ' * bool(count)}{count}")
        for k, entry in enumerate(value):
            check(entry, one, f"{where}[{k}]")
        return
    options = ONE_OF.get(kind, kind).split("|")
    objects = [SHAPES[option] for option in options if option in SHAPES]
    if not isinstance(value, dict) or not objects:
        if any(_is(value, option) for option in options):
            return
        raise Invalid(f"{where}: got {value!r:.60}; expected {kind}")
    own = f"={value.get('kind')}"
    shape = min(objects, key=lambda each: (each.get("kind") != own, len(each.keys() ^ value.keys())))
    kinds = {key.rstrip("?"): kind for key, kind in shape.items()}
    odd = (value.keys() - kinds) | ({key for key in shape if not key.endswith("?")} - value.keys())
    require(not odd, f"{where or 'the file'}: missing or unknown: {', '.join(sorted(map(repr, odd)))}")
    for key, entry in value.items():
        check(entry, kinds[key], f"{where}.{key}".lstrip("."))


def _is(value: Json, kind: str) -> bool:
    if kind == "num":
        return type(value) in (int, float) and abs(value) <= LARGEST and math.isfinite(value)
    if kind.isdigit():
        return isinstance(value, list) and len(value) == int(kind) and all(_is(entry, "num") for entry in value)
    if kind == "int":
        return type(value) is int and abs(value) < 2**63
    return kind == "any" or type(value) is TYPES.get(kind) or kind == f"={value}"
