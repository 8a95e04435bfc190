"""Motions as programs in the languages of robot controllers: URScript, RAPID (ABB), KRL (KUKA) and LS (Fanuc).

A program of joint moves stops at points of the proven curve, so close together that the straight moves between them
stay within a tolerance of it. One of ``servoj`` sends points in time. No program moves to where the motion begins: it
checks that the arm stands there, or asks. Where the gripper's width changes it waits for an operator, in one
routine that is to be replaced by the gripper's own.

Angles are those of the description file. Its zeros and signs have to be the controller's. On Fanuc's, J3 is counted
from the horizontal, which is q3 - q2.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import count, pairwise

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.validation import number
from planner_service.path.trajectory import Samples, Trajectory
from planner_service.planning.task_result import Segment
from planner_service.records.exports.trajectory_export import on_one_clock
from planner_service.robot.model import Robot

__all__ = ["AT_START", "AXES", "PROGRAMS", "even_samples", "points_within", "program_text"]

AXES = 6
"""Joints of an arm that these programs move."""

AT_START = 0.002
"""Radians by which a joint may be away from where a program begins."""

MIN_TOLERANCE, MAX_TOLERANCE = 1e-6, 0.1
"""Radians between the curve and the moves of a program."""

MAX_POINTS = 100_000
"""Of a program."""

SPEED = 20
"""Percent of the axes' speed at which joint moves run."""

DEGREES_AT_START = f"{math.degrees(AT_START):.4f}"

NUMBER = "\0"
"""Where a line of LS has its number."""

LS_REMARK = 60
"""Characters of a remark in LS."""


def points_within(trajectory: Trajectory, tolerance: float) -> FloatArray:
    """Points of a curve whose polyline is nowhere further than ``tolerance`` from it in any joint, shape (m, n).

    Lemma: on a piece where a joint's second derivative by s is at most A, a chord of length h in s is at most A h^2 / 8
    from the curve. On a straight piece A is 0, on a blend it is largest in the middle (``corner_blend``).
    """
    path = trajectory.path
    inner = path.breaks[(path.breaks > trajectory.begin) & (path.breaks < trajectory.end)]
    ends = np.concatenate(([trajectory.begin], inner, [trajectory.end]))
    pieces = path.pieces_at((ends[1:] + ends[:-1]) / 2.0)
    bent = np.abs(path((path.breaks[pieces] + path.breaks[pieces + 1]) / 2.0, 2)).max(axis=1)
    counts = np.maximum(1, np.ceil(np.diff(ends) * np.sqrt(bent / (8.0 * tolerance)))).astype(int)
    parts = [np.linspace(low, high, k + 1)[1:] for (low, high), k in zip(pairwise(ends), counts.tolist(), strict=True)]
    return path(np.concatenate([ends[:1], *parts]))


def even_samples(trajectory: Trajectory, dt: float) -> Samples:
    """Samples at equal distances of at most ``dt`` seconds, the exact end included.

    Sent every ``dt`` seconds they are the same curve, driven slower by less than one step in all.
    """
    steps = len(trajectory.sample(dt).t) - 1
    return trajectory.sample(trajectory.duration / steps) if steps > 0 else trajectory.sample(dt)


@dataclass(frozen=True)
class _Language:
    """How programs of a kind are written.

    Attributes:
        remark: The line of a remark.
        head: The lines before the first motion, from remarks and where the motion begins.
        move: The line that moves to a point, from its values and its number, from 1.
        gripper: The lines that set the gripper to so many metres.
        pause: The line that waits for so many seconds.
        end: The lines after the last motion, from all points.
        degrees: Whether joints are in degrees.
        streams: Whether points are sent in time.
    """

    remark: Callable[[str], str]
    head: Callable[[Sequence[str], FloatArray], list[str]]
    move: Callable[[FloatArray, int], str]
    gripper: Callable[[float], list[str]]
    pause: Callable[[float], str]
    end: Callable[[FloatArray], list[str]]
    degrees: bool = True
    streams: bool = False


