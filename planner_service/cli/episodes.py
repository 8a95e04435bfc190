"""The command ``episodes``: an oracle data set, written or gone on with."""

from __future__ import annotations

import time
from dataclasses import asdict
from typing import Annotated, Any

import typer

from planner_service.cli.exit_codes import NO_PLAN, bad_input_exits, json_text
from planner_service.cli.options import AsJson, RobotName, Seed
from planner_service.cli.tables import emit, render
from planner_service.datasets import EPISODE_TASKS, EpisodesSummary, EpisodeWork, episode_task, write_episodes
from planner_service.parallel.named import engine_named
from planner_service.presentation.progress import bar
from planner_service.robot.model import load_robot

__all__ = ["episodes"]


def episodes(
    out: Annotated[str, typer.Option(metavar="DIR", help="A new folder, or one to go on with.")],
    task: Annotated[str, typer.Option(help=f"One of {', '.join(EPISODE_TASKS)}.")] = "pick-place",
    count: Annotated[int, typer.Option(help="Worlds to draw; more than before to go on with a folder.")] = 1000,
    seed: Seed = 0,
    robot: RobotName = "wxai",
    fps: Annotated[int, typer.Option(help="Frames per second.")] = 30,
    workers: Annotated[int | None, typer.Option(help="Processes; as many as there are cores if not given.")] = None,
    engine: Annotated[str, typer.Option(help="processes, ray (on this machine), or ray=ADDRESS.")] = "processes",
    as_json: AsJson = False,
) -> None:
    """Write an oracle data set: worlds drawn at random, in each the task planned, proven, timed and sampled.

    Parquet in the layout and column names of LeRobot v2.1, with tables of scenes, requests, exact curves, counts,
    certificates and failures, and a data card. An interrupted run goes on where it was with the same command.
    """
    with bad_input_exits():
        hands = engine_named(engine, workers)
        work = EpisodeWork(load_robot(robot), episode_task(task), seed=seed, fps=fps)
        began = time.perf_counter()
        try:
            with bar("episodes", None) as progress:
                summary = write_episodes(out, work, count, engine=hands, progress=progress)
        except KeyboardInterrupt:
            typer.echo(f"interrupted: what is finished is kept in {out}; the same command goes on with it", err=True)
            raise
    seconds, new = time.perf_counter() - began, summary.new
    if as_json:
        told: dict[str, Any] = {"out": out, **asdict(summary), "seconds": seconds}
        emit(json_text(told))
    else:
        emit(render(*_words(out, fps, summary), f"this run:  {new:,} requests in {seconds:.1f} s{_rate(new, seconds)}"))
    raise typer.Exit(0 if summary.episodes else NO_PLAN)


def _words(out: str, fps: int, summary: EpisodesSummary) -> list[str]:
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


def _rate(new: int, seconds: float) -> str:
    return f", {new / seconds:.1f} a second" if new else ""
