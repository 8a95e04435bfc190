"""The command ``episodes``: writes a data set of planned motions, or continues one."""

from __future__ import annotations

import time
from dataclasses import asdict
from typing import Annotated

import typer

from planner_service.cli import options
from planner_service.cli.exit_codes import NO_PLAN, bad_input_exits, report_error
from planner_service.cli.options import option
from planner_service.cli.output import show
from planner_service.datasets import EPISODE_TASKS, EpisodesSummary, EpisodeWork, episode_task, write_episodes
from planner_service.datasets.episode import as_layout
from planner_service.parallel.named import engine_named
from planner_service.presentation.progress import bar

__all__ = ["episodes"]


def episodes(
    out: Annotated[str, option("DIR", "A new folder, or the folder of a data set to continue.")],
    task: Annotated[str, option("NAME", f"One of {', '.join(EPISODE_TASKS)}.")] = "pick-place",
    count: Annotated[int, option("N", "Worlds to draw in all; to continue, more than before.")] = 1000,
    seed: options.Seed = 0,
    robot: options.RobotName = options.WXAI,
    fps: Annotated[int, option("HZ", "Frames per second.")] = 30,
    workers: options.Workers = None,
    engine: Annotated[str, option("NAME", "processes, ray (this machine) or ray=ADDRESS.")] = "processes",
    layout: Annotated[str, option("VERSION", "LeRobot's version: v3.0, or v2.1 with a file per episode.")] = "v3.0",
    as_json: options.AsJson = False,
) -> None:
    """Write a data set of planned motions: in each of many random worlds a task is planned, proven, timed and sampled.

    The files are Parquet in the layout of LeRobot v3.0, with tables of scenes, requests, exact curves, check counts,
    certificates and failures, and a data card. If the command is interrupted, run it again to continue.
    """
    with bad_input_exits():
        chosen_engine = engine_named(engine, workers)
        work = EpisodeWork(robot.load(), episode_task(task), seed=seed, fps=fps, layout=as_layout(layout))
        began = time.perf_counter()
        try:
            with bar("episodes", True) as progress:
                summary = write_episodes(out, work, count, engine=chosen_engine, progress=progress)
        except KeyboardInterrupt:
            report_error(f"interrupted: finished episodes are kept in {out}; run the same command again to continue")
            raise
    seconds, new = time.perf_counter() - began, summary.new
    rate = f", {new / seconds:.1f} a second" if new else ""
    lines = [*_lines(out, fps, summary), f"this run:  {new:,} requests in {seconds:.1f} s{rate}"]
    show({"out": out, **asdict(summary), "seconds": seconds}, *lines, as_json=as_json)
    raise typer.Exit(0 if summary.episodes else NO_PLAN)


def _lines(out: str, fps: int, summary: EpisodesSummary) -> list[str]:
    share = 100.0 * summary.episodes / summary.requests
    failed = ", ".join(f"{number:,} {reason}" for reason, number in summary.failures.items()) or "none"
    return [
        f"written: {summary.episodes:,} episodes to {out}",
        "",
        f"planned:   {summary.episodes:,} of {summary.requests:,} requests ({share:.1f} %)",
        f"failed:    {failed}",
        f"certified: {summary.certified:,} of {summary.motions:,} motions",
        f"frames:    {summary.frames:,} at {fps} Hz, {summary.motion_seconds:,.0f} s of motion",
        f"checks:    {summary.states:,} states, {summary.edges:,} edges, {summary.distances:,} distances",
    ]
