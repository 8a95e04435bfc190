"""What a file may hold: every key is known and every value of its kind, or the file proves nothing.

``SHAPES`` lists the keys of each object with the kind of their values, a ``?`` after those that may be missing. A kind
is ``num`` (finite), ``int``, ``text``, ``flag``, ``null``, ``any``, a number n for a list of n numbers, ``[kind]`` for
a list, ``kind/n`` for a list of n, the name of an object, or several of these with ``|`` between them. Objects of
``solid``, ``convex`` and ``constraint`` say by their key ``kind`` which of several they are.
"""

from __future__ import annotations

import json
import math
from typing import Any

Json = Any

MOST_BYTES = 200_000_000
LARGEST = 1e12

HEAD = "format:text version:int made_with:any robot:robot scene:scene allowed:[text/2]"
CLAIM = "clearance:num|null padding:num exempt:[exempt] part:2|null"
COUNTS = "states:int edges:int distances:int projections?:int"
WORDS = {
    "planner-service/plan": f"{HEAD} edge_step:any request:request|null result:result sections:any",
    "planner-service/task": f"{HEAD} edge_step:any request:request|null task:text ok:flag failure:null counts:counts "
    "choosing:counts seconds:num notes:[text] segments:[segment] sections:any",
    "planner-service/no-path": "format:text version:int robot:robot scene:scene allowed:[text/2] start:[num] "
    "goals:[[num]] moved:num boxes:any faces:any joints:[text] range:[[num]] divisions:[int] encloses:text "
    "region:text walls:text pairs:[text/2] centres:text",
    "pose": "position:3 quaternion_wxyz:4",
    "convex box": "kind:text size:3",
    "convex sphere": "kind:text radius:num",
    "convex cylinder": "kind:text radius:num length:num",
    "convex capsule": "kind:text radius:num length:num",
    "convex mesh": "kind:text vertices:text",
    "solid compound": "kind:text parts:[part]",
    "solid cloud": "kind:text resolution:num cells:text",
    "solid heights": "kind:text cell:num floor:num columns:int heights:text",
    "part": "shape:convex pose:pose",
    "constraint tool region": "kind:text name:text frame:pose lower:num|null/3 upper:num|null/3 tilt:num|null "
    "turn:num|null tool:pose link:text|null relative_to:text|null",
    "constraint joint range": "kind:text joint:text lower:num upper:num",
    "obstacle": "name:text shape:solid pose:pose",
    "attached": "name:text shape:solid pose:pose touch_links:[text] constraints?:[constraint] mass?:num|null",
    "scene": "name:text description:text hash:text obstacles:[obstacle] attached:[attached]",
    "world": "obstacles:[text|obstacle] attached:[attached]",
    "robot": "name:text hash:text joint_names:[text] limits:limits named_poses:[named_pose] base_links:[text] "
    "tool_frame:text tool_body:int tool_placement:4/4 bodies:[body] shapes:[link_shape] allowed_contacts:[contact] "
    "gripper:gripper|null gripper_width:num retreats:[retreat] inverse:text settle_time:num link_frames?:[link_frame] "
    "continuous?:[flag] dynamics?:dynamics|null locked_joints?:[locked]",
    "limits": "lower:[num] upper:[num] velocity:[num] acceleration:[num] jerk:[num]",
    "named_pose": "name:text q:[num]",
    "body": "name:text parent:int placement:4/4 axis:3 prismatic:flag q_index:int multiplier?:num",
    "link_shape": "link:text body:int shape:convex pose:pose",
    "link_frame": "link:text body:int pose:pose",
    "contact": "links:text/2 reason:text",
    "gripper": "joints:[text] links:[text] lower:num upper:num closed:[link_shape] directions:[3] approach:3 closing:3 "
    "kind?:text turns?:[[turn]] tips?:[text] across?:3 positions?:2 radius?:num",
    "turn": "axis:3 point:3 ratio:num",
    "retreat": "pose:text to:[num] pairs:[text/2] reason:text",
    "dynamics": "effort:[num] links:[inertia]",
    "inertia": "link:text body:int mass:num tensor:6 pose:pose",
    "locked": "name:text position:num",
    "request": "start:[num] goals:[joints|tool] planner:choice timing:choice polish:choice|null seed:int "
    "max_checks:int "
    "retries:int|null padding:num velocity_scale:num acceleration_scale:num blend:num start_tolerance:num "
    "time_limit:num|null max_tool_speed:num|null constraints?:[constraint] payload?:payload|null torque_scale?:num "
    "evidence?:flag start_overlap?:num",
    "choice": "name:text settings:any",
    "joints": "joints:[num]",
    "tool": "pose:pose room:room|null",
    "room": "position_tolerance:num orientation_tolerance:num free_axis:3|null candidates:int",
    "payload": "mass:num com:3 inertia:6",
    "counts": COUNTS,
    "segment": "name:text gripper_width:num|null gripper:fingers|null timing:choice|null scene:world|null "
    "result:result",
    "fingers": "start_width:num end_width:num seconds:num certificate:certificate travel?:num|null",
    "result": "ok:flag failure:null goal_index:int|null attempts:int padding:num deterministic:flag notes:[text] "
    "counts:counts stages:[stage] certificate:certificate motion:motion polish:any path:path trajectory:law "
    "constraints?:[constraint] near_ends?:[near_end]",
    "near_end": "s_start:num s_end:num pairs:[text/2]",
    "stage": f"stage:text {COUNTS} seconds:num length:num|null note:text",
    "certificate": f"certified:flag distances:int refusal:null allowed:[text/2] kept?:[kept] {CLAIM}",
    "exempt": "s_start:num s_end:num pairs:[text/2] reason:text depth?:num|null",
    "kept": "name:text bounds:[bound]",
    "bound": "quantity:text bound:num tolerance:num unit:text",
    "motion": "peaks:peaks tool_speed:num duration:num settle_time:num stop_duration:num|null",
    "peaks": "velocity:peak acceleration:peak jerk:peak torques?:[peak]",
    "peak": "ratio:num|null joint:int time:num",
    "path": "length:num waypoints:[[num]] blends:[num]",
    "law": "duration:num dilation:num durations:[num] coefficients:[4] part:2|null",
    "evidence": "version:int robot:text scene:text boxes:any proofs:[proof]",
    "proof": f"motion:int gripper:2 moved:2 s:text pairs:text rows:text {CLAIM}",
}
SHAPES = {name: dict(word.split(":") for word in words.split()) for name, words in WORDS.items()}
FILES = tuple(name for name in SHAPES if "/" in name)
TYPES = {"text": str, "flag": bool}


