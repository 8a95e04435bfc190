"""Opens the page in the browser, serves it until its last window is closed, and shuts it down."""

from __future__ import annotations

import contextlib
import io
import os
import socket
import sys
import threading
import time
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from planner_service.cell import CellPlan
from planner_service.errors import InvalidRequest, MissingDependency
from planner_service.geometry.validation import whole
from planner_service.planning.request import World
from planner_service.presentation.page import Showable
from planner_service.service import PlannerService
from planner_service.view.cell.folder import CellFolder
from planner_service.view.page import Page
from planner_service.view.state import ViewState
from planner_service.view.still.maps import require_map_of
from planner_service.workspace import ReachabilityMap

if TYPE_CHECKING:
    from planner_service.view.serving.server import PageServer

__all__ = ["HOST", "PORT", "ServedPage", "Viewer", "interactive", "open_viewer", "served", "show"]

HOST, PORT = "127.0.0.1", 8080

GRACE = 3.0
"""Seconds to wait after the last window closed before ending: a reload closes the window, too."""

LOADING = 60.0
"""Seconds that a window may take from asking for the page to showing it."""


S = TypeVar("S", bound="ServedPage")


class Drawn(Protocol):
    """What a page draws."""

    def close(self) -> None:
        """Draw no more."""


class ServedPage:
    """A page served from this process until its last window is closed.

    Attributes:
        url: The page's address. It ends with a token, without which nothing is answered.
        page: What it draws.
    """

    page: Drawn

    def __init__(self, server: PageServer, page: Drawn, *, keep: bool) -> None:
        self._server, self.page, self.url, self._keep = server, page, server.url, keep
        self._ended, self._lock = threading.Event(), threading.Lock()
        self._seen, self._empty_since = False, time.monotonic()
        server.viser.on_client_connect(self._on_connect)
        threading.Thread(target=self._watch, name="planner-service view: watch", daemon=True).start()

    def _on_connect(self, _: Any) -> None:
        self._seen = True

    def _watch(self) -> None:
        while not self._ended.wait(0.2):
            now, loading = time.monotonic(), self._server.loading_since
            if self._server.viser.get_clients() or not self._seen or (loading and now - loading < LOADING):
                self._empty_since = now
            elif not self._keep and now - self._empty_since > GRACE:
                self.close()

    @property
    def open(self) -> bool:
        """Whether the page is still served."""
        return not self._ended.is_set()

    def wait(self) -> None:
        """Wait until the page is closed; on Ctrl-C close it and raise KeyboardInterrupt."""
        try:
            while not self._ended.wait(0.5):
                pass
        finally:
            self.close()

    def close(self) -> None:
        """Stop serving the page and end its threads."""
        with self._lock:
            if self._ended.is_set():
                return
            self.page.close()
            with contextlib.redirect_stdout(io.StringIO()):  # viser prints that it stopped
                self._server.viser.stop()
            self._ended.set()

    def __enter__(self: S) -> S:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<{type(self).__name__} at {self.url}, {'open' if self.open else 'closed'}>"

    def _repr_html_(self) -> str:
        """The page inside a notebook."""
        return f'<iframe src="{self.url}" width="100%" height="640" style="border: 0"></iframe>'


class Viewer(ServedPage):
    """A page of robot, scene and motions, served from this process until its last window is closed.

    Attributes:
        url: The page's address. It ends with a token, without which nothing is answered.
        page: The page itself.
    """

    page: Page


def show(
    world: World,
    shown: Showable | None = None,
    *,
    host: str = HOST,
    port: int = PORT,
    block: bool | None = None,
    reach: ReachabilityMap | None = None,
) -> Viewer:
    """Open a page and print its address; see ``PlannerService.view`` and, for a reachability map, ``open_viewer``."""
    viewer = open_viewer(PlannerService.of(world), shown, host=host, port=port, reach=reach)
    print(f"view: {viewer.url}", flush=True)
    if not interactive() if block is None else block:
        viewer.wait()
    return viewer


def open_viewer(
    service: PlannerService,
    shown: Showable | CellPlan | None,
    *,
    host: str = HOST,
    port: int = PORT,
    keep: bool = False,
    folder: str | os.PathLike[str] | None = None,
    reach: ReachabilityMap | None = None,
) -> Viewer:
    """Open a page that shows a service's robot and scene, and a plan or a task.

    The plan of a cell is shown by the service of all its arms, ``cell.service``.

    Args:
        port: The first port to try; if it is taken, the next free one is used. 0 for any.
        keep: Go on serving after the last window was closed.
        folder: Where the page may read meshes, clouds and scenes, and write scenes; None for nowhere.
        reach: A reachability map of the robot and the scene, of which the page shows slices; None for none.

    Raises:
        InvalidRequest: ``port`` or ``host`` is invalid, ``folder`` is none, ``shown`` cannot be shown, or ``reach`` is
            about another robot or scene.
        MissingDependency: viser is not installed.
    """
    state, files = ViewState.of(service, shown), None if folder is None else CellFolder(folder)
    if reach is not None:
        require_map_of(service.robot, service.scene, reach)
    server = served(host, port)
    return Viewer(server, Page(server.viser, state, files, reach), keep=keep)


def served(host: str, port: int) -> PageServer:
    """A server without a page.

    Raises:
        InvalidRequest: ``port`` or ``host`` is invalid.
        MissingDependency: viser is not installed.
    """
    whole("port", port, 0, 65_535)
    if not host:  # an empty host means every address of the machine
        raise InvalidRequest("host", host, f"an address of this machine, such as {HOST}")
    try:
        from planner_service.view.serving.server import PageServer
    except ImportError:
        raise MissingDependency("viser", "view") from None
    try:
        with socket.create_server((host, 0)):
            pass
    except OSError as error:
        raise InvalidRequest("host", host, f"an address of this machine ({error})") from None
    with contextlib.redirect_stdout(io.StringIO()):  # viser prints its addresses
        return PageServer(host, port)


def interactive() -> bool:
    """Whether this is a notebook or a Python prompt."""
    return hasattr(sys, "ps1") or bool(sys.flags.interactive)
