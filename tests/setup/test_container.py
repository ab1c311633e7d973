"""The Containerfile: what it must keep to; and its image, built without an image builder, with a read-only root."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import yaml

from tests.setup.image import BUILT, Container, build, instructions, last
from tests.setup.machine import ROOT
from tests.support.missing import DEBIAN, need
from tests.support.wait import until


def test_it_keeps_to_the_rules() -> None:
    """Those of hadolint that matter here: bases, apt, pip, the user, and commands without a shell."""
    words = instructions()
    known = {"FROM", "RUN", "WORKDIR", "COPY", "ENV", "USER", "VOLUME", "STOPSIGNAL", "HEALTHCHECK", "ENTRYPOINT"}
    assert {word for word, _ in words} <= known | {"CMD"}
    for word, rest in words:
        if word == "FROM":
            assert re.fullmatch(r"[\w./-]+:[\w.-]+( AS \w+)?", rest), "a base has a tag"
            assert ":latest" not in rest
        if "apt-get install" in rest:
            assert "--no-install-recommends" in rest
            assert rest.startswith("apt-get update &&"), "lists and packages are of one layer"
            assert "rm -rf /var/lib/apt/lists/*" in rest
        if "pip install" in rest:
            assert "--no-cache-dir" in rest
            assert "-c requirements.lock" in rest
        assert "sudo" not in rest
        if word in ("ENTRYPOINT", "CMD", "VOLUME"):
            assert isinstance(json.loads(rest), list), "no shell stands between"
    assert last("USER") == "10001"
    final = words[max(n for n, (word, _) in enumerate(words) if word == "FROM") :]
    assert not any("g++" in rest for _, rest in final), "the compiler stays in the first image"
    assert [word for word, _ in final].index("USER") < [word for word, _ in final].index("ENTRYPOINT")


def test_it_has_the_packages_of_ros_1_that_set_up_installs() -> None:
    """All but those that only the tests start: a launch tool, node and parameter tools."""
    setup = (ROOT / "scripts" / "setup.sh").read_text(encoding="utf-8")
    wanted = set(re.search(r'^ros1="([^"]*)"', setup, re.MULTILINE)[1].split())  # type: ignore[index]
    installed = {name for _, rest in instructions() for name in rest.split() if name.startswith("python3-")}
    assert wanted - installed == {"python3-roslaunch", "python3-rosnode", "python3-rosparam"}


@pytest.fixture
def container(tmp_path: Path) -> Iterator[Container]:
    """Of the image, with a configuration that joins ROS 2 and looks for a ROS 1 master."""
    need(DEBIAN)
    with ExitStack() as stack:
        image = build(stack, tmp_path)
        off = {name: {"enabled": False} for name in ("yarp", "zenoh")}
        config = image.root.folder / "etc/midspan/midspan.yaml"
        config.parent.mkdir()
        config.write_text(yaml.safe_dump({"name": "boxed", **off}))
        made = Container(image, tmp_path / "volume")
        stack.callback(made.close)
        yield made


@pytest.mark.long
@pytest.mark.timeout(1200)
def test_the_image_is_built_and_healthy_with_a_read_only_root_and_not_as_root(container: Container) -> None:
    """In one test, since to build it takes a minute."""
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
        assert list((root / "opt/midspan/interfaces/packages").glob(f"{BUILT}-*")), "the image has its own"
        assert container.stop(20) == 0
        assert "Traceback" not in container.process.output()
        assert "Read-only file system" not in container.process.output()
    except BaseException:
        print(container.process.output())
        raise
    assert container.image.root.files() == before


def states(told: str) -> set[tuple[str, str]]:
    """Of each worker, in what the health check prints."""
    return {(one["worker"], one["state"]) for one in json.loads(told or "[]")}
