"""Simulated machines: network namespaces joined by veth links, whose addresses exist only in them."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Self

import pytest

from tests.support.process import Process


def ip(*words: str) -> None:
    """Run iproute2's ``ip``."""
    done = subprocess.run(["ip", *words], capture_output=True, text=True, check=False)
    if done.returncode:
        msg = f"ip {' '.join(words)}: {done.stderr.strip()}"
        raise OSError(msg)


def need_namespaces() -> None:
    """Skip the test, or fail it in CI, if this machine cannot create network namespaces."""
    name = f"midspan-try-{os.getpid()}"
    try:
        ip("netns", "add", name)
    except OSError as err:
        reason = f"cannot create network namespaces (they need iproute2 and root): {err}"
        if os.environ.get("CI"):
            pytest.fail(reason)
        pytest.skip(reason)
    ip("netns", "delete", name)


class Machine:
    """A network namespace with loopback.

    Args:
        name: the machine's name; the namespace's name also contains the process ID.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.namespace = f"midspan-{name}-{os.getpid()}"
        self._files = Path("/etc/netns") / self.namespace
        ip("netns", "add", self.namespace)
        ip("-n", self.namespace, "link", "set", "lo", "up")

    def hosts(self, **addresses: str) -> None:
        """Set the names that this machine resolves. `ip netns exec` mounts the file over /etc/hosts."""
        self._files.mkdir(parents=True, exist_ok=True)
        lines = ["127.0.0.1 localhost", *(f"{address} {name}" for name, address in addresses.items())]
        (self._files / "hosts").write_text("\n".join(lines) + "\n")

    def command(self, *words: str | Path) -> list[str]:
        """Return a command line that runs a program on this machine."""
        return ["ip", "netns", "exec", self.namespace, *map(str, words)]

    def run(self, *words: str | Path, env: Mapping[str, str] | None = None, seconds: float = 30) -> str:
        """Run a program until it exits, and return its output."""
        done = subprocess.run(
            self.command(*words), env=env, capture_output=True, text=True, timeout=seconds, check=False
        )
        assert done.returncode == 0, f"{words}: {done.stdout[-2000:]}{done.stderr[-2000:]}"
        return done.stdout

    def start(self, *words: str | Path, env: Mapping[str, str] | None = None) -> Process:
        """Start a program."""
        return Process(self.command(*words), env)

    def close(self) -> None:
        """Remove the namespace and its links."""
        with contextlib.suppress(OSError):
            ip("netns", "delete", self.namespace)
        shutil.rmtree(self._files, ignore_errors=True)


class Cable:
    """A veth link between two machines: ``one`` has ``10.<net>.0.1``, ``other`` ``10.<net>.0.2``."""

    def __init__(self, one: Machine, other: Machine, net: int = 77) -> None:
        self.addresses = (f"10.{net}.0.1", f"10.{net}.0.2")
        self._end = other.namespace, f"eth{net}"
        ip(
            "link",
            "add",
            f"eth{net}",
            "netns",
            one.namespace,
            "type",
            "veth",
            "peer",
            f"eth{net}",
            "netns",
            other.namespace,
        )
        for machine, address in zip((one, other), self.addresses, strict=True):
            ip("-n", machine.namespace, "address", "add", f"{address}/24", "dev", f"eth{net}")
            ip("-n", machine.namespace, "link", "set", f"eth{net}", "up")

    def cut(self) -> None:
        """Take the link down."""
        ip("-n", self._end[0], "link", "set", self._end[1], "down")

    def mend(self) -> None:
        """Take the link up."""
        ip("-n", self._end[0], "link", "set", self._end[1], "up")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, tb: TracebackType | None) -> None:
        self.mend()
