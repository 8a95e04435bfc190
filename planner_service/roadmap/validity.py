"""For what the verdicts in a roadmap hold: robot, scene, padding and step; and what another scene leaves of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

from planner_service.collision import CollisionChecker
from planner_service.collision.edge_sampling import EdgeStep, FinestStep, JointStep, MotionStep

__all__ = ["Terms"]


@dataclass(frozen=True)
class Terms:
    """What decides a verdict.

    Attributes:
        robot: Its name.
        robot_hash: ``Robot.hash``, the gripper's width included.
        joint_names: The joints of q.
        scene: Its name.
        scene_hash: ``Scene.hash``.
        obstacles: Name and hash of each obstacle, sorted by name.
        attached: Hash of what is attached to the tool.
        allowed: Pairs that may touch, beside those that the robot allows.
        padding: Metres that are kept.
        step: How finely edges are sampled, in words; empty of a rule of the user, which words do not tell from others.
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
        """What decides the verdicts of a checker."""
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
        """Whether verdicts hold in both; never where how finely edges are sampled cannot be told."""
        return self == other and self.step != ""

    def same_but_for_obstacles(self, other: Terms) -> bool:
        """Whether at most obstacles differ, which are judged one by one."""
        named = {"scene": "", "scene_hash": "", "obstacles": ()}
        return replace(self, **named).same(replace(other, **named))  # type: ignore[arg-type]

    def changed(self, other: Terms) -> tuple[frozenset[str], frozenset[str]]:
        """The obstacles that are new or different there, and those that are gone or different."""
        before, after = dict(self.obstacles), dict(other.obstacles)
        come = frozenset(name for name, content in after.items() if before.get(name) != content)
        return come, frozenset(name for name, content in before.items() if after.get(name) != content)


def _in_words(step: EdgeStep) -> str:
    """One of our own rules by its fields, which are all there is to it; "" of a user's, whatever its ``repr`` says."""
    if isinstance(step, FinestStep):
        rules = [_in_words(rule) for rule in step.rules]
        return f"finest of {', '.join(rules)}" if all(rules) else ""
    return repr(step) if type(step) in (MotionStep, JointStep) else ""
