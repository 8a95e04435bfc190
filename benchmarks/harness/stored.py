"""The stored queries are what their seed gives; ``--write`` stores them."""

from __future__ import annotations

import argparse
import difflib
from collections.abc import Sequence

from rich.console import Console

from benchmarks.worlds import queries
from planner_service.files.writing import write_whole

__all__ = ["main"]


def main(arguments: Sequence[str], console: Console) -> int:
    """Store, or compare with what is stored; exit code 0 if equal or stored."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks queries", description=__doc__)
    parser.add_argument("--write", action="store_true", help="store them")
    write = parser.parse_args(arguments).write
    texts = {queries.FOLDER / f"{scene}.json": queries.text_of(queries.draw(scene)) for scene in queries.SCENES}
    made = {path: text for path, text in texts.items() if not path.exists() or path.read_text("utf-8") != text}
    for path, text in made.items():
        if write:
            write_whole(path, text)
            console.print(f"stored {path.name}")
        else:
            old = path.read_text("utf-8").splitlines() if path.exists() else []
            for line in difflib.unified_diff(old, text.splitlines(), path.name, "now", lineterm="", n=0):
                console.print(line, markup=False, highlight=False, soft_wrap=True)
    if not made:
        console.print("queries: equal to what is stored")
    elif not write:
        console.print("store it with: python -m benchmarks queries --write")
    return 1 if made and not write else 0
