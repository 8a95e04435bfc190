"""Timing laws: how fast an arm travels along a path. All joints share one s(t), so a straight line stays straight.

A corner without a blend is a stop: passing it at speed would take infinite acceleration. Between stops the joints'
limits become limits of s(t): on straight sections ds/dt <= min v_i / abs(dq_i/ds), and likewise for acceleration and
jerk; on blends they follow from the chain rule. The limits are then verified on every result, between grid points too,
and a result that exceeds one is slowed down.

Trapezoids and TOPP-RA are compiled, too, from the path to the motion and its peaks. The Python below has the same
bits, and does what compiled code leaves to it: a caller's own speed limits, jerk, and every failure.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import accumulate
from types import MappingProxyType, ModuleType
from typing import Any, Literal, Protocol

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, cross
from planner_service.geometry.validation import flag, number, whole
from planner_service.native.loading import load_core
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import LimitPeaks, Peak, Trajectory
from planner_service.robot.kinematic_tree import chain_to_base
from planner_service.robot.model import JointLimits, Robot
from planner_service.timing.limit_check import TOLERANCE, peaks, require_limits
from planner_service.timing.profiles import Phase, Section, TimingFailed, TooFast, speed_profile, trapezoid
from planner_service.timing.runs import runs_of, split_at
from planner_service.timing.segments import PathSegment, SpeedLimit, path_segments, straight_sections
from planner_service.timing.time_optimal import constant_accelerations, grid_of, optimal_speeds, two_passes
from planner_service.timing.toppra_backend import toppra_passes
from planner_service.timing.torque_limits import TorqueLimits

__all__ = [
    "TIMINGS",
    "SCurve",
    "Timing",
    "TimingFailed",
    "ToppRa",
    "Trapezoidal",
    "effective_limits",
    "peak_tool_speed",
    "reference_stop_duration",
    "reference_time_with_peaks",
    "stop_duration",
    "time_with_peaks",
    "tool_speeds",
    "within_limits",
]

SHORT_SEGMENT = 1e-3
"""Below this length (rad) TOPP-RA is badly conditioned (it fails at 1e-6 rad, not at 1e-9): the closed form is used."""

MAX_GRIDPOINTS = 10_000

MIN_RUN_UP = 1e-6
"""Least length of a straight section between a blend and a stop, relative to the blend's length. With less, a constant
speed on the blend would take thousands of seconds.
"""

TAYLOR = np.array([1.0, 1.0, 2.0, 6.0])
"""Position, speed, acceleration and jerk divided by these are the coefficients of a cubic."""

MIN_JERK, MAX_JERK = 1e-6, 1e6
"""rad/s^3. No arm is slower, and none responds faster: at 1e9 a phase of jerk is so short that rounding is a jump."""


class Timing(Protocol):
    """A timing law; its fields are its settings."""

    @property
    def name(self) -> str:
        """Short name for tables."""

    def time_path(self, path: JointPath, limits: JointLimits, *, speed_limit: SpeedLimit | None = None) -> Trajectory:
        """The path travelled from rest to rest, stopping at its corners, within the velocity and acceleration limits.

        Args:
            speed_limit: Bounds ds/dt along the path as well. It is sampled densely, and not verified between samples.

        Raises:
            InvalidRequest: The limits have another length than the path's joints, or one is not positive and finite
                for a joint that moves (a joint that stands still may have any); a speed limit that is not positive.
            TimingFailed: The law found no solution.
        """


@dataclass(frozen=True)
class Trapezoidal:
    """Trapezoids and triangles: the fastest law for a straight line with velocity and acceleration limits.

    Jerk is unbounded. Each blend is passed at one constant speed, the largest that all joints and the neighbouring
    sections allow.
    """

    name = "trapezoidal"

    def time_path(self, path: JointPath, limits: JointLimits, *, speed_limit: SpeedLimit | None = None) -> Trajectory:
        """The path travelled from rest to rest; see ``Timing``."""
        return time_with_peaks(self, path, limits, speed_limit)[0]


@dataclass(frozen=True)
class SCurve:
    """Seven-phase S-curves: the fastest rest-to-rest law for a straight line when jerk is limited too.

    Blends are passed at constant speed, or together with what is around them as if on a line, whichever is faster.

    Args:
        jerk: One limit for all joints (rad/s^3); None takes each joint's own limit from the robot.

    Raises:
        InvalidRequest: ``jerk`` is not a number from 1e-6 to 1e6.
    """

    jerk: float | None = None

    name = "s-curve"

    def __post_init__(self) -> None:
        if self.jerk is not None:
            expected = f"a number of rad/s^3 from {MIN_JERK:g} to {MAX_JERK:g}, or None for the robot's own"
            object.__setattr__(self, "jerk", number("jerk", self.jerk, expected, MIN_JERK, MAX_JERK))

    def time_path(self, path: JointPath, limits: JointLimits, *, speed_limit: SpeedLimit | None = None) -> Trajectory:
        """The path travelled from rest to rest; see ``Timing``."""
        return time_with_peaks(self, path, limits, speed_limit)[0]


@dataclass(frozen=True)
class ToppRa:
    """TOPP-RA (Pham & Pham, IEEE T-RO 34(3), 2018): time-optimal under velocity and acceleration limits.

    Its speeds at the grid points are joined by constant accelerations, so the result stays on the path; fitting a
    spline would leave it. Limits hold at the grid points and are exceeded between them by about 0.3 % on blends, for
    which the result is slowed down. Between two stops on a straight line the optimum is the trapezoid, which is used.
    So are trapezoids where TOPP-RA fails on blends or is slower, as with blends below 1e-4 rad.

    With ``torque`` the joints' torques are kept, too, within ``TorqueLimits``: at the grid points by the same linear
    programs, and between them to ``torque_limits.EXCESS`` of each limit. Such a motion is timed in Python.

    Args:
        gridpoints: Intervals between two stops, shared by the straight sections; each blend has 24 of its own.
        backend: Who solves the linear programs: "own" (compiled, closed form) or "toppra", the library, 60 times more
            slowly. Durations agree to 1e-9.
        torque: Keep torque limits.

    Raises:
        InvalidRequest: ``gridpoints`` is not an integer from 2 to 10,000, or there is no such backend.
    """

    gridpoints: int = 50
    backend: Literal["own", "toppra"] = "own"
    torque: bool = False

    name = "toppra"

    def __post_init__(self) -> None:
        object.__setattr__(self, "gridpoints", whole("gridpoints", self.gridpoints, 2, MAX_GRIDPOINTS))
        if not isinstance(self.backend, str) or self.backend not in ("own", "toppra"):
            raise InvalidRequest("backend", self.backend, "'own' or 'toppra'")
        object.__setattr__(self, "torque", flag("torque", self.torque))

    def time_path(
        self,
        path: JointPath,
        limits: JointLimits,
        *,
        speed_limit: SpeedLimit | None = None,
        torque_limits: TorqueLimits | None = None,
    ) -> Trajectory:
        """The path travelled from rest to rest; see ``Timing``. ``torque_limits`` are those to keep with ``torque``."""
        return time_with_peaks(self, path, limits, speed_limit, torque_limits)[0]

    def continue_to_rest(
        self,
        path: JointPath,
        limits: JointLimits,
        s_start: float,
        speed: float,
        *,
        speed_limit: SpeedLimit | None = None,
        blend_share: float = 1.0,
    ) -> list[Phase]:
        """The motion along the rest of a path from a moving start to rest at its end, its limits not yet verified.

        Args:
            speed: ds/dt at ``s_start``.
            blend_share: Share of the limits that may be used on blends, where they are slightly exceeded between grid
                points.

        Raises:
            InvalidRequest: as ``time_path``.
            TimingFailed: The speed is too high to slow down in time, or there is no solution.
        """
        rows = self.rows_to_rest(path, limits, s_start, speed, speed_limit=speed_limit, blend_share=blend_share)
        return list(map(Phase._make, rows.tolist()))

    def rows_to_rest(
        self,
        path: JointPath,
        limits: JointLimits,
        s_start: float,
        speed: float,
        *,
        speed_limit: SpeedLimit | None = None,
        blend_share: float = 1.0,
    ) -> FloatArray:
        """``continue_to_rest`` as an array, a row for each phase, (m, 5)."""
        core, gridpoints = _compiled(self, path, limits, speed_limit)
        if core is not None and 0.0 <= s_start <= path.length and speed >= 0.0 and 0.0 < blend_share <= 1.0:
            rows: FloatArray | None = _unless_failed(
                core.continue_to_rest(*_question(path, limits), gridpoints, s_start, speed, blend_share)
            )
            if rows is not None:
                return rows
        phases = self.reference_continuation(path, limits, s_start, speed, speed_limit, blend_share)
        return np.array(phases).reshape(-1, 5)

    def reference_continuation(
        self,
        path: JointPath,
        limits: JointLimits,
        s_start: float,
        speed: float,
        speed_limit: SpeedLimit | None = None,
        blend_share: float = 1.0,
    ) -> list[Phase]:
        """``continue_to_rest`` in Python: the same bits."""
        require_limits(path, limits, jerk=False)
        phases: list[Phase] = []
        with _overflow_fails():
            for segment in path_segments(path, limits, speed_limit, s_start):
                phases += self.phases(replace(segment, blend_share=blend_share), 0.0 if phases else speed)
        return phases

    def phases(self, segment: PathSegment, entry: float = 0.0) -> list[Phase]:
        """The motion along a segment from the speed ``entry`` to rest."""
        sections = segment.sections(jerk=False)
        if segment.torque is not None:
            return self._within_torques(segment, segment.torque, sections)
        closed_form: list[Phase] | None = None
        if not _blend_at_stop(sections, entry):
            with suppress(TooFast):
                closed_form = speed_profile(sections, entry)
        straight = len(sections) == 1 and segment.speed_limit is None
        if closed_form is not None and (straight or segment.length < SHORT_SEGMENT):
            return closed_form
        unit = min(_seconds(phases) for phases in (closed_form, _slowest(sections)) if phases is not None)
        try:
            optimal = self._optimal(segment, sections, unit, entry)
        except TimingFailed:
            if closed_form is None:
                raise
            return closed_form
        return optimal if closed_form is None else min(optimal, closed_form, key=_seconds)

    def _optimal(self, segment: PathSegment, sections: Sequence[Section], unit: float, entry: float) -> list[Phase]:
        """The fastest motion along a segment; ``unit`` is about its duration in seconds."""
        grids = [grid_of(section, segment, self.gridpoints) for section in sections]
        passes = toppra_passes if self.backend == "toppra" else two_passes
        speeds = optimal_speeds(passes, segment, sections, grids, unit, entry)
        return constant_accelerations(sections, grids, speeds)

    def _within_torques(self, segment: PathSegment, torque: TorqueLimits, sections: Sequence[Section]) -> list[Phase]:
        """The fastest motion along a segment, from rest to rest, that keeps torque limits as well.

        On a segment too short for a grid torques hardly change: what gravity leaves of them limits the acceleration.
        """
        if segment.length >= SHORT_SEGMENT:
            return self._optimal(segment, sections, _seconds(_slowest(sections)), 0.0)
        s = segment.start + segment.length * np.array([0.0, 0.5, 1.0])
        pushed, _, held = torque.rows(*(segment.derivative(s, order) for order in range(3)))
        with np.errstate(divide="ignore", invalid="ignore"):
            most = float(np.where(pushed != 0.0, (1.0 - np.abs(held)) / np.abs(pushed), math.inf).min())
        if not most > 0.0:
            raise TimingFailed(f"torques leave no room to move at s = {segment.start:.6g}")
        speed, acceleration = (min(section.limits[k] for section in sections) for k in range(2))
        phases = trapezoid(segment.length, speed, min(acceleration, most))
        return [phase._replace(position=segment.start + phase.position) for phase in phases]


TIMINGS: Mapping[str, type[ToppRa | Trapezoidal | SCurve]] = MappingProxyType(
    {law.name: law for law in (ToppRa, Trapezoidal, SCurve)}
)
"""Every timing law that can be made from its name alone, by that name."""


def effective_limits(timing: Timing, limits: JointLimits) -> JointLimits:
    """The limits that a law keeps, given a robot's: an S-curve may have a jerk limit of its own."""
    if isinstance(timing, SCurve) and timing.jerk is not None:
        return replace(limits, jerk=np.full(len(limits.jerk), timing.jerk))
    return limits


