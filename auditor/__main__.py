"""``python -m auditor plan.json``: see ``verify``."""

import sys

from auditor.verify import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
