"""The built wheel: complete, tidy, and at home anywhere; ``make wheel`` keeps the one that is tested here in dist/."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest
import tomli

ROOT = Path(__file__).resolve().parents[2]
PIP = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
PROJECT = tomli.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = Path(os.environ.get("WHEEL_DIR") or tmp_path_factory.mktemp("wheel"))
    built = f"-Cbuild-dir={ROOT / 'build' / 'native'}"  # where ``make`` compiled: only changes are compiled again
    command = [*PIP, "wheel", "--no-deps", "--no-build-isolation", built, "-w", str(folder), str(ROOT)]
    subprocess.run(command, check=True, capture_output=True)
    return max(folder.glob("*.whl"), key=lambda path: path.stat().st_mtime)


@pytest.fixture(scope="module")
def scripts(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The commands of a fresh virtual environment with the wheel.

    For ``make wheel`` its dependencies are installed, too; in the test suite those of this environment are used.
    """
    folder = tmp_path_factory.mktemp("fresh")
    venv.create(folder, symlinks=True)
    python = folder / "bin" / "python"
    install = [*PIP, "--python", str(python), "install", "-c", str(ROOT / "constraints.txt"), str(wheel)]
    if "WHEEL_DIR" not in os.environ:
        install.append("--no-deps")
        borrowed = [entry for entry in sys.path if Path(entry).is_relative_to(sys.prefix)]
        site_packages = folder / Path(sysconfig.get_path("purelib")).relative_to(sys.prefix)
        (site_packages / "borrowed.pth").write_text("\n".join(borrowed))
    subprocess.run(install, check=True, capture_output=True)
    return folder / "bin"


def test_the_wheel_puts_nothing_but_the_package_into_site_packages(wheel: Path) -> None:
    top = {name.split("/")[0] for name in zipfile.ZipFile(wheel).namelist()}
    assert {name for name in top if not name.endswith(".dist-info")} == {"auditor", "planner_service"}


def test_the_wheel_carries_the_template_of_the_data_card_and_every_robot_and_scene(wheel: Path) -> None:
    inside = set(zipfile.ZipFile(wheel).namelist())
    assert "planner_service/datasets/card.md" in inside
    for kind in ("robots", "scenes"):
        files = [path.relative_to(ROOT) for path in (ROOT / kind).rglob("*") if path.is_file()]
        assert files
        assert {f"planner_service/_data/{path.as_posix()}" for path in files} <= inside


def test_the_wheel_carries_the_page_of_the_server_and_its_licences(wheel: Path) -> None:
    inside = set(zipfile.ZipFile(wheel).namelist())
    page = ROOT / "planner_service" / "serve" / "docs_page"
    files = {path.relative_to(ROOT).as_posix() for path in page.rglob("*") if path.suffix not in ("", ".pyc")}
    assert len(files) >= 6
    assert files <= inside
    licences = {name.partition(".dist-info/licenses/")[2] for name in inside}
    folder = "planner_service/serve/docs_page/swagger-ui"
    assert {f"{folder}/LICENSE", f"{folder}/LICENSE-of-parts", f"{folder}/NOTICE"} <= licences


def test_the_wheel_carries_compiled_code_for_this_platform_and_its_stubs_and_none_of_its_sources(wheel: Path) -> None:
    inside = zipfile.ZipFile(wheel).namelist()
    built = [name.split(".")[0] for name in inside if Path(name).suffix in (".so", ".pyd")]
    assert sorted(built) == ["planner_service/certify/native/_proof", "planner_service/native/_core"]
    assert not wheel.stem.endswith("-any")
    assert {f"{name}.pyi" for name in built} <= set(inside)
    assert not [name for name in inside if name.endswith((".cpp", ".hpp", ".inc"))]


def test_an_installed_wheel_plans_from_the_root_folder_with_its_kernel_and_without_a_compiler(
    scripts: Path, tmp_path: Path
) -> None:
    program = (
        "import planner_service as p; s = p.PlannerService('wxai', 'table'); "
        "print(p.__file__, s.plan(p.PlanRequest(s.robot.home, [0.5, 1.3, 1.0, -0.8, 0.0, 0.0])).ok, "
        "s.checker.instruction_set is not None, p.__version__)"
    )
    place, *words = run_at_the_root([str(scripts / "python"), "-c", program], tmp_path).split()
    assert Path(place).is_relative_to(scripts.parent)
    assert words == ["True", "True", PROJECT["version"]]


def run_at_the_root(command: list[str], empty: Path) -> str:
    """What a command prints that finds no other program and no settings."""
    environment = {"PATH": str(empty), "HOME": str(empty)}
    return subprocess.run(command, cwd="/", env=environment, capture_output=True, text=True, check=True).stdout