def stop_duration(
    path: JointPath, timing: Timing, limits: JointLimits, torque_limits: TorqueLimits | None = None
) -> float:
    """Seconds that the law takes along the path without its blends, stopping at each corner.

    For TOPP-RA these are trapezoids, its optimum between stops; under torque limits it is its own motion, with limits
    that are not verified between grid points.

    Raises:
        InvalidRequest, TimingFailed: as ``Timing.time_path``.
    """
    _require_torques(timing, torque_limits)
    if isinstance(timing, ToppRa) and torque_limits is not None:
        segments = path_segments(path.with_blends(None), limits, None, torque=torque_limits)
        return _timed(path.with_blends(None), segments, timing.phases).duration
    core, _ = _compiled(timing, path, limits, None)
    if core is not None:
        tables = path.waypoints, path.knots, path.tangents, path.turns
        seconds: float | None = core.stop_duration(*tables, limits.velocity, limits.acceleration)
        if seconds is not None:
            return seconds
    return reference_stop_duration(path, timing, limits)


def reference_stop_duration(path: JointPath, timing: Timing, limits: JointLimits) -> float:
    """``stop_duration`` in Python: the same bits."""
    sharp = path.with_blends(None)
    if type(timing) not in (ToppRa, Trapezoidal, SCurve):
        return timing.time_path(sharp, limits).duration
    limits, jerk = effective_limits(timing, limits), isinstance(timing, SCurve)
    require_limits(sharp, limits, jerk=jerk)
    with _overflow_fails():
        sections = straight_sections(sharp, limits, jerk=jerk)
        phases = [phase for section in sections for phase in speed_profile([section])]
    seconds = _seconds(phases) if phases else 0.0
    if not math.isfinite(seconds):
        raise TimingFailed(f"limits too extreme to compute with ({seconds} s)")
    return seconds


