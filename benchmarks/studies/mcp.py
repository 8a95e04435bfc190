"""Twenty tabletop tasks as tool calls of an agent, by the protocol's own client, on the simulated arm.

A task is a short program in place of an agent: it calls tools, reads the refusals and does what they say. Every motion
of every plan that is returned, executed or not, is judged again by the auditor, which shares no code with the planner.
"""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import Any

import anyio
from mcp import Client
from mcp_types import TextContent

import planner_service as ps
from auditor.checker import IndependentChecker, tables_of
from benchmarks.harness.audit import touch_of_plan
from benchmarks.harness.report import Promise, Report, Row, table, table_of
from planner_service.collision import CancelToken
from planner_service.files.package_data import data_folder
from planner_service.mcp import Session, SimulatedMover
from planner_service.mcp.motion import Done
from planner_service.mcp.server import server_of
from planner_service.planning.task_result import Segment, TaskResult

__all__ = ["TASKS", "run", "tabletop"]

NEAR = 0.01
"""Metres from where an object was to be put: what closing fingers push it and settling let it move."""

LOOK = 0.002
"""Metres that a point of the robot moves, at most, from one configuration that is judged to the next."""

SIDE = 0.04
"""Of the blocks, in metres."""

TRAY, SHELF = (0.2, 0.28), (0.2, -0.3)

MAX_CELL = 300
"""Characters of an answer in a transcript."""


def tabletop() -> ps.Scene:
    """A table with three blocks, a can, a crate that is too wide, a tray, a shelf and a post."""
    block = ps.Box((SIDE, SIDE, SIDE))
    middle = SIDE / 2
    return ps.Scene(
        (
            *(ps.Obstacle("table", ps.Box((1.4, 1.4, 0.1)), ps.Pose((0.0, 0.0, -0.051))),),
            *(ps.Obstacle("red_block", block, ps.Pose((0.26, 0.12, middle))),),
            *(ps.Obstacle("green_block", block, ps.Pose((0.3, -0.01, middle))),),
            *(ps.Obstacle("blue_block", block, ps.Pose((0.25, -0.14, middle))),),
            *(ps.Obstacle("can", ps.Cylinder(0.022, 0.09), ps.Pose((0.38, -0.12, 0.045))),),
            *(ps.Obstacle("crate", ps.Box((0.12, 0.12, 0.1)), ps.Pose((0.46, 0.08, 0.05))),),
            *(ps.Obstacle("tray", ps.Box((0.18, 0.18, 0.01)), ps.Pose((*TRAY, 0.005))),),
            *(ps.Obstacle("shelf", ps.Box((0.14, 0.14, 0.05)), ps.Pose((*SHELF, 0.025))),),
            *(ps.Obstacle("post", ps.Cylinder(0.02, 0.3), ps.Pose((0.36, 0.24, 0.15))),),
        ),
        name="tabletop",
    )


class Watched(SimulatedMover):
    """The simulated arm; keeps what it was told to execute."""

    def __init__(self, robot: ps.Robot, scene: ps.Scene) -> None:
        super().__init__(robot, scene, robot.home)
        self.executed: list[TaskResult] = []
        self.unexpected: list[str] = []

    def run(self, task: TaskResult, cancel: CancelToken) -> Done:
        done = super().run(task, cancel)
        self.executed.append(task)
        self.unexpected += [str(contact) for contact in done.contacts or ()]
        return done


class Failed(Exception):
    """A task that did not go as it was to."""


