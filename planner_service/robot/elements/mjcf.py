"""The elements and attributes of MJCF, mujoco's format: mujoco reads them all, and a robot is made of some.

mujoco refuses what it does not know, so a word that is in no list here is one of a newer mujoco, and gets a warning.
"""

from __future__ import annotations

from planner_service.robot.elements.table import Effect, rule

__all__ = ["MJCF"]

READ, NONE, WARNED = Effect.READ, Effect.NONE, Effect.WARNED

DYNAMICS = "forces, which planning does not simulate"
LOOKS = "looks alone"
USER = "for a simulator"

_PLACE = (READ, "pos quat axisangle euler xyaxes zaxis", "where it is in the body")
_CLASS = (READ, "class", "its defaults")
_NAME = (READ, "name", "")
_FORCES = rule(NONE, DYNAMICS)
_SEEN = rule(NONE, LOOKS)
_SOFT = rule(WARNED, "what bends is not part of the robot that is checked")
_PAIR = (READ, "geom1 geom2", "both geoms are shapes, whatever their contype")

_JOINT = rule(
    READ,
    "hinge and slide; ball and free are refused",
    _NAME,
    _CLASS,
    (READ, "type pos axis range limited ref", "a hinge without a range is continuous, a slide without one is refused"),
    (READ, "actuatorfrcrange actuatorfrclimited", "its upper end is the effort"),
    (NONE, "armature damping frictionloss springdamper springref stiffness margin actuatorgravcomp", DYNAMICS),
    (NONE, "solreflimit solimplimit solreffriction solimpfriction group user", USER),
)
_GEOM = rule(
    READ,
    "a shape of its body; of each of several; planes are left out, with a warning; hfield and sdf are refused",
    _NAME,
    _CLASS,
    _PLACE,
    (READ, "type size fromto mesh fitscale", ""),
    (
        READ,
        "contype conaffinity",
        "one with 0 for both is no shape, unless a <pair> names it; all others are checked",
    ),
    (READ, "mass density shellinertia", "for torque limits"),
    (NONE, "hfield", "height fields are refused"),
    (NONE, "condim friction priority gap margin adhesion surfacevel", "how contacts feel; here nothing may touch"),
    (NONE, "solref solimp solmix fluidcoef fluidshape group material rgba user", USER),
    children={"plugin": rule(READ, "a shape by a plugin (sdf) is refused", whole=True)},
)
_SITE = rule(
    READ,
    "a frame that can be the tool frame, called like the site, or site/name where a body has that name",
    _NAME,
    _CLASS,
    _PLACE,
    (READ, "fromto", "where it is"),
    (NONE, "type size mesh group material rgba user", LOOKS),
)

_INSIDE = {
    "inertial": rule(
        READ,
        "for torque limits",
        _PLACE,
        (READ, "mass diaginertia fullinertia", ""),
    ),
    "joint": _JOINT,
    "freejoint": rule(READ, "refused: the robot stands on its base", (READ, "name", ""), (NONE, "align group", USER)),
    "geom": _GEOM,
    "site": _SITE,
    "camera": rule(NONE, "sensors do not move the robot"),
    "light": _SEEN,
    "plugin": _FORCES,
    "composite": _SOFT,
    "flexcomp": _SOFT,
    "attach": rule(READ, "mujoco puts another model in its place", (READ, "model body prefix frame", "")),
    "include": rule(READ, "mujoco puts the file in its place", (READ, "file", "in a folder that may be read")),
}
_BODY = rule(
    READ,
    "a link",
    (READ, "name childclass", ""),
    _PLACE,
    (READ, "mocap", "a body that a program moves; here it stands still"),
    (READ, "count offset sep", "of <replicate>"),
    (READ, "fuse", ""),
    (NONE, "gravcomp simple sleep user", DYNAMICS),
    children=dict(_INSIDE),
)
for _tag in ("body", "frame", "replicate"):
    _BODY.children[_tag] = _BODY  # type: ignore[index]

