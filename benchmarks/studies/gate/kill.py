"""A policy, and the gate's caller, ended by kill -9, and a network that is silent for a second: the arm comes to rest.

The driver is a process of its own. With each verdict it gets all rows, targets and stop, and goes on with them, one a
period, whatever becomes of the others. A verdict counts only for the period in which it was asked for. A
caller that is late waits until the arm rests, and starts again with ``reset``. The driver's time is counted in
periods, so a busy machine makes others late but does not change how the arm moves, which Coal judges afterwards.
"""

from __future__ import annotations

import os
import random
import signal
import time
from dataclasses import dataclass, replace
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from benchmarks.harness.kept import NONE, Kept
from benchmarks.harness.report import Promise, Report, Row, table_of
from benchmarks.studies.gate.driver import Driver
from benchmarks.studies.gate.judge import Judge
from benchmarks.studies.gate.worlds import World, world
from planner_service.errors import BrokenInvariant
from planner_service.gate import Tracking
from planner_service.geometry.arrays import FloatArray

__all__ = ["run"]

TURNS = 12
"""Of each kind of end."""

KINDS = ("the policy is killed", "the gate's caller is killed", "the network is silent for 1 s")

RATE = 30.0
PERIODS, EARLIEST, LATEST = 90, 5, 60
"""Of a turn, and the periods between which something ends."""

SILENT = 1.0
"""Seconds."""

PATIENCE = 120.0
"""Seconds that the driver may take to start, or for a period."""

ANSWER = 0.5
"""Seconds that the driver waits for the answer of a caller that is on time, at most; its own time stands still."""

RESTING = 1e-9
"""Radians between the setpoint and its last target: at rest."""


@dataclass(frozen=True)
class _State:
    """What the driver says each period: which it is, where the arm is, and how many rows were sent since a verdict."""

    period: int
    q: FloatArray
    sent: int
    rests: bool


def run(queries: int | None, seed: int, robot: str | None, _: Kept = NONE) -> Report:
    """Turns, in each of which an arm is driven towards an obstacle until something ends."""
    rows = list[Row]()
    turns = TURNS if queries is None else queries
    for kind in KINDS:
        found = [_turn(kind, seed, k, robot or "wxai") for k in range(turns)]
        rows.append(
            {
                "part": "kill",
                "what": kind,
                "turns": turns,
                "moving": sum(each["moving"] for each in found),
                "resting": sum(each["rests"] for each in found),
                "touching": sum(each["touch"] is not None for each in found),
                "each": found,
            }
        )
    lines = [
        {
            "what ends": row["what"],
            "turns": row["turns"],
            "arm moving then": row["moving"],
            "at rest afterwards": row["resting"],
            "touching anything": row["touching"],
        }
        for row in rows
    ]
    promises = [
        Promise(
            f"{row['what']}: the arm comes to rest and touches nothing",
            f"{row['resting']} of {row['turns']} at rest, {row['touching']} touch",
            row["resting"] == row["turns"] and not row["touching"] and row["moving"] > 0,
        )
        for row in rows
    ]
    return Report("gate", tuple(rows), (table_of("Kill -9, and silence", lines),), tuple(promises))


def _turn(kind: str, seed: int, number: int, robot: str) -> Row:
    context, draws = get_context("spawn"), random.Random(f"{seed} {kind} {number}")
    place = world(robot, seed, number)
    to_driver, from_caller = context.Pipe()
    to_caller, from_policy = context.Pipe()
    answer, told = context.Pipe()
    policy = context.Process(target=_policy, args=(from_policy, robot, seed, number), daemon=True)
    caller = context.Process(target=_caller, args=(to_driver, to_caller, robot, seed, number), daemon=True)
    policy.start()
    caller.start()
    driver = context.Process(target=_driver, args=(from_caller, told, robot, seed, number), daemon=True)
    driver.start()
    for end in (to_driver, from_caller, to_caller, from_policy, told):
        end.close()
    ends = draws.randint(EARLIEST, LATEST)
    message: Any = 0
    while isinstance(message, int):
        if not answer.poll(PATIENCE):
            raise BrokenInvariant(f"the driver said nothing for {PATIENCE:g} s")
        message = answer.recv()
        if not isinstance(message, int):
            break
        victim = (policy, caller, None)[KINDS.index(kind)]
        if message == ends and victim is not None:
            assert victim.pid is not None
            os.kill(victim.pid, signal.SIGKILL)
        answer.send(victim is None and ends <= message < ends + SILENT * RATE)
    for process in (policy, caller, driver):
        process.kill()
        process.join()
    places, rests = message
    way = np.array(places)
    moving = ends < len(way) - 1 and bool(np.abs(way[ends + 1] - way[ends]).max() > RESTING)
    return {"number": number, "ends": ends, "moving": moving, "rests": bool(rests), "touch": _touch(place, way)}


