"""The data card: the README.md of a data set."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from planner_service.datasets.summary import EpisodesSummary

__all__ = ["card"]

TEXT = """\
---
tags:
- LeRobot
- robotics
task_categories:
- robotics
configs:
- config_name: default
  data_files: data/*/*.parquet
---
# {episodes:,} episodes of {task}: {sentence}

Every motion here was planned by planner-service in a world drawn at random, and proven free of collisions as a whole
curve, between samples too, before it was timed. Nobody moved a robot for it: these are plans, not recordings, without
sensor noise, tracking errors or pictures.

| | |
|---|---|
| requests (worlds drawn) | {requests:,} |
| episodes | {episodes:,} |
| frames, at {fps} per second | {frames:,} |
| motions, of these proven | {motions:,}, {certified:,} |
| seconds of motion | {motion_seconds:,.1f} |
| collision checks of all requests | {states:,} states, {edges:,} edges, {distances:,} distances |
| robot | {robot}, {robot_hash} |
| seed | {seed} |

## Requests without an episode
{failures}

## How it was made
Request k is drawn from seed and k alone, so it is the same in any data set of that seed. Its planner got a seed of its
own and as many checks as each plan may take; no clock had a say. Settings and the releases of the libraries, all that
decides a byte of these files but the number of requests, are in `meta/generation.json`. (On processors without FMA,
from before 2013, the C library's sines differ, and with them the last bits of angles. And a request that ended two
workers, for want of memory say, is a failure WORKER_LOST above, though it may have an episode on another machine.)

```json
{generation}
```

Worlds: see `planner_service/datasets/bin_task.py` for the ranges of `pick-place`. Nothing touches anything in them, and
the start keeps 1 cm from everything; whether the task can be done is left open, and is the failures above.

An episode begins at the first motion with the gripper as open as that needs. The gripper opens and closes at
{gripper_speed} m/s while the robot stands still, after the time that the robot rings after a stop. The object moves
with the tool on {carrying}, as if glued; it does not slip or fall.

## Files
`data/` and `meta/` are laid out as LeRobot v2.1 does it, with one file for each episode, so that each is there whole
or not at all (v3.0 puts many into one; `lerobot` converts). Beside them, in `tables/`, folders of Parquet files that a
reader takes as one table each:

| table | a row for | what of it |
|---|---|---|
| requests | every request | its episode if there is one, seed of the planner, start, what was checked in all |
| episodes | every episode | its request, number of frames, statistics |
| scenes | every obstacle | shape, sizes (full lengths of a box; radius, length of a cylinder), pose in the base frame |
| motions | every motion of an episode | when it begins, the gripper, and the exact curve |
| counts | every stage of every motion | states, edges, distances; motion -1 is the choice of grasps and places |
| certificates | every motion | what was proven, its smallest clearance, and where named pairs were meant to touch |
| failures | every request without an episode | stage, reason, detail, and how many motions had a plan |

Columns of the frames:

| column | type | |
|---|---|---|
{columns}

Frames are float32, as LeRobot's are and policies take them: right to 2e-7 rad, which moves no point of the robot by
0.2 micrometres. The float64 curves are in `motions`: q(t) is the polyline `waypoints` with rounded corners (`blends`)
at s(t), cubic polynomials `coefficients` for `durations` seconds each; `Trajectory(JointPath(waypoints, blends),
durations, coefficients, dilation)` gives them back bit for bit. The action of a frame is the state of the next; of the
last frame, at which all is at rest, its own state. Lengths in metres, angles in radians, quaternions w, x, y, z.

`meta/journal.jsonl`, where it is there, has the rows of the last, unfinished files of the tables: with it the data set
can be continued, by the same command with a larger count.

## Limits
One robot, one task, one kind of gripper; no pictures; a motion is what this planner finds, not the best there is. The
statistics of `meta/episodes_stats.jsonl` are of all frames. A proof is of the shapes in the robot's model and in
`scenes`, not of the world.

## Licence
The generator claims no rights in what it writes; whoever publishes it chooses a licence and names it here. The robot's
description has a licence of its own.
"""


def card(about: Mapping[str, Any], info: Mapping[str, Any], carrying: Sequence[str], summary: EpisodesSummary) -> str:
    """The text of the card; it depends only on the content of the data set."""
    rows = [f"| {reason} | {number:,} |" for reason, number in summary.failures.items()]
    failures = "\n".join(["| reason | requests |", "|---|---|", *rows]) if rows else "None: every request has one."
    columns = "\n".join(
        f"| `{name}` | {feature['dtype']}, {feature['shape'][0]} | {', '.join(feature['names'] or ())} |"
        for name, feature in info["features"].items()
    )
    words = {"failures": failures, "columns": columns, "generation": json.dumps(about, indent=1)}
    words["carrying"] = " and ".join(carrying)
    return TEXT.format(**{**about, **asdict(summary), **words})
