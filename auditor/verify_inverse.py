"""Checks a proof in a file that the tool of an arm is at a pose in these configurations, and in no others.

    python -m auditor inverse.json

The joints' ranges are a box, which the steps of the proof make smaller, split, or discard. What a step takes away is
looked at here with intervals of its own: an equation of the closed loop (closed_loop.py), or a sum of several by the
mean value theorem, has no zero there. What is not discarded is where a solution is alone: with Y any matrix, J the
derivative at q and r half widths, ``q - Y F`` maps the box into itself and is a contraction if
``|Y F(q)| + |Y| errors + |I - Y J| r + |Y| (second derivatives times r r) < r``, so there is exactly one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from auditor.closed_loop import Equation, Loop, Wanted, at_boxes, equation_of, own_equations, parts_of
from auditor.intervals import Interval, cosine_and_sine, exactly, stacked, upper_norm
from auditor.schema import check_file, require
from auditor.trails import chain, digest, frame, unpacked

__all__ = ["FORMAT", "verify"]

Array = Any
Json = Any

FORMAT = "planner-service/inverse"
MOST_STEPS, MOST_SOLUTIONS, MOST_JOINTS = 400_000, 4096, 7
LEAST = 1e-11  # metres and radians within which two poses are one
TURN, TURN_ROUNDING = 2.0 * math.pi, 1e-14
LIMIT = 1e-9  # by which values within the limits may exceed them
CUT, SUM_CUT, NONE, NONE_OF, SUM_NONE, KNOWN, TURNED, SPLIT, MARKED = range(9)


def verify(document: Json) -> Iterator[str]:
    """What a file of a proof shows, line by line; Invalid if that is not all that it claims."""
    check_file(document)
    require(document["version"] == 1, "a file of another version")
    robot, n = document["robot"], len(document["joints"])
    parents = [body["parent"] for body in robot["bodies"]]
    require(all(0 <= parent < k for k, parent in enumerate(parents) if k), "bodies before what carries them")
    links = list(reversed(chain(robot["bodies"], robot["tool_body"])))
    columns = sorted({robot["bodies"][index]["q_index"] for index in links})
    require([robot["joint_names"][k] for k in columns] == document["joints"], "other joints than move the tool")
    require(0 < n <= MOST_JOINTS and len(links) <= 16, "more joints than are read")
    wanted = _wanted(document["goal"])
    domain, points = unpacked(document["domain"], "<f8", n), unpacked(document["points"], "<f8", 3)
    require(domain.shape == (2, n) and points.shape == (len(links), 3), "a domain or points of another arm")
    loop = Loop(robot, columns, links, points, domain)
    rows = {"pose": 6, "axis": 5, "position": 3}[wanted.kind]
    lower, upper = (np.array(robot["limits"][key], float)[columns] for key in ("lower", "upper"))
    require(len(lower) == n and np.all(lower <= upper) and np.abs(domain).max() <= 300.0, "limits that are none")
    endless = np.array(robot.get("continuous") or [False] * len(robot["joint_names"]))[columns]
    rounds = (domain[1] - domain[0] >= np.nextafter(TURN, 7.0)) & _go_round(loop)
    covered = rounds | (~endless & (domain[0] <= lower) & (domain[1] >= upper))
    require(covered, "values within the limits that were not searched")
    found = unpacked(document["found"], "<f8", 5 * n).reshape(-1, 5, n)
    require(len(found) <= MOST_SOLUTIONS, "too many solutions")
    require(not len(found) or n <= rows, "solutions of an arm with infinitely many")
    slides = [entry for entry, sliding in zip(loop.entry, loop.slides, strict=True) if sliding]
    beyond = np.maximum(domain[0] - found[:, 3], found[:, 4] - domain[1])[:, slides]
    require(beyond <= 0.1, "a box in which a joint slides farther than was reckoned with")
    for one in found:
        _alone(loop, wanted, one, rows)
    _nothing_else(loop, wanted, document, domain, found)
    listed = [np.array(document[key], float).reshape(-1, n) for key in ("q", "lower", "upper")]
    _all_listed(found, np.stack(listed, axis=1), _at_goal(loop, wanted, listed[0]), (lower, upper), rounds, endless)
    yield f"robot {digest(robot)}"
    what = {"pose": "a pose", "axis": "a pose with a free axis", "position": "a place"}[wanted.kind]
    at = np.array2string(wanted.pose[:3, 3], precision=6)
    yield f"{len(found)} solutions alone in their boxes, nothing in what is left of the ranges of {n} joints"
    count = len(listed[0])
    how = f"in {count} configurations within the limits, and in no others" if count else "in no configuration"
    yield f"the tool reaches {what} at {at} {how}"


def _wanted(goal: Json) -> Wanted:
    room = goal["room"] or {"position_tolerance": 0.0, "orientation_tolerance": 0.0, "free_axis": None}
    shift, turn = room["position_tolerance"], room["orientation_tolerance"]
    require(1 <= room.get("candidates", 1) <= 1000, "candidates that no goal has")
    require(0.0 <= shift <= 1.0 and 0.0 <= turn <= math.pi, "a tolerance that no goal has")
    require(abs(float(np.linalg.norm(goal["pose"]["quaternion_wxyz"])) - 1.0) <= 1e-3, "a quaternion that is no unit")
    axis = None if room["free_axis"] is None else np.array(room["free_axis"], float)
    require(axis is None or abs(float(axis @ axis) - 1.0) < 1e-9, "an axis that is no unit vector")
    kind = "position" if turn >= math.pi else "pose" if axis is None else "axis"
    return Wanted(kind, frame(goal["pose"]), max(shift, LEAST), max(turn, LEAST), axis)


def _go_round(loop: Loop) -> Array:
    """Which entries of q only turn, once for each turn."""
    out = np.ones(loop.n, dtype=bool)
    for slides, entry, by in zip(loop.slides, loop.entry, loop.by, strict=True):
        out[entry] &= not slides and abs(by) == 1.0
    return out


def _alone(loop: Loop, wanted: Wanted, one: Array, rows: int) -> None:
    """Raise Invalid unless exactly one solution is in a box, and in the larger box where it is alone."""
    q, inner, outer = one[0], one[1:3], one[3:5]
    value, slope, agreement, errors = own_equations(loop, wanted, q[None])
    value, J = value[0], slope[0]
    middle = (J.low + J.high) / 2.0
    try:
        Y = np.linalg.pinv(middle)
    except np.linalg.LinAlgError:
        Y = np.zeros(middle.T.shape)
    moved = [(exactly(Y[v]) * value).total().size for v in range(loop.n)]
    away = Interval(np.eye(loop.n), np.eye(loop.n)) - stacked(
        [stacked([(exactly(Y[v]) * J[:, w]).total() for w in range(loop.n)]) for v in range(loop.n)], 0
    )
    shifts, turns = (np.sqrt((part**2).sum(axis=1)) * (1 + 1e-12) for part in (Y[:, :3], Y[:, 3:]))
    if loop.n < rows:  # at most one for each pose, and at q the tool is at the goal
        off = np.sqrt((value.size[:3] ** 2).sum()), np.sqrt((value.size[3:] ** 2).sum())
        model = LEAST * (1.0 + loop.longest)
        require(off[0] <= errors[0] + model and off[1] <= wanted.turn + model, "a tool that is elsewhere")
    turn_error = wanted.turn if rows > 3 else 0.0
    bends = loop.bends(wanted)
    for low, high in (inner, outer):
        r = np.minimum(high - q, q - low) * (1.0 - 1e-12)
        require(r > 0.0, "a solution outside of its box")
        curved = [float(r @ table @ r) for table in bends]
        sides = np.array(moved) + shifts * (errors[0] + curved[0]) + turns * (turn_error + curved[1]) + away.size @ r
        require(sides * (1.0 + 1e-9) < r, "a solution that is not proven to be alone")
    widest = np.maximum(inner[1] - q, q - inner[0])
    require(agreement.low[0] - 2.0 * float(loop.turns() @ widest) > 0.0, "a tool that is half a turn away")
    require(inner[0] >= outer[0], "a box beyond where the solution is alone")
    require(inner[1] <= outer[1], "a box beyond where the solution is alone")


def _at_goal(loop: Loop, wanted: Wanted, Q: Array) -> Array:
    """At which configurations (k, n) the tool is within the tolerances of the goal, turned by less than 90 degrees."""
    value, _, agreement, _ = own_equations(loop, wanted, Q)
    off, turned = (np.sqrt((part**2).sum(axis=1)) for part in (value.size[:, :3], value.size[:, 3:]))
    angle, model = np.arcsin(np.minimum(turned, 1.0)), LEAST * (1.0 + loop.longest)
    far = float(upper_norm(loop.end(wanted) - loop.tool[:3, 3])) if wanted.kind == "pose" else 0.0
    near = (off + far * turned <= wanted.shift + model) & ((agreement.low > 1.0) | (wanted.kind == "position"))
    return np.asarray(near & ((angle <= wanted.turn + model) | (wanted.kind == "position")))


def _all_listed(
    found: Array, listed: Array, at_goal: Array, limits: tuple[Array, Array], rounds: Array, endless: Array
) -> None:
    """Raise Invalid unless the listed solutions are those found, at each whole turn within the limits.

    A box that exceeds a limit by more than rounding does may only be listed with a configuration within the limits
    whose tool is at the goal.
    """
    lower, upper = limits
    middle = (lower + upper) / 2.0
    low = np.where(endless, middle - math.pi, lower)
    high = np.where(endless, middle + math.pi, upper)
    free = [True] * len(listed)
    for k, one in enumerate(found):
        if any(_within(one[1:3], other, rounds) for other in found[:k]):
            continue
        first = np.where(endless, np.round((middle - one[0]) / TURN), np.ceil((low - one[2]) / TURN - 1e-9))
        last = np.where(endless, first, np.floor((high - one[1]) / TURN + 1e-9))
        ranges = [np.arange(a, b + 1) if r else np.zeros(1) for r, a, b in zip(rounds, first, last, strict=True)]
        require(math.prod(map(len, ranges)) <= MOST_SOLUTIONS, "too many whole turns")
        for turns in np.stack(np.meshgrid(*ranges, indexing="ij"), -1).reshape(-1, len(low)):
            slack = np.where(turns != 0.0, TURN_ROUNDING, 0.0)
            box = one[1:3] + TURN * turns + np.stack([-slack, slack])
            inside = endless | ((low - LIMIT <= box[0]) & (box[1] <= high + LIMIT))
            outside = ~endless & ((box[1] < low) | (box[0] > high))
            if np.any(outside):
                continue
            loose = one[3:5] + TURN * turns - np.stack([-slack, slack])
            same = [
                j
                for j, (q, a, b) in enumerate(listed)
                if free[j]
                and np.all(a <= box[0])
                and np.all(box[1] <= b)
                and np.all(loose[0] <= a)
                and np.all(b <= loose[1])
                and np.all(a <= q)
                and np.all(q <= b)
            ]
            if not np.all(inside):
                q = listed[:, 0]
                within = at_goal & np.all(endless | ((lower <= q) & (q <= upper)), axis=1)
                same = [j for j in same if within[j]]
            require(len(same) > 0, "a solution that is not listed")
            free[same[0]] = False
    require(not any(free), "a configuration that is no solution, or stands twice")


def _within(box: Array, other: Array, rounds: Array) -> bool:
    """Whether a box is where another solution is alone, up to whole turns."""
    moved = box - np.where(rounds, TURN * np.round(((box[0] + box[1]) / 2 - other[0]) / TURN), 0.0)
    return bool(np.all(other[3] + TURN_ROUNDING <= moved[0]) and np.all(moved[1] <= other[4] - TURN_ROUNDING))


def _nothing_else(loop: Loop, wanted: Wanted, document: Json, domain: Array, found: Array) -> None:
    """Raise Invalid unless the steps of the proof leave nothing of the domain but where solutions are alone."""
    steps, sums = unpacked(document["steps"], "<f8", 6), unpacked(document["sums"], "<f8", 14).reshape(-1, 7, 2)
    rows, followed = unpacked(document["equations"], "<f8", 6), unpacked(document["followed"], "<f8", 5)
    require(len(steps) <= MOST_STEPS and len(rows) <= 64 and len(followed) <= 8, "more steps than are read")
    alone: list[tuple[int, int, float, float, Array]] = []  # equation, joint of the chain, from, to, box
    summed: list[tuple[int, int, float, float, Array]] = []  # sum, entry of q, from, to, box
    turned: list[Array] = []
    stack, box, marked = [domain.copy()], None, None
    for kind, a, b, low, high, c in steps.tolist():
        if box is None:
            require(len(stack) > 0, "steps of no box")
            box = stack.pop()
        step, first, second = int(kind), int(a), int(b)
        if step in (CUT, SUM_CUT):
            j = loop.entry[_index(second, loop.m)] if step == CUT else _index(second, loop.n)
            require(box[0, j] <= low <= high <= box[1, j], "a cut beyond the box")
            taken = ((box[0, j], low), (high, box[1, j]))
            (alone if step == CUT else summed).extend(
                (first, second, s, t, box.copy() if step == CUT else marked) for s, t in taken if s < t
            )
            box[:, j] = low, high
        elif step == MARKED:
            marked = box.copy()
        elif step == SPLIT:
            j = _index(second, loop.n)
            require(box[0, j] <= low <= high <= box[1, j], "a split beyond the box")
            if low < high:
                require(loop.entry[_index(int(c), loop.m)] == j, "a hole of another joint")
                alone.append((first, int(c), low, high, box.copy()))
            one, other = box.copy(), box.copy()
            one[1, j], other[0, j] = low, high
            stack += [other, one]
            box = None
        else:
            if step == NONE:
                alone.append((first, -1, 0.0, 0.0, box))
            elif step == NONE_OF:
                j = loop.entry[_index(second, loop.m)]
                alone.append((first, second, box[0, j], box[1, j], box))
            elif step == SUM_NONE:
                j = _index(second, loop.n) if second >= 0 else -1
                summed.append((first, j, *((box[0, j], box[1, j]) if j >= 0 else (0.0, 0.0)), marked))
            elif step == KNOWN:
                where = found[_index(first, len(found))]
                require(np.all(where[3] <= box[0]) and np.all(box[1] <= where[4]), "a box beyond a solution's")
            else:
                require(step == TURNED, "no such step")
                turned.append(box)
            box = None
    require(box is None and not stack, "boxes that are left")
    used = {row[0] for row in alone} | {int(e) for row in summed for e in sums[_index(row[0], len(sums)), :, 0]}
    equations = {e: equation_of(loop, wanted, followed, rows[e]) for e in used if 0 <= e < len(rows)}
    for e in {row[0] for row in alone}:
        require(e in equations, "no such equation")
        mine = [row for row in alone if row[0] == e]
        require(_free_of_zeros(loop, equations[e], mine), "an equation that may have a zero in what is taken away")
    if summed:
        require(_sums_free(loop, wanted, equations, len(rows), sums, summed), "a sum that may have a zero")
    if turned:
        boxes = np.stack(turned)
        middle = (boxes[:, 0] + boxes[:, 1]) / 2
        half = np.maximum(boxes[:, 1] - middle, middle - boxes[:, 0]) * (1 + 1e-12)
        _, _, agreement, _ = own_equations(loop, wanted, middle)
        least = 1.0 + 2.0 * math.cos(min(wanted.turn, math.pi)) - 1e-9
        require(agreement.high + 2.0 * (half @ loop.turns()) < least, "a tool that may not be turned away")


def _index(k: int, count: int) -> int:
    require(0 <= k < count, "a number of nothing")
    return k


def _free_of_zeros(loop: Loop, equation: Equation, rows: list[tuple[int, int, float, float, Array]]) -> bool:
    """Whether an equation has no zero in boxes where a joint of the chain is from one value to another."""
    good = True
    for joint in {row[1] for row in rows}:
        mine = [row for row in rows if row[1] == joint]
        boxes = np.stack([row[4] for row in mine])
        numbers = at_boxes(loop, boxes[:, 0], boxes[:, 1])
        values, parts = zip(*(parts_of(side, numbers, len(mine)) for side in equation.sides), strict=True)
        if joint < 0:
            whole = values[0] + values[1]
        else:
            side = 0 if joint in equation.sides[0].joints else 1
            require(joint in equation.sides[side].joints, "an equation without the joint")
            part = parts[side][equation.sides[side].joints.index(joint)]
            rest = part[:, 0] + values[1 - side]
            x = Interval(np.array([row[2] for row in mine]), np.array([row[3] for row in mine])) * loop.by[joint]
            x = Interval(np.minimum(x.low, x.high), np.maximum(x.low, x.high))
            if loop.slides[joint]:
                whole = part[:, 1] * x + rest
            else:  # a cos x + b sin x, turned so that b is nearly 0
                a, b = ((part[:, k].low + part[:, k].high) / 2 for k in (1, 2))
                c, s = cosine_and_sine(exactly(way := np.arctan2(b, a)))
                near, far = cosine_and_sine(x - exactly(way))
                whole = (a * c + b * s) * near + (b * c - a * s) * far + rest
                around, across = cosine_and_sine(x)
                whole = whole + (part[:, 1] - a) * around + (part[:, 2] - b) * across
        good &= bool(np.all(whole.widened(equation.slack).without_zero()))
    return good


def _sums_free(
    loop: Loop, wanted: Wanted, equations: dict[int, Equation], count: int, sums: Array, rows: list[Any]
) -> bool:
    """Whether sums of equations have no zero in boxes where an entry of q is from one value to another."""
    require(all(row[4] is not None for row in rows), "a sum without a box")
    boxes = np.stack([row[4] for row in rows])
    middle = (boxes[:, 0] + boxes[:, 1]) / 2.0
    half = np.maximum(boxes[:, 1] - middle, middle - boxes[:, 0]) * (1.0 + 1e-12)
    k, n = middle.shape
    own, slopes, _, errors = own_equations(loop, wanted, middle)
    bends, turns = loop.bends(wanted)
    value, rates = exactly(np.zeros(k)), exactly(np.zeros((k, n)))
    numbers, points = at_boxes(loop, boxes[:, 0], boxes[:, 1]), at_boxes(loop, middle, middle)
    chosen = sums[[row[0] for row in rows]]
    for e in np.unique(chosen[:, :, 0]).astype(int).tolist():
        factor = np.where(chosen[:, :, 0] == e, chosen[:, :, 1], 0.0)
        require((np.count_nonzero(factor, axis=1) <= 1), "an equation that stands twice")
        weight = factor.sum(axis=1)
        if e == -1:
            require(weight == 0.0, "no equation")
        elif e >= count:
            row = _index(e - count, own.low.shape[1])
            bend = half @ (bends if row < 3 else turns) * (1.0 + 1e-12)
            value = value + own[:, row].widened(errors[row]) * weight
            rates = rates + slopes[:, row].widened(bend) * weight[:, None]
        else:
            require(e in equations, "no such equation")
            at, over = _of_equation(loop, equations[e], numbers, points, k)
            value = value + at.widened(equations[e].slack) * weight
            rates = rates + over * weight[:, None]
    spans = Interval(-half, half)
    for i, row in enumerate(rows):
        if row[1] >= 0:
            spans.low[i, row[1]], spans.high[i, row[1]] = row[2] - middle[i, row[1]], row[3] - middle[i, row[1]]
    spans = Interval(np.nextafter(spans.low, -np.inf), np.nextafter(spans.high, np.inf))
    return bool(np.all((value + (rates * spans).total()).without_zero()))


def _of_equation(loop: Loop, equation: Equation, numbers: Any, points: Any, count: int) -> tuple[Interval, Interval]:
    """Values in the middles (k,), derivatives over boxes (k, n)."""
    value, rates = exactly(np.zeros(count)), [exactly(np.zeros(count))] * loop.n
    for side in equation.sides:
        value = value + parts_of(side, points, count)[0]
        _, parts = parts_of(side, numbers, count)
        for joint, part in zip(side.joints, parts, strict=True):
            c, s = numbers[joint]
            rate = part[:, 1] if loop.slides[joint] else part[:, 2] * c - part[:, 1] * s
            entry = loop.entry[joint]
            rates = [x + rate * loop.by[joint] if j == entry else x for j, x in enumerate(rates)]
    return value, stacked(rates)
