"""``python -m auditor FILE``: a plan with evidence, by ``verify`` and ``verify_constraints``, or a proof that no path
exists, by ``verify_no_path``."""

import sys
from collections.abc import Iterator
from typing import Any

from auditor import verify, verify_constraints, verify_no_path


def judged(document: Any) -> Iterator[str]:
    """What a file shows, whichever of both it is."""
    if document.get("format") == verify_no_path.FORMAT:
        return verify_no_path.verify(document)
    return verify_constraints.verify(document)


if __name__ == "__main__":
    sys.exit(verify.main(sys.argv[1:], judged))
