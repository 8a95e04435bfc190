"""The elements and attributes of SRDF, as srdfdom and MoveIt read them, and of what common tools add."""

from __future__ import annotations

from planner_service.robot.elements.table import Effect, rule

__all__ = ["SRDF"]

READ, NONE, WARNED = Effect.READ, Effect.NONE, Effect.WARNED

_NAME = (READ, "name", "")
_LINK = (READ, "link", "a link of the URDF")

SRDF = rule(
    READ,
    "",
    (READ, "name", "the robot's; a warning if it is not the URDF's"),
    (NONE, "version", ""),
    (NONE, "xmlns", "a namespace; a prefix may be declared, too (xmlns:...)"),
    children={
        "group": rule(
            READ,
            "a planning group (robot.group)",
            (READ, "name", "each group has its own"),
            children={
                "joint": rule(READ, "", _NAME),
                "link": rule(READ, "its parent joint", _NAME),
                "chain": rule(READ, "the joints between two links", (READ, "base_link tip_link", "")),
                "group": rule(READ, "a group within a group", _NAME),
                "passive_joint": rule(WARNED, "it belongs into <robot>"),
            },
        ),
        "group_state": rule(
            READ,
            "a named pose",
            (READ, "name group", ""),
            children={"joint": rule(READ, "", (READ, "name value", "rad or m, within the limits"))},
        ),
        "end_effector": rule(
            READ,
            "whose joints are those of a gripper",
            (READ, "group", ""),
            (NONE, "name parent_link parent_group component_name", "the links and joints of the URDF say the same"),
        ),
        "virtual_joint": rule(
            NONE,
            "how a moving base stands in the world; here the base stands still",
        ),
        "passive_joint": rule(READ, "the joint is not planned for; it stands at home, with a warning", _NAME),
        "disable_collisions": rule(
            READ,
            "the two links may touch",
            (READ, "link1 link2", "links of the URDF"),
            (READ, "reason", "kept with it"),
        ),
        "disable_default_collisions": rule(
            READ, "the link may touch all others of the robot, but never an obstacle", _LINK, (READ, "reason", "kept")
        ),
        "enable_collisions": rule(
            READ,
            "the two links are checked although one may touch all others; <disable_collisions> of the pair wins",
            (READ, "link1 link2", "links of the URDF"),
            (NONE, "reason", "the pair is checked like any other"),
        ),
        "link_sphere_approximation": rule(NONE, "spheres for a planner that checks less; here the shapes are checked"),
        "joint_property": rule(NONE, "hints for other planners"),
        "gripper": rule(NONE, "how HPP grasps; the gripper is found by its fingers"),
        "contact": rule(NONE, "how HPP steps"),
        "handle": rule(NONE, "how HPP grasps"),
        "rotor_params": rule(NONE, "masses and gears of motors, for Pinocchio"),
        "specificities": rule(NONE, "sizes of feet, for walking"),
    },
    extensible=True,
)
"""What is read of an SRDF, and what is not."""
