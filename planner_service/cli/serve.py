"""The commands ``serve``, one planner for many programs, and ``mcp``, an arm for an agent."""

from __future__ import annotations

import logging
from enum import Enum
from pathlib import Path
from typing import Annotated

from planner_service.cli import arguments, options
from planner_service.cli.exit_codes import ErrorLog, bad_input_exits
from planner_service.cli.options import option
from planner_service.cli.output import emit
from planner_service.errors import InvalidRequest, MissingDependency
from planner_service.parallel import Processes, Ray

__all__ = ["mcp", "serve"]


class EngineName(str, Enum):
    """Where plans are made."""

    PROCESSES = "processes"
    RAY = "ray"


def serve(
    scene: Annotated[list[str], option("NAME", "Scene to begin with, by name or path; may be repeated.")],
    robot: options.RobotName = options.WXAI,
    port: Annotated[int, option("N", "Port; 0 for any.", min=0, max=65_535)] = 8080,
    host: Annotated[str, option("Address; any but this machine's own needs --token-file.")] = "127.0.0.1",
    token_file: Annotated[Path | None, option("FILE", "File with the token that clients have to send.")] = None,
    allow_origin: Annotated[
        list[str] | None, option("ORIGIN", "Pages of this origin may use the server too; may be repeated.")
    ] = None,
    state: Annotated[
        Path | None, option("FOLDER", "Folder for scenes, roadmaps and answers; default: none kept.")
    ] = None,
    keep: Annotated[
        int, option("MB", "Megabytes of answers that are kept; the oldest are deleted first.", min=1, max=1_000_000)
    ] = 2_000,
    workers: options.Workers = None,
    queue: Annotated[int | None, option("N", "Requests that may wait; default: 16 per worker.", min=1)] = None,
    engine: Annotated[EngineName, option("Processes here, or actors on a Ray cluster.")] = (EngineName.PROCESSES),
    address: Annotated[str | None, option("A", "With --engine ray: the cluster's address, such as auto.")] = None,
) -> None:
    """Plan for other programs over HTTP, until Ctrl-C.

    The page /docs says what can be asked. Answers are the library's: the same plans, proofs and counts.
    """
    logging.getLogger("planner_service.serve").addHandler(ErrorLog(logging.WARNING))
    with bad_input_exits():
        try:
            from planner_service.serve.run import Settings, read_token
            from planner_service.serve.run import serve as run_server
        except ImportError as error:
            raise MissingDependency(error.name or "starlette", "serve") from error
        if engine is EngineName.PROCESSES and address is not None:
            raise InvalidRequest("--address", address, "with --engine ray only")
        chosen = Ray(address, workers) if engine is EngineName.RAY else Processes(workers)
        token = None if token_file is None else read_token(token_file)
        settings = Settings(robot.load(), scene, chosen, state, queue, keep * 1_000_000)
        told = lambda url: emit(f"serving at {url}\n")  # noqa: E731
        run_server(settings, host=host, port=port, token=token, started=told, origins=allow_origin or ())


def mcp(
    scene: options.SceneName,
    robot: options.RobotName = options.WXAI,
    start: options.Start = "home",
    execute: Annotated[
        str | None,
        option("DRIVER", "Let tools move this arm: simulator, or trossen=ADDRESS; without it nothing moves."),
    ] = None,
    speed: Annotated[
        float | None, option("X", "Fraction of the planned speed.  [default: 1 in simulation, 0.2 on an arm]")
    ] = None,
) -> None:
    """Offer planning as tools to an agent, over standard input and output (Model Context Protocol).

    An agent's program starts this command itself. Whatever it plans is proven free; names in the scene are data.
    """
    logging.getLogger("planner_service.mcp").addHandler(ErrorLog(logging.WARNING))
    with bad_input_exits():
        try:
            from planner_service.mcp.server import run, wire
        except ImportError as error:
            raise MissingDependency(error.name or "mcp", "mcp") from error
        from planner_service.cli.run import signals_as_ctrl_c

        if speed is not None and execute is None:
            raise InvalidRequest("--speed", speed, "with --execute only")
        with wire() as (reading, writing), signals_as_ctrl_c():
            service = arguments.service_for(robot, scene)
            run(service, arguments.configuration("--start", start, service.robot), execute, speed, reading, writing)
