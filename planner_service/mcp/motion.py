"""What moves an arm for an agent: a driver that the operator has named, the simulated arm or a real one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from planner_service.collision import CancelToken
from planner_service.errors import InvalidRequest
from planner_service.execute import (
    ArmContact,
    Driver,
    ExecutionReport,
    ExecutionStopped,
    SimulatedArm,
    Streaming,
    TrossenDriver,
    execute,
    meant_contacts,
    taken,
)
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.grasping.grasps import top_grasps
from planner_service.planning.task_result import TaskResult
from planner_service.robot.model import Robot
from planner_service.scene.names import Kind, owner_of
from planner_service.scene.scene import Scene
from planner_service.tasks.pick_place import standing_on

__all__ = ["ArmMover", "Done", "Mover", "SimulatedMover", "mover_named"]

PATIENCE = 0.5
"""Seconds by which a command to the simulated arm may be late; a delay does no harm in simulation."""

TROSSEN = "trossen="


@dataclass(frozen=True, eq=False)
class Done:
    """An execution.

    Attributes:
        report: How it went, also if it was stopped.
        q: Where the arm stands now, shape (n,).
        width: Metres between its finger pads.
        seen: Where loose objects lie now, by name, as far as that can be seen.
        contacts: Those that were not meant; None where nobody can tell.
    """

    report: ExecutionReport
    q: FloatArray
    width: float
    seen: Mapping[str, Pose]
    contacts: tuple[ArmContact, ...] | None


class Mover(Protocol):
    """Executes plans on one arm.

    Attributes:
        name: As the operator gave it.
    """

    @property
    def name(self) -> str: ...

    def seen(self, scene: Scene) -> Scene:
        """The scene with loose objects where they lie."""
        ...

    def run(self, task: TaskResult, cancel: CancelToken) -> Done:
        """Execute a task; proven again before the arm moves, and a cancelled call stops the arm where it is.

        Raises:
            InvalidRequest: as ``execute``; nothing has moved.
        """
        ...

    def positions(self) -> FloatArray:
        """Where the arm stands, shape (n,)."""
        ...

    def close(self) -> None:
        """Let go of the arm."""
        ...


class _Cancellable:
    """A driver that takes no further command once the call that moves it was cancelled."""

    def __init__(self, driver: Driver, cancel: CancelToken) -> None:
        self._driver, self._cancel = driver, cancel

    def __getattr__(self, name: str) -> Any:
        return getattr(self._driver, name)

    def command(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> None:
        self._require_wanted()
        self._driver.command(q, qd, qdd)

    def move_gripper(self, width: float, seconds: float) -> None:
        self._require_wanted()
        self._driver.move_gripper(width, seconds)

    def _require_wanted(self) -> None:
        if self._cancel.cancelled:
            raise InterruptedError("the call was cancelled")


class ArmMover:
    """Moves the arm behind a driver.

    Args:
        name: What it is called.
        streaming: How plans are executed; an agent cannot change it.
    """

    def __init__(self, name: str, driver: Driver, streaming: Streaming | None = None) -> None:
        self.name, self._driver, self._streaming = name, driver, streaming or Streaming()

    def seen(self, scene: Scene) -> Scene:
        """The scene itself: nobody looks."""
        return scene

    def positions(self) -> FloatArray:
        """See ``Mover``."""
        return np.array(self._driver.positions(), dtype=np.float64)

    def run(self, task: TaskResult, cancel: CancelToken) -> Done:
        """See ``Mover``."""
        driver: Any = _Cancellable(self._driver, cancel)
        try:
            report = execute(task, driver, streaming=self._streaming)
        except ExecutionStopped as stopped:
            report = stopped.report
        return Done(report, self.positions(), self._driver.gripper_width(), self._poses(), self._unexpected(task))

    def _poses(self) -> Mapping[str, Pose]:
        return {}

    def _unexpected(self, task: TaskResult) -> tuple[ArmContact, ...] | None:
        return None

    def close(self) -> None:
        """See ``Mover``."""
        self._driver.close()


class SimulatedMover(ArmMover):
    """Moves the simulated arm, which sees where loose objects lie: all that its gripper could take.

    Args:
        q: Where the arm stands, shape (n,).
    """

    def __init__(self, robot: Robot, scene: Scene, q: ArrayLike, streaming: Streaming | None = None) -> None:
        self._arm = SimulatedArm(robot, scene, q, loose=_loose(robot, scene))
        self._told = 0
        try:
            super().__init__("simulator", self._arm.connect(), streaming or Streaming(latest=PATIENCE))
        except BaseException:
            self._arm.close()
            raise

    def seen(self, scene: Scene) -> Scene:
        """The scene with loose objects where they came to lie."""
        seen = self._arm.seen()
        self._told = len(self._arm.contacts())
        return seen

    def _poses(self) -> Mapping[str, Pose]:
        return self._arm.poses()

    def _unexpected(self, task: TaskResult) -> tuple[ArmContact, ...]:
        """Those of the robot and of what it takes; other loose objects may lie where they like."""
        every, may, robot = self._arm.contacts(), meant_contacts(task), task.world.robot
        new, self._told = every[self._told :], len(every)
        moved = taken(task, robot)
        return tuple(
            contact
            for contact in new
            if contact.pair not in may
            and any(o.kind is Kind.LINK or o.name in moved for o in (owner_of(name, robot) for name in contact.pair))
        )

    def close(self) -> None:
        """See ``Mover``."""
        try:
            super().close()
        finally:
            self._arm.close()


def _loose(robot: Robot, scene: Scene) -> tuple[str, ...]:
    """The obstacles that stand on others, and that the gripper could take."""
    names = []
    for obstacle in scene.obstacles:
        if standing_on(scene, obstacle.name) is not None:
            with suppress(InvalidRequest):
                names += [obstacle.name] if top_grasps(robot, obstacle) else []
    return tuple(names)


def mover_named(driver: str, robot: Robot, scene: Scene, q: ArrayLike, speed: float | None) -> Mover:
    """The mover that an operator asked for: ``simulator``, or ``trossen=ADDRESS``.

    Raises:
        InvalidRequest: There is no such driver, it does not answer, or it does not go with the robot.
        MissingDependency: the extra ``sim`` is not installed.
    """
    if driver == "simulator":
        return SimulatedMover(robot, scene, q, Streaming(speed=speed, latest=PATIENCE))
    address = driver.removeprefix(TROSSEN)
    if address == driver or not address:
        raise InvalidRequest("--execute", driver, f"simulator, or {TROSSEN}ADDRESS")
    return ArmMover(driver, TrossenDriver(address), Streaming(speed=speed))


def apart(a: Pose, b: Pose) -> tuple[float, float]:
    """Metres and radians between two poses."""
    turn = min(1.0, abs(sum(x * y for x, y in zip(a.quaternion, b.quaternion, strict=True))))
    return math.dist(a.position, b.position), 2.0 * math.acos(turn)
