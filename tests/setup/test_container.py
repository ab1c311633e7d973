"""The Containerfile: what it must keep to, and its entry point and health check with a read-only root, not as root.

No image builder is needed: the root is made of this machine's `/usr` and `/etc` and of the checkout's environment, and
the file says who runs what in it.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from tests.setup.machine import ROOT
from tests.support.ports import free_port
from tests.support.process import Process
from tests.support.wait import until

FILE = ROOT / "Containerfile"
USER = "10001"


def instructions() -> list[tuple[str, str]]:
    """The file's instructions, each on one line, with their words in capitals."""
    text = re.sub(r"^#.*\n", "", FILE.read_text(encoding="utf-8"), flags=re.MULTILINE).replace("\\\n", " ")
    found = [line.split(maxsplit=1) for line in text.splitlines() if line.strip()]
    return [(word, " ".join(rest.split())) for word, rest in found]


def last(word: str) -> str:
    """The instruction of the final image that holds."""
    return [rest for each, rest in instructions() if each == word][-1]


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
    assert last("USER") == USER
    final = words[max(n for n, (word, _) in enumerate(words) if word == "FROM") :]
    assert not any("g++" in rest for _, rest in final), "the compiler stays in the first image"
    assert [word for word, _ in final].index("USER") < [word for word, _ in final].index("ENTRYPOINT")


def test_it_has_the_packages_of_ros_1_that_set_up_installs() -> None:
    """All but those that only the tests start: a launch tool, node and parameter tools."""
    setup = (ROOT / "scripts" / "setup.sh").read_text(encoding="utf-8")
    wanted = set(re.search(r'^ros1="([^"]*)"', setup, re.MULTILINE)[1].split())  # type: ignore[index]
    installed = {name for _, rest in instructions() for name in rest.split() if name.startswith("python3-")}
    assert wanted - installed == {"python3-roslaunch", "python3-rosnode", "python3-rosparam"}


ENTER = """
set -eu
root=$1 checkout=$2 state=$3 user=$4
shift 4
mount -t tmpfs -o mode=755 tmpfs "$root"
for name in usr etc proc dev tmp opt/midspan var/lib/midspan; do mkdir -p "$root/$name"; done
for name in bin sbin lib lib64; do ln -s "usr/$name" "$root/$name"; done
mount --bind /usr "$root/usr"
mount --bind /etc "$root/etc"
mount --rbind /proc "$root/proc"
mount -t tmpfs -o mode=755 tmpfs "$root/dev"
for name in null urandom; do touch "$root/dev/$name"; mount --bind "/dev/$name" "$root/dev/$name"; done
mkdir "$root/dev/shm"
mount -t tmpfs -o mode=1777 tmpfs "$root/dev/shm"
mount -t tmpfs -o mode=1777 tmpfs "$root/tmp"
mkdir -p "$root$checkout"
mount --bind "$checkout" "$root$checkout"
mount --bind "$checkout/.venv" "$root/opt/midspan"
mount --bind "$state" "$root/var/lib/midspan"
for name in usr etc opt/midspan "${checkout#/}" dev; do mount -o remount,bind,ro "$root/$name"; done
mount -o remount,ro "$root"
cd /
exec chroot --userspec="$user:$user" "$root" /usr/bin/env -i "$@"
"""


class Container:
    """The final image's root, made anew for each program in a mount namespace of its own."""

    def __init__(self, folder: Path) -> None:
        self.root, self.state = folder / "root", folder / "state"
        self.root.mkdir()
        self.state.mkdir()
        self.port = free_port()
        config = {"name": "boxed", "hub": {"listen": f"tcp/127.0.0.1:{self.port}"}}
        off = {name: {"enabled": False} for name in ("ros1", "ros2", "yarp", "zenoh")}
        (self.state / "midspan.yaml").write_text(yaml.safe_dump({**config, **off}))
        for path in (self.state, self.state / "midspan.yaml"):
            os.chown(path, int(USER), int(USER))
        folder.chmod(0o755)

    def command(self, *words: str) -> list[str]:
        """A program in it, with the environment of the file."""
        environ = [*last("ENV").split(), "MIDSPAN_CONFIG=/var/lib/midspan/midspan.yaml"]
        if run := os.environ.get("MIDSPAN_TEST_RUN"):
            environ.append(f"MIDSPAN_TEST_RUN={run}")
        places = str(self.root), str(ROOT), str(self.state)
        return ["unshare", "--mount", "sh", "-c", ENTER, "enter", *places, last("USER"), *environ, *words]

    def run(self, *words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(self.command(*words), capture_output=True, text=True, timeout=60, check=False)


@pytest.fixture
def container(tmp_path: Path) -> Iterator[Container]:
    if os.geteuid() != 0 or subprocess.run(["unshare", "--mount", "true"], check=False).returncode:
        why = "a root of its own cannot be made here: it needs root"
        if os.environ.get("CI"):
            pytest.fail(why)
        pytest.skip(why)
    made = Container(tmp_path)
    yield made
    shutil.rmtree(made.state)


@pytest.mark.long
def test_the_daemon_is_healthy_with_a_read_only_root_and_not_as_root(container: Container) -> None:
    refused = container.run("sh", "-c", "id -u; for at in / /usr /etc /opt/midspan; do touch $at/x || echo no; done")
    assert refused.stdout.split() == [USER, "no", "no", "no", "no"]
    health = json.loads(last("HEALTHCHECK").partition("CMD ")[2])
    assert container.run(*health).returncode == 1, "nothing runs yet"
    words = [*json.loads(last("ENTRYPOINT")), *json.loads(last("CMD"))]
    with Process(container.command(*words)) as daemon:
        try:
            until(lambda: container.run(*health).returncode == 0, "the health check passes", 60)
            assert any(d["daemon"] == "boxed" for d in json.loads(container.run(*health).stdout))
            assert "Traceback" not in daemon.output()
            assert "Read-only file system" not in daemon.output()
            daemon.popen.terminate()  # STOPSIGNAL
            assert daemon.popen.wait(20) == 0
        except BaseException:
            print(daemon.output())
            raise
    assert container.run(*health).returncode == 1
