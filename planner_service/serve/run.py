"""Runs a server: the folder, the workers, the port, until a signal ends it."""

from __future__ import annotations

import os
import socket
import stat
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import uvicorn

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.reading import read_bytes
from planner_service.parallel import Processes, Ray
from planner_service.planning.request import World
from planner_service.robot.model import Robot
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.loading import load_scene
from planner_service.scene.scene import Scene
from planner_service.serve.app import create_app
from planner_service.serve.connection import Channel, Connection
from planner_service.serve.guard import LOOPBACK, MAX_BODY, Guard, checked_origins
from planner_service.serve.server import PlanningServer
from planner_service.serve.state.store import MAX_BYTES, Store
from planner_service.serve.work import ServerWork

__all__ = ["MIN_TOKEN", "Settings", "new_server", "read_token", "serve"]

MIN_TOKEN, MAX_TOKEN = 32, 1_000
"""Characters of a token."""

WAITING_PER_WORKER = 16
"""Requests that may wait for each worker unless a capacity is given."""

PROCESSES_POLL, RAY_POLL = 0.05, 0.005
"""Seconds; see ``Dispatcher.poll``."""


@dataclass(frozen=True)
class Settings:
    """What a server is started with.

    Attributes:
        robot: Itself, its name, or the path of its file.
        scenes: Names or paths of scenes; the first is what workers prepare for.
        engine: ``Processes`` on this machine, or ``Ray`` on a cluster.
        state: The folder that outlives the server; None for one that is deleted with it.
        capacity: Requests that may wait; None for so many per worker.
        keep: Bytes of answers that are kept; beyond that the oldest are deleted.
    """

    robot: Robot | str
    scenes: Sequence[str]
    engine: Processes | Ray
    state: Path | None = None
    capacity: int | None = None
    keep: int = MAX_BYTES


def new_server(settings: Settings) -> PlanningServer:
    """A server that is not started yet.

    Raises:
        InvalidRequest: There is no such robot, scene, folder or cluster.
    """
    robot = settings.robot if isinstance(settings.robot, Robot) else load_robot(settings.robot)
    scenes: list[Scene] = [load_scene(name) for name in settings.scenes]
    world = World(robot, scenes[0] if scenes else Scene())
    own = None if settings.state is not None else Path(tempfile.mkdtemp(prefix="planner-service-"))
    store = Store(settings.state or own or Path(), max_bytes=settings.keep)
    try:
        backend = settings.engine.backend(ServerWork(world))
        capacity = settings.capacity or WAITING_PER_WORKER * backend.max_workers
        poll = RAY_POLL if isinstance(settings.engine, Ray) else PROCESSES_POLL
        return PlanningServer(
            world, store, backend, capacity=capacity, poll=poll, scenes=tuple(scenes), folder_to_remove=own
        )
    except BaseException:
        store.close()
        raise


def serve(
    settings: Settings,
    *,
    host: str,
    port: int,
    token: str | None,
    started: Callable[[str], None] = lambda _: None,
    origins: Sequence[str] = (),
) -> None:
    """Serve until SIGINT or SIGTERM.

    Args:
        port: 0 for any that is free.
        origins: Pages of these may use the server, such as http://localhost:5173.
        started: Called with the address once clients can connect.

    Raises:
        InvalidRequest: As ``new_server``; an origin is none; the port is not free; or another address than a loopback
            one has no token.
    """
    local = host in (*LOOPBACK, "::1")
    if not local and token is None:
        raise InvalidRequest("--host", host, "127.0.0.1, or a --token-file: others could use this server")
    allowed = checked_origins(origins)
    with _listening(host, port) as listener:
        port = listener.getsockname()[1]
        server = new_server(settings)
        app = Guard(create_app(server), token, Guard.loopback(port) if local else None, allowed)
        config = uvicorn.Config(
            app,
            log_config=None,
            access_log=False,
            server_header=False,
            proxy_headers=False,
            date_header=False,
            lifespan="on",
            ws=Channel,
            ws_max_size=MAX_BODY,
            ws_per_message_deflate=False,
            http=Connection,
            timeout_graceful_shutdown=5,
            limit_concurrency=1_000,
        )
        shown = f"[{host}]" if ":" in host else host
        started(f"http://{shown}:{port}")
        _Uvicorn(config, server).run([listener])


class _Uvicorn(uvicorn.Server):
    """Lets clients go that wait for answers before it waits for their connections to close."""

    def __init__(self, config: uvicorn.Config, server: PlanningServer) -> None:
        super().__init__(config)
        self._planning = server

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End the server."""
        self._planning.leave()
        await super().shutdown(sockets)


def _listening(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)  # asyncio sets TCP_NODELAY only on these
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host.strip("[]"), port))
        listener.listen(1_024)
    except OSError as error:
        listener.close()
        raise InvalidRequest("--port", port, f"a free port of {host} ({error.strerror or error})") from error
    return listener


def read_token(path: Path) -> str:
    """The token in a file that only its owner can read.

    Raises:
        InvalidFile: It cannot be used.
    """
    token = read_bytes(path, MAX_TOKEN + 1).decode("ascii", "replace").strip()
    if os.stat(path).st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise InvalidFile(path, ["others may read it; chmod 600"])
    if not MIN_TOKEN <= len(token) <= MAX_TOKEN or not all("!" <= character <= "~" for character in token):
        raise InvalidFile(path, [f"expected {MIN_TOKEN} to {MAX_TOKEN:,} printable ASCII characters without spaces"])
    return token
