"""``python -m auditor FILE [--allow A B]...``: what a plan, task or cell with evidence shows, or another proof.

That is one of no path, or of inverse kinematics.

The last line begins with VALID or INVALID and says for what; the exit code is 0 or 1. ``--allow`` names a pair that may
touch everywhere. A file that allows a pair is INVALID unless the pair is named here as well.
"""

import argparse
import resource
import signal
import sys
from collections.abc import Iterator, Sequence
from typing import Any

from auditor import verify, verify_cell, verify_inverse, verify_no_path
from auditor.schema import CELL, MOST_BYTES, Invalid, parsed

MOST_MEMORY, MOST_SECONDS = 8 * 2**30, 600.0


def judged(document: Any, named: Sequence[Sequence[str]] = ()) -> Iterator[str]:
    """What a file shows, whichever it is."""
    form = document.get("format") if isinstance(document, dict) else None
    try:
        if form == verify_no_path.FORMAT:
            yield from verify_no_path.verify(document)
        elif form == verify_inverse.FORMAT:
            yield from verify_inverse.verify(document)
        elif form == CELL:
            yield from verify_cell.verify(document)
        else:
            yield from verify.verify(document, named)
    except Invalid:
        raise
    except Exception as error:  # whatever a file is made of
        raise Invalid(f"no file that can be judged: {type(error).__name__}, {error}") from error


def main(arguments: Sequence[str]) -> int:
    """Print what a file shows, then VALID and for what, or INVALID and why; 0 or 1."""
    parser = argparse.ArgumentParser(prog="python -m auditor")
    parser.add_argument("file")
    parser.add_argument("--allow", nargs=2, action="append", default=[], metavar=("A", "B"))
    chosen = parser.parse_args(arguments)
    try:
        with open(chosen.file, "rb") as file:
            *lines, last = judged(parsed(file.read(MOST_BYTES + 1)), chosen.allow)
        said, code = [*lines, f"VALID: {last}"], 0
    except Exception as error:  # whatever a file is made of: it proves nothing
        known = "" if isinstance(error, Invalid) else f"no file that can be judged: {type(error).__name__}, "
        said, code = [f"INVALID: {known}{error}"], 1
    for line in said:  # names are the file's own: none may write a line of its own
        print("".join(each if each.isprintable() else repr(each)[1:-1] for each in line))
    return code


def _late(*_: object) -> None:
    raise Invalid(f"it takes more than {MOST_SECONDS:g} s to check")


if __name__ == "__main__":
    resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))
    signal.signal(signal.SIGALRM, _late)
    signal.setitimer(signal.ITIMER_REAL, MOST_SECONDS)
    sys.exit(main(sys.argv[1:]))
