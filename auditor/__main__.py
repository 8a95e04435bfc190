"""``python -m auditor plan.json``: see ``verify``, and ``verify_no_path`` for a proof that no path exists."""

import sys

from auditor import verify, verify_no_path

if __name__ == "__main__":
    sys.exit(verify.main(sys.argv[1:], {verify_no_path.FORMAT: verify_no_path.verify}))