_TENDON = rule(
    NONE,
    DYNAMICS,
    (WARNED, "range", "joints whose sum a tendon limits are planned for as if each were free"),
    (
        NONE,
        "name class limited group margin material rgba width user springlength stiffness damping frictionloss armature"
        " actuatorfrclimited actuatorfrcrange solreflimit solimplimit solreffriction solimpfriction",
        DYNAMICS,
    ),
    children={tag: rule(NONE, "of a tendon") for tag in ("site", "geom", "pulley", "joint")},
)

_DEFAULT = rule(
    READ,
    "mujoco puts them in their places",
    (READ, "class", ""),
    children={"joint": _JOINT, "geom": _GEOM, "site": _SITE}
    | {
        "mesh": rule(READ, "", (READ, "scale", ""), (NONE, "inertia maxhullvert", "the whole hull is checked")),
        "pair": rule(NONE, "how contacts feel"),
        "equality": rule(READ, "", (READ, "active", ""), (NONE, "solref solimp", DYNAMICS)),
        "tendon": _TENDON,
    }
    | dict.fromkeys(("texture", "material", "camera", "light"), _SEEN)
    | dict.fromkeys(
        (
            *("general", "motor", "position", "velocity", "intvelocity", "orientation", "pid", "damper", "cylinder"),
            *("muscle", "adhesion", "dcmotor"),
        ),
        _FORCES,
    ),
)
_DEFAULT.children["default"] = _DEFAULT  # type: ignore[index]

_EQUALITY = rule(READ, "an active one closes a loop and is refused", whole=True)

MJCF = rule(
    READ,
    "",
    (READ, "model", "the robot's name"),
    children={
        "compiler": rule(READ, "units, Euler angles and folders, as mujoco reads them", whole=True),
        "option": _FORCES,
        "size": rule(NONE, "memory of the simulator"),
        "statistic": _SEEN,
        "visual": _SEEN,
        "default": _DEFAULT,
        "extension": rule(NONE, USER),
        "custom": rule(NONE, USER),
        "asset": rule(
            READ,
            "",
            children={
                "mesh": rule(
                    READ,
                    "the solid convex hull of its vertices",
                    _NAME,
                    _CLASS,
                    (READ, "file vertex face scale refpos refquat builtin params content_type", ""),
                    (NONE, "inertia maxhullvert smoothnormal normal texcoord material", "the whole hull is checked"),
                    children={"plugin": rule(READ, "mujoco makes the mesh", whole=True)},
                ),
                "hfield": rule(READ, "refused where a geom uses it", whole=True),
                "model": rule(READ, "another model, for <attach>", whole=True),
                "skin": _SEEN,
                "texture": _SEEN,
                "material": _SEEN,
            },
        ),
        "worldbody": _BODY,
        "deformable": _SOFT,
        "contact": rule(
            READ,
            "",
            children={
                "pair": rule(
                    READ,
                    "",
                    _PAIR,
                    (NONE, "name class condim friction gap margin adhesion solref solreffriction solimp", USER),
                ),
                "exclude": rule(READ, "the bodies may touch", (READ, "body1 body2", ""), (NONE, "name", "")),
            },
        ),
        "tendon": rule(NONE, DYNAMICS, children={"spatial": _TENDON, "fixed": _TENDON}),
        "equality": rule(
            READ,
            "",
            children={
                "joint": rule(
                    READ,
                    "a joint mimics another, if it is linear in it",
                    (READ, "joint1 joint2 polycoef active", ""),
                    (NONE, "name class solref solimp", USER),
                ),
                **dict.fromkeys(("connect", "weld", "tendon", "flex", "flexvert", "flexstrain"), _EQUALITY),
            },
        ),
        "actuator": rule(NONE, "how motors are driven; limits are those of the joints"),
        "sensor": rule(NONE, "sensors do not move the robot"),
        "keyframe": rule(
            READ,
            "",
            children={
                "key": rule(
                    READ, "a named pose", (READ, "name qpos", ""), (NONE, "time qvel act ctrl mpos mquat", USER)
                )
            },
        ),
        "include": rule(READ, "mujoco puts the file in its place", (READ, "file", "in a folder that may be read")),
    },
    looks=True,
)
"""What a robot is made of in an MJCF file, and what not. ``looks``: mujoco itself refuses what it does not know."""
