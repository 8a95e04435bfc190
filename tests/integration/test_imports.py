"""What pyproject.toml's import contracts cannot say: how deep imports go, how large folders are, what loads when."""

from __future__ import annotations

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

import grimp
import pytest

import planner_service

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "planner_service"

MAX_LEVELS = 14
MAX_FILES = 15
MAX_ROOT_NAMES = 60

SLOW = (
    *("yourdfpy", "toppra", "trimesh", "viser", "scipy.optimize", "scipy.sparse", "piqp"),
    *("matplotlib", "lxml", "rich", "typer", "PIL", "trossen_arm", "trossen_arm_sim", "mujoco", "ray"),
    "pydantic",
)
"""Only imported when first used."""

SOURCES = sorted(PACKAGE.rglob("*.py"))


@pytest.fixture(scope="module")
def graph() -> grimp.ImportGraph:
    """Who imports whom, in calls and for types, too."""
    return grimp.build_graph("planner_service", cache_dir=None)


def test_a_walk_from_package_to_package_is_short(graph: grimp.ImportGraph) -> None:
    packages = graph.find_children("planner_service") - {"planner_service.__main__"}
    for package in packages:
        graph.squash_module(package)

    @cache
    def longest(package: str) -> tuple[str, ...]:
        below = (longest(other) for other in graph.find_modules_directly_imported_by(package) - {package})
        return (package, *max(below, key=len, default=()))

    walk = max(map(longest, packages), key=len)
    assert len(walk) <= MAX_LEVELS, walk


def test_no_folder_has_too_many_files() -> None:
    counts = {folder: len(list(folder.glob("*.py"))) for folder in {source.parent for source in SOURCES}}
    assert {folder.name: count for folder, count in counts.items() if count > MAX_FILES} == {}


def test_the_root_has_few_names_and_each_is_there() -> None:
    assert len(planner_service.__all__) <= MAX_ROOT_NAMES
    assert [name for name in planner_service.__all__ if not hasattr(planner_service, name)] == []


def test_no_import_hides_in_a_call() -> None:
    hidden = {"__import__", "import_module", "exec", "eval"}
    found = {
        f"{source.relative_to(PACKAGE)}:{node.lineno}"
        for source in SOURCES
        for node in ast.walk(ast.parse(source.read_text("utf-8")))
        if isinstance(node, ast.Name | ast.Attribute)
        if (node.id if isinstance(node, ast.Name) else node.attr) in hidden
    }
    assert found == set()


@pytest.mark.parametrize("module", ["planner_service", "planner_service.collision"])
def test_importing_brings_nothing_that_is_slow(module: str) -> None:
    ask = f"import sys, {module}; print(*(name for name in {SLOW!r} if name in sys.modules))"
    done = subprocess.run([sys.executable, "-c", ask], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.stdout.strip(), done.stderr, done.returncode) == ("", "", 0)
