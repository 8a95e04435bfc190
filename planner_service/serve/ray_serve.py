"""The server as a deployment of Ray Serve: one replica in front, and planners on the machines of its cluster.

The front has the folder, the queue and the addresses, so there is one of it, and Ray Serve starts another when it dies.
Planners are the replicas: actors without a state of their own, as many as the engine's workers, wherever the cluster
has cores. A machine that is lost costs nothing but time: what its planners were at is planned on another one.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from planner_service.errors import InvalidRequest, MissingDependency
from planner_service.parallel import Ray
from planner_service.serve.app import create_app
from planner_service.serve.guard import Guard
from planner_service.serve.run import Settings, new_server

__all__ = ["deployment"]

MAX_ONGOING = 1_000
"""Requests, waiting ones included, that Ray Serve hands to the front at once."""


def deployment(
    settings: Settings, *, port: int = 8000, token: str | None = None, actor_options: Mapping[str, Any] | None = None
) -> Any:
    """An application for ``ray.serve.run``.

    Args:
        settings: With ``Ray`` as the engine; its address is not used. A folder for the state has to be on the machine
            of the front: if the front may be started on several machines, on all of them what is stored differs, so
            name one machine in ``actor_options``, such as ``{"resources": {"node:10.0.0.5": 0.001}}``.
        port: Where Ray Serve listens: without a token only requests to this machine's own names with this port are
            answered.
        token: What clients have to send; needed if Ray Serve listens on other addresses than 127.0.0.1.
        actor_options: Of the front's actor; it needs no core.

    Raises:
        InvalidRequest: The engine is another one.
        MissingDependency: The extra ``ray-serve`` is not installed.
    """
    if not isinstance(settings.engine, Ray):
        raise InvalidRequest("settings.engine", settings.engine, "Ray(workers=...)")
    try:
        from ray import serve
    except ImportError as error:
        raise MissingDependency("ray[serve]", "ray-serve") from error

    def guarded() -> Guard:
        return Guard(create_app(new_server(settings)), token, Guard.loopback(port) if token is None else None)

    options = {"num_cpus": 0, **(actor_options or {})}

    @serve.deployment(name="planner-service", max_ongoing_requests=MAX_ONGOING, ray_actor_options=options)
    @serve.ingress(guarded)
    class Front:
        """Has the routes."""

    front: Any = Front
    return front.bind()
