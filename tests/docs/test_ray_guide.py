"""From ``ray start --head`` to the first answer: what the guide to the server says is done as it is written."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "guides" / "server.md"
PORTS = ("6379", "8080")


@pytest.mark.slow
@pytest.mark.ray
def test_a_cluster_is_started_and_answers_as_the_guide_says(tmp_path: Path) -> None:
    blocks: list[str] = re.findall(r"^```sh\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    (lines,) = [block for block in blocks if "ray start --head" in block]
    for port in PORTS:
        assert lines.count(port) >= 2
        with socket.create_server(("127.0.0.1", 0)) as free:
            lines = lines.replace(port, str(free.getsockname()[1]))
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    command = ["bash", "-e", "-m", "-c", lines]
    with subprocess.Popen(
        command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, text=True, start_new_session=True
    ) as shell:
        try:
            said, _ = shell.communicate(timeout=240)
        finally:
            if shell.poll() is None:
                os.killpg(shell.pid, signal.SIGKILL)
    assert said.startswith("certified: plan.json with wxai in bin\n")
    assert shell.returncode == 0
