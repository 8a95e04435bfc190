"""The built wheel: complete, tidy, and at home anywhere."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    command = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--quiet",
        "--no-deps",
        "--no-build-isolation",
        "-w",
        str(folder),
        ".",
    ]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    return next(folder.glob("*.whl"))


def test_the_wheel_puts_nothing_but_the_package_into_site_packages(wheel: Path) -> None:
    top = {name.split("/")[0] for name in zipfile.ZipFile(wheel).namelist()}
    assert {name for name in top if not name.endswith(".dist-info")} == {"planner_service"}


def test_the_wheel_carries_every_robot_and_scene(wheel: Path) -> None:
    inside = set(zipfile.ZipFile(wheel).namelist())
    for kind in ("robots", "scenes"):
        files = [path.relative_to(ROOT) for path in (ROOT / kind).rglob("*") if path.is_file()]
        assert files
        assert {f"planner_service/_data/{path.as_posix()}" for path in files} <= inside


def test_the_wheel_carries_compiled_code_for_this_platform_and_its_stubs_and_none_of_its_sources(wheel: Path) -> None:
    inside = zipfile.ZipFile(wheel).namelist()
    built = [name.split(".")[0] for name in inside if Path(name).suffix in (".so", ".pyd")]
    assert sorted(built) == ["planner_service/certify/_proof", "planner_service/collision/_kernel"]
    assert not wheel.stem.endswith("-any")
    assert {f"{name}.pyi" for name in built} <= set(inside)
    assert not [name for name in inside if "/native/" in name or name.endswith((".cpp", ".hpp", ".inc"))]


def test_an_installed_wheel_plans_from_the_root_folder_with_its_kernel_and_without_a_compiler(
    wheel: Path, tmp_path: Path
) -> None:
    zipfile.ZipFile(wheel).extractall(tmp_path)
    program = (
        "import sys; sys.meta_path = [f for f in sys.meta_path if 'editable' not in type(f).__module__]; "
        "import planner_service as p; s = p.PlannerService('wxai', 'table'); "
        "print(p.__file__, s.plan(p.PlanRequest(s.robot.home, [0.5, 1.3, 1.0, -0.8, 0.0, 0.0])).ok, "
        "s.checker.instruction_set is not None)"
    )
    environment = {**os.environ, "PYTHONPATH": str(tmp_path), "PATH": str(tmp_path / "nothing")}
    done = subprocess.run(
        [sys.executable, "-c", program], cwd="/", env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == [str(tmp_path / "planner_service" / "__init__.py"), "True", "True"]