def time_with_peaks(
    timing: Timing,
    path: JointPath,
    limits: JointLimits,
    speed_limit: SpeedLimit | None,
    torque_limits: TorqueLimits | None = None,
) -> tuple[Trajectory, LimitPeaks]:
    """A law's trajectory along a path, and how close it comes to the limits.

    Raises:
        InvalidRequest, TimingFailed: as ``Timing.time_path``.
        InvalidRequest: A law that keeps torque limits without them, or the reverse.
    """
    _require_torques(timing, torque_limits)
    if isinstance(timing, ToppRa) and torque_limits is not None:
        return _time_within_torques(timing, path, limits, speed_limit, torque_limits)
    core, gridpoints = _compiled(timing, path, limits, speed_limit)
    timed = None if core is None else _unless_failed(core.time_path(*_question(path, limits), gridpoints))
    if timed is None:
        return reference_time_with_peaks(timing, path, limits, speed_limit)
    motion, found = timed
    velocity, acceleration, jerk = map(Peak._make, found)
    trajectory, highest = Trajectory.checked(path, *motion), LimitPeaks(velocity, acceleration, jerk)
    return trajectory, highest if trajectory.dilation == 1.0 else highest.dilated(trajectory.dilation)


def _require_torques(timing: Timing, given: TorqueLimits | None) -> None:
    wanted = isinstance(timing, ToppRa) and timing.torque
    if wanted and given is None:
        raise InvalidRequest("torque_limits", given, "TorqueLimits, as the law keeps torques")
    if given is not None and not wanted:
        raise InvalidRequest("timing", timing, "ToppRa(torque=True): no other law keeps torque limits")


