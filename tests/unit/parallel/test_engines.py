"""Engines: items through one work, in order, whatever becomes of workers."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from planner_service.errors import BrokenInvariant, InvalidRequest
from planner_service.parallel import Engine, InWorker, Lost, Processes, Ray, Sequential
from planner_service.parallel.engine import LOOK_AHEAD
from tests.support.optional import present
from tests.support.parallel_work import Echo, Faulty, Stillborn

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Two machines with a core each, as far as Ray knows."""
    import ray
    from ray.cluster_utils import Cluster

    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    made.add_node(num_cpus=1)
    ray.init(address=made.address, logging_level="ERROR", log_to_driver=False)
    yield made
    ray.shutdown()
    made.shutdown()


@pytest.fixture(params=["sequential", "processes", pytest.param("ray", marks=pytest.mark.ray)])
def engine(request: pytest.FixtureRequest) -> Engine:
    if request.param == "ray":
        request.getfixturevalue("cluster")
        return Ray()
    return Processes(2) if request.param == "processes" else Sequential()


@pytest.fixture(params=["processes", pytest.param("ray", marks=pytest.mark.ray)])
def workers(request: pytest.FixtureRequest) -> Engine:
    """An engine with workers that may be lost."""
    if request.param == "ray":
        request.getfixturevalue("cluster")
        return Ray()
    return Processes(2)


def without_end(taken: list[int]) -> Iterator[int]:
    """Items, which are also remembered as they are taken."""
    while True:
        taken.append(len(taken))
        yield taken[-1]


@pytest.mark.slow
def test_items_without_end_are_taken_as_they_are_needed_and_answered_in_order(engine: Engine) -> None:
    taken: list[int] = []
    with closing(engine.run(Echo(), without_end(taken))) as answers:
        found = [next(answers) for _ in range(300)]
    assert [(index, answer[0]) for index, answer in found if not isinstance(answer, Lost)] == [
        (k, k) for k in range(300)
    ]
    assert len(taken) <= 300 + 2 * LOOK_AHEAD


# --- faults


@pytest.mark.slow
def test_an_item_that_ends_its_worker_is_tried_twice_one_over_its_limit_once_and_both_are_lost_alone(
    workers: Engine, tmp_path: Path
) -> None:
    work = Faulty(tmp_path / "log", {3: "segfault", 8: "spin"})
    answers = dict(workers.run(work, range(12), limit=lambda item: 0.5 if item == 8 else None))
    ended, late = answers.pop(3), answers.pop(8)
    assert isinstance(ended, Lost)
    assert isinstance(late, Lost)
    assert (ended.over_limit, late.over_limit) == (False, True)
    assert ended.detail.startswith("two workers were lost; ")
    assert answers == {k: k * k for k in range(12) if k not in (3, 8)}
    assert work.tries() == {k: 2 if k == 3 else 1 for k in range(12)}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "told"),
    [
        *(("exit", "exit code 3"), ("memory", "out of memory")),
        *(("hang up", "it closed its connection"), ("leave a child", "exit code 3")),
    ],
)
def test_what_became_of_a_worker_is_told(fault: str, told: str, tmp_path: Path) -> None:
    [(_, lost)] = Processes(1).run(Faulty(tmp_path / "log", {0: fault}), [0], limit=lambda _: 30.0)
    assert isinstance(lost, Lost)
    assert told in lost.detail


@pytest.mark.slow
def test_a_worker_that_is_killed_costs_nobody_an_answer(workers: Engine) -> None:
    killed: set[int] = set()
    items = []
    for index, answer in workers.run(Echo(), range(400)):
        assert not isinstance(answer, Lost)
        items.append((index, answer[0]))
        if len(killed) < 1:
            killed.add(answer[1])
            os.kill(answer[1], signal.SIGKILL)
    assert items == [(k, k) for k in range(400)]