@dataclass
class Agent:
    """The client's side, and what was said."""

    client: Client
    transcript: list[tuple[str, str]] = field(default_factory=list)
    refusals: int = 0

    async def call(self, tool: str, **given: Any) -> dict[str, Any]:
        """The answer to a call.

        Raises:
            Failed: It was refused.
        """
        fields, refused = await self._called(tool, given)
        if refused:
            raise Failed(f"{tool}: {fields['detail']}")
        return fields

    async def refused(self, tool: str, reason: str, **given: Any) -> dict[str, Any]:
        """The refusal of a call.

        Raises:
            Failed: It was answered, or refused for another reason, or does not say what to do.
        """
        fields, refused = await self._called(tool, given)
        if not refused or fields["refused"] != reason or not fields["do"]:
            raise Failed(f"{tool}: not refused as {reason}: {fields}")
        self.refusals += 1
        return fields

    async def _called(self, tool: str, given: dict[str, Any]) -> tuple[dict[str, Any], bool]:
        result = await self.client.call_tool(tool, given)
        said = next(part.text for part in result.content if isinstance(part, TextContent)).splitlines()[0]
        words = ", ".join(f"{key}={value}" for key, value in given.items())
        self.transcript.append((f"{tool}({words})", said if len(said) <= MAX_CELL else f"{said[:MAX_CELL]}..."))
        return result.structured_content or {}, bool(result.is_error)

    async def where(self, name: str, after: str | None = None) -> tuple[float, float, float]:
        """The middle of an object, now or at the end of a plan."""
        scene = await self.call("describe_scene", **({} if after is None else {"after": after}))
        (thing,) = [thing for thing in scene["objects"] if thing["name"] == name]
        x, y, z = thing["middle"]
        return x, y, z

    async def move(self, name: str, onto: str, at: tuple[float, float] | None = None) -> None:
        """Pick and place, planned in one go and executed in one go."""
        pick = await self.call("pick", object=name)
        given: dict[str, Any] = {} if at is None else {"at": list(at)}
        place = await self.call("place", onto=onto, after=pick["plan"], **given)
        await self.carry_out(place["plan"], name)

    async def carry_out(self, plan: str, name: str) -> None:
        """Execute a plan; at its end an object must lie where it was to be put."""
        target = await self.where(name, plan)
        await self.call("execute", plan=plan)
        off = math.dist(await self.where(name), target)
        if off > NEAR:
            raise Failed(f"{name} lies {off * 1e3:.0f} mm from where it was to be put")


async def one_go(agent: Agent) -> None:
    await agent.move("red_block", "tray")


async def step_by_step(agent: Agent) -> None:
    pick = await agent.call("pick", object="green_block")
    await agent.call("execute", plan=pick["plan"])
    place = await agent.call("place", onto="shelf")
    await agent.carry_out(place["plan"], "green_block")


async def upright(agent: Agent) -> None:
    pick = await agent.call("pick", object="can", upright=0.35)
    place = await agent.call("place", onto="tray", after=pick["plan"])
    await agent.carry_out(place["plan"], "can")


async def stack(agent: Agent) -> None:
    await agent.move("red_block", "green_block")


async def tower(agent: Agent) -> None:
    for name, onto in (("green_block", "shelf"), ("red_block", "green_block")):
        await agent.move(name, onto)


async def clear(agent: Agent) -> None:
    for k, name in enumerate(("red_block", "green_block", "blue_block")):
        await agent.move(name, "tray", (TRAY[0] - 0.055 + 0.055 * k, TRAY[1] + 0.04 * (k - 1)))


async def aside(agent: Agent) -> None:
    x, y, _ = await agent.where("blue_block")
    await agent.move("blue_block", "table", (x, y + 0.06))


async def swap(agent: Agent) -> None:
    red, blue = (await agent.where("red_block"))[:2], (await agent.where("blue_block"))[:2]
    await agent.move("red_block", "tray")
    await agent.move("blue_block", "table", red)
    await agent.move("red_block", "table", blue)


async def lift(agent: Agent) -> None:
    at = (await agent.where("blue_block"))[:2]
    pick = await agent.call("pick", object="blue_block")
    line = await agent.call("move_linear", by=[0.0, 0.0, 0.02], after=pick["plan"])
    place = await agent.call("place", onto="table", at=list(at), after=line["plan"])
    await agent.carry_out(place["plan"], "blue_block")