def _time_within_torques(
    timing: ToppRa, path: JointPath, limits: JointLimits, speed_limit: SpeedLimit | None, torque_limits: TorqueLimits
) -> tuple[Trajectory, LimitPeaks]:
    """``time_with_peaks`` under torque limits, slowed down where torques between grid points exceed them."""
    require_limits(path, limits, jerk=False)
    segments = path_segments(path, limits, speed_limit, torque=torque_limits)
    try:
        trajectory, highest = within_limits(_timed(path, segments, timing.phases), limits)
        samples = torque_limits.samples(trajectory)
        factor = samples.factor()
    except TimingFailed as failed:
        raise TimingFailed(torque_limits.objection_on(path) or str(failed)) from failed
    if not math.isfinite(factor):
        raise TimingFailed(torque_limits.objection_on(path) or "a joint can hardly hold the robot on the way")
    if factor > 1.0:
        trajectory, highest = trajectory.dilated(factor), highest.dilated(factor)
    return trajectory, replace(highest, torques=samples.peaks(max(factor, 1.0)))


def _compiled(
    timing: Timing, path: JointPath, limits: JointLimits, speed_limit: SpeedLimit | None
) -> tuple[ModuleType | None, int]:
    """The compiled core and the grid points it uses (0: trapezoids); None where only Python times this request."""
    gridpoints = timing.gridpoints if type(timing) is ToppRa and timing.backend == "own" else 0
    if speed_limit is not None or (not gridpoints and type(timing) is not Trapezoidal):
        return None, 0
    if type(path) is not JointPath or type(limits) is not JointLimits or len(limits.velocity) != path.n:
        return None, 0
    return load_core(), gridpoints