@pytest.mark.slow
def test_an_error_comes_back_as_itself_in_its_turn_with_its_index(engine: Engine, tmp_path: Path) -> None:
    answers = engine.run(Faulty(tmp_path / "log", {2: "bug"}), range(6))
    assert [next(answers), next(answers)] == [(0, 0), (1, 1)]
    with pytest.raises(ZeroDivisionError, match="our bug") as raised:
        next(answers)
    cause = raised.value.__cause__
    assert isinstance(cause, InWorker)
    assert cause.index == 2
    assert list(answers) == []


@pytest.mark.slow
def test_workers_that_never_become_ready_are_not_started_for_ever() -> None:
    answers = Processes(2).run(Stillborn(), range(5))
    with pytest.raises(BrokenInvariant, match=r"3 workers ended before they were ready; .* exit code 7"):
        next(answers)


@pytest.mark.slow
def test_what_cannot_be_sent_is_named() -> None:
    answers = Processes(1).run(Echo(), [lambda: 0])
    with pytest.raises(InvalidRequest, match=r"^item: .*lambda.* cannot be sent to a worker"):
        next(answers)


@pytest.mark.slow
@pytest.mark.ray
def test_a_lost_machine_is_nobodys_fault(cluster: Any, tmp_path: Path) -> None:
    work = Faulty(tmp_path / "log", {}, seconds=0.02)
    lost = cluster.add_node(num_cpus=1)
    answers = []
    for answer in Ray().run(work, range(150)):
        answers.append(answer)
        if len(answers) == 60:
            cluster.remove_node(lost, allow_graceful=False)
    assert answers == [(k, k * k) for k in range(150)]


# --- from a script


def script(text: str, folder: Path) -> subprocess.Popen[str]:
    (folder / "script.py").write_text(text, "utf-8")
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-u", str(folder / "script.py")]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)


def is_gone(process: int) -> bool:
    """Whether a process has ended, be it that nobody asked for its exit code yet."""
    try:
        return (Path("/proc") / str(process) / "stat").read_text("utf-8").rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True


def wait_for(condition: Callable[[], bool]) -> None:
    for _ in range(600):
        if condition():
            return
        time.sleep(0.05)
    pytest.fail("half a minute was not enough")


INTERRUPTED = """\
from itertools import count
from tests.support.parallel_work import Echo
from planner_service.parallel import Processes

answers = Processes(2).run(Echo(), count())
try:
    for index, (_, process) in answers:
        print(process, flush=True)
except KeyboardInterrupt:
    answers.close()
    kept = answers.finished
    print("kept", all(k >= index and answer[0] == k for k, answer in kept.items()), len(kept) <= 129)
"""


@pytest.mark.slow
def test_ctrl_c_ends_the_workers_and_keeps_what_is_finished(tmp_path: Path) -> None:
    with script(INTERRUPTED, tmp_path) as running:
        assert running.stdout is not None
        processes = {int(running.stdout.readline()) for _ in range(200)}
        running.send_signal(signal.SIGINT)
        told, errors = running.communicate()
    *rest, last = told.split("\n")[:-1]
    assert (last, errors, running.returncode) == ("kept True True", "", 0)
    wait_for(lambda: all(map(is_gone, [*processes, *map(int, rest)])))


ORPHANED = """\
import os, time
from tests.support.parallel_work import Faulty
from planner_service.parallel import Processes
from pathlib import Path

class Work(Faulty):
    pass

for index, answer in Processes(1).run(Faulty(Path("{log}"), {{1: "spin"}}), [0, 1]):
    import subprocess
    children = Path(f"/proc/self/task/{{os.getpid()}}/children").read_text()
    print(children, flush=True)
"""


@pytest.mark.slow
def test_workers_end_with_the_process_that_started_them_even_in_native_code(tmp_path: Path) -> None:
    log = tmp_path / "log"
    with script(ORPHANED.format(log=log), tmp_path) as running:
        processes = [int(word) for word in present(running.stdout).readline().split()]
        wait_for(lambda: "1" in log.read_text("utf-8").split())
        assert processes
        assert not any(map(is_gone, processes))
        running.kill()
    wait_for(lambda: all(map(is_gone, processes)))
