"""Interrupts and kills at random moments: files are whole or absent, and the next plan is the same to the last bit."""

from __future__ import annotations

import _thread
import gc
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import MISSING, fields, is_dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

import planner_service as ps
from benchmarks.attack.harness import Case, Part, Wrong
from benchmarks.attack.threads import Reference, digest
from planner_service.parallel import Processes
from planner_service.records import load_plan

__all__ = ["Attack"]

SAFE = 20.0
"""Seconds that the next plan may take: beyond, something is still held."""

FRAGILE = "AORRTC"
"""The planner of OMPL whose destructor crashes when it was not set up: half of the planners drawn."""

SMALL = {"checks": 60, "milestones": 8, "samples": 20}
"""Settings with which planners are quick, so that much of a plan is making and ending them."""

ENDS = ("interrupted", "Ctrl-C reaches the caller", "after Ctrl-C a plan is the same", "Ctrl-C is no other error")
"""The exit codes of a process that was interrupted: how it should be, and the laws that others break."""

FIRST = """
import planner_service as ps
from planner_service.planners import AORRTC
ps.PlannerService("planar2", "discs").plan(ps.PlanRequest((-2.5, 2.0), (2.2, -2.2), planner=AORRTC(checks=60)))
"""
"""A process's first plan, with all that it imports."""


def _planners() -> dict[str, Any]:
    """Every planner whose settings have defaults, by its name, small."""
    made = {}
    for name in ps.planners.__all__:
        kind = getattr(ps.planners, name)
        if is_dataclass(kind) and all(one.default is not MISSING for one in fields(kind)):
            made[name] = getattr(ps.planners, name)(
                **{one.name: SMALL[one.name] for one in fields(kind) if one.name in SMALL}
            )
    return made


class Attack(Part):
    name = "kill"
    what = "Ctrl-C in imports, every planner and the proof; SIGKILL of processes that write files and of workers"
    limit = 60.0

    @cached_property
    def _known(self) -> tuple[Reference, float]:
        """What plans are to be, and the seconds that one takes."""
        known = Reference.of("post")
        clock = time.perf_counter()
        known.service.plan(known.requests[0])
        return known, time.perf_counter() - clock

    @cached_property
    def _asked(self) -> tuple[ps.PlannerService, dict[str, tuple[ps.PlanRequest, Any, float]]]:
        """A service, and by planner a request, what its plan is to be, and the seconds that it takes."""
        service, asked = ps.PlannerService("planar2", "discs"), {}
        for name, planner in _planners().items():
            request = ps.PlanRequest((-2.5, 2.0), (2.2, -2.2), planner=planner, time_limit=None, max_checks=20_000)
            service.plan(request)
            clock = time.perf_counter()
            asked[name] = request, digest(service.plan(request)), time.perf_counter() - clock
        return service, asked

    def draw(self, rng: np.random.Generator) -> Case:
        kinds = ("planner", "plan", "certify", "check", "write", "worker", "import")
        what = str(rng.choice(kinds, p=(0.5, 0.2, 0.1, 0.05, 0.12, 0.01, 0.02)))
        planner = FRAGILE if rng.random() < 0.5 else str(rng.choice(sorted(_planners())))
        return {"what": what, "planner": planner, "when": float(rng.random()), "number": int(rng.integers(8))}

    def run(self, case: Case) -> None:
        if case["what"] == "planner":
            self._planner(case["planner"], case["when"])
            return
        if case["what"] == "import":
            self._first(case["when"])
            return
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

    def _planner(self, name: str, when: float) -> None:
        """A child plans again and again until Ctrl-C comes; then it plans once more."""
        service, asked = self._asked
        request, same, seconds = asked[name]
        child = os.fork()
        if child == 0:
            code = len(ENDS) - 1
            try:
                code = _struck(ps.PlannerService(service.robot, service.scene), request, same, 2.0 * seconds * when)
            finally:
                os._exit(code)
        _, status = os.waitpid(child, 0)
        if os.WIFSIGNALED(status):
            raise Wrong("Ctrl-C ends no process with a crash", f"{name}: signal {os.WTERMSIG(status)}")
        if code := os.WEXITSTATUS(status):
            raise Wrong(ENDS[code], name)
        self.counted[f"{name} interrupted"] += 1

    def _first(self, when: float) -> None:
        """A new process imports everything and plans, and SIGINT comes somewhere in between."""
        command = [sys.executable, "-c", FIRST]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as child:
            try:
                _, told = child.communicate(timeout=3.0 * when)
            except subprocess.TimeoutExpired:
                child.send_signal(signal.SIGINT)
                _, told = child.communicate()
        if child.returncode not in (0, 1, -signal.SIGINT):
            raise Wrong("Ctrl-C ends no process with a crash", f"a first plan: exit code {child.returncode}")
        last = told.strip().rpartition("\n")[2]
        if child.returncode == 1 and not last.startswith("KeyboardInterrupt"):
            raise Wrong(ENDS[3], f"a first plan: {last[:200]}")
        self.counted["first plans ended"] += child.returncode != 0

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
                        ps.save_scene(service.scene, folder / "scene.toml")
                        memory.save(folder / "memory.npz")
                        result.save(folder / "plan.json")
                finally:
                    os._exit(1)
            time.sleep(0.05 + 0.2 * when)
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            self.counted["writers killed"] += 1
            for file, read in (
                ("scene.toml", ps.load_scene),
                ("memory.npz", ps.Roadmap.load),
                ("plan.json", load_plan),
            ):
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


def _struck(service: ps.PlannerService, request: ps.PlanRequest, same: Any, after: float) -> int:
    """Plan until a signal raises KeyboardInterrupt, as Ctrl-C would; the exit code of this process, see ``ENDS``."""
    came = []

    def strike(*_: object) -> None:
        came.append(True)
        raise KeyboardInterrupt

    service.plan(request)  # a first plan prepares more than a later one
    try:
        signal.signal(signal.SIGALRM, strike)
        signal.setitimer(signal.ITIMER_REAL, max(after, 1e-6))
        while not came:
            service.plan(request)
        return 1
    except KeyboardInterrupt:
        gc.collect()  # what still lives in cycles ends here, and crashes here if it does
    return 0 if digest(service.plan(request)) == same else 2


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
