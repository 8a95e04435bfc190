"""The elements and attributes of URDF, versions 1.0 to 1.2 (github.com/ros/urdfdom), and of what common tools add."""

from __future__ import annotations

from planner_service.robot.elements.table import Effect, rule

__all__ = ["URDF"]

READ, NONE, WARNED, REFUSED = Effect.READ, Effect.NONE, Effect.WARNED, Effect.REFUSED

LOOKS = "what a link looks like is drawn and compared with its shapes, and never checked"
SIMULATOR = "for a simulator"
OLD = "an old word, which no reader uses"
CONTACT = "how contacts feel in a simulator; here links may not touch"

_ORIGIN = rule(
    READ,
    "where an element is in the one that holds it, or a joint in its parent link",
    (READ, "xyz", "metres; 0 if not given"),
    (READ, "rpy", "roll, pitch, yaw in radians; 0 if not given"),
    (READ, "quat_xyzw", "URDF 1.1: a unit quaternion; refused in a file of version 1.0, whose readers ignore it"),
)
_NAME = (NONE, "name", "only names the element")
_MATERIAL = rule(NONE, "colours and textures")
_GEOMETRY = rule(
    READ,
    "exactly one shape",
    _NAME,
    one_child=True,
    children={
        "box": rule(READ, "", (READ, "size", "the lengths of its edges, metres")),
        "cylinder": rule(READ, "", (READ, "radius length", "metres, along z")),
        "sphere": rule(READ, "", (READ, "radius", "metres")),
        "capsule": rule(READ, "URDF 1.2", (READ, "radius length", "metres; the length is without the two caps")),
        "mesh": rule(
            READ,
            "the solid convex hull of the vertices that its faces use, or pieces (decompose)",
            (READ, "filename", "STL, OBJ, PLY or COLLADA"),
            (READ, "scale", "three factors; 1 if not given, and a negative one mirrors"),
        ),
    },
)
_CONTACTS = dict.fromkeys(("contact", "surface", "max_contacts", "contact_coefficients"), rule(NONE, CONTACT))
_SHAPE = {"origin": _ORIGIN, "geometry": _GEOMETRY, "material": _MATERIAL}

_LINK = rule(
    READ,
    "",
    (READ, "name", "each link has its own"),
    (NONE, "type", OLD),
    (NONE, "concave", "the hull that is checked contains the concave mesh"),
    children={
        "collision": rule(
            READ,
            "what is checked; several are one link's shapes",
            _NAME,
            (NONE, "group mask", "which shapes a simulator checks together; here all are checked"),
            (NONE, "concave", "the hull that is checked contains the concave mesh"),
            children={
                **_SHAPE,
                "verbose": rule(NONE, OLD),
                **_CONTACTS,
            },
        ),
        "visual": rule(READ, f"{LOOKS}, unless visual_as_collision asks for it", _NAME, children=_SHAPE, looks=True),
        "inertial": rule(
            READ,
            "for torque limits alone",
            children={
                "origin": _ORIGIN,
                "mass": rule(READ, "", (READ, "value", "kg")),
                "inertia": rule(
                    READ,
                    "",
                    (READ, "ixx ixy ixz iyy iyz izz", "kg m^2"),
                    (NONE, "iyx izx izy", "the tensor is symmetric"),
                ),
            },
        ),
        "origin": rule(WARNED, "no reader of URDF moves a link; the origin of its joint does"),
        "collision_checking": rule(WARNED, "a wish for other shapes, which few readers know; <capsule> is read"),
        "self_collision_checking": rule(WARNED, "a wish for other shapes, which few readers know"),
        "self_filter": rule(NONE, "which sensor readings are the robot itself"),
        **_CONTACTS,
        "gravity": rule(NONE, SIMULATOR),
        "kinematic": rule(NONE, SIMULATOR),
        "sensor": rule(NONE, "sensors do not move the robot"),
    },
)

_JOINT = rule(
    READ,
    "",
    (READ, "name", "each joint has its own"),
    (READ, "type", "revolute, continuous, prismatic or fixed; planar, floating and others are refused"),
    (NONE, "dont_collapse", "whether other tools may merge links"),
    children={
        "origin": _ORIGIN,
        "parent": rule(READ, "", (READ, "link", "a link")),
        "child": rule(READ, "", (READ, "link", "a link; each has one parent joint, but for the root")),
        "axis": rule(
            READ,
            "",
            (READ, "xyz", "made a unit vector; 1 0 0 if not given"),
            (WARNED, "rpy", "no reader of URDF turns an axis"),
        ),
        "limit": rule(
            READ,
            "revolute and prismatic joints need one",
            (
                READ,
                "lower upper",
                "rad or m; 0 if one is not given (in URDF 1.2 both are). Of a continuous joint they have no effect,"
                " with a warning, and are refused in URDF 1.2",
            ),
            (READ, "velocity", "rad/s or m/s; a slow one is assumed for none or 0, with a warning"),
            (READ, "effort", "Nm or N, for torque limits"),
            (READ, "acceleration deceleration", "URDF 1.2; the smaller one holds; a convention if neither is given"),
            (READ, "jerk", "URDF 1.2; a convention if not given"),
            (NONE, "command_effort current gear_velocity stiffness damping", "what one motor does"),
        ),
        "mimic": rule(
            READ,
            "the joint follows another, and is none of q",
            (READ, "joint", "another joint, which may mimic a third"),
            (READ, "multiplier offset", "1 and 0 if not given"),
        ),
        "safety_controller": rule(
            READ,
            "",
            (
                READ,
                "soft_lower_limit soft_upper_limit",
                "a plan stays within them, because the robot's own controller slows down and stops there; both or"
                " neither; not those of a continuous joint",
            ),
            (NONE, "k_position k_velocity", "how hard that controller brakes"),
        ),
        "dynamics": rule(NONE, "friction and damping; torques are worked out without"),
        "joint_properties": rule(NONE, "friction and damping; torques are worked out without"),
        "calibration": rule(NONE, "how the robot finds its zero; joint values here are those of its driver"),
        "sensor": rule(NONE, "sensors do not move the robot"),
    },
)

URDF = rule(
    READ,
    "",
    (READ, "name", ""),
    (READ, "version", "1.0, 1.1 or 1.2; 1.0 if not given, and others are refused"),
    (NONE, "xmlns", "a namespace; a prefix may be declared, too (xmlns:...)"),
    children={
        "link": _LINK,
        "joint": _JOINT,
        "material": _MATERIAL,
        "transmission": rule(NONE, "how motors turn joints; joint values here are behind the transmission"),
        "gazebo": rule(NONE, SIMULATOR),
        "mujoco": rule(NONE, SIMULATOR),
        "sensor": rule(NONE, "sensors do not move the robot"),
        "ros2_control": rule(NONE, "how commands reach the hardware"),
        "loop_joint": rule(REFUSED, "a closed loop of links; expected a tree"),
    },
    extensible=True,
)
"""What is read of a URDF, and what is not."""
