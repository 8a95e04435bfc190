"""``python -m auditor FILE [--allow A B]...``: what a plan or a task with evidence shows, or a proof of no path.

The last line begins with VALID or INVALID and says for what; the exit code is 0 or 1. ``--allow`` names a pair that may
touch everywhere: a file that allows one is INVALID unless whoever asks names it, too.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from typing import Any

from auditor import verify, verify_no_path
from auditor.schema import MOST_BYTES, Invalid, parsed


def judged(document: Any, named: Sequence[Sequence[str]] = ()) -> Iterator[str]:
    """What a file shows, whichever of both it is."""
    if isinstance(document, dict) and document.get("format") == verify_no_path.FORMAT:
        return verify_no_path.verify(document)
    return verify.verify(document, named)


def main(arguments: Sequence[str]) -> int:
    """Print what a file shows, then VALID and for what, or INVALID and why; 0 or 1."""
    parser = argparse.ArgumentParser(prog="python -m auditor")
    parser.add_argument("file")
    parser.add_argument("--allow", nargs=2, action="append", default=[], metavar=("A", "B"))
    chosen = parser.parse_args(arguments)
    try:
        with open(chosen.file, "rb") as file:
            *lines, last = judged(parsed(file.read(MOST_BYTES + 1)), chosen.allow)
        print(*lines, f"VALID: {last}", sep="\n")
        return 0
    except Exception as error:  # whatever a file is made of: it proves nothing
        known = "" if isinstance(error, Invalid) else f"no file that can be judged: {type(error).__name__}, "
        print(f"INVALID: {known}{error}")
        return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
