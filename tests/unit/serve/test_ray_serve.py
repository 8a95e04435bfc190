"""The server on a Ray cluster answers every request, also those whose machine is lost."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import pytest

from planner_service import PlannerService, PlanRequest
from planner_service.parallel import Ray
from planner_service.records.plan_file import SavedTask
from planner_service.serve.ray_serve import deployment
from planner_service.serve.run import Settings
from planner_service.tasks import plan_pick_place

TASK = {"scene": "bin", "target": "blue_block", "onto": "tray"}
COUNT = 24


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """A machine for the front with a core, and another one with a core."""
    import ray
    from ray.cluster_utils import Cluster

    head = {"num_cpus": 1, "resources": {"front": 1}, "include_dashboard": False}
    made = Cluster(initialize_head=True, head_node_args=head)
    ray.init(address=made.address, logging_level="ERROR", log_to_driver=False)
    yield made
    ray.shutdown()
    made.shutdown()


@pytest.mark.slow
@pytest.mark.cluster
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # ray's own
def test_every_request_is_answered_once_though_a_machine_is_lost(cluster: Any, tmp_path: Path) -> None:
    from ray import serve

    lost = cluster.add_node(num_cpus=1)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    settings = Settings("wxai", ["bin"], Ray(workers=2), tmp_path / "state", capacity=COUNT)
    serve.start(proxy_location="HeadOnly", http_options={"host": "127.0.0.1", "port": port})
    try:
        serve.run(deployment(settings, port=port, actor_options={"resources": {"front": 1}}), route_prefix="/")
        with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=120.0) as client:

            def answer(seed: int) -> Any:
                response = client.post(
                    "/pick_place", json={**TASK, "request": {"seed": seed}}, headers={"Prefer": "wait"}
                )
                return response.status_code, response.json()

            assert answer(0)[0] == 200
            with ThreadPoolExecutor(COUNT) as threads:
                answers = [threads.submit(answer, seed % 3) for seed in range(COUNT)]
                answers[2].result()
                cluster.remove_node(lost, allow_graceful=False)
                found = [future.result() for future in answers]
            assert client.get("/plans", headers={"Host": f"elsewhere:{port}"}).status_code == 421
            assert len(client.get("/plans").json()["plans"]) == COUNT + 1
    finally:
        serve.shutdown()
    service = PlannerService("wxai", "bin")
    home = service.robot.home
    for seed in range(3):
        task = plan_pick_place(service, "blue_block", "tray", PlanRequest(home, home, seed=seed))
        saved = timeless(json.loads(SavedTask.of(task).file_text()))
        assert all((status, timeless(document)) == (200, saved) for status, document in found[seed::3])


def timeless(value: Any) -> Any:
    """A document without the seconds that something took."""
    if isinstance(value, dict):
        return {key: timeless(entry) for key, entry in value.items() if key != "seconds"}
    return [timeless(entry) for entry in value] if isinstance(value, list) else value
