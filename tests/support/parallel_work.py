"""Works for tests of engines: workers can import them from here."""

from __future__ import annotations

import ctypes
import os
import re
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = ["Echo", "Faulty", "Picky", "Stillborn", "spin"]


def spin() -> None:
    """Compute for hours without letting any other Python run, or look at signals."""
    re.match(r"(a+)+$", "a" * 60 + "b")


class Picky(Exception):
    """Can be sent, and not be made again of what it keeps."""

    def __init__(self, one: str, two: str) -> None:
        super().__init__(f"{one} {two}")


@dataclass(frozen=True)
class Echo:
    """Answers with the item itself, and the worker's process."""

    def prepare(self) -> None:
        """Nothing."""

    def __call__(self, item: Any) -> tuple[Any, int]:
        return item, os.getpid()


@dataclass(frozen=True)
class Faulty:
    """Squares numbers; the ones named here end badly. Every try is a line in a file."""

    log: Path
    faults: dict[int, str]
    seconds: float = 0.0

    def prepare(self) -> None:
        """Nothing."""

    def __call__(self, item: int) -> int:
        with self.log.open("a", encoding="utf-8") as log:
            log.write(f"{item}\n")
        fault = self.faults.get(item)
        if fault == "segfault":
            ctypes.string_at(0)
        elif fault == "exit":
            os._exit(3)
        elif fault == "spin":
            spin()
        elif fault == "memory":
            raise MemoryError
        elif fault == "bug":
            raise ZeroDivisionError("our bug")
        elif fault == "picky":
            raise Picky("our", "bug")
        elif fault == "hang up":
            os.closerange(3, 100)
            time.sleep(3600.0)
        elif fault == "leave a child":
            os.system("sleep 60 >/dev/null 2>&1 &")
            os._exit(3)
        time.sleep(self.seconds)
        return item * item

    def tries(self) -> dict[int, int]:
        """How often each item was begun."""
        lines = [int(line) for line in self.log.read_text("utf-8").split()]
        return {item: lines.count(item) for item in lines}


@dataclass(frozen=True)
class Stillborn:
    """Ends its worker before that is ready."""

    def prepare(self) -> None:
        """End."""
        os._exit(7)

    def __call__(self, item: Any) -> None:
        """Is never called."""
