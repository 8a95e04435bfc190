"""The simulated arm: our robot among our obstacles in MuJoCo, behind the network interface of the real controller.

It runs in a process of its own, in real time, and ends with this one, however that ends. The vendor's driver connects
to it as to an arm, so the same code runs as on a real arm.
"""

from __future__ import annotations

import contextlib
import json
import math
import queue
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from planner_service.errors import BrokenInvariant, InvalidRequest, MissingDependency
from planner_service.execute.mjcf import MARK, link_of, mjcf_text
from planner_service.execute.trossen import SIMULATED_LAG, TrossenDriver
from planner_service.geometry.shapes import Pose
from planner_service.robot.model import Robot, joint_vector
from planner_service.robot.package_files import package_folder
from planner_service.scene.names import Names
from planner_service.scene.scene import Scene

__all__ = ["ArmContact", "SimulatedArm", "arm_file"]

TCP_PORT, UDP_PORT = 50001, 50000
"""The controller's ports; only its address can be chosen."""

HOSTS = tuple(f"127.0.0.{k}" for k in range(1, 33))
"""Loopback addresses tried, in this order; systems that have only the first run one simulated arm at a time."""

SECONDS = 30.0
"""How long to wait for an answer of the child, which takes 0.5 s on a quiet machine."""

LOOK, STILL = 0.1, 1e-5
"""Seconds between two looks at what lies loose, and metres by which it has moved in between if it lies still."""


@dataclass(frozen=True)
class ArmContact:
    """A contact that the simulator reported.

    Attributes:
        a: A link of the robot, or what lies loose.
        b: What it touched.
        began: Seconds of simulation.
        duration: Seconds, so far.
        force: The largest normal force in N.
        position: Of the first touch, metres in the base frame.
    """

    a: str
    b: str
    began: float
    duration: float
    force: float
    position: tuple[float, float, float]

    @property
    def pair(self) -> frozenset[str]:
        """Both names."""
        return frozenset((self.a, self.b))

    def __str__(self) -> str:
        return f"{self.a} x {self.b} at {self.began:.2f} s for {self.duration:.2f} s, up to {self.force:.1f} N"