def _touch(place: World, way: FloatArray) -> str | None:
    judge: Judge = place.judge
    moved = np.abs(np.diff(way, axis=0)).max(axis=1) > 0.0
    hit = judge.walked(way[np.append(True, moved)]) if moved.any() else None
    return judge.touch(way[0]) if hit is None else hit.what


def _driver(caller: Connection, told: Connection, robot: str, seed: int, number: int) -> None:
    """Sends rows of the last verdict, one a period; tells the parent each period, and the way of the setpoint."""
    driver = _exact(world(robot, seed, number))
    rows, sent, places, connected = np.empty((0, len(driver.setpoint))), 0, [driver.setpoint], True
    caller.recv()  # it is ready
    for period in range(PERIODS):
        told.send(period)
        silent = told.recv()
        rests = bool(np.abs(driver.setpoint - driver.target).max() <= RESTING) and sent >= len(rows)
        if connected and not silent:
            try:
                while caller.poll(0.0):
                    caller.recv()  # late, and so of no account
                caller.send(_State(period, driver.setpoint, sent, rests))
                if caller.poll(ANSWER):
                    asked, answer = caller.recv()
                    if asked == period:
                        rows, sent = answer, 0
            except (EOFError, OSError):
                connected = False
        if sent < len(rows):
            driver, sent = driver.told(rows[sent]), sent + 1
        driver = driver.waited(1.0 / RATE)
        places.append(driver.setpoint)
    told.send((places, np.abs(driver.setpoint - driver.target).max() <= RESTING))
    told.recv()


def _caller(driver: Connection, policy: Connection, robot: str, seed: int, number: int) -> None:
    """Checks what the policy wants each period; starts anew at rest if it was late."""
    place = _at_rate(world(robot, seed, number))
    gate = place.gate()
    gate.reset(place.start)
    driver.send("ready")
    expected, chunk = 0, place.start[None]
    while True:
        try:
            state: _State = driver.recv()
            while driver.poll(0.0):
                state = driver.recv()
        except (EOFError, OSError):
            return
        if state.period != expected:
            if not state.rests:
                continue
            gate.reset(state.q)
        expected = state.period + 1
        try:
            policy.send(state.q)
            if policy.poll(0.1):
                chunk = policy.recv()
        except (EOFError, OSError):
            break  # no policy any more: nothing is sent, and the driver goes on with the stop
        verdict = gate.check(state.q, chunk, sent=min(state.sent, 1))
        driver.send((state.period, verdict.rows))
    while True:
        time.sleep(1.0)


def _policy(caller: Connection, robot: str, seed: int, number: int) -> None:
    """Wants to go straight to the goal, through whatever is between."""
    place = _at_rate(world(robot, seed, number))
    limits = place.service.robot.limits
    way = (place.goal - place.start) / np.abs(place.goal - place.start).max()
    speed = 0.5 * float(limits.velocity.min()) / RATE
    gone = 0.0
    while True:
        caller.recv()
        gone += speed
        caller.send(place.start + np.clip(gone + speed * np.arange(10.0), 0.0, 3.0)[:, None] * way)


def _at_rate(place: World) -> World:
    return replace(place, rate=RATE, tracking=Tracking(goal_time=0.1, error=0.002, jitter=0.002))


def _exact(place: World) -> Driver:
    return _at_rate(place).driver(place.start)
