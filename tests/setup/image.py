"""An image builder and a container manager for the Containerfile, in trees that debootstrap creates.

Two steps that would take minutes are shortened: of the kernels and the message packages that are already compiled on
this machine, only one each is compiled. Without a usable cache of kernels, the compiler does not optimize.
"""

from __future__ import annotations

import ast
import json
import os
import platform
import re
import shlex
import signal
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

from scripts import dist
from tests.setup.builds import copy_kernels, copy_packages
from tests.setup.machine import ROOT
from tests.support.debian import Root, inner, proxies
from tests.support.netns import Machine
from tests.support.process import Process
from tests.support.wait import until

FILE = ROOT / "Containerfile"
PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
_KERNELS = "opt/kernels"
"""Folder in the first stage for the cache of compiled kernels, which another release's compiler cannot use."""

_COMPILER = '#!/bin/sh\nexec /usr/bin/${0##*/} "$@" -O0 -g0 -w\n'


def instructions() -> list[tuple[str, str]]:
    """Return the Containerfile's instructions, joined to one line each, as upper-case keyword and arguments."""
    text = re.sub(r"^#.*\n", "", FILE.read_text(encoding="utf-8"), flags=re.MULTILINE).replace("\\\n", " ")
    lines = [line.split(maxsplit=1) for line in text.splitlines() if line.strip()]
    return [(keyword, " ".join(arguments.split())) for keyword, arguments in lines]


def last(keyword: str) -> str:
    """Return the arguments of the last instruction with a keyword, which takes effect in the final image."""
    return [arguments for name, arguments in instructions() if name == keyword][-1]


def pip_settings() -> tuple[dict[str, str], list[str]]:
    """Return this machine's pip settings as environment variables, and the files and folders that they name."""
    output = subprocess.run([sys.executable, "-m", "pip", "config", "list"], capture_output=True, text=True, check=True)
    settings: dict[str, str] = {}
    for name, _, value in sorted(line.partition("=") for line in output.stdout.splitlines()):  # variables come first
        settings.setdefault(f"PIP_{name.rpartition('.')[2].upper().replace('-', '_')}", ast.literal_eval(value))
    paths = [Path(url.removeprefix("file://")) for value in settings.values() for url in value.split()]
    # the files of an index are next to it
    paths = [path.parent if path.name == "simple" else path for path in paths if path.is_absolute() and path.exists()]
    return settings, [str(path) for path in paths]


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
    """A build stage, which begins with `FROM`."""

    def __init__(self, root: Root) -> None:
        self.root = root
        self.folder, self.user, self.environ = "/", "0", {"PATH": PATH}

    def execute(self, keyword: str, arguments: str, stages: dict[str, Stage]) -> None:
        """Execute an instruction; `Container` handles those for the start of a container."""
        if keyword == "RUN":
            self._run(arguments)
        elif keyword == "COPY":
            *option, source, target = arguments.split()
            if option:
                earlier = stages[option[0].removeprefix("--from=")].root.folder
                subprocess.run(["cp", "-a", f"{earlier}{source}", f"{self.root.folder}{target}"], check=True)
            else:
                dist.copy_tracked([source], self.root.folder / self.folder[1:] / target)
        elif keyword == "ENV":
            self.environ |= dict(pair.split("=", 1) for pair in shlex.split(arguments))
        elif keyword == "USER":
            self.user = arguments
        elif keyword == "WORKDIR":
            self.folder = arguments
            (self.root.folder / arguments[1:]).mkdir(parents=True, exist_ok=True)

    def _run(self, line: str) -> None:
        settings, paths = pip_settings()
        environ = {"HOME": "/root", **proxies(), **settings, **self.environ}
        command = ["-C", self.folder, *(f"{name}={value}" for name, value in environ.items()), "sh", "-c", line]
        namespaces = ["unshare", "--mount", "--pid", "--fork", "--kill-child=SIGKILL", "sh", "-ec", _RUN, "sh"]
        with Process([*namespaces, self.root.folder, self.user, " ".join(paths), *command]) as run:
            assert run.popen.wait(900) == 0, f"{line}: {run.output()[-4000:]}"


def build(stack: ExitStack, folder: Path) -> Stage:
    """Build and return the final image; the stack removes all stages."""
    stages: dict[str, Stage] = {}
    for keyword, arguments in instructions():
        if keyword == "FROM":
            base, _, name = arguments.partition(" AS ")
            suite = base.removeprefix("debian:").removesuffix("-slim")
            stage = stages[name] = Stage(stack.enter_context(Root(folder / (name or "final"), suite)))
            if name:
                _hasten(stage, suite)
        else:
            stage.execute(keyword, arguments, stages)
    return stage


def _hasten(stage: Stage, suite: str) -> None:
    root = stage.root.folder
    copy_packages(root / "opt/midspan/interfaces")
    if platform.freedesktop_os_release().get("VERSION_CODENAME") == suite and copy_kernels(root / _KERNELS):
        stage.environ["MIDSPAN_KERNEL_CACHE"] = f"/{_KERNELS}"
        return
    for name in ("gcc", "g++", "x86_64-linux-gnu-gcc", "x86_64-linux-gnu-g++"):
        (root / "usr/local/bin" / name).write_text(_COMPILER)
        (root / "usr/local/bin" / name).chmod(0o755)


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
    """A container of the image with a read-only root and without capabilities, as in docs/start/container.md.

    Args:
        image: the image.
        volume: folder to create for the volume; a manager fills a new volume with the image's files.
    """

    def __init__(self, image: Stage, volume: Path) -> None:
        self.image = image
        (place,) = json.loads(last("VOLUME"))
        subprocess.run(["cp", "-a", f"{image.root.folder}{place}", volume], check=True)
        (image.root.folder / "etc/hosts").write_text(f"127.0.0.1 localhost {os.uname().nodename}\n")
        self.machine = Machine("container")
        namespaces = [
            "unshare",
            "--mount",
            "--pid",
            "--ipc",
            "--fork",
            "--kill-child=SIGKILL",
            "sh",
            "-ec",
            _START,
            "sh",
        ]
        command = [*json.loads(last("ENTRYPOINT")), *json.loads(last("CMD"))]
        self.process = Process(self.machine.command(*namespaces, image.root.folder, volume, *self._as_user(command)))
        until(lambda: self.run("true").returncode == 0, "the container's root is mounted")

    def _as_user(self, command: list[str]) -> list[str]:
        user = self.image.user
        environ = [f"{name}={value}" for name, value in self.image.environ.items()]
        bare = ["setpriv", f"--reuid={user}", f"--regid={user}", "--clear-groups", "--bounding-set=-all"]
        return [*bare, "--no-new-privs", "env", "-i", "-C", self.image.folder, *environ, *command]

    def run(self, *command: str) -> subprocess.CompletedProcess[str]:
        """Run another program in the container until it exits."""
        first = inner(self.process)
        enter = ["nsenter", f"--target={first}", "--mount", "--pid", "--ipc", "--net", "--root", "--wd"]
        return subprocess.run(
            [*enter, *self._as_user(list(command))], capture_output=True, text=True, timeout=60, check=False
        )

    def stop(self, seconds: float) -> int:
        """Send `STOPSIGNAL` to the container's first process, and return its exit code."""
        os.kill(int(inner(self.process)), signal.Signals[last("STOPSIGNAL")])
        return self.process.popen.wait(seconds)

    def close(self) -> None:
        """Kill the remaining processes."""
        self.process.stop()
        self.machine.close()