def program_text(
    form: str, segments: Sequence[Segment], robot: Robot, *, dt: float = 0.01, tolerance: float = 1e-4
) -> str:
    """A program of motions one after another.

    Args:
        form: One of ``PROGRAMS``.
        dt: Seconds between the points of ``servoj``, a multiple of the controller's own step.
        tolerance: Radians between the proven curve and joint moves.

    Raises:
        InvalidRequest: The robot does not have six revolute joints, ``tolerance`` is not from 1e-6 to 0.1, the program
            would have more than 100,000 points, or as of ``task_csv_text``.
        PlanningFailed: A motion without a plan.
    """
    number("tolerance", tolerance, f"radians in [{MIN_TOLERANCE:g}, {MAX_TOLERANCE:g}]", MIN_TOLERANCE, MAX_TOLERANCE)
    if robot.n != AXES or any(robot.sliding):
        what = "some of which slide" if any(robot.sliding) else "all revolute"
        given = f"{robot.name}: {robot.n} joints, {what}"
        raise InvalidRequest("robot", given, f"an arm of {AXES} revolute joints with --format {form}")
    language = _languages(dt)[form]
    lines: list[str] = []
    points: list[FloatArray] = []
    width = math.nan
    for segment, _ in on_one_clock(segments):
        trajectory = segment.result.unwrap()[1]
        q = even_samples(trajectory, dt).q if language.streams else points_within(trajectory, tolerance)
        q = np.degrees(q) if language.degrees else q
        lines.append(language.remark(_plain(segment.name)))
        if segment.width > 0.0 and segment.width != width:
            lines += language.gripper(segment.width)
            width = segment.width
        lines += [language.pause(segment.wait)] if segment.wait > 0.0 else []
        first = sum(map(len, points))
        if first + len(q) > MAX_POINTS:
            raise InvalidRequest("points", first + len(q), f"at most {MAX_POINTS:,}: a larger dt or tolerance")
        lines += [language.move(row, number) for number, row in enumerate(q[1:], first + 2)]
        points.append(q)
    whole = np.concatenate(points)
    remarks = [
        f"Motions of {_plain(robot.name)}, proven along their curves",
        f"Points are sent every {dt:g} s."
        if language.streams
        else f"Moves stay within {tolerance:g} rad of the curves.",
    ]
    written = [*language.head(remarks, whole[0]), *lines, *language.end(whole)]
    return "\n".join([*_numbered(written), ""])


def _plain(value: str) -> str:
    """Text that ends no comment and no string."""
    return "".join(c if c.isascii() and (c.isalnum() or c in " _-+>.,()") else "_" for c in value)[:60]


def _numbers(values: FloatArray) -> list[str]:
    return [f"{value:.9f}" for value in (values + 0.0).tolist()]


def _numbered(lines: Sequence[str]) -> list[str]:
    """Lines, with the numbers that LS wants where a line has a place for one."""
    number = count(1)
    return [line.replace(NUMBER, f"{next(number):4}", 1) if line.startswith(NUMBER) else line for line in lines]


# URScript: radians.


def _ur_head(remarks: Sequence[str], start: FloatArray) -> list[str]:
    away = " or ".join(f"norm(now[{k}] - ({value})) > {AT_START:g}" for k, value in enumerate(_numbers(start)))
    return [
        "def planned_motion():",
        *(f"  # {remark}" for remark in remarks),
        "  def set_gripper(metres):",
        '    popup(str_cat("Set the gripper to this width in metres: ", metres), blocking=True)',
        "  end",
        "  local now = get_actual_joint_positions()",
        f"  if {away}:",
        '    popup("The arm does not stand where the motion begins.", error=True, blocking=True)',
        "    halt",
        "  end",
    ]


def _ur_list(q: FloatArray) -> str:
    return f"[{', '.join(_numbers(q))}]"


def _ur_move(q: FloatArray, _: int) -> str:
    return f"  movej({_ur_list(q)}, a=1.4, v=0.5, r=0)"


def _ur_gripper(width: float) -> list[str]:
    return [f"  set_gripper({width:.6f})"]


# RAPID: degrees, in joint targets.


def _rapid_head(remarks: Sequence[str], start: FloatArray) -> list[str]:
    away = [
        f"    IF Abs(now.robax.rax_{k} - ({value})) > {DEGREES_AT_START} stop_elsewhere;"
        for k, value in enumerate(_numbers(start), 1)
    ]
    return [
        "MODULE PlannedMotion",
        *(f"  ! {remark}" for remark in remarks),
        "  PROC stop_elsewhere()",
        '    TPWrite "The arm does not stand where the motion begins.";',
        "    EXIT;",
        "  ENDPROC",
        "  PROC set_gripper(num metres)",
        '    TPWrite "Set the gripper to this width in metres: " \\Num:=metres;',
        "    Stop;",
        "  ENDPROC",
        "  PROC main()",
        "    VAR jointtarget now;",
        "    now := CJointT();",
        *away,
    ]