async def there_and_back(agent: Agent) -> None:
    there = await agent.call("plan", goal={"named": "ready"})
    back = await agent.call("plan", goal={"named": "home"}, after=there["plan"])
    await agent.call("execute", plan=back["plan"])


async def above(agent: Agent) -> None:
    x, y, z = await agent.where("green_block")
    place = {"position": [x, y, z + 0.17]}
    if not (await agent.call("check", at=place))["free"]:
        raise Failed("above the block is not free")
    plan = await agent.call("plan", goal=place)
    done = await agent.call("execute", plan=plan["plan"])
    if math.dist(done["stand"]["tool"]["position"], place["position"]) > 1e-3:
        raise Failed("the tool is elsewhere")


async def too_wide(agent: Agent) -> None:
    refused = await agent.refused("pick", "INVALID_REQUEST", object="crate")
    if "at most 0.080 m wide" not in refused["detail"]:
        raise Failed("it does not say how wide an object may be")
    await agent.move("red_block", "tray")


async def occupied(agent: Agent) -> None:
    pick = await agent.call("pick", object="red_block")
    taken = list((await agent.where("green_block"))[:2])
    await agent.refused("place", "PLANNING_FAILED", onto="table", at=taken, after=pick["plan"])
    place = await agent.call("place", onto="tray", after=pick["plan"])
    await agent.carry_out(place["plan"], "red_block")


async def inside(agent: Agent) -> None:
    x, y, z = await agent.where("shelf")
    goal = {"position": [x, y, z]}
    await agent.refused("plan", "GOAL_IN_COLLISION", goal=goal)
    why = await agent.call("explain", goal=goal)
    if why["has_plan"] or not why["helps"]:
        raise Failed("nothing helps")
    plan = await agent.call("plan", goal={"position": [x, y, z + 0.17]})
    await agent.call("execute", plan=plan["plan"])


async def too_far(agent: Agent) -> None:
    await agent.refused("plan", "NO_IK_SOLUTION", goal={"position": [2.0, 0.0, 0.2]})
    plan = await agent.call("plan", goal={"position": [0.3, 0.0, 0.22]})
    await agent.call("execute", plan=plan["plan"])


async def around(agent: Agent) -> None:
    x, y, _ = await agent.where("post")
    near = await agent.call("plan", goal={"position": [x - 0.12, y - 0.14, 0.2]})
    far = {"position": [x - 0.12, y + 0.08, 0.2]}
    through = {"position": [x + 0.02, y, 0.2]}
    await agent.refused("move_linear", "LINE_BLOCKED", to=through, after=near["plan"])
    plan = await agent.call("plan", goal=far, after=near["plan"])
    await agent.call("execute", plan=plan["plan"])


async def two_at_once(agent: Agent) -> None:
    pick = await agent.call("pick", object="red_block")
    await agent.call("execute", plan=pick["plan"])
    await agent.refused("pick", "HOLDING", object="blue_block")
    place = await agent.call("place", onto="tray")
    await agent.call("execute", plan=place["plan"])
    await agent.move("blue_block", "shelf")


async def once(agent: Agent) -> None:
    plan = await agent.call("plan", goal={"named": "ready"})
    await agent.call("execute", plan=plan["plan"])
    await agent.refused("execute", "EXECUTED", plan=plan["plan"])


async def outdated(agent: Agent) -> None:
    early = await agent.call("pick", object="blue_block")
    await agent.move("red_block", "tray")
    await agent.refused("execute", "OUTDATED", plan=early["plan"])
    await agent.move("blue_block", "shelf")


async def careful(agent: Agent) -> None:
    await agent.call("look")
    pick = await agent.call("pick", object="green_block")
    place = await agent.call("place", onto="tray", after=pick["plan"])
    for plan in (pick["plan"], place["plan"]):
        if not (await agent.call("certify", plan=plan))["proven"]:
            raise Failed("it is not proven again")
        await agent.call("look", plan=plan)
    await agent.carry_out(place["plan"], "green_block")


