"""Tools of others that send requests, in an environment of their own: locust for load, schemathesis for attacks."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from planner_service.errors import InvalidRequest
from planner_service.files.disk_cache import cache_folder

__all__ = ["tool"]

PINNED = ("locust==2.47.0", "schemathesis==4.32.5")

INSTALL_SECONDS = 900.0


def tool(name: str) -> Path:
    """The program of that name; the environment is made when it is first asked for.

    Raises:
        InvalidRequest: it cannot be made.
    """
    caches = cache_folder(os.environ)
    if caches is None:
        raise InvalidRequest(
            "HOME", "unset", "a folder in which an environment for locust and schemathesis can be made"
        )
    folder = caches.absolute() / "serve-tools"
    program = folder / "bin" / name
    if not program.exists():
        _install(folder)
    return program


def _install(folder: Path) -> None:
    for command in (
        [sys.executable, "-m", "venv", str(folder)],
        [str(folder / "bin" / "python"), "-m", "pip", "install", "--quiet", *PINNED],
    ):
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=INSTALL_SECONDS)
        if done.returncode:
            raise InvalidRequest("tools", done.stderr[-500:], f"an environment with {' and '.join(PINNED)}")
