"""A Debian for another processor in a folder: this machine unpacks its packages, and its programs run under qemu.

The packages' own scripts do not run, because under qemu they take an hour on a busy machine. So the tree lacks what
they write, such as bytecode, the loader's cache and alternatives, which Python and its libraries do not need.

The kernel starts qemu for each program of the other processor (binfmt_misc). Debian's `qemu-user-static` registers qemu
for the whole machine if systemd or binfmt-support runs. Otherwise a tree registers qemu in a user namespace, which
needs Linux 6.7.
"""

from __future__ import annotations

import os
import platform
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from tests.support.debian import archive, proxies

EMULATOR = "qemu-aarch64-static"
REGISTERED = Path("/proc/sys/fs/binfmt_misc/qemu-aarch64")
_PATH = "/usr/sbin:/usr/bin:/sbin:/bin"
_MAPPED = "0 0 65536"
"""The user and group IDs of a tree, which are the same in its namespace. dpkg needs more IDs than root's."""

_MAGIC = (
    r":qemu-aarch64:M::\x7fELF\x02\x01\x01\x00\x00\x00\x00\x00\x00\x00\x00\x00\x02\x00\xb7\x00"
    r":\xff\xff\xff\xff\xff\xff\xff\x00\xff\xff\xff\xff\xff\xff\xff\xff\xfe\xff\xff\xff:{}:OCF"
)
"""Registration of arm64's ELF files, as in Debian's qemu-user-static; F opens qemu outside the tree."""

_ENTER = r"""
read -r _
root=$1 registration=$2
shift 2
if [ "$registration" ]; then
    mount -t binfmt_misc binfmt_misc /proc/sys/fs/binfmt_misc
    printf %s "$registration" >/proc/sys/fs/binfmt_misc/register
fi
mount -t proc proc "$root/proc"
mount -t tmpfs -o mode=755 tmpfs "$root/dev"
mkdir "$root/dev/pts" "$root/dev/shm"
mount -t tmpfs -o mode=1777 tmpfs "$root/dev/shm"
mount -t devpts -o newinstance,ptmxmode=0666 devpts "$root/dev/pts"
ln -s pts/ptmx "$root/dev/ptmx"
ln -s /proc/self/fd "$root/dev/fd"
touch "$root/dev/console"
for device in null zero full random urandom tty; do
    touch "$root/dev/$device"
    mount --bind "/dev/$device" "$root/dev/$device"
done
ip link set lo up
exec chroot "$root" env -i "$@" </dev/null
"""
"""Runs a command in a tree, in new namespaces without a network."""


def missing() -> list[str]:
    """Describe what this machine lacks to create and run trees, and how to install it."""
    lacks = [
        f"{program} (apt install {package})"
        for program, package in (("debootstrap", "debootstrap"), ("ip", "iproute2"), ("unshare", "util-linux"))
        if not shutil.which(program, path=_PATH)
    ]
    if os.geteuid() != 0:
        lacks.append("root (run it with sudo)")
    if REGISTERED.exists():
        return lacks
    if not shutil.which(EMULATOR):
        lacks.append(f"{EMULATOR} (apt install qemu-user-static; on Debian 13: qemu-user-binfmt)")
    elif _linux() < (6, 7):
        lacks.append(f"a registration in {REGISTERED} (apt install binfmt-support), or Linux 6.7 or newer")
    return lacks


def _linux() -> tuple[int, ...]:
    numbers = re.findall(r"\d+", platform.release())
    return tuple(map(int, numbers[:2]))