def _unless_failed(answer: Any) -> Any:
    """What compiled code says of a motion.

    Raises:
        TimingFailed: in its words: there is none.
    """
    if isinstance(answer, str):
        raise TimingFailed(answer)
    return answer


def _question(path: JointPath, limits: JointLimits) -> tuple[object, ...]:
    """A path, its corners and the limits as compiled code takes them."""
    return (*path.tables, path.corners, limits.velocity, limits.acceleration, limits.jerk)


def reference_time_with_peaks(
    timing: Timing, path: JointPath, limits: JointLimits, speed_limit: SpeedLimit | None
) -> tuple[Trajectory, LimitPeaks]:
    """``time_with_peaks`` in Python: the same bits."""
    jerk = isinstance(timing, SCurve)
    if isinstance(timing, ToppRa):
        law = timing.phases
    elif isinstance(timing, Trapezoidal | SCurve):
        law = partial(_closed_form, jerk=jerk)
    else:
        trajectory = timing.time_path(path, limits, speed_limit=speed_limit)
        return trajectory, peaks(trajectory, limits)
    limits = effective_limits(timing, limits)
    require_limits(path, limits, jerk=jerk)
    return within_limits(_timed(path, path_segments(path, limits, speed_limit), law), limits, jerk=jerk)


@contextmanager
def _overflow_fails() -> Iterator[None]:
    """Turn arithmetic errors in the block, such as overflow, into ``TimingFailed``."""
    try:
        with np.errstate(over="raise"):
            yield
    except ArithmeticError as error:
        raise TimingFailed(f"limits too extreme to compute with, or path ({error})") from error


def _timed(path: JointPath, segments: Iterable[PathSegment], law: Callable[[PathSegment], list[Phase]]) -> Trajectory:
    with _overflow_fails():
        phases = [phase for segment in segments for phase in law(segment)]
    table = np.array(phases).reshape(-1, 5)
    try:
        return Trajectory(path, table[:, 0], table[:, 1:] / TAYLOR)
    except InvalidRequest as error:  # rounding left nothing of the motion
        raise TimingFailed(f"limits too extreme to compute with ({error})") from error


def _closed_form(segment: PathSegment, *, jerk: bool) -> list[Phase]:
    sections = segment.sections(jerk=jerk)
    if _blend_at_stop(sections):
        raise TimingFailed(f"no constant speed on a blend that reaches a stop (segment from s = {segment.start:.6g})")
    constant = speed_profile(sections)
    if not jerk:
        return constant
    on_runs = min((speed_profile(runs) for runs in runs_of(segment, sections)), key=_seconds, default=constant)
    if _seconds(constant) <= _seconds(on_runs):
        return constant
    return split_at(on_runs, [section.start for section in sections])


