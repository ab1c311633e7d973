"""What an image builder and a container manager do with the Containerfile, in trees that debootstrap makes.

Two things are quicker than they are elsewhere, since they cost minutes: the compiler does not optimize, and of the
message packages that are built on this machine already one is left to build.
"""

from __future__ import annotations

import ast
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

from bridge.interfaces.cache import BuildCache, default_cache
from scripts import dist
from tests.setup.machine import ROOT
from tests.support.debian import Root, inner, proxies
from tests.support.netns import Machine
from tests.support.process import Process
from tests.support.wait import until

FILE = ROOT / "Containerfile"
PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
BUILT = "octomap_msgs"
"""The message package that is built: the quickest."""

_COMPILER = '#!/bin/sh\nexec /usr/bin/${0##*/} "$@" -O0 -g0 -w\n'


def instructions() -> list[tuple[str, str]]:
    """The file's instructions, each on one line, with their words in capitals."""
    text = re.sub(r"^#.*\n", "", FILE.read_text(encoding="utf-8"), flags=re.MULTILINE).replace("\\\n", " ")
    found = [line.split(maxsplit=1) for line in text.splitlines() if line.strip()]
    return [(word, " ".join(rest.split())) for word, rest in found]


def last(word: str) -> str:
    """The instruction of the final image that holds."""
    return [rest for each, rest in instructions() if each == word][-1]


def pip_settings() -> tuple[dict[str, str], list[str]]:
    """This machine's settings of pip, as variables; and the files and folders that they name."""
    told = subprocess.run([sys.executable, "-m", "pip", "config", "list"], capture_output=True, text=True, check=True)
    found: dict[str, str] = {}
    for name, _, value in sorted(line.partition("=") for line in told.stdout.splitlines()):  # variables come first
        found.setdefault(f"PIP_{name.rpartition('.')[2].upper().replace('-', '_')}", ast.literal_eval(value))
    paths = [Path(word.removeprefix("file://")) for value in found.values() for word in value.split()]
    # an index has its files beside it
    paths = [path.parent if path.name == "simple" else path for path in paths if path.is_absolute() and path.exists()]
    return found, [str(path) for path in paths]


_RUN = r"""
root=$1 user=$2 paths=$3
shift 3
mount --make-rprivate /
mount -t proc proc "$root/proc"
for path in $paths; do
    if [ -d "$path" ]; then mkdir -p "$root$path"; else mkdir -p "$root${path%/*}"; touch "$root$path"; fi
    mount --bind "$path" "$root$path"
done
exec chroot --userspec="$user:$user" "$root" env -i "$@"
"""


class Stage:
    """What is made from a `FROM` on."""

    def __init__(self, root: Root) -> None:
        self.root = root
        self.folder, self.user, self.environ = "/", "0", {"PATH": PATH}

    def take(self, word: str, rest: str, stages: dict[str, Stage]) -> None:
        """Do what an instruction says; those for who starts a container are left to `Container`."""
        if word == "RUN":
            self._run(rest)
        elif word == "COPY":
            *option, source, target = rest.split()
            if option:
                earlier = stages[option[0].removeprefix("--from=")].root.folder
                subprocess.run(["cp", "-a", f"{earlier}{source}", f"{self.root.folder}{target}"], check=True)
            else:
                dist.copy_tracked([source], self.root.folder / self.folder[1:] / target)
        elif word == "ENV":
            self.environ |= dict(pair.split("=", 1) for pair in shlex.split(rest))
        elif word == "USER":
            self.user = rest
        elif word == "WORKDIR":
            self.folder = rest
            (self.root.folder / rest[1:]).mkdir(parents=True, exist_ok=True)

    def _run(self, line: str) -> None:
        settings, paths = pip_settings()
        environ = {"HOME": "/root", **proxies(), **settings, **self.environ}
        words = ["-C", self.folder, *(f"{name}={value}" for name, value in environ.items()), "sh", "-c", line]
        own = ["unshare", "--mount", "--pid", "--fork", "--kill-child=SIGKILL", "sh", "-ec", _RUN, "sh"]
        with Process([*own, self.root.folder, self.user, " ".join(paths), *words]) as run:
            assert run.popen.wait(900) == 0, f"{line}: {run.output()[-4000:]}"


