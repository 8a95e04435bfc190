"""The same forgeries at the library's own doors: ``certify`` of a file, ``run`` with the operator's world, ``Remote``.

What a file or a server says of a motion is not believed there. So what the door itself has proven is judged: its own
certificates take the place of the forgery's before ``auditor.sampling`` looks for what is false.
"""

from __future__ import annotations

import json
import random
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import deepcopy
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from rich.table import Table

from benchmarks.harness.report import Promise, Report, Row, grouped, table_of
from benchmarks.studies.evidence.forgeries import Forger, forged, meaning, objections_of
from benchmarks.studies.evidence.saved_files import Document, saved_files
from planner_service.client import Remote
from planner_service.errors import PlannerServiceError
from planner_service.execute.preconditions import admitted
from planner_service.records import SavedPlan
from planner_service.records.plan_file import plan_or_task
from planner_service.records.recertify import Recertified, recertify
from planner_service.records.result import certificate_record

__all__ = ["run"]

FORGERIES = 2_000

Door = Callable[[Document, Document], tuple[Recertified, Document]]
"""Of a forgery and the file that it was made of: what was proven, and what that says."""


def run(queries: int | None, seed: int) -> Report:
    """Bring so many forgeries to each door that they fit."""
    files = [each for each in saved_files(seed) if "encloses" not in each[1]]
    with _answering() as remote:
        doors: dict[str, Door] = {"certify": _certify, "run": _run, "Remote": remote}
        rows = list[Row]()

        def judge(kind: str, name: str, _: bool, forger: Forger, base: Document) -> Row:
            row: Row = {"kind": kind, "file": name}
            for door, opens in doors.items():
                if door != "Remote" or name.startswith("plan"):
                    rows.append(row | {"door": door} | _judged(opens, forger, base))
            return row

        for _ in forged(files, queries or FORGERIES, random.Random(f"doors {seed}"), set(), judge):
            pass
    false = [row for row in rows if row["false"]]
    promise = f"no forgery of {len(rows):,} passes a door that sampling refutes"
    odd = [{key: str(row[key]) for key in ("door", "kind", "file", "false")} for row in false[:40]]
    tables = [_table(rows), *([table_of("Passed and refuted", odd)] if odd else [])]
    return Report("evidence", tuple(rows), tuple(tables), (Promise(promise, f"{len(false)} do", not false),))


def _judged(opens: Door, forger: Forger, base: Document) -> Row:
    try:
        document = json.loads(json.dumps(forger.sealed(), allow_nan=False))
        proven, said = opens(document, base)
        proven.required()
    except (PlannerServiceError, ValueError) as error:  # or what is no JSON
        return {"why": str(error)[:160] or "refused", "false": ""}
    if meaning(document) == meaning(base):
        return {"why": "", "false": ""}
    said = deepcopy(said)
    for part, motion in zip(said.get("segments", [said]), proven.motions, strict=True):
        part["result"]["certificate"] = certificate_record(motion.certificate)
        moved = motion.gripper
        part["gripper"] = None if moved is None else {"certificate": certificate_record(moved.certificate)}
    return {"why": "", "false": "; ".join(objections_of(said | {"allowed": list(map(list, proven.allowed))})[:3])}


def _read(document: Document) -> Any:
    return plan_or_task("forged.json", json.dumps(document).encode())


def _certify(document: Document, _: Document) -> tuple[Recertified, Document]:
    """In the world that the file tells of."""
    return recertify(_read(document)), document


def _run(document: Document, base: Document) -> tuple[Recertified, Document]:
    """On a real arm, in the operator's own world: that of the file before it was forged."""
    service, plan = _read(base).service(), _read(document)
    _, _, proven = admitted(plan, None, service, allowed=(), simulated=False, allow_unproven=False, squeeze=0.0)
    assert proven is not None
    return proven, document | {"robot": base["robot"], "scene": base["scene"]}


@contextmanager
def _answering() -> Iterator[Door]:
    """The door of a client whose server answers with forgeries."""
    answers: dict[str, Any] = {}

    class Forging(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def answer(self) -> None:
            self.rfile.read(int(self.headers.get("Content-Length", 0)))
            content = json.dumps(answers.get(self.path, {"version": 1})).encode()
            self.send_response(200)
            self.send_header("Content-Length", str(len(content)))
            self.send_header("Content-Location", "/plans/1")
            self.end_headers()
            self.wfile.write(content)

        do_GET = do_PUT = do_POST = do_DELETE = answer  # noqa: N815

        def log_message(self, *_: object) -> None:
            """Nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Forging) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()

        def door(document: Document, base: Document) -> tuple[Recertified, Document]:
            made = _read(base)
            assert isinstance(made, SavedPlan)
            assert made.request is not None
            answers["/robot"] = {key: base[key] for key in ("robot", "allowed", "edge_step")}
            answers["/plans"] = document
            with Remote(f"http://127.0.0.1:{server.server_port}", made.scene) as remote:
                result = remote.plan(made.request)
            own = {key: base[key] for key in ("robot", "scene", "request")}
            return recertify(result, made.service()), document | own

        try:
            yield door
        finally:
            server.shutdown()


def _table(rows: list[Row]) -> Table:
    lines = [
        {
            "door": door,
            "forgeries": f"{len(group):,}",
            "refused": f"{sum(bool(row['why']) for row in group):,}",
            "passed, true": f"{sum(not row['why'] and not row['false'] for row in group):,}",
            "passed, refuted": f"{sum(bool(row['false']) for row in group):,}",
        }
        for door, group in grouped(rows, "door").items()
    ]
    caption = (
        "true: Pinocchio and Coal find nothing false in what the door has proven of the changed file. Remote is asked "
        "for plans alone, by a server that answers with the forgery"
    )
    return table_of("Forgeries at the library's doors", lines, caption=caption)
