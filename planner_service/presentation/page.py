"""What results know of the page in the browser that shows them."""

from __future__ import annotations

from typing import Protocol

from planner_service.provided import Provided

__all__ = ["OpenPage", "Showable", "recording_bytes", "show_page"]


class OpenPage(Protocol):
    """A page in the browser, served from this process until its last window is closed."""

    @property
    def url(self) -> str:
        """Its address."""

    @property
    def open(self) -> bool:
        """Whether it is still served."""

    def wait(self) -> None:
        """Return when its last window was closed, or ``close`` was called."""

    def close(self) -> None:
        """Stop serving it."""


class Showable(Protocol):
    """A result that the page can show: a plan, a task, or a saved task."""

    def show(self, *, port: int = 8080, block: bool | None = None) -> OpenPage:
        """Show it on a page of its own."""


show_page: Provided[..., OpenPage] = Provided()
"""Shows something of a world on a page of its own."""

recording_bytes: Provided[..., bytes] = Provided()
"""Makes a recording, "rrd" or "mcap", of a service's motions, every dt seconds."""