def _rapid_move(q: FloatArray, _: int) -> str:
    return f"    MoveAbsJ [[{', '.join(_numbers(q))}], [9E9, 9E9, 9E9, 9E9, 9E9, 9E9]] \\NoEOffs, v200, fine, tool0;"


# KRL: degrees, in axis aggregates.


def _krl_head(remarks: Sequence[str], start: FloatArray) -> list[str]:
    away = [
        f"  IF ABS($AXIS_ACT.A{k} - ({value})) > {DEGREES_AT_START} THEN\n    HALT\n  ENDIF"
        for k, value in enumerate(_numbers(start), 1)
    ]
    speeds = [f"  $VEL_AXIS[{k}] = {SPEED}\n  $ACC_AXIS[{k}] = {SPEED}" for k in range(1, AXES + 1)]
    return ["DEF planned_motion()", *(f"  ; {remark}" for remark in remarks), *speeds, *away]


def _krl_move(q: FloatArray, _: int) -> str:
    return f"  PTP {{{', '.join(f'A{k} {value}' for k, value in enumerate(_numbers(q), 1))}}}"


# LS: degrees, in a table of positions at the end.


def _ls_head(remarks: Sequence[str], _: FloatArray) -> list[str]:
    return [
        "/PROG  PLANNED",
        "/ATTR",
        'COMMENT = "planner_service";',
        "DEFAULT_GROUP = 1,*,*,*,*;",
        "/MN",
        *map(_ls_remark, remarks),
        _ls_remark("The arm has to stand at P[1]"),
        f"{NUMBER}:  PAUSE ;",
    ]


def _ls_move(_: FloatArray, number: int) -> str:
    return f"{NUMBER}:J P[{number}] {SPEED}% FINE ;"


def _ls_end(points: FloatArray) -> list[str]:
    lines = ["/POS"]
    for place, q in enumerate(points, 1):
        counted = q.copy()
        counted[2] -= counted[1]
        joints = [f"J{k}= {value} deg" for k, value in enumerate(_numbers(counted), 1)]
        lines += [f"P[{place}]{{", "   GP1:", "\tUF : 0, UT : 1,", "\t" + ",\t".join(joints), "};"]
    return [*lines, "/END"]


def _ls_remark(text: str) -> str:
    return f"{NUMBER}:  !{text[:LS_REMARK]} ;"


def _languages(dt: float) -> dict[str, _Language]:
    """How programs are written, by format."""
    movej = _Language(
        "  # {}".format,
        _ur_head,
        _ur_move,
        _ur_gripper,
        "  sleep({:.3f})".format,
        lambda _: ["end"],
        degrees=False,
    )
    send = f"t={dt:g}, lookahead_time=0.03, gain=300"
    return {
        "urscript": movej,
        "urscript-servoj": replace(movej, move=lambda q, _: f"  servoj({_ur_list(q)}, {send})", streams=True),
        "rapid": _Language(
            "    ! {}".format,
            _rapid_head,
            _rapid_move,
            lambda width: [f"    set_gripper {width:.6f};"],
            "    WaitTime {:.3f};".format,
            lambda _: ["  ENDPROC", "ENDMODULE"],
        ),
        "krl": _Language(
            "  ; {}".format,
            _krl_head,
            _krl_move,
            lambda width: [f"  ; set the gripper to {width:.6f} m", "  HALT"],
            "  WAIT SEC {:.3f}".format,
            lambda _: ["END"],
        ),
        "fanuc-ls": _Language(
            _ls_remark,
            _ls_head,
            _ls_move,
            lambda width: [_ls_remark(f"Set the gripper to {width:.6f} m"), f"{NUMBER}:  PAUSE ;"],
            lambda seconds: f"{NUMBER}:  WAIT {seconds:.2f}(sec) ;",
            _ls_end,
        ),
    }


PROGRAMS = {
    "urscript": re.compile(rb"def planned_motion\(\):\n"),
    "urscript-servoj": re.compile(rb"def planned_motion\(\):\n"),
    "rapid": re.compile(rb"MODULE PlannedMotion\n"),
    "krl": re.compile(rb"DEF planned_motion\(\)\n"),
    "fanuc-ls": re.compile(rb"/PROG  PLANNED\n"),
}
"""Their formats, and how they begin."""
