"""A fresh Debian or Ubuntu in a folder: debootstrap creates it, and its own systemd runs in namespaces as process 1."""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from tests.support.netns import Machine
from tests.support.process import Process
from tests.support.wait import until

CACHE = Path(__file__).resolve().parents[2] / ".cache" / "debootstrap"
"""Cache of debootstrap's packages and, for a day, of the created systems, which several tests use."""

DAY = 24 * 3600  # seconds

UBUNTU = ("noble", "resolute")
"""Releases of Ubuntu: 24.04 and 26.04."""

_CGROUP = r"""
mount --make-rprivate /
mount -t cgroup2 cgroup2 "$2"
mkdir -p "$2/$1"
echo $$ >"$2/$1/cgroup.procs"
umount --lazy "$2"
shift 2
exec "$@"
"""
"""Runs a command in a new cgroup, no matter where this machine has mounted cgroups."""

_BOOT = r"""
tree=$1
mount --make-rprivate /
mount --bind "$tree" "$tree"
mount -t proc proc "$tree/proc"
mount -t sysfs -o ro sysfs "$tree/sys"
mount -t cgroup2 cgroup2 "$tree/sys/fs/cgroup"
for folder in run dev dev/shm; do
    mkdir -p "$tree/$folder"
    mount -t tmpfs -o mode=755 tmpfs "$tree/$folder"
done
chmod 1777 "$tree/dev/shm"
mkdir "$tree/dev/pts"
mount -t devpts -o newinstance,ptmxmode=0666 devpts "$tree/dev/pts"
ln -s pts/ptmx "$tree/dev/ptmx"
ln -s /proc/self/fd "$tree/dev/fd"
for device in null zero full random urandom tty; do
    touch "$tree/dev/$device"
    mount --bind "/dev/$device" "$tree/dev/$device"
done
hostname tree
cd "$tree"
pivot_root . .
umount -l .
exec env -i container=lxc PATH=/usr/sbin:/usr/bin:/sbin:/bin /sbin/init
"""
"""Starts systemd in a container, as https://systemd.io/CONTAINER_INTERFACE requires."""

_REMOVE_CGROUP = r"""
mount --make-rprivate /
mount -t cgroup2 cgroup2 "$2"
until find "$2/$1" -depth -type d -exec rmdir {} + 2>/dev/null || [ ! -e "$2/$1" ]; do
    sleep 0.1 # killed processes are still exiting
done
"""


class Root:
    """The files of a fresh system in a folder: debootstrap's minimal variant, and certificates.

    Args:
        folder: where the system is created.
        suite: the release; Ubuntu's signatures are not checked.
    """

    def __init__(self, folder: Path, suite: str) -> None:
        self.folder = folder
        folder.mkdir()
        self._call(["mount", "-t", "tmpfs", "-o", "mode=755", "tmpfs", folder], 10)  # speeds up dpkg and the removal
        try:
            self._fill(suite)
        except BaseException:
            self.close()
            raise

    def _fill(self, suite: str) -> None:
        """Create the system, or unpack one that was created less than a day ago."""
        folder, packed = self.folder, CACHE / f"{suite}.tar"
        CACHE.mkdir(parents=True, exist_ok=True)
        with (CACHE / f"{suite}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if packed.exists() and packed.stat().st_mtime > time.time() - DAY:
                self._call(["tar", "-C", folder, "-xpf", packed], 60)
                return
            self._debootstrap(suite)
            (folder / "etc/dpkg/dpkg.cfg.d/unsafe").write_text("force-unsafe-io\n")
            shutil.copy("/etc/resolv.conf", folder / "etc/resolv.conf")
            self._call(["tar", "-C", folder, "-cf", packed.with_suffix(".new"), "."], 60)
            packed.with_suffix(".new").rename(packed)

    def _debootstrap(self, suite: str) -> None:
        command = ["debootstrap", "--variant=minbase", f"--cache-dir={CACHE}", "--include=ca-certificates"]
        if suite in UBUNTU:  # Debian's debootstrap may have neither the suite nor its keys
            command += ["--components=main,universe", "--no-check-gpg"]
            last = ["http://archive.ubuntu.com/ubuntu", "/usr/share/debootstrap/scripts/gutsy"]
        else:
            last = archive(suite)
        self._call([*command, suite, self.folder, *last], 600)

    def _call(self, command: Sequence[str | Path], seconds: float, code: int = 0) -> str:
        environ = {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "DEBIAN_FRONTEND": "noninteractive", "LC_ALL": "C.UTF-8"}
        environ |= proxies()
        done = subprocess.run(
            command, env=environ, capture_output=True, text=True, timeout=seconds, check=False,
            stdin=subprocess.DEVNULL,
        )  # fmt: skip
        assert done.returncode == code, f"{command}: {(done.stdout + done.stderr)[-4000:]}"
        return done.stdout

    def chroot(self, *words: str, seconds: float = 300) -> str:
        """Run a program in a chroot, with this machine's network."""
        return self._call(["chroot", str(self.folder), *words], seconds)

    def files(self) -> set[str]:
        """Return all paths in the system."""
        return set(self._call(["find", self.folder, "-xdev", "-printf", "/%P\n"], 60).splitlines())

    def close(self) -> None:
        """Remove the system."""
        with contextlib.suppress(AssertionError):
            self._call(["umount", "--lazy", self.folder], 30)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None
    ) -> None:
        self.close()