class Invalid(Exception):
    """Why a file proves nothing, in words; and of a trail all that is not shown: s, gap, s, and two names."""


def parsed(data: bytes) -> Json:
    """The content of a file; Invalid for a key that stands twice in an object, and for numbers that are none."""
    if len(data) > MOST_BYTES:
        raise Invalid(f"a file of more than {MOST_BYTES:,} bytes")

    def once(pairs: list[tuple[str, Json]]) -> Json:
        if len(dict(pairs)) < len(pairs):
            raise Invalid(f"a key stands twice: {sorted(key for key, _ in pairs)}")
        return dict(pairs)

    def refused(text: str) -> Json:
        raise Invalid(f"{text} is no number")

    return json.loads(data, object_pairs_hook=once, parse_constant=refused)


def check_file(document: Json) -> None:
    """Raise Invalid unless a document is one of the files that are known, whole and with nothing else."""
    form = document.get("format") if isinstance(document, dict) else None
    if form not in FILES:
        raise Invalid(f"format: got {form!r:.60}; expected one of {', '.join(FILES)}")
    check(document, form, "")
    if "sections" in document:
        sections = document["sections"]
        if not isinstance(sections, dict) or "evidence" not in sections:
            raise Invalid("sections: no evidence; planner-service certify FILE --evidence OUT adds it")
        check(sections["evidence"], "evidence", "sections.evidence")


def check(value: Json, kind: str, where: str) -> None:
    """Raise Invalid, naming the place, unless a value is of a kind."""
    if kind in SHAPES:
        return _check_object(value, SHAPES[kind], where)
    if kind in ("solid", "convex", "constraint"):
        own = f"{value.get('kind')!s:.60}" if isinstance(value, dict) else type(value).__name__
        names = [f"{group} {own}" for group in (kind, "convex" * (kind == "solid"))]
        known = [name for name in names if name in SHAPES]
        if not known:
            raise Invalid(f"{where}: {own} is no {kind}")
        return _check_object(value, SHAPES[known[0]], where)
    if kind.startswith("[") or "/" in kind or kind.isdigit():
        one, _, count = (kind[1:-1], "", "") if kind.startswith("[") else kind.rpartition("/")
        one = one or "num"
        if not isinstance(value, list) or (count and len(value) != int(count)):
            raise Invalid(f"{where}: expected a list{' of ' * bool(count)}{count}")
        for k, entry in enumerate(value):
            check(entry, one, f"{where}[{k}]")
        return None
    parts = kind.split("|")
    if len(parts) > 1:
        objects = [part for part in parts if part in SHAPES]
        if isinstance(value, dict) and objects:
            best = min(objects, key=lambda part: len(SHAPES[part].keys() ^ value.keys()))
            return check(value, best, where)
        simple = [part for part in parts if part not in SHAPES and part not in ("solid", "convex")]
        if not any(_is(value, part) for part in simple):
            raise Invalid(f"{where}: got {value!r:.60}; expected {kind}")
        return None
    if not _is(value, kind):
        raise Invalid(f"{where}: got {value!r:.60}; expected {kind}")
    return None


def _check_object(value: Json, shape: dict[str, str], where: str) -> None:
    if not isinstance(value, dict):
        raise Invalid(f"{where}: got {value!r:.60}; expected an object")
    known = {key.rstrip("?") for key in shape}
    odd = (value.keys() - known) | ({key for key in shape if not key.endswith("?")} - value.keys())
    if odd:
        raise Invalid(f"{where or 'the file'}: missing or unknown: {', '.join(sorted(map(repr, odd)))}")
    for key, kind in shape.items():
        if key.rstrip("?") in value:
            check(value[key.rstrip("?")], kind, f"{where}.{key.rstrip('?')}".lstrip("."))


def _is(value: Json, kind: str) -> bool:
    if kind == "num":
        return type(value) in (int, float) and abs(value) <= LARGEST and math.isfinite(value)
    if kind.isdigit():
        return isinstance(value, list) and len(value) == int(kind) and all(_is(entry, "num") for entry in value)
    if kind == "int":
        return type(value) is int and abs(value) < 2**63
    return kind == "any" or (value is None if kind == "null" else type(value) is TYPES[kind])
