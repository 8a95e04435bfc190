"""What locust does: each user sends the next of the requests in a file and compares the answer's digest.

Run by ``load.py`` in an environment that has nothing but locust; ``SERVE_REQUESTS`` names the file. Where the digest is
empty any answer is right.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import os
from typing import Any

from locust import FastHttpUser, task

with open(os.environ["SERVE_REQUESTS"], encoding="utf-8") as file:
    ASKED: list[dict[str, Any]] = json.load(file)

NEXT = itertools.cycle(ASKED)


def digest(document: dict[str, Any]) -> str:
    """As ``asked.digest``."""
    return hashlib.sha256(json.dumps(still(document), sort_keys=True).encode()).hexdigest()


def still(value: Any) -> Any:
    """Without what a clock says."""
    if isinstance(value, dict):
        return {name: still(entry) for name, entry in value.items() if name != "seconds"}
    return [still(entry) for entry in value] if isinstance(value, list) else value


class Client(FastHttpUser):  # type: ignore[misc]
    """One program that plans without a pause."""

    connection_timeout = network_timeout = 120.0

    @task  # type: ignore[untyped-decorator]
    def ask(self) -> None:
        """The next request."""
        one = next(NEXT)
        headers = {"Prefer": "wait=60"}
        with self.client.post(one["path"], json=one["body"], headers=headers, catch_response=True) as response:
            if response.status_code != 200:
                response.failure(f"status {response.status_code}")
            elif one["digest"] not in ("", digest(json.loads(response.text))):
                response.failure("another answer than the library's")
