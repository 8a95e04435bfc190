"""The simulated arm in a process of its own: physics in real time, and the network interface of its controller.

A loose body is welded to the hand from when both fingers press on it until neither does. Friction alone does not do in
this simulator: a block slipped 11 to 14 mm through the grip on the way; with four times the force, an elliptic cone and
impratio 100, or noslip_iterations, too.

A script that nothing imports. Its argument is JSON with ``path`` (the parent's sys.path), ``scene`` (an MJCF file),
``host``, ``joints`` (positions at the start, by name, which the controller holds), ``fingers`` (how the names of their
geoms begin) and ``loose`` (names of bodies, and of their welds). It prints a JSON object a line:
``{"ready": ...}`` when it can be connected to, then each contact that begins or ends; after every line on its
standard input the answer to it: the time, the contacts that there are, and where the loose bodies are. It ends with
its standard input: with its parent, however that ends.
"""

from __future__ import annotations

import json
import os
import queue
import sys
import threading
from typing import Any


def main() -> None:
    job = json.loads(sys.argv[1])
    sys.path[:] = job["path"]
    answer = os.fdopen(os.dup(1), "w", encoding="utf-8", buffering=1)
    os.dup2(2, 1)  # what a library prints is not part of the answer

    import mujoco
    from trossen_arm_sim import CollisionMonitor, TrossenArmSimServer, WidowXSim

    simulation = WidowXSim(job["scene"])
    _stand(mujoco, simulation, job["joints"])
    for name in job["loose"]:
        simulation.add_step_hook(_Grip(mujoco, simulation, name, job["fingers"]))
    monitor = CollisionMonitor(simulation)
    _, events = monitor.subscribe()
    server = TrossenArmSimServer(simulation, host=job["host"])
    try:
        server.start()
    except OSError as error:
        answer.write(json.dumps({"busy": str(error)}) + "\n")
        return
    simulation.start()
    lock = threading.Lock()

    def tell(document: dict[str, Any]) -> None:
        with lock:
            answer.write(json.dumps(document) + "\n")

    tell({"ready": simulation.model.ngeom})
    threading.Thread(target=_report, args=(events, tell), daemon=True).start()
    for _ in sys.stdin:
        state = {"time": monitor.time, "contacts": [c.to_dict() for c in monitor.active_contacts()]}
        events.put({**state, "bodies": _loose(mujoco, simulation)})  # behind all events before
    server.stop()
    simulation.stop()


def _report(events: queue.Queue[Any], tell: Any) -> None:
    while True:
        event = events.get()
        tell(event if isinstance(event, dict) else event.to_dict())


def _stand(mujoco: Any, simulation: Any, joints: dict[str, float]) -> None:
    """Put the arm's joints and their commands to where they begin."""
    model, data = simulation.model, simulation.data
    for name, value in joints.items():
        joint = model.joint(name).id
        data.qpos[model.jnt_qposadr[joint]] = value
        for k in range(model.nu):
            if model.actuator_trnid[k, 0] == joint:
                data.ctrl[k] = value
    mujoco.mj_forward(model, data)


class _Grip:
    """Holds one loose body as long as the fingers do; called after each step."""

    def __init__(self, mujoco: Any, simulation: Any, name: str, fingers: list[str]) -> None:
        self.mujoco, self.simulation = mujoco, simulation
        model = simulation.model
        self.weld, self.body = model.equality(name).id, model.body(name).id
        self.hand = model.eq_obj1id[self.weld]
        self.finger_of = {
            geom: finger
            for geom in range(model.ngeom)
            for finger in fingers
            if model.geom(geom).name.startswith(finger)
        }
        self.both = len(fingers)

    def __call__(self) -> None:
        model, data = self.simulation.model, self.simulation.data
        pressing = set()
        for a, b in data.contact.geom[: data.ncon].tolist():
            for finger, other in ((a, b), (b, a)):
                if finger in self.finger_of and model.geom_bodyid[other] == self.body:
                    pressing.add(self.finger_of[finger])
        if not pressing:
            data.eq_active[self.weld] = 0
        elif len(pressing) == self.both and not data.eq_active[self.weld]:
            turned, pose = data.xmat[self.hand].reshape(3, 3).T, model.eq_data[self.weld]
            back = data.xquat[self.hand] * (1.0, -1.0, -1.0, -1.0)
            pose[:3] = 0.0
            pose[3:6] = turned @ (data.xpos[self.body] - data.xpos[self.hand])
            self.mujoco.mju_mulQuat(pose[6:10], back, data.xquat[self.body])
            data.eq_active[self.weld] = 1


def _loose(mujoco: Any, simulation: Any) -> dict[str, list[float]]:
    """Positions and quaternions (wxyz) of bodies that are free to move."""
    model, data = simulation.model, simulation.data
    poses = {}
    with simulation._lock:  # a position and its quaternion are of one instant
        for joint in range(model.njnt):
            if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
                at = model.jnt_qposadr[joint]
                poses[model.joint(joint).name] = data.qpos[at : at + 7].tolist()
    return poses


if __name__ == "__main__":
    main()
