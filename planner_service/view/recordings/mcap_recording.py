"""Motions as MCAP recordings, which Foxglove plays: joints, frames of all links, robot and scene, and the clearance.

Messages are JSON in Foxglove's own schemas, each described in the file as far as it is used here.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from planner_service.errors import InvalidRequest, MissingDependency
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.path.trajectory import Trajectory
from planner_service.presentation.page import Showable
from planner_service.service import PlannerService
from planner_service.view.playback import Clip
from planner_service.view.state import ViewState
from planner_service.view.triangles import Solid, placements, robot_solids, scene_solids

__all__ = ["MCAP", "mcap_bytes"]

MCAP = re.compile(rb"\x89MCAP0\r\n")
"""How a recording begins."""

WORLD = "world"
"""The frame in which everything stands."""

SECOND = 1_000_000_000


def mcap_bytes(service: PlannerService, shown: Showable, *, dt: float = 0.02) -> bytes:
    """The content of an .mcap file of a plan, or of the motions of a task one after another.

    On one clock from 0, every ``dt`` seconds and at the exact ends: ``/joint_states`` (foxglove.JointStates), ``/tf``
    (foxglove.FrameTransforms) of all links in ``world``, ``/clearance`` as proven in metres; and ``/scene``
    (foxglove.SceneUpdate) with the robot and what stands around it, at each motion's beginning.

    Args:
        service: Plans for the robot and the scene as they are before the first motion.
        shown: A PlanResult, TaskResult or SavedTask.

    Raises:
        InvalidRequest: There is no motion in it, it is something else, or ``dt`` is not positive or gives more than a
            million moments.
        MissingDependency: mcap is not installed.
    """
    try:
        import mcap.writer
    except ImportError:
        raise MissingDependency("mcap", "mcap") from None
    playback = ViewState.of(service, shown).playback
    if playback is None:
        raise InvalidRequest("shown", shown, "a plan or a task with a motion")
    written = io.BytesIO()
    writer: Any = mcap.writer.Writer(written)
    writer.start(profile="", library="planner-service")
    channels = {}
    for topic, (name, schema) in TOPICS.items():
        number = writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
        channels[topic] = writer.register_channel(topic, "json", number)
    for clip in playback.clips:
        for topic, t, message in _messages(clip, dt):
            nanoseconds = round(t * SECOND)
            content = json.dumps(message, allow_nan=False, separators=(",", ":")).encode()
            writer.add_message(channels[topic], nanoseconds, content, nanoseconds)
    writer.finish()
    return written.getvalue()


def _messages(clip: Clip, dt: float) -> Iterator[tuple[str, float, Mapping[str, Any]]]:
    """Topic, time in seconds and message, in order."""
    robot, world, trajectory = clip.service.robot, clip.service.world, clip.trajectory
    assert isinstance(trajectory, Trajectory)
    stamp = _time(clip.begin)
    solids = (*robot_solids(robot), *scene_solids(world.scene))
    entities = [_entity(solid, number, stamp) for number, solid in enumerate(solids)]
    yield "/scene", clip.begin, {"deletions": [{"timestamp": stamp, "type": 1, "id": ""}], "entities": entities}
    t, q, qd, qdd = trajectory.sample(dt)
    clearances = clip.clearances(t)
    for at, position, velocity, acceleration, clearance in zip(t.tolist(), q, qd, qdd, clearances, strict=True):
        moment = clip.begin + at
        stamp = _time(moment)
        values = zip(
            robot.joint_names, *((part + 0.0).tolist() for part in (position, velocity, acceleration)), strict=True
        )
        joints = [{"name": n, "position": p, "velocity": v, "acceleration": a} for n, p, v, a in values]
        yield "/joint_states", moment, {"timestamp": stamp, "joints": joints}
        frames = [_frame(name, matrix, stamp) for name, matrix in placements(robot, position).items()]
        yield "/tf", moment, {"transforms": frames}
        if np.isfinite(clearance):
            yield "/clearance", moment, {"timestamp": stamp, "metres": float(clearance)}


def _frame(name: str, matrix: FloatArray, stamp: Mapping[str, int]) -> dict[str, Any]:
    pose = Pose.from_matrix(matrix)
    w, *turned = pose.quaternion
    return {
        "timestamp": stamp,
        "parent_frame_id": WORLD,
        "child_frame_id": name,
        "translation": _xyz(pose.position),
        "rotation": _xyz(turned) | {"w": w},
    }


def _entity(solid: Solid, number: int, stamp: Mapping[str, int]) -> dict[str, Any]:
    """A link, an obstacle or what is carried, as triangles that move with their frame."""
    r, g, b = (part / 255.0 for part in solid.colour)
    triangles = {
        "pose": {"position": _xyz((0.0, 0.0, 0.0)), "orientation": _xyz((0.0, 0.0, 0.0)) | {"w": 1.0}},
        "points": [_xyz(point) for point in solid.vertices.tolist()],
        "color": {"r": r, "g": g, "b": b, "a": solid.opacity},
        "colors": [],
        "indices": solid.faces.ravel().tolist(),
    }
    return {
        "timestamp": stamp,
        "frame_id": WORLD if solid.frame is None else solid.frame,
        "id": f"{number} {solid.name}",
        "lifetime": _time(0.0),
        "frame_locked": True,
        "metadata": [],
        **{kind: [] for kind in ("arrows", "cubes", "spheres", "cylinders", "lines", "texts", "models")},
        "triangles": [triangles],
    }


def _xyz(values: Any) -> dict[str, float]:
    return dict(zip("xyz", values, strict=True))


def _time(seconds: float) -> dict[str, int]:
    nanoseconds = round(seconds * SECOND)
    return {"sec": nanoseconds // SECOND, "nsec": nanoseconds % SECOND}


def _object(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


def _list(of: Mapping[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": of}


TEXT, NUMBER, WHOLE = {"type": "string"}, {"type": "number"}, {"type": "integer"}
TIME = _object(sec=WHOLE, nsec=WHOLE)
POINT = _object(x=NUMBER, y=NUMBER, z=NUMBER)
TURN = _object(x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER)
COLOUR = _object(r=NUMBER, g=NUMBER, b=NUMBER, a=NUMBER)
TRIANGLES = _object(
    pose=_object(position=POINT, orientation=TURN),
    points=_list(POINT),
    color=COLOUR,
    colors=_list(COLOUR),
    indices=_list(WHOLE),
)
ENTITY = _object(
    timestamp=TIME, frame_id=TEXT, id=TEXT, lifetime=TIME, frame_locked={"type": "boolean"}, triangles=_list(TRIANGLES)
)
TRANSFORM = _object(timestamp=TIME, parent_frame_id=TEXT, child_frame_id=TEXT, translation=POINT, rotation=TURN)
JOINT = _object(name=TEXT, position=NUMBER, velocity=NUMBER, acceleration=NUMBER)
DELETION = _object(timestamp=TIME, type=WHOLE, id=TEXT)

TOPICS: Mapping[str, tuple[str, dict[str, Any]]] = {
    "/joint_states": ("foxglove.JointStates", _object(timestamp=TIME, joints=_list(JOINT))),
    "/tf": ("foxglove.FrameTransforms", _object(transforms=_list(TRANSFORM))),
    "/scene": ("foxglove.SceneUpdate", _object(deletions=_list(DELETION), entities=_list(ENTITY))),
    "/clearance": ("planner_service.Clearance", _object(timestamp=TIME, metres=NUMBER)),
}
"""Topics, the names of their schemas, and these."""
