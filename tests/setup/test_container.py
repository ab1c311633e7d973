"""The Containerfile: its rules; and its image, built without an image builder, with a read-only root."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import yaml

from tests.setup.builds import PACKAGE
from tests.setup.image import Container, build, instructions, last
from tests.support.missing import DEBIAN, need
from tests.support.wait import until


def test_the_containerfile_follows_the_rules() -> None:
    """The relevant rules of hadolint: bases, apt, pip, the user, and commands without a shell."""
    file_instructions = instructions()
    known = {"FROM", "RUN", "WORKDIR", "COPY", "ENV", "USER", "VOLUME", "STOPSIGNAL", "HEALTHCHECK", "ENTRYPOINT"}
    assert {keyword for keyword, _ in file_instructions} <= known | {"CMD"}
    for keyword, arguments in file_instructions:
        if keyword == "FROM":
            assert re.fullmatch(r"[\w./-]+:[\w.-]+( AS \w+)?", arguments), "a base has a tag"
            assert ":latest" not in arguments
        if "apt-get install" in arguments:
            assert "--no-install-recommends" in arguments
            assert arguments.startswith("apt-get update &&"), "lists and packages are in one layer"
            assert "rm -rf /var/lib/apt/lists/*" in arguments
        if "pip install" in arguments:
            assert "--no-cache-dir" in arguments
            assert "-c requirements.lock" in arguments
        assert "sudo" not in arguments
        if keyword in ("ENTRYPOINT", "CMD", "VOLUME"):
            assert isinstance(json.loads(arguments), list), "no shell in between"
    assert last("USER") == "10001"
    final = file_instructions[max(n for n, (keyword, _) in enumerate(file_instructions) if keyword == "FROM") :]
    assert not any("g++" in arguments for _, arguments in final), "the compiler stays in the first image"
    assert [keyword for keyword, _ in final].index("USER") < [keyword for keyword, _ in final].index("ENTRYPOINT")


def test_the_image_installs_no_ros_1() -> None:
    """Its packages and their dependencies took 0.5 of the image's 1.2 GB, and Midspan needs none of them."""
    installed = {name for _, arguments in instructions() for name in arguments.split() if name.startswith("python3-")}
    assert installed == {"python3-dev", "python3-venv"}, "the packages of the first stage"


@pytest.mark.parametrize("installed", [True, False])
def test_messages_are_built_only_if_pip_installed_ros_2(tmp_path: Path, installed: bool) -> None:
    """On arm64, pip does not install ROS 2, so `midspan interfaces build` would fail, and stop the image's build."""
    (line,) = [arguments for _, arguments in instructions() if "interfaces build" in arguments]
    programs = tmp_path / "bin"
    programs.mkdir()
    for name in ("python3", "pip", "midspan"):
        shows = f'case "$*" in show*) exit {int(not installed)};; esac'
        (programs / name).write_text(f'#!/bin/sh\necho "{name} $*" >>"{tmp_path}/calls"\n{shows}\n')
        (programs / name).chmod(0o755)
    line = line.replace("/opt/midspan/bin/", f"{programs}/")
    subprocess.run(["sh", "-c", line], env={"PATH": f"{programs}:/usr/bin:/bin"}, check=True)
    calls = (tmp_path / "calls").read_text().splitlines()
    assert ("midspan interfaces build" in calls) is installed
    assert any(call.startswith("pip install") and ".[ros2,web]" in call for call in calls)


def test_no_instruction_names_a_processor() -> None:
    """The same file builds the image for x86-64 and arm64."""
    words = re.findall(r"x86[-_]64|amd64|aarch64|arm64|--platform", " ".join(map(" ".join, instructions())))
    assert words == []


@pytest.fixture
def container(tmp_path: Path) -> Iterator[Container]:
    """A container of the image, with a configuration that joins ROS 2 and connects to a ROS 1 master."""
    need(DEBIAN)
    with ExitStack() as stack:
        image = build(stack, tmp_path)
        off = {name: {"enabled": False} for name in ("yarp", "zenoh")}
        config = image.root.folder / "etc/midspan/midspan.yaml"
        config.parent.mkdir()
        config.write_text(yaml.safe_dump({"name": "boxed", **off}))
        started = Container(image, tmp_path / "volume")
        stack.callback(started.close)
        yield started


@pytest.mark.long
@pytest.mark.timeout(1200)
def test_the_image_is_healthy_with_a_read_only_root_and_an_unprivileged_user(container: Container) -> None:
    """All in one test, because building the image takes a minute."""
    root = container.image.root.folder
    before = container.image.root.files()
    try:
        health = json.loads(last("HEALTHCHECK").partition("CMD ")[2])
        until(lambda: container.run(*health).returncode == 0, "the health check passes", 60)
        wanted = {("ros1", "waiting"), ("ros2", "running")}
        until(lambda: states(container.run(*health).stdout) >= wanted, f"{wanted}", 60)
        refused = container.run(
            "sh", "-c", "id -u; for at in / /usr /etc /opt/midspan /dev; do touch $at/x || echo -; done"
        )
        assert refused.stdout.split() == ["10001", *"-----"]
        assert container.run("midspan", "doctor", "--only", "kernels").returncode == 0
        assert list((root / "opt/midspan/interfaces/packages").glob(f"{PACKAGE}-*")), "the image has its own package"
        assert container.stop(20) == 0
        assert "Traceback" not in container.process.output()
        assert "Read-only file system" not in container.process.output()
    except BaseException:
        print(container.process.output())
        raise
    assert container.image.root.files() == before


def states(output: str) -> set[tuple[str, str]]:
    """Return the state of each worker in the health check's output."""
    return {(entry["worker"], entry["state"]) for entry in json.loads(output or "[]")}
