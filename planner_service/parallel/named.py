"""Engines by the names that the command line takes."""

from __future__ import annotations

from planner_service.errors import InvalidRequest
from planner_service.geometry.validation import text
from planner_service.parallel.engine import Engine
from planner_service.parallel.processes import Processes, require_workers
from planner_service.parallel.ray_engine import Ray
from planner_service.parallel.sequential import Sequential

__all__ = ["engine_named"]


def engine_named(name: str, workers: int | None) -> Engine:
    """The engine for ``processes``, ``ray`` (on this machine) or ``ray=ADDRESS``; one process needs no worker.

    Raises:
        InvalidRequest: Another name, or ``workers`` is not a whole number from 1 to 10,000.
        MissingDependency: ray is not installed.
    """
    text("--engine", name, "processes, ray or ray=ADDRESS")
    require_workers(workers)
    kind, _, address = name.partition("=")
    if name == "processes":
        return Sequential() if workers == 1 else Processes(workers)
    if kind == "ray" and (address or name == "ray"):
        return Ray(address or None, workers)
    raise InvalidRequest("--engine", name, "processes, ray or ray=ADDRESS")
