"""A random policy, one that pushes into things and a leader that jerks command the simulated arm: nothing is touched.

Needs the extra sim: pip install 'planner-service[sim]'. Run: python examples/12_gate_in_simulation.py
With --view (and the extra view) a page in the browser shows the arm and what the gate decides.
"""

import sys
import time
from collections.abc import Callable

import numpy as np

from planner_service import PlannerService, load_robot, load_scene
from planner_service.execute import GatedArm, SimulatedArm
from planner_service.gate import ActionGate, TargetFilter, Tracking
from planner_service.geometry.arrays import FloatArray
from planner_service.view import watch

RATE, SECONDS = 30.0, 4.0
DRIVER = Tracking(goal_time=0.1, error=(0.02, 0.02, 0.02, 0.03, 0.05, 0.06), jitter=0.02, lag=0.1)  # the simulator's


def main() -> None:
    """Let each of the three command the arm for four seconds behind a gate."""
    service, rng = PlannerService(load_robot("wxai"), load_scene("bin")), np.random.default_rng(0)
    policies: dict[str, Callable[[float, FloatArray], FloatArray]] = {
        "a random policy": lambda t, q: q + rng.uniform(-0.3, 0.3, 6),
        "one that pushes": lambda t, q: q + min(t, 1.0) * np.array([0.0, 0.1, -0.1, 0.0, 0.0, 0.0]),
        "a leader that jerks": lambda t, q: np.array([0.6 * np.sin(2 * t) + 0.2 * (t % 1 > 0.9), 1.2, 1.0, -0.8, 0, 0]),
    }
    with SimulatedArm(service.robot, service.scene) as simulated:
        driver = simulated.connect()
        gate = ActionGate(service, rate=RATE, tracking=DRIVER, slow=True)
        arm = GatedArm(driver, TargetFilter(gate))
        if "--view" in sys.argv:
            print(watch(gate).url)
        for name, policy in policies.items():
            arm.move_to(service.robot.home)
            before, began = sum(gate.counts.refused.values()), time.perf_counter()
            while (t := time.perf_counter() - began) < SECONDS:
                arm.send(policy(t, driver.positions()))
                time.sleep(max(0.0, 1 / RATE - (time.perf_counter() - began - t)))
            print(f"{name}: {sum(gate.counts.refused.values()) - before} refusals {gate.counts.refused}")
        arm.move_to(service.robot.home)
        print(f"contacts: {len(simulated.contacts())}", *simulated.contacts(), sep="\n")
        driver.close()


if __name__ == "__main__":
    main()
