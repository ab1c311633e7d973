"""Midspan's command line, and its daemon as a user starts it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from bridge.cli.main import VERBS
from bridge.hub.session import HubSettings
from tests.support.forks import COMMAND, DAEMON, DAEMON_AND_WORKERS
from tests.support.ports import free_port
from tests.support.process import DAEMON_SECONDS, Process, run_forked

MIDSPAN = [sys.executable, "-m", "bridge.cli.main"]


def verb_module(verb: str) -> str:
    """Return the module that the command line imports for a command."""
    return VERBS[verb].register.partition(":")[0]


class MidspanDaemon:
    """`midspan run` with a configuration file in a folder.

    Args:
        folder: for the configuration file and the state.
        name: the daemon's name.
        env: environment of the daemon and of commands; None for the test's environment.

    Attributes:
        port: port of the daemon's router.
        daemon: process of the daemon; None if it does not run.
    """

    def __init__(self, folder: Path, name: str, env: Mapping[str, str] | None = None) -> None:
        self.folder, self.file, self.name = folder, folder / "midspan.yaml", name
        self.env = None if env is None else dict(env)
        self.port = free_port()
        self.endpoint = f"tcp/127.0.0.1:{self.port}"
        self.daemon: Process | None = None

    def configure(self, **sections: Any) -> None:
        """Write the configuration file."""
        own = {"name": self.name, "state": str(self.folder / "state"), "hub": {"listen": self.endpoint}}
        self.file.write_text(yaml.safe_dump({**own, **sections}))

    def run(self) -> None:
        """Start the daemon without waiting for its workers."""
        self.daemon = self.midspan("run")

    def midspan(self, *words: str) -> Process:
        """Start a ``midspan`` command."""
        imports = DAEMON_AND_WORKERS if words[:1] == ("run",) else DAEMON
        return Process([*MIDSPAN, *words, "--config", self.file], self.env, imports=imports)

    def command(self, *words: str, seconds: float = 60.0) -> subprocess.CompletedProcess[str]:
        """Run a ``midspan`` command, and return its output and exit code."""
        command = [*MIDSPAN, *words, "--config", str(self.file)]
        return run_forked(command, self.env, imports=[*COMMAND, verb_module(words[0])], seconds=seconds)

    def settings(self, node: str, worker: str = "") -> HubSettings:
        """Return settings for a session in the test's process, without shared memory of workers that the test kills."""
        return HubSettings(router=self.endpoint, node=node, daemon="far", worker=worker or node, shared_memory=False)

    def stop_daemon(self) -> int:
        """Stop the daemon with SIGTERM, and return its exit code."""
        assert self.daemon is not None
        daemon, self.daemon = self.daemon, None
        return daemon.stop(DAEMON_SECONDS)
