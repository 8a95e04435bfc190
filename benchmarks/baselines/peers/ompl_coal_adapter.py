"""OMPL as one sets it up by hand: RRTConnect and OMPL's simplifier, each state judged by Pinocchio and Coal.

Two of OMPL's defaults are replaced by what is usually recommended: an edge is 0.5 rad long at most, and judged every
0.05 rad. Nothing times the path. The states that are judged are counted here, by stage.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import coal
import numpy as np
import ompl.base as ob
import ompl.geometric as og
import ompl.util as ou
import pinocchio as pin

from benchmarks.baselines.peers.adapter_protocol import Answer, Table, clock, matrix_of, serve

__all__ = ["OmplCoal"]


class World:
    """The robot and a problem's obstacles, asked one state after the other by Pinocchio's naive manager."""

    def __init__(self, robot: Table, problem: Table) -> None:
        urdf = Path(robot["urdf"])
        self._model = pin.buildModelFromUrdf(str(urdf))
        if list(self._model.names)[1:] != list(robot["joints"]):
            raise ValueError("Pinocchio orders the joints otherwise")
        kind = pin.GeometryType.COLLISION
        world = pin.buildGeomFromUrdf(self._model, str(urdf), kind, package_dirs=[str(urdf.parent)])
        for shape in world.geometryObjects:
            if isinstance(shape.geometry, coal.BVHModelBase):
                shape.geometry.buildConvexHull(True, "Qt")
                shape.geometry = shape.geometry.convex
        owners = [self._model.frames[shape.parentFrame].name for shape in world.geometryObjects]
        links = len(owners)
        for body in problem["obstacles"]:
            placed = pin.SE3(np.array(matrix_of(body)))
            world.addGeometryObject(pin.GeometryObject(body["name"], 0, placed, _shape(body)))
        disabled = {frozenset(pair) for pair in robot["disabled_pairs"]}
        for j in range(len(world.geometryObjects)):
            for i in range(min(j, links)):
                own = frozenset((owners[i], owners[j])) if j < links else frozenset((owners[i],))
                same = world.geometryObjects[i].parentJoint == world.geometryObjects[j].parentJoint
                if j < links and (same or own in disabled):
                    continue
                if j >= links and owners[i] in robot["base_links"]:
                    continue
                world.addCollisionPair(pin.CollisionPair(i, j))
        self._data, self._world, self._placed = self._model.createData(), world, world.createData()
        self._manager = pin.BroadPhaseManager_NaiveCollisionManager(self._model, world, self._placed)
        self._span = slice(0, self._model.nq)
        self.judged = 0

    def is_free(self, state: Any) -> bool:
        """Whether nothing touches at a state of OMPL's."""
        self.judged += 1
        q = np.array(state[self._span])
        return not pin.computeCollisions(self._model, self._data, self._manager, q, True)


class OmplCoal:
    """Everything is built anew for each problem, as OMPL needs it to be reproducible."""

    def __init__(self, job: Table) -> None:
        self._robot, self._settings, self._limit = job["robot"], job["settings"], job["time_limit"]
        ou.setLogLevel(ou.LOG_NONE)

    def solve(self, problem: Table, seed: int, answer: Answer) -> None:
        """RRTConnect, then ``simplifyMax``."""
        with answer.stage("setup"):
            world = World(self._robot, problem)
            ou.RNG.setSeed(1 + seed)  # 0 is ignored
            si = self._space(world)
        definition, planner = ob.ProblemDefinition(si), og.RRTConnect(si)
        definition.addStartState(_state(si, problem["start"]))
        goals = ob.GoalStates(si)
        for goal in problem["goals"]:
            goals.addState(_state(si, goal))
        definition.setGoal(goals)
        planner.setRange(self._settings["range"])
        planner.setProblemDefinition(definition)
        planner.setup()
        with answer.stage("search"):
            status = planner.solve(ob.timedPlannerTerminationCondition(self._limit))
        answer.checks["search"] = world.judged
        if not status == ob.PlannerStatus.EXACT_SOLUTION:  # noqa: SIM201 - it knows == alone
            answer.error = f"{status.asString()} within {self._limit:g} s"
            return
        path = definition.getSolutionPath()
        with answer.stage("shortcut"):
            og.PathSimplifier(si).simplify(path, clock(answer, self._limit))
        answer.checks["shortcut"] = world.judged - answer.checks["search"]
        answer.waypoints = _rows(path, len(problem["start"]))

    def _space(self, world: World) -> Any:
        lower, upper = self._robot["lower"], self._robot["upper"]
        space, bounds = ob.RealVectorStateSpace(len(lower)), ob.RealVectorBounds(len(lower))
        for joint, (low, high) in enumerate(zip(lower, upper, strict=True)):
            bounds.setLow(joint, low)
            bounds.setHigh(joint, high)
        space.setBounds(bounds)
        si = ob.SpaceInformation(space)
        si.setStateValidityChecker(world.is_free)
        si.setStateValidityCheckingResolution(self._settings["step"] / space.getMaximumExtent())
        si.setup()
        return si


def _state(si: Any, q: list[float]) -> Any:
    state = si.allocState()
    for joint, value in enumerate(q):
        state[joint] = value
    return state


def _rows(path: Any, size: int) -> list[list[float]]:
    return [list(path.getState(k)[0:size]) for k in range(path.getStateCount())]


def _shape(body: Table) -> Any:
    kind = body["kind"]
    if kind == "box":
        return coal.Box(*body["size"])
    if kind == "sphere":
        return coal.Sphere(body["radius"])
    return {"cylinder": coal.Cylinder, "capsule": coal.Capsule}[kind](body["radius"], body["length"])


if __name__ == "__main__":
    serve(("ompl", "pin", "coal", "numpy"), OmplCoal)
