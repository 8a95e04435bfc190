"""The README and the pages of docs/ show what happens, their links lead somewhere, and nothing public is left out.

``WRITE_OUTPUTS=1`` in the environment writes the outputs of today into the pages.
"""

from __future__ import annotations

import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import time
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import unquote, urlsplit

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

import planner_service
from planner_service.cli.commands import app
from planner_service.constraints import toml_reader as constraint_file
from planner_service.constraints import values as constraints
from planner_service.files import json_reader as json_file
from planner_service.files import schema as record
from planner_service.files import toml_reader as toml_file
from planner_service.files import xml_reader as xml_file
from planner_service.gate import log as gate_log
from planner_service.gate import log_reader
from planner_service.geometry import composite, mesh
from planner_service.geometry import mesh_formats as mesh_file
from planner_service.geometry import mesh_paths as mesh_path
from planner_service.geometry.scans import octomap as octomap_file
from planner_service.geometry.scans import pcd as pcd_file
from planner_service.memory import memory
from planner_service.records import plan_file, problem_set
from planner_service.records import steps as step_file
from planner_service.records.problems import moveit_folder
from planner_service.roadmap import roadmap_file
from planner_service.robot import toml_reader as robot_file
from planner_service.robot import urdf_reader as urdf
from planner_service.scene import moveit_scene, scene
from planner_service.scene import toml_reader as scene_file
from planner_service.tasks import steps as task_steps
from tests.support.chromium import executable, headless, new_window

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
IMAGES = DOCS / "images"
RUN_HERE = (
    "README.md",
    *(f"docs/tutorial/{name}.md" for name in ("first-plan", "pick-and-place", "your-own-robot")),
    *(f"docs/guides/{name}.md" for name in ("choosing-a-planner", "robots-and-scenes", "roadmaps", "optimisation")),
    *(f"docs/guides/{name}.md" for name in ("tool-motions", "constraints", "replanning", "when-there-is-no-plan")),
    *(f"docs/guides/{name}.md" for name in ("start-in-collision", "coming-from", "depth-camera", "palletising")),
    *("docs/guides/proofs-for-others.md", "docs/guides/exporting.md", "docs/reference/command-line.md"),
    *("docs/guides/gate.md", "docs/guides/two-arms.md", "docs/guides/tasks.md", "docs/guides/sort-a-bin.md"),
    *("docs/guides/task-constructor.md", "docs/guides/memory.md", "docs/guides/order.md"),
    "docs/guides/reachability.md",
    *(f"docs/explanation/{name}.md" for name in ("concepts", "counting", "timing", "how-it-works", "background")),
)
"""Pages whose Python and commands are run below; other pages are with the tests of what they are about."""

BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", flags=re.DOTALL | re.MULTILINE)
NARROW = 390
"""Pixels: the width of a telephone."""

SECONDS = re.compile(r" +(?:in )?[\d.,]+(?: s)?$")
"""What a line of a command's table ends with."""


def exactly(text: str) -> list[str]:
    return [line.rstrip() for line in text.splitlines()]


def without_seconds(text: str) -> list[str]:
    return [SECONDS.sub("", line) for line in exactly(text)]


def printed_by(command: str, capsys: pytest.CaptureFixture[str]) -> str:
    """What a line of a page prints; nothing if it is not one of ours to run."""
    if command.startswith("planner-service "):
        done = CliRunner(env={"COLUMNS": "100"}).invoke(app, shlex.split(command)[1:])
        assert (command, done.exit_code) == (command, 0)
        return done.stdout
    if command.startswith("python examples/"):
        runpy.run_path(str(ROOT / command.split()[1]), run_name="__main__")
    return capsys.readouterr().out


def with_outputs_of_today(name: str, page: str, capsys: pytest.CaptureFixture[str]) -> str:
    """A page whose ``text`` blocks hold what the block above them prints now."""
    names: dict[str, Any] = {}
    printed, lines, pieces, end = "", exactly, list[str](), 0
    for block in BLOCK.finditer(page):
        language, content = block.groups()
        if language == "text":
            known = dict(zip(lines(content), content.splitlines(), strict=True))  # seconds stay as they are on the page
            now = [known.get(plain, line) for plain, line in zip(lines(printed), exactly(printed), strict=True)]
            pieces += [page[end : block.start(2)], "".join(f"{line}\n" for line in now)]
            printed, end = "", block.end(2)
        elif language == "python":
            exec(compile(content, name, "exec"), names)
            printed, lines = capsys.readouterr().out, exactly
        elif language == "console":
            commands = re.findall(r"^\$ (.*?)(?: +#.*)?$", content, flags=re.MULTILINE)
            printed = "".join(printed_by(command, capsys) for command in commands)
            ours = any(command.startswith("planner-service ") for command in commands)
            lines = without_seconds if ours else exactly  # examples print no time that it took
    assert end > 0
    return "".join(pieces) + page[end:]