class SimulatedArm(contextlib.AbstractContextManager["SimulatedArm"]):
    """A simulated WidowX AI that stands at ``start`` among a scene's obstacles; a context manager, which ends it.

    Args:
        robot: The WidowX AI; the gripper stands as its does.
        start: Joint vector, shape (n,); home if None.
        loose: Obstacles that are bodies of their own, to be taken; the others stand still.
        host: The loopback address to listen at; a free one if None.

    Raises:
        MissingDependency: trossen_arm_sim is not installed (extra ``sim``).
        InvalidRequest: another robot, a shape that the simulator has not, a host whose ports are in use.
    """

    def __init__(
        self,
        robot: Robot,
        scene: Scene,
        start: ArrayLike | None = None,
        *,
        loose: Collection[str] = (),
        host: str | None = None,
    ) -> None:
        if host is not None and not host.startswith("127."):
            raise InvalidRequest("host", host, "a loopback address, 127.x.y.z: anyone who reaches it can move the arm")
        self.scene = scene
        text = mjcf_text(arm_file(), robot, scene, loose=loose)
        q = joint_vector("start", robot.home if start is None else start, robot)
        joints = dict(zip(robot.joint_names, q.tolist(), strict=True))
        joints |= {} if robot.gripper is None else dict.fromkeys(robot.gripper.joints, robot.gripper_width / 2.0)
        self._folder = tempfile.TemporaryDirectory(prefix="planner-service-")
        self._errors = Path(self._folder.name) / "errors.txt"
        self._said: queue.Queue[dict[str, Any] | None] = queue.Queue()
        self._asking = threading.Lock()
        self._contacts: list[dict[str, Any]] = []
        self._process: subprocess.Popen[str] | None = None
        try:
            model = Path(self._folder.name) / "scene.xml"
            model.write_text(text, "utf-8")
            names = Names(robot, scene)
            fingers = [] if robot.gripper is None else [names.link(link) + MARK for link in robot.gripper.links]
            bodies = [name + MARK for name in sorted(loose)]
            job = {"scene": str(model), "joints": joints, "fingers": fingers, "loose": bodies}
            self.host = self._started(job, host)
            self._began = 0.0
            self._began = self.behind()
        except BaseException:  # what was begun is ended, also by Ctrl-C
            self.close()
            raise

    def connect(self) -> TrossenDriver:
        """The vendor's driver, connected; one at a time."""
        return TrossenDriver(self.host, simulated=True, lag=SIMULATED_LAG)

    def time(self) -> float:
        """Seconds of simulation so far, which stand still while the machine gives it no time."""
        return float(self._ask()["time"])

    def behind(self) -> float:
        """Seconds by which the simulation is behind the clock since it began: the machine gave it too little time."""
        return time.perf_counter() - self._began - self.time()

    def contacts(self) -> tuple[ArmContact, ...]:
        """All contacts so far, in the order in which they began: of the robot or of what lies loose with anything."""
        self._ask()
        return tuple(_contact(event) for event in self._contacts)

    def poses(self) -> dict[str, Pose]:
        """Where loose obstacles are now, by name."""
        poses_by_name = {}
        for name, (x, y, z, w, i, j, k) in self._ask()["bodies"].items():
            poses_by_name[name.removesuffix(MARK)] = Pose((x, y, z), (w, i, j, k))
        return poses_by_name

    def seen(self) -> Scene:
        """The scene with loose obstacles where they came to lie, once they lie still: what there is to plan for.

        Scenes leave a gap below what stands in them, through which it falls.

        Raises:
            InvalidRequest: they never do.
        """
        before = self.poses()
        for _ in range(round(SECONDS / LOOK)):
            time.sleep(LOOK)
            now = self.poses()
            if all(math.dist(now[name].position, pose.position) <= STILL for name, pose in before.items()):
                scene = self.scene
                for name, pose in now.items():
                    scene = scene.moved(name, pose)
                return scene
            before = now
        raise InvalidRequest("loose", sorted(before), "obstacles that come to lie still")

    def close(self) -> None:
        """End it; nothing remains of it but the contacts."""
        self._end()
        self._folder.cleanup()

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            stdin, stdout = process.stdin, process.stdout
            assert stdin is not None
            assert stdout is not None
            with contextlib.suppress(OSError):
                stdin.close()
            try:
                process.wait(5.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            self._listener.join()
            stdout.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _started(self, job: dict[str, Any], host: str | None) -> str:
        for candidate in HOSTS if host is None else (host,):
            if not _free(candidate):
                continue
            self._said = queue.Queue()
            self._spawn({**job, "path": sys.path, "host": candidate})
            if "ready" in self._next():
                return candidate
            self._end()  # another process took the ports in between
        where = f"{HOSTS[0]} to {HOSTS[-1]}" if host is None else host
        expected = f"an address of this machine at which TCP {TCP_PORT} and UDP {UDP_PORT} are free"
        raise InvalidRequest("host", where, expected)

    def _spawn(self, job: dict[str, Any]) -> None:
        script = Path(__file__).with_name("simulator_child.py")
        command = [sys.executable, "-I", str(script), json.dumps(job)]
        pipe = subprocess.PIPE
        with self._errors.open("wb") as errors:  # a pipe that nobody reads would stop the simulation when it is full
            self._process = subprocess.Popen(
                command, stdin=pipe, stdout=pipe, stderr=errors, text=True, encoding="utf-8", errors="replace"
            )
        self._listener = threading.Thread(target=self._listen, args=(self._process,), daemon=True)
        self._listener.start()

    def _listen(self, process: subprocess.Popen[str]) -> None:
        """Sort what the child says until it ends."""
        assert process.stdout is not None
        said = self._said
        try:
            for line in process.stdout:
                event = json.loads(line)
                kind = event.get("type")
                if kind == "begin":
                    self._contacts.append(event)
                elif kind == "end":
                    self._ended(event)
                else:
                    said.put(event)
        except (ValueError, AttributeError, KeyError):
            process.kill()  # what else it says would not be known to be true
        said.put(None)

    def _ended(self, event: dict[str, Any]) -> None:
        for begun in reversed(self._contacts):
            if (begun["geom1"], begun["geom2"]) == (event["geom1"], event["geom2"]):
                begun.update(duration=event["duration"], peak_force=event["peak_force"])
                return

    def _ask(self) -> dict[str, Any]:
        """The state of the simulation; what it had reported before is then known, too."""
        if self._process is None or self._process.stdin is None:
            raise InvalidRequest("arm", "closed", "a simulated arm that runs")
        with self._asking:
            try:
                self._process.stdin.write("?\n")
                self._process.stdin.flush()
            except OSError as error:
                raise BrokenInvariant(f"the simulated arm ended by itself: {error}") from None
            return self._next()

    def _next(self) -> dict[str, Any]:
        try:
            message = self._said.get(timeout=SECONDS)
        except queue.Empty:
            raise BrokenInvariant(f"the simulated arm said nothing for {SECONDS:g} s") from None
        if message is None:
            self._said.put(None)  # the next one who asks hears it, too
            last = self._errors.read_text("utf-8", "replace").strip()[-300:] if self._errors.exists() else ""
            raise BrokenInvariant(f"the simulated arm ended by itself: {last}")
        return message


def arm_file() -> Path:
    """The vendor's MJCF of the arm.

    Raises:
        MissingDependency: trossen_arm_sim is not installed (extra ``sim``).
    """
    try:
        return package_folder("trossen-arm-sim") / "assets" / "wxai_follower.xml"
    except MissingDependency:
        raise MissingDependency("trossen-arm-sim", "sim") from None


def _contact(event: dict[str, Any]) -> ArmContact:
    x, y, z = event["pos"]
    names = link_of(event["geom1"]), link_of(event["geom2"])
    return ArmContact(*names, event["time"], event["duration"], event["peak_force"], (x, y, z))


def _free(host: str) -> bool:
    """Whether both ports can be listened at."""
    return all(_bindable(host, *port) for port in ((socket.SOCK_STREAM, TCP_PORT), (socket.SOCK_DGRAM, UDP_PORT)))


def _bindable(host: str, kind: socket.SocketKind, port: int) -> bool:
    with socket.socket(socket.AF_INET, kind) as probe:
        if kind == socket.SOCK_STREAM:  # else what was closed a minute ago counts as in use
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError:
            return False
    return True