def build(stack: ExitStack, folder: Path) -> Stage:
    """The final image; all of it is removed with the stack."""
    stages: dict[str, Stage] = {}
    for word, rest in instructions():
        if word == "FROM":
            base, _, name = rest.partition(" AS ")
            suite = base.removeprefix("debian:").removesuffix("-slim")
            stage = stages[name] = Stage(stack.enter_context(Root(folder / (name or "final"), suite)))
            if name:
                _hasten(stage.root.folder)
        else:
            stage.take(word, rest, stages)
    return stage


def _hasten(root: Path) -> None:
    for name in ("gcc", "g++", "x86_64-linux-gnu-gcc", "x86_64-linux-gnu-g++"):
        (root / "usr/local/bin" / name).write_text(_COMPILER)
        (root / "usr/local/bin" / name).chmod(0o755)
    for package in BuildCache(default_cache()).packages():
        if not package.name.startswith(BUILT):
            shutil.copytree(package, root / "opt/midspan/interfaces/packages" / package.name, symlinks=True)


_START = r"""
root=$1 volume=$2
shift 2
mount --make-rprivate /
mount --bind "$root" "$root"
mount -t proc proc "$root/proc"
mount -t sysfs -o ro sysfs "$root/sys"
mount -t tmpfs -o mode=755 tmpfs "$root/dev"
ln -s /proc/self/fd "$root/dev/fd"
for device in null zero full random urandom; do
    touch "$root/dev/$device"
    mount --bind "/dev/$device" "$root/dev/$device"
done
mkdir "$root/dev/shm"
mount -o remount,bind,ro "$root/dev"
for folder in dev/shm tmp; do mount -t tmpfs -o mode=1777 tmpfs "$root/$folder"; done
mount --bind "$volume" "$root/var/lib/midspan"
mount -o remount,bind,ro "$root"
cd "$root"
exec chroot "$root" "$@"
"""


class Container:
    """What the image starts: its root read-only, without capabilities, as docs/start/container.md says.

    Args:
        image: of which.
        volume: a folder to make for the volume; a manager fills a new one with what the image has there.
    """

    def __init__(self, image: Stage, volume: Path) -> None:
        self.image = image
        (place,) = json.loads(last("VOLUME"))
        subprocess.run(["cp", "-a", f"{image.root.folder}{place}", volume], check=True)
        (image.root.folder / "etc/hosts").write_text(f"127.0.0.1 localhost {os.uname().nodename}\n")
        self.machine = Machine("container")
        own = ["unshare", "--mount", "--pid", "--ipc", "--fork", "--kill-child=SIGKILL", "sh", "-ec", _START, "sh"]
        words = [*json.loads(last("ENTRYPOINT")), *json.loads(last("CMD"))]
        self.process = Process(self.machine.command(*own, image.root.folder, volume, *self._as_user(words)))
        until(lambda: self.run("true").returncode == 0, "its own root is made")

    def _as_user(self, words: list[str]) -> list[str]:
        user = self.image.user
        environ = [f"{name}={value}" for name, value in self.image.environ.items()]
        bare = ["setpriv", f"--reuid={user}", f"--regid={user}", "--clear-groups", "--bounding-set=-all"]
        return [*bare, "--no-new-privs", "env", "-i", "-C", self.image.folder, *environ, *words]

    def run(self, *words: str) -> subprocess.CompletedProcess[str]:
        """A further program in it, to its end."""
        first = inner(self.process)
        enter = ["nsenter", f"--target={first}", "--mount", "--pid", "--ipc", "--net", "--root", "--wd"]
        return subprocess.run(
            [*enter, *self._as_user(list(words))], capture_output=True, text=True, timeout=60, check=False
        )

    def stop(self, seconds: float) -> int:
        """The signal of `STOPSIGNAL` to its first process; the exit code of that."""
        os.kill(int(inner(self.process)), signal.Signals[last("STOPSIGNAL")])
        return self.process.popen.wait(seconds)

    def close(self) -> None:
        """End what still runs."""
        self.process.stop()
        self.machine.close()