TASKS: dict[str, Callable[[Agent], Awaitable[None]]] = {
    "put the red block on the tray": one_go,
    "put the green block on the shelf, looking after each step": step_by_step,
    "put the can on the tray and keep it upright": upright,
    "stack the red block on the green one": stack,
    "build a tower on the shelf": tower,
    "put all blocks on the tray": clear,
    "move the blue block 6 cm aside": aside,
    "swap the red and the blue block": swap,
    "lift the blue block higher and put it back": lift,
    "go to ready and back": there_and_back,
    "go above the green block": above,
    "take the crate, or else the red block": too_wide,
    "put the red block where the green one is, or else on the tray": occupied,
    "go into the shelf, or else above it": inside,
    "reach 2 m away, or else near": too_far,
    "go straight through the post, or else around it": around,
    "take two blocks": two_at_once,
    "do the same plan twice": once,
    "take the blue block by a plan from before": outdated,
    "look and prove again before moving": careful,
}
"""What each program shows, said as a user would ask for it."""


def run(queries: int | None = None) -> Report:
    """Every task on an arm of its own.

    Args:
        queries: Tasks, the first of them; all if None.
    """
    scene, robot = tabletop(), ps.load_robot("wxai")
    rows, transcripts = [], []
    for name in list(TASKS)[:queries]:
        row, transcript = _done(name, robot, scene)
        rows.append(row)
        transcripts.append(table(f"Transcript: {name}", (f"{len(rows)}. {name}", "answer"), transcript))
    total = {key: sum(row[key] for row in rows) for key in ("motions", "unproven", "contacts", "refused")}
    finished = sum(row["done"] == "yes" for row in rows)
    promises = (
        Promise("tasks that an agent's calls get done", f"{finished} of {len(rows)}", finished == len(rows)),
        Promise("motions that the auditor finds touching", f"0 of {total['motions']:,}", total["unproven"] == 0),
        Promise("unexpected contacts in simulation", f"{total['contacts']}", total["contacts"] == 0),
    )
    if total["unproven"]:
        measured = f"{total['unproven']} of {total['motions']:,}"
        promises = (promises[0], replace(promises[1], measured=measured), promises[2])
    return Report("mcp", tuple(rows), (table_of("Tabletop tasks as tool calls", rows), *transcripts), promises)


def _done(name: str, robot: ps.Robot, scene: ps.Scene) -> tuple[Row, list[tuple[str, str]]]:
    """A row about one task, and its transcript."""
    with closing(Watched(robot, scene)) as mover:
        session = Session(ps.PlannerService(robot, scene), mover=mover)

        async def worked() -> tuple[Agent, str]:
            async with Client(server_of(session), mode="legacy") as client:
                agent = Agent(client)
                try:
                    await TASKS[name](agent)
                except Failed as failed:
                    agent.transcript.append(("FAILED", str(failed)))
                    return agent, "no"
                return agent, "yes"

        agent, done = anyio.run(worked)
    planned = [segment for task in session.tasks for segment in task.segments]
    executed = [segment for task in mover.executed for segment in task.segments]
    touching = [segment for segment in (*planned, *executed) if _touch(robot, segment) is not None]
    row = {
        "task": name,
        "calls": len(agent.transcript),
        "refused": agent.refusals,
        "motions": len(planned),
        "executed": len(executed),
        "unproven": len(touching),
        "contacts": len(mover.unexpected),
        "done": done,
    }
    return row, agent.transcript


def _touch(robot: ps.Robot, segment: Segment) -> str | None:
    """What the auditor finds touching on a motion that is not meant to."""
    scene, folder = segment.scene or ps.Scene(), data_folder("robots") / robot.name

    def judge(pairs: tuple[tuple[str, str], ...]) -> IndependentChecker:
        return IndependentChecker(folder, tables_of(scene), gripper_width=segment.width, allowed=pairs)

    proof = segment.result.certificate
    if segment.result.path is None or proof is None or not proof.certified:
        return "no proof"
    return touch_of_plan(judge, segment.result, LOOK)
