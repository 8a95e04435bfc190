"""The guide to the server shows what a server answers.

``WRITE_OUTPUTS=1`` in the environment writes the outputs of today into the page.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.support.command import run
from tests.support.served import served

PAGE = Path(__file__).parents[2] / "docs" / "guides" / "server.md"
SHOWN_AT = "http://localhost:8080"
BLOCK = re.compile(r"^```console\n(.*?)^```\n", re.MULTILINE | re.DOTALL)
CHANNEL = re.compile(r"^```python\n(import msgpack\n.*?)^```\n", re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"^\$ (?:.*\\\n)*.*\n", re.MULTILINE)


def answered(command: str, url: str, folder: Path) -> str:
    """What a command of the page prints."""
    text, _, rest = command.removeprefix("$ ").replace(SHOWN_AT, url).partition(" | ")
    if text.startswith("planner-service "):
        text, given = rest or "cat", run(*shlex.split(text)[1:]).stdout
    else:
        text, given = f"{text} | {rest}" if rest else text, ""
    done = subprocess.run(
        ["bash", "-c", text], cwd=folder, input=given, capture_output=True, text=True, check=True, timeout=120
    )
    return done.stdout if done.stdout.endswith("\n") or not done.stdout else f"{done.stdout}\n"


@pytest.mark.slow
def test_the_guide_to_the_server_shows_its_answers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    page = PAGE.read_text(encoding="utf-8")
    with served(tmp_path, "--robot", "wxai", "--scene", "bin", "--workers", "1") as url:

        def of_today(block: re.Match[str]) -> str:
            commands = COMMAND.findall(block[1])
            if not any(SHOWN_AT in command for command in commands):
                return block[0]
            lines = "".join(command + answered(command, url, tmp_path) for command in commands)
            return f"```console\n{lines}```\n"

        today = BLOCK.sub(of_today, page)
        found = CHANNEL.search(page)
        assert found is not None
        names: dict[str, Any] = {}
        exec(found[1].replace(SHOWN_AT.replace("http", "ws"), url.replace("http", "ws")), names)
        assert names["reply"]["status"] == 200
    if "WRITE_OUTPUTS" in os.environ:  # to take over what changed on purpose; read the diff
        PAGE.write_text(today, encoding="utf-8")
    assert page.splitlines() == today.splitlines()