@pytest.mark.parametrize("name", RUN_HERE)
def test_what_a_page_shows_is_what_happens(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(ROOT / "examples" / "desk_arm.urdf", tmp_path)
    monkeypatch.chdir(tmp_path)
    # on a busy machine tasks that fail, which are looked at in full, would reach their time limit
    monkeypatch.setattr("planner_service.tasks.motions.time", SimpleNamespace(monotonic=time.thread_time))
    page = (ROOT / name).read_text(encoding="utf-8")
    today = with_outputs_of_today(name, page, capsys)
    if "WRITE_OUTPUTS" in os.environ:  # to take over what changed on purpose; read the diff
        (ROOT / name).write_text(today, encoding="utf-8")
    assert page.splitlines() == today.splitlines()
    pictures = {Path(image).name for image in re.findall(r"\]\((\S+\.png)\)", page)}
    for drawn in tmp_path.glob("*.png"):
        if drawn.name in pictures:
            assert_is_shown(drawn)


def assert_is_shown(drawn: Path) -> None:
    """That a picture is the one of the pages; ``WRITE_OUTPUTS=1`` makes it that."""
    if "WRITE_OUTPUTS" in os.environ:
        (IMAGES / drawn.name).write_bytes(drawn.read_bytes())
    with Image.open(drawn) as today, Image.open(IMAGES / drawn.name) as shown:
        assert np.array_equal(np.asarray(today), np.asarray(shown)), drawn.name


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 120


class Page(HTMLParser):
    """What a built page links to, what it loads, and the places in it that can be linked to."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.ids: list[str] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name == "id" and value:
                self.ids.append(value)
            elif name == "href" and value:
                (self.links if tag == "a" else self.loaded).append(value)
            elif name == "src" and value:
                self.loaded.append(value)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> dict[Path, Page]:
    """The pages of the site, built strictly: a link, an anchor or a page that is missing is an error."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return {path: Page(path) for path in sorted(folder.rglob("*.html"))}


def test_every_link_leads_to_a_page_and_a_place_in_it(site: dict[Path, Page]) -> None:
    astray, followed = [], 0
    for path, page in site.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or path.name == "404.html":  # that page is served from anywhere, and its links are absolute
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            place = unquote(parts.fragment)
            found = target.exists() and (not place or place in site[target].ids)
            astray += [] if found else [f"{path.name}: {link}"]
            followed += 1
    assert astray == []
    assert followed > 1000


def test_pages_load_nothing_from_elsewhere(site: dict[Path, Page]) -> None:
    assert {url for page in site.values() for url in page.loaded if urlsplit(url).netloc} == set()
    text = "".join(path.read_text(encoding="utf-8") for path in site)
    assert re.findall(r"(?:@import|url\()[^)]*https?://", text) == []


def test_the_reference_has_every_public_name_once(site: dict[Path, Page]) -> None:
    public = {f"planner_service.{name}" for name in planner_service.__all__}
    pages = [page for path, page in site.items() if path.parent.name == "reference"]
    assert sorted(place for page in pages for place in page.ids if place in public) == sorted(public)


@pytest.mark.browser
@pytest.mark.slow
@pytest.mark.skipif(executable() is None, reason="needs Chromium")
def test_code_stays_in_its_block_and_pages_on_a_narrow_screen(site: dict[Path, Page]) -> None:
    measured = """[document.documentElement.scrollWidth, ...[...document.querySelectorAll("pre > code")]
                   .map(code => [code.scrollWidth - code.clientWidth, code.innerText])]"""
    with headless() as browser:
        window = new_window(browser, viewport={"width": NARROW, "height": 800})
        for path in site:
            window.goto(path.as_uri())
            wide, *blocks = window.evaluate(measured)
            assert (path.name, wide, [text for over, text in blocks if over > 0]) == (path.name, NARROW, [])


@pytest.mark.parametrize(
    ("page", "begin", "end"),
    [("docs/index.md", '<div class="figures">', "<p>"), ("README.md", "- **Fast.**", "- **Every")],
)
def test_the_figures_that_a_first_page_shows_are_among_all_figures(page: str, begin: str, end: str) -> None:
    shown, figures = ((ROOT / name).read_text(encoding="utf-8") for name in (page, "docs/figures/measured.md"))
    numbers = re.findall(r"\d[\d,.]*\d", shown.split(begin)[1].split(end)[0])
    assert len(numbers) >= 4
    assert [each for each in numbers if not re.search(rf"(?<![\d.,]){re.escape(each)}(?!\d)", figures)] == []


CAPS: dict[str, tuple[int, ...]] = {
    "`robot.toml`": (robot_file.MAX_BYTES, toml_file.MAX_KEY_PARTS),
    "Scene (TOML)": (scene_file.MAX_BYTES, scene.MAX_OBJECTS, toml_file.MAX_KEY_PARTS),
    "Constraints (TOML)": (constraint_file.MAX_BYTES, constraints.MAX_CONSTRAINTS, toml_file.MAX_KEY_PARTS),
    "MoveIt `.scene`": (moveit_scene.MAX_BYTES, scene.MAX_OBJECTS, moveit_scene.MAX_LINE),
    "URDF, SRDF, SDF": (xml_file.MAX_XML_BYTES, *[urdf.MAX_ELEMENTS] * 2, xml_file.MAX_ELEMENTS, xml_file.MAX_DEPTH),
    "Mesh (STL, OBJ, PLY, COLLADA, GLB)": (
        *(mesh_file.MAX_BYTES, mesh_file.MAX_VERTICES, mesh_file.MAX_TRIANGLES),
        *(mesh.MAX_HULL, xml_file.MAX_DEPTH),
    ),
    "Points (PLY, PCD, XYZ, LAS, LAZ, NPY, NPZ)": (
        *(mesh_file.MAX_BYTES, pcd_file.MAX_POINTS, mesh_file.MAX_VERTICES),
        composite.MAX_CELLS,
    ),
    "OctoMap (`.bt`, `.ot`)": (
        *(mesh_file.MAX_BYTES, octomap_file.MAX_NODES, octomap_file.MAX_CELLS),
        octomap_file.DEPTH,
    ),
    "All meshes and clouds of one robot or scene": (mesh_path.MAX_TOTAL,),
    "Plan or task (JSON)": (
        *(json_file.MAX_BYTES, json_file.MAX_PARTS, json_file.MAX_KEYS),
        *(plan_file.MAX_SEGMENTS, record.MAX_WAYPOINTS, plan_file.MAX_DEPTH),
    ),
    "Problem set (MotionBenchMaker)": (
        *(moveit_folder.MAX_BYTES, moveit_folder.MAX_ARCHIVE),
        *(problem_set.MAX_PROBLEMS, moveit_folder.MAX_ENTRIES),
    ),
    "Problem set (JSON, YAML)": (
        *(json_file.MAX_BYTES, problem_set.MAX_PROBLEMS),
        *(problem_set.MAX_GOALS, scene.MAX_OBJECTS),
    ),
    "Steps of a task (JSON)": (
        *(json_file.MAX_BYTES, task_steps.MAX_STEPS, task_steps.MAX_POSES),
        step_file.MAX_DEPTH,
    ),
    "Log of a gate (JSON lines)": (gate_log.MAX_LOG, log_reader.MAX_LINES),
    "Roadmap": (roadmap_file.MAX_BYTES,),
    "Memory (JSON)": (json_file.MAX_BYTES, memory.MAX_MOTIONS, memory.MAX_GRIPS, memory.MAX_WAYPOINTS),
}


def test_the_caps_of_files_are_those_in_force() -> None:
    page = (DOCS / "explanation" / "limitations.md").read_text(encoding="utf-8")
    table = page.split("## Files\n")[1].split("\n## ")[0]
    rows = dict(re.findall(r"^\| ([^|]+) \| (.*) \|$", table, flags=re.MULTILINE))
    told = {kind: tuple(int(n.replace(",", "")) for n in re.findall(r"\d[\d,]*\d|\d", rows[kind])) for kind in CAPS}
    assert told == CAPS
    assert len(rows) == len(CAPS) + 1  # the head; the line below it has no spaces