def proxies() -> dict[str, str]:
    """Return this machine's proxy variables."""
    return {name: value for name, value in os.environ.items() if name.lower().endswith("_proxy")}


def archive(suite: str) -> list[str]:
    """Return the archive that this machine's apt uses for the release, or an empty list for debootstrap's default."""
    command = ["apt-get", "indextargets", "--format", "$(SITE)", "Identifier: Packages", f"Codename: {suite}"]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.split()[:1]


def inner(process: Process) -> str:
    """Return the process id of the child of ``unshare --fork``."""
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")

    def started() -> list[str]:
        assert process.popen.poll() is None, process.output()
        return children.read_text(encoding="utf-8").split()

    return until(started, "the child has started")[0]


class Tree(Root):
    """A system with its own systemd, isolated from this machine's network."""

    def __init__(self, folder: Path, suite: str) -> None:
        super().__init__(folder, suite)
        self.machine = Machine(f"tree-{suite}")
        self._init: Process | None = None
        self._name = f"midspan-tree-{os.getpid()}"
        (folder.parent / "mount").mkdir(exist_ok=True)
        self.chroot("apt-get", "update")
        self.chroot("apt-get", "install", "-y", "--no-install-recommends", "dbus", "systemd", "systemd-sysv")
        # a container loads no kernel modules, and systemd 259's service that loads them fails without libkmod
        self.chroot("systemctl", "mask", "systemd-modules-load.service")

    def boot(self) -> None:
        """Start systemd, and wait until all units have started."""
        mount = self.folder.parent / "mount"
        cgroup = ["unshare", "--mount", "sh", "-ec", _CGROUP, "sh", self._name, mount]
        namespaces = ["unshare", "--mount", "--pid", "--fork", "--uts", "--ipc", "--cgroup", "--kill-child=SIGKILL"]
        self._init = Process(self.machine.command(*cgroup, *namespaces, "sh", "-ec", _BOOT, "sh", self.folder))
        until(self._is_up, "systemd runs in the tree", 60)

    def _is_up(self) -> bool:
        assert self._init is not None
        assert self._init.popen.poll() is None, self._init.output()
        with contextlib.suppress(AssertionError, OSError, IndexError):
            return self._call([*self._enter(), "systemctl", "is-system-running"], 10).strip() == "running"
        return False

    def _enter(self) -> list[str]:
        assert self._init is not None
        kinds = ["--mount", "--pid", "--uts", "--ipc", "--net", "--cgroup", "--root", "--wd"]
        return ["nsenter", f"--target={inner(self._init)}", *kinds]

    def run(self, *words: str, seconds: float = 120, code: int = 0) -> str:
        """Run a program in the system, as root."""
        return self._call([*self._enter(), *words], seconds, code)

    def close(self) -> None:
        """Kill the system's processes, and remove the system."""
        if self._init is not None:
            self._init.signal(signal.SIGKILL)
            self._init.stop()
            removal = ["unshare", "--mount", "sh", "-ec", _REMOVE_CGROUP, "sh", self._name]
            with contextlib.suppress(AssertionError):
                self._call([*removal, self.folder.parent / "mount"], 30)
        self.machine.close()
        super().close()