class ForeignTree:
    """A minimal system of a release for arm64, which stays in its folder.

    Args:
        folder: the root of the tree, which need not exist yet.
        suite: the release.
        packages: packages to install in addition to debootstrap's minimal variant.
    """

    def __init__(self, folder: Path, suite: str, packages: Sequence[str]) -> None:
        self.folder, self._suite, self._packages = folder, suite, packages

    def create(self, log: Path) -> bool:
        """Create the system if it is missing, and return whether it was; raise `RuntimeError` with the log's name."""
        if self.folder.exists():
            return False
        new = ForeignTree(self.folder.with_name(f"{self.folder.name}.new"), self._suite, self._packages)
        shutil.rmtree(new.folder, ignore_errors=True)
        new.folder.mkdir(parents=True)
        include = f"--include={','.join(self._packages)}"
        command = ["debootstrap", "--foreign", "--arch=arm64", "--variant=minbase", include, self._suite, new.folder]
        environ = {"PATH": _PATH, "LC_ALL": "C.UTF-8", **proxies()}
        with log.open("ab") as out:
            done = subprocess.run(
                [*command, *archive(self._suite)], env=environ, stdin=subprocess.DEVNULL, stdout=out, stderr=out,
                timeout=1800, check=False,
            )  # fmt: skip
        if done.returncode:
            raise RuntimeError(f"debootstrap could not download {self._suite} for arm64; its output is in {log}")
        for package in sorted((new.folder / "var/cache/apt/archives").glob("*.deb")):
            _unpack(package, new.folder)
            package.unlink()
        for name in ("passwd", "group"):
            shutil.copy(new.folder / f"usr/share/base-passwd/{name}.master", new.folder / f"etc/{name}")
        proc = new.folder / "proc"
        if proc.is_symlink():  # debootstrap links to /proc in some containers; nothing can be mounted over a link
            proc.unlink()
            proc.mkdir()
        (new.folder / "etc/hosts").write_text("127.0.0.1 localhost\n::1 localhost\n", encoding="ascii")
        new.folder.rename(self.folder)
        return True

    def run(self, words: Sequence[str], log: Path, seconds: float, environ: Mapping[str, str] | None = None) -> int:
        """Run a program in the system, and append its output to a file; return its exit code, -1 after ``seconds``."""
        registration = "" if REGISTERED.exists() else _MAGIC.format(shutil.which(EMULATOR))
        values = {"PATH": _PATH, "HOME": "/root", "LC_ALL": "C.UTF-8", **(environ or {})}
        kinds = ["--mount", "--pid", "--ipc", "--net", "--uts", "--fork", "--kill-child=SIGKILL"]
        command = ["unshare", *(["--user"] if registration else []), *kinds, "sh", "-ec", _ENTER, "sh"]
        command += [str(self.folder), registration, *(f"{name}={value}" for name, value in values.items()), *words]
        with log.open("ab") as out:
            process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=out, stderr=subprocess.STDOUT)
            try:
                if registration:
                    _map_users(process)
                process.communicate(b"\n", seconds)
            except subprocess.TimeoutExpired:
                return -1
            finally:
                with suppress(ProcessLookupError):
                    process.send_signal(signal.SIGKILL)
                process.wait()
        return process.returncode


def _unpack(package: Path, folder: Path) -> None:
    """Unpack a package's files; raise `RuntimeError` with the cause if that fails."""
    command = ["dpkg-deb", "--fsys-tarfile", package]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as files:
        # /lib and others are links to folders in /usr
        into = ["tar", "-C", folder, "--keep-directory-symlink", "-xf", "-"]
        done = subprocess.run(into, stdin=files.stdout, capture_output=True, text=True, check=False)
    if files.returncode or done.returncode:
        raise RuntimeError(f"cannot unpack {package}: {done.stderr.strip() or 'it is damaged'}")


def _map_users(process: subprocess.Popen[bytes]) -> None:
    """Map users into a process's new user namespace, as soon as the process is in it."""
    own, end = Path("/proc/self/ns/user").readlink(), time.monotonic() + 10.0
    proc = Path(f"/proc/{process.pid}")
    while (proc / "ns/user").readlink() == own:
        if process.poll() is not None or time.monotonic() > end:
            raise RuntimeError("this machine does not allow user namespaces (sysctl user.max_user_namespaces)")
        os.sched_yield()
    for name in ("uid_map", "gid_map"):
        (proc / name).write_text(f"{_MAPPED}\n", encoding="ascii")
