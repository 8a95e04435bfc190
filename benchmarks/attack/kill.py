"""Interrupts and kills at random moments: files are whole or absent, and the next plan is the same to the last bit."""

from __future__ import annotations

import _thread
import os
import signal
import tempfile
import threading
import time
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.attack.harness import Case, Part, Wrong
from benchmarks.attack.threads import Reference, digest
from planner_service import Roadmap, load_scene, save_scene
from planner_service.parallel import Processes
from planner_service.records.plan_file import load_plan

__all__ = ["Attack"]

SAFE = 20.0
"""Seconds that the next plan may take: beyond, something is still held."""


class Attack(Part):
    name = "kill"
    what = "KeyboardInterrupt while planning and certifying; SIGKILL of processes that write files and of workers"
    limit = 60.0

    @cached_property
    def _known(self) -> tuple[Reference, float]:
        """What plans are to be, and the seconds that one takes."""
        known = Reference.of("post")
        clock = time.perf_counter()
        known.service.plan(known.requests[0])
        return known, time.perf_counter() - clock

    def draw(self, rng: np.random.Generator) -> Case:
        what = str(rng.choice(("plan", "certify", "check", "write", "worker"), p=(0.5, 0.15, 0.1, 0.23, 0.02)))
        return {"what": what, "when": float(rng.random()), "number": int(rng.integers(8))}

    def run(self, case: Case) -> None:
        known, seconds = self._known
        service, asked = known.service, known.requests
        number = case["number"] % len(asked)
        if case["what"] == "write":
            self._write(case["when"])
            return
        if case["what"] == "worker":
            self._workers(case["when"])
            return
        path = service.plan(asked[number]).path
        works = {
            "plan": lambda: service.plan(asked[number]),
            "certify": lambda: path is not None and [service.certify(path) for _ in range(4)],
            "check": lambda: service.checker.states_are_free(np.repeat([asked[0].start], 4000, axis=0)),
        }
        self.counted["interrupted" if _interrupted(works[case["what"]], 1.5 * seconds * case["when"]) else "done"] += 1
        clock = time.perf_counter()
        known.require_same(number, "after an interrupt a plan is the same")
        if time.perf_counter() - clock > SAFE:
            raise Wrong("after an interrupt a plan takes no longer")

    def _write(self, when: float) -> None:
        """A child writes files without end, and is killed; each is whole, or absent, and is read."""
        service = self._known[0].service
        result = service.plan(self._known[0].requests[0])
        memory = service.path_memory()
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            child = os.fork()
            if child == 0:
                try:
                    while True:
                        save_scene(service.scene, folder / "scene.toml")
                        memory.save(folder / "memory.npz")
                        result.save(folder / "plan.json")
                finally:
                    os._exit(1)
            time.sleep(0.05 + 0.2 * when)
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            self.counted["writers killed"] += 1
            for file, read in (("scene.toml", load_scene), ("memory.npz", Roadmap.load), ("plan.json", load_plan)):
                if (folder / file).exists():
                    try:
                        read(folder / file)
                    except Exception as error:
                        raise Wrong("a file is whole or absent", f"{file}: {error}") from None

    def _workers(self, when: float) -> None:
        """A worker of a batch is killed; the batch is the same."""
        (known, _), before = self._known, set(_children())

        def shoot() -> None:
            time.sleep(1.0 + 2.0 * when)
            for pid in set(_children()) - before:
                os.kill(pid, signal.SIGKILL)
                self.counted["workers killed"] += 1
                return

        thread = threading.Thread(target=shoot, daemon=True)
        thread.start()
        found = known.service.plan_many(known.requests * 3, engine=Processes(2), progress=False)
        thread.join()
        if [digest(result) for result in found] != known.digests * 3:
            raise Wrong("a batch whose worker was killed is the same")


def _children() -> list[int]:
    tasks = Path(f"/proc/{os.getpid()}/task")
    return [int(pid) for task in tasks.iterdir() for pid in (task / "children").read_text().split()]


def _interrupted(work: Any, seconds: float) -> bool:
    """Whether work was interrupted, as by Ctrl-C, so many seconds after it began."""
    armed = threading.Event()

    def fire() -> None:
        if not armed.wait(seconds):
            _thread.interrupt_main()

    signal.signal(signal.SIGINT, signal.default_int_handler)
    thread = threading.Thread(target=fire, daemon=True)
    try:
        thread.start()
        work()
        armed.set()
        thread.join()
        for _ in range(100):  # one that came just now
            pass
    except KeyboardInterrupt:
        armed.set()
        return True
    return False