def _blend_at_stop(sections: Sequence[Section], entry: float = 0.0) -> bool:
    """Whether a blend leaves no usable straight section to the stop after it or, from rest, to the stop before it."""
    if len(sections) == 1:
        return sections[0].blended
    ends = ((sections[-1], sections[-2]), (sections[0], sections[1]))[: 1 if entry > 0.0 else 2]
    return any(end.blended or end.length < MIN_RUN_UP * inner.length for end, inner in ends)


def _slowest(sections: Sequence[Section]) -> Sequence[Phase]:
    """A trapezoid as long as all sections together, under the lowest limits of any."""
    speed, acceleration = (min(section.limits[k] for section in sections) for k in range(2))
    return trapezoid(math.fsum(section.length for section in sections), speed, acceleration)


def _seconds(phases: Iterable[Phase]) -> float:
    return list(accumulate(phase.duration for phase in phases))[-1]


def within_limits(trajectory: Trajectory, limits: JointLimits, *, jerk: bool = False) -> tuple[Trajectory, LimitPeaks]:
    """The same trajectory if it keeps the limits to a relative 1e-9, else slowed down until it just does.

    ``dilation`` of the result says by how much; how close it comes to the limits is returned beside it. Jerk is checked
    only with ``jerk``.

    Raises:
        InvalidRequest: as ``peaks``.
        TimingFailed: Jerk is checked and acceleration jumps, which slowing down cannot mend.
    """
    highest = peaks(trajectory, limits)
    ratios = [highest.velocity.ratio, highest.acceleration.ratio, *([highest.jerk.ratio] if jerk else [])]
    if max(ratios) <= 1.0 + TOLERANCE:
        return trajectory, highest
    if not math.isfinite(max(ratios)):
        raise TimingFailed(f"acceleration of joint {highest.jerk.joint} jumps at t = {highest.jerk.time:.6g} s")
    factor = max(math.pow(ratio, 1.0 / power) for power, ratio in enumerate(ratios, start=1))
    return trajectory.dilated(factor), highest.dilated(factor)


# The speed of the tool is no polynomial in time: its peak is found by sampling, ever denser around the highest samples.


def peak_tool_speed(robot: Robot, trajectory: Trajectory) -> float:
    """The largest speed in m/s of the tool frame's origin, to about six digits."""
    speed: float = (
        load_core()
        .TrajectoryTables(*trajectory.tables)
        .peak_tool_speed(robot.body_table, robot.tool_body, robot.tool_placement[:3, 3].tolist())
    )
    return speed


def tool_speeds(robot: Robot, Q: FloatArray, Qd: FloatArray) -> FloatArray:
    """The speed (m/s) of the tool frame's origin at configurations Q (m, n) with velocities Qd (m, n), shape (m,)."""
    R, t = robot.body_poses_batch(Q, portable=True)
    x, y, z = robot.tool_placement[:3, 3].tolist()
    at = t[:, robot.tool_body] + _turned(R[:, robot.tool_body], (x, y, z))
    chain = chain_to_base(robot.bodies, robot.tool_body)
    if not chain:
        return np.zeros(len(t))
    bodies = [robot.bodies[index] for index in chain]
    axes = np.array([body.axis for body in bodies])[:, :, None, None]  # a row per joint, a column per sample
    columns, origins = R.transpose(1, 3, 2, 0)[chain], t.transpose(1, 2, 0)[chain]
    moves = columns[:, 0] * axes[:, 0] + columns[:, 1] * axes[:, 1] + columns[:, 2] * axes[:, 2]
    turns = [not body.prismatic for body in bodies]
    moves[turns] = cross(moves[turns], at.T - origins[turns], axis=1)
    multipliers = np.array([body.multiplier for body in bodies])[:, None]
    moves *= (Qd.T[[body.q_index for body in bodies]] * multipliers)[:, None]
    velocity = np.add.accumulate(moves, axis=0)[-1]  # in one order: durations depend on it
    return np.asarray(np.sqrt(velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2))


def _turned(R: FloatArray, vector: tuple[float, float, float]) -> FloatArray:
    """One vector rotated by many rotations (m, 3, 3); (m, 3)."""
    x, y, z = vector
    return np.asarray(R[:, :, 0] * x + R[:, :, 1] * y + R[:, :, 2] * z)
