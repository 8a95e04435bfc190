"""A xacro file is the robot that its macros make, and can neither read nor run anything else."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from planner_service.errors import InvalidFile
from planner_service.robot.macros import expansion
from planner_service.robot.urdf_reader import read_urdf

pytest.importorskip("xacro")

NAMESPACE = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
LINK = '<link name="base"/>'


def xacro(*parts: str) -> str:
    return f'<robot name="r" {NAMESPACE}>{"".join(parts)}</robot>'


def written(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, "utf-8")
    return path


def links(path: Path, *folders: Path) -> list[str]:
    return [link.name for link in read_urdf(path, folders).links]


def test_macros_properties_and_defaults_of_arguments_make_the_robot(tmp_path: Path) -> None:
    arm = xacro(
        '<xacro:arg name="prefix" default="left"/><xacro:property name="n" value="${2 * 3 - len([1, 2])}"/>',
        '<xacro:macro name="one" params="name"><link name="$(arg prefix)_${name}_${n}"/></xacro:macro>',
        '<xacro:one name="base"/>',
    )
    assert links(written(tmp_path / "arm.urdf.xacro", arm)) == ["left_base_4"]


def test_a_file_of_its_package_and_numbers_in_yaml_are_found(tmp_path: Path) -> None:
    package = tmp_path / "folder_of_another_name"
    written(package / "package.xml", "<package><name>my_arm</name></package>")
    written(package / "config" / "names.yaml", "first: shoulder\n")
    macro = "<link name=\"${xacro.load_yaml('$(find my_arm)/config/names.yaml')['first']}\"/>"
    written(package / "urdf" / "macro.xacro", xacro(f'<xacro:macro name="arm" params="">{macro}</xacro:macro>'))
    user = xacro('<xacro:include filename="$(find my_arm)/urdf/macro.xacro"/><xacro:arm/>')
    assert links(written(package / "urdf" / "user.xacro", user), package) == ["shoulder"]


@pytest.mark.parametrize(
    "expression",
    ["(lambda: ().__class__.__bases__[0].__subclasses__())()", "(x for x in [1]).gi_frame.f_back", "'a'.format(1)"],
)
def test_an_expression_that_does_more_than_compute_is_refused(tmp_path: Path, expression: str) -> None:
    path = written(tmp_path / "arm.xacro", xacro(LINK, f'<link name="${{{expression}}}"/>'))
    with pytest.raises(InvalidFile, match="is not allowed: it does more than compute"):
        read_urdf(path)


@pytest.mark.parametrize(
    ("part", "problem"),
    [
        ('<xacro:include filename="/etc/passwd"/>', "/etc/passwd lies outside the folders that may be read"),
        ('<xacro:include filename="link.xacro"/>', "link.xacro lies outside"),
        ("<link name=\"${xacro.load_yaml('/etc/hostname')}\"/>", "/etc/hostname lies outside"),
        (
            "<link name=\"$(eval open('/etc/passwd').read())\"/>",
            r"arm\.xacro, line 1: name 'open' is not defined, in \"open",
        ),
        ("<link name=\"${python.vars(python.type)['__base__']}\"/>", "no key|vars|not defined|python"),
        ('<link name="$(env HOME)"/>', "environment variable 'HOME' is not set"),
        ('<link name="${[0] * 10**10}"/>', "too much memory is needed"),
        ("<xacro:a/>", "call each other without end"),
        ('<xacro:include filename="laughs.xacro"/>', "<!DOCTYPE is not allowed"),
        ("<xacro:fan n=\"${'x' * 30000}\"/>" * 400, "expands to more than 10,000,000 bytes"),
    ],
    ids=lambda value: value[:40],
)
def test_a_hostile_file_is_refused_and_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, part: str, problem: str
) -> None:
    if "it took" in problem:
        monkeypatch.setattr(expansion, "SECONDS", 2)
    written(tmp_path / "outside.xacro", xacro(LINK))
    own = tmp_path / "own"
    macros = '<xacro:macro name="a" params=""><xacro:a/></xacro:macro>'
    macros += '<xacro:macro name="fan" params="n"><link name="l" text="${n}"/></xacro:macro>'
    path = written(own / "arm.xacro", xacro(LINK, macros, part))
    (own / "link.xacro").symlink_to(tmp_path / "outside.xacro")
    laughs = "".join(f'<!ENTITY l{k} "{f"&l{k - 1};" * 10 if k else "ha"}">' for k in range(10))
    written(own / "laughs.xacro", f"<!DOCTYPE robot [{laughs}]><robot name='r'>&l9;</robot>")
    written(own / "broken.xacro", "<robot name='r'>")
    begun = time.monotonic()
    with pytest.raises(InvalidFile, match=problem):
        read_urdf(path)
    assert time.monotonic() - begun < 60


def test_a_file_of_macros_alone_says_what_they_are_for(tmp_path: Path) -> None:
    path = written(tmp_path / "arm.xacro", xacro('<xacro:macro name="my_arm" params=""><link name="a"/></xacro:macro>'))
    with pytest.raises(InvalidFile, match="it defines the macros my_arm; write a file that includes it and uses one"):
        read_urdf(path)
