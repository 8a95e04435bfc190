"""``python -m benchmarks lines [COMMIT...]``: lines of code by folder, without blanks, comments and docstrings."""

from __future__ import annotations

import argparse
import ast
import io
import subprocess
import tokenize
from collections import Counter
from collections.abc import Iterator, Sequence

from rich.console import Console

from benchmarks.harness.environment import ROOT
from benchmarks.harness.report import table

__all__ = ["code_lines", "main"]

TOPS = ("planner_service", "auditor", "tests", "benchmarks", "examples")

_NO_CODE = {
    *(tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT),
    *(tokenize.ENCODING, tokenize.ENDMARKER),
}


def code_lines(source: str) -> int:
    """Lines of Python that hold code: no blank ones, no comments, no docstrings (nor strings below a constant)."""
    strings = {
        number
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        for number in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    lines = {
        number for token in tokens if token.type not in _NO_CODE for number in range(token.start[0], token.end[0] + 1)
    }
    return len(lines - strings)


def _files(commit: str | None) -> Iterator[tuple[str, str]]:
    """Path and text of each Python file, of a commit or of the working tree."""
    if commit is None:
        for top in TOPS:
            for path in sorted((ROOT / top).rglob("*.py")):
                yield path.relative_to(ROOT).as_posix(), path.read_text("utf-8")
        return
    listed = _git("ls-tree", "-r", "--name-only", commit)
    for name in listed.splitlines():
        if name.endswith(".py") and name.startswith(tuple(f"{top}/" for top in TOPS)):
            yield name, _git("show", f"{commit}:{name}")


def _git(*arguments: str) -> str:
    return subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True).stdout


def main(arguments: Sequence[str], console: Console) -> int:
    """Print the table; exit code 0."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks lines", description=__doc__)
    parser.add_argument("commits", nargs="*", metavar="COMMIT", help="commits to show beside the working tree")
    commits: list[str | None] = [*parser.parse_args(arguments).commits, None]
    counts = list[Counter[str]]()
    for commit in commits:
        counter = Counter[str]()
        for name, source in _files(commit):
            top, *folders = name.split("/")[:-1]
            lines = code_lines(source)
            counter[top] += lines
            if top != "examples":
                counter[f"{top}/{folders[0] if folders else '.'}"] += lines
        counts.append(counter)
    columns = ("folder", *(commit or "now" for commit in commits))
    folders = sorted(set().union(*counts))
    cells = [(name, *(f"{counter[name]:,}" if name in counter else "-" for counter in counts)) for name in folders]
    console.print(table("Lines of code", columns, cells))
    return 0
