"""An environment for each peer, made on demand in a folder among the user's caches, with pinned versions."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from benchmarks.baselines.peers.catalogue import Peer
from planner_service.errors import InvalidRequest
from planner_service.files.disk_cache import cache_folder
from planner_service.files.writing import write_whole

__all__ = ["FOLDER_VARIABLE", "Environment", "environments_folder"]

FOLDER_VARIABLE = "PLANNER_SERVICE_PEERS"
"""The environment variable that names the folder of the environments."""

STATE = "state.json"
"""The file by which an environment is known to be one."""

INSTALL_SECONDS = 1800.0
"""After which an installation is given up: the slowest compiles for about ten minutes."""

TOLD = 12
"""Last lines of pip that are kept of a failed installation."""


def environments_folder(surroundings: Mapping[str, str] = os.environ) -> Path:
    """Where the environments are: ``$PLANNER_SERVICE_PEERS``, else ``peers`` in the folder of the package's caches.

    Raises:
        InvalidRequest: neither is known.
    """
    named = surroundings.get(FOLDER_VARIABLE)
    folder = cache_folder(surroundings)
    if named:
        return Path(named).absolute()
    if folder is None:
        raise InvalidRequest(FOLDER_VARIABLE, "unset", "the folder in which environments of peers are to be made")
    return folder.absolute() / "peers"


@dataclass(frozen=True)
class Environment:
    """A peer's virtual environment, which may not have been made yet."""

    peer: Peer
    folder: Path

    @classmethod
    def of(cls, peer: Peer, folder: Path | None = None) -> Environment:
        """The peer's environment in a folder of environments."""
        return cls(peer, (environments_folder() if folder is None else folder) / peer.name)

    @property
    def python(self) -> Path:
        """Its interpreter."""
        return self.folder / "bin" / "python"

    @property
    def state(self) -> str:
        """``installed``, ``not installed``, or why it could not be."""
        try:
            told = json.loads((self.folder / STATE).read_text("utf-8"))
        except (OSError, ValueError, RecursionError):
            return "not installed"
        if not isinstance(told, dict):
            return "not installed"
        if told.get("requirements") != list(self.peer.requirements):
            return "installed for other versions; install it again"
        return str(told.get("state"))

    @property
    def ready(self) -> bool:
        """Whether it can be run."""
        return self.state == "installed"

    def surroundings(self) -> dict[str, str]:
        """Environment variables for what runs in it: one thread, nothing of ours."""
        kept = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "VIRTUAL_ENV"))}
        threads = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        return kept | threads | {"PYTHONNOUSERSITE": "1"}

    def install(self, python: Path | None = None) -> str:
        """Make it anew; ``installed``, or why it could not be, which is also what ``state`` says from then on.

        Raises:
            InvalidRequest: something else is in its place.
        """
        if self.folder.exists() and any(self.folder.iterdir()) and not (self.folder / STATE).is_file():
            raise InvalidRequest(
                FOLDER_VARIABLE, str(self.folder), "a folder that is empty, or an environment of a peer"
            )
        try:
            if self.folder.exists():
                shutil.rmtree(self.folder)
            self.folder.mkdir(parents=True)
        except OSError as error:
            message = f"{self.folder} cannot be made: {error.strerror}; ${FOLDER_VARIABLE} names the folder it is in"
            raise InvalidRequest(FOLDER_VARIABLE, str(self.folder), "a folder", message=message) from None
        self._note("interrupted while it was installed")
        state = self._installed(Path(sys.executable) if python is None else python.absolute())
        self._note(state)
        return state

    def _note(self, state: str) -> None:
        told = {"state": state, "requirements": list(self.peer.requirements)}
        write_whole(self.folder / STATE, json.dumps(told, indent=1) + "\n")

    def _installed(self, python: Path) -> str:
        failed = self._call([str(python), "-m", "venv", str(self.folder)], "venv")
        failed = failed or self._call([str(self.python), *_PIP, "install", *self.peer.requirements], "pip install")
        if failed:
            return failed
        imports = f"import {self.peer.imports}"
        return self._call([str(self.python), "-c", imports], imports) or "installed"

    def _call(self, command: list[str], what: str) -> str:
        """Run it; empty if it went well, else the reason."""
        try:
            done = subprocess.run(
                command,
                cwd=self.folder,
                env=self.surroundings(),
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                errors="replace",
                check=False,
                timeout=INSTALL_SECONDS,
            )
        except subprocess.TimeoutExpired:
            return f"{what}: given up after {INSTALL_SECONDS:g} s"
        except OSError as error:
            return f"{what}: {error}"
        (self.folder / "install.log").write_text(done.stdout + done.stderr, "utf-8")
        return "" if done.returncode == 0 else f"{what} failed: {_reason(done.stderr + done.stdout)}"


_PIP = ("-m", "pip", "--disable-pip-version-check", "--no-input")


def _reason(output: str) -> str:
    """The reason, from the output: lines that mention errors, or the last lines if there are none."""
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    marks = ("error:", "from url", "could not", "not found", "importerror", "no matching")
    telling = [line for line in dict.fromkeys(lines) if any(mark in line.lower() for mark in marks)]
    return " | ".join((telling or lines)[:TOLD])[:2000]
