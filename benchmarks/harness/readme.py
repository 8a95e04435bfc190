"""The outputs the README shows, made again from its own examples."""

from __future__ import annotations

import contextlib
import io
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

from rich.console import Console

from planner_service.files.writing import write_whole

__all__ = ["main", "refreshed"]

README = Path(__file__).parents[2] / "README.md"
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", flags=re.DOTALL | re.MULTILINE)


def _trimmed(text: str) -> str:
    return "".join(line.rstrip() + "\n" for line in text.splitlines())


def _demo() -> str:
    command = [sys.executable, "-c", "from planner_service.cli import main; main()", "pick-place"]
    environment = {**os.environ, "COLUMNS": "100", "OPENBLAS_NUM_THREADS": "1"}
    printed = subprocess.run(command, capture_output=True, text=True, check=True, env=environment).stdout
    return "$ make demo\n" + _trimmed(printed)


def refreshed(text: str) -> str:
    """A README whose first console block and whose output blocks below Python blocks are what is printed now."""
    names: dict[str, Any] = {}
    pieces, end, printed, demo_shown = [], 0, "", False
    for block in BLOCK.finditer(text):
        language, content = block.groups()
        if language == "python":
            with contextlib.redirect_stdout(io.StringIO()) as out:
                exec(compile(content, README.name, "exec"), names)
            printed = _trimmed(out.getvalue())
        elif language == "text":
            content = printed
        elif language == "console" and not demo_shown:
            content, demo_shown = _demo(), True
        pieces += [text[end : block.start(2)], content]
        end = block.end(2)
    return "".join(pieces) + text[end:]


def main(*, write: bool, console: Console) -> int:
    """Exit code 0 if the README shows what is printed, but for milliseconds, or was written so."""
    text = README.read_text(encoding="utf-8")
    now = refreshed(text)
    if write:
        write_whole(README, now)
        return 0
    same = [line[:92].rstrip() for line in text.splitlines()] == [line[:92].rstrip() for line in now.splitlines()]
    console.print("the README shows what is printed" if same else "stale: python -m benchmarks readme --write")
    return 0 if same else 1
