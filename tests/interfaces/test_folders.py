"""Folders that `midspan interfaces build` accepts, and the packages that they hold."""

from __future__ import annotations

from pathlib import Path

import pytest

from bridge.interfaces.definition import BuildError
from bridge.interfaces.folders import read_folders

ONE = {"msg/One.msg": "uint8 a\n"}
XML = """<?xml version="1.0"?>
<package format="3">
  <name> xml_pkg </name><version>0.1.0</version>
</package>
"""


def write(folder: Path, *paths: str) -> Path:
    for path in paths:
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(XML if path.endswith(".xml") else "uint8 a\n")
    return folder


@pytest.mark.parametrize("inside", ["", "msg"])
def test_a_packages_own_folder_is_one_package(tmp_path: Path, inside: str, monkeypatch: pytest.MonkeyPatch) -> None:
    package = write(tmp_path / "my_msgs", "msg/One.msg", "include/my_msgs/msg/One.msg", "msg/old/Two.msg")
    assert read_folders([package / inside]) == {"my_msgs": ONE}
    monkeypatch.chdir(package / inside)
    assert read_folders([Path()]) == {"my_msgs": ONE}


def test_a_package_has_the_name_of_its_package_xml(tmp_path: Path) -> None:
    for name, path in (("checkout-main", "msg/One.msg"), ("flat", "One.msg")):
        package = write(tmp_path / name, "package.xml", path, "old/Two.msg")
        assert read_folders([package]) == {"xml_pkg": ONE}
    write(tmp_path / "broken", "msg/One.msg").joinpath("package.xml").write_bytes(b"\xff")
    assert read_folders([tmp_path / "broken"]) == {"broken": ONE}


def test_all_packages_in_a_folder_are_read(tmp_path: Path) -> None:
    write(tmp_path, "a_msgs/msg/One.msg", "b_msgs/One.msg", "c_pkg/package.xml", "c_pkg/msg/One.msg", "docs/readme.md")
    write(tmp_path, "package.xml")  # the package.xml of a metapackage
    assert read_folders([tmp_path]) == {"a_msgs": ONE, "b_msgs": ONE, "xml_pkg": ONE}


@pytest.mark.parametrize("kind", ["srv", "action"])
def test_a_package_of_services_or_actions_is_read(tmp_path: Path, kind: str) -> None:
    package = write(tmp_path / "my_srvs", f"{kind}/Ask.{kind}")
    assert read_folders([package]) == read_folders([package / kind]) == {"my_srvs": {f"{kind}/Ask.{kind}": "uint8 a\n"}}


def test_a_package_given_by_two_folders_is_refused(tmp_path: Path) -> None:
    package = write(tmp_path / "my_msgs", "msg/One.msg")
    with pytest.raises(BuildError, match="my_msgs is given twice"):
        read_folders([package, package / "msg"])


def test_a_folder_without_definitions_is_named(tmp_path: Path) -> None:
    for folder in (write(tmp_path / "empty", "msg/readme.md"), tmp_path / "nowhere"):
        with pytest.raises(BuildError, match=f"no .msg, .srv or .action files in .*{folder.name}"):
            read_folders([folder])
