"""What the verdicts of a roadmap depend on: robot, scene, padding and edge step, and how those of two scenes differ."""

from __future__ import annotations

from dataclasses import dataclass, replace

from planner_service.collision import CollisionChecker
from planner_service.collision.edge_sampling import EdgeStep, FinestStep, JointStep, MotionStep

__all__ = ["Terms"]


@dataclass(frozen=True)
class Terms:
    """Everything that a verdict depends on.

    Attributes:
        robot: Its name.
        robot_hash: ``Robot.hash``, which includes the gripper's width.
        joint_names: The joints of q.
        scene: Its name.
        scene_hash: ``Scene.hash``.
        obstacles: Name and hash of each obstacle, sorted by name.
        attached: Hash of what is attached to the tool.
        allowed: Pairs that may touch, in addition to those that the robot allows.
        padding: The padding in metres.
        step: How finely edges are sampled, in words; empty for a rule of the user, which cannot be compared.
    """

    robot: str
    robot_hash: str
    joint_names: tuple[str, ...]
    scene: str
    scene_hash: str
    obstacles: tuple[tuple[str, str], ...]
    attached: str
    allowed: tuple[tuple[str, str], ...]
    padding: float
    step: str

    @classmethod
    def of(cls, checker: CollisionChecker) -> Terms:
        """What a checker's verdicts depend on."""
        robot, scene = checker.robot, checker.scene
        return cls(
            robot.name,
            robot.hash,
            robot.joint_names,
            scene.name,
            scene.hash,
            tuple(sorted(scene.obstacle_hashes.items())),
            scene.attached_hash,
            checker.allowed,
            checker.padding,
            _in_words(checker.edge_step),
        )

    def same(self, other: Terms) -> bool:
        """Whether the same verdicts hold in both; False if the edge step cannot be compared."""
        return self == other and self.step != ""

    def same_but_for_obstacles(self, other: Terms) -> bool:
        """Whether they differ in obstacles at most."""
        named = {"scene": "", "scene_hash": "", "obstacles": ()}
        return replace(self, **named).same(replace(other, **named))  # type: ignore[arg-type]

    def changed(self, other: Terms) -> tuple[frozenset[str], frozenset[str]]:
        """The obstacles that are new or changed in the other, and those that are gone or changed."""
        before, after = dict(self.obstacles), dict(other.obstacles)
        come = frozenset(name for name, content in after.items() if before.get(name) != content)
        return come, frozenset(name for name, content in before.items() if after.get(name) != content)


def _in_words(step: EdgeStep) -> str:
    """One of our own rules with its fields; "" for a user's rule, whatever its ``repr``."""
    if isinstance(step, FinestStep):
        rules = [_in_words(rule) for rule in step.rules]
        return f"finest of {', '.join(rules)}" if all(rules) else ""
    return repr(step) if type(step) in (MotionStep, JointStep) else ""
