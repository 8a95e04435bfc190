"""The simulated arm in a process of its own: physics in real time, and the network interface of its controller.

A script that nothing imports. Its argument is JSON with ``path`` (the parent's sys.path), ``scene`` (an MJCF file),
``host`` and ``joints`` (positions at the start, by name, which the controller holds). It prints a JSON object a line:
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
        told = {"time": monitor.time, "contacts": [c.to_dict() for c in monitor.active_contacts()]}
        events.put({**told, "bodies": _loose(mujoco, simulation)})  # behind all events before
    server.stop()
    simulation.stop()


def _report(events: queue.Queue[Any], tell: Any) -> None:
    while True:
        event = events.get()
        tell(event if isinstance(event, dict) else event.to_dict())


def _stand(mujoco: Any, simulation: Any, joints: dict[str, float]) -> None:
    """Put the arm's joints, and what they are told, to where they begin."""
    model, data = simulation.model, simulation.data
    for name, value in joints.items():
        joint = model.joint(name).id
        data.qpos[model.jnt_qposadr[joint]] = value
        for k in range(model.nu):
            if model.actuator_trnid[k, 0] == joint:
                data.ctrl[k] = value
    mujoco.mj_forward(model, data)


def _loose(mujoco: Any, simulation: Any) -> dict[str, list[float]]:
    """Positions and quaternions (wxyz) of bodies that are free to move."""
    model, data = simulation.model, simulation.data
    found = {}
    with simulation._lock:  # a position and its quaternion are of one instant
        for joint in range(model.njnt):
            if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
                at = model.jnt_qposadr[joint]
                found[model.joint(joint).name] = data.qpos[at : at + 7].tolist()
    return found


if __name__ == "__main__":
    main()
