"""The workers that Midspan has, by name: where their code is, what they need, what of the configuration they use.

``$MIDSPAN_WORKERS`` (``ros1=package.module:Class,...``) puts a class of one's own in a worker's place, called without
arguments; it then runs in the daemon's own environment.
"""

from __future__ import annotations

import importlib
import os
import site
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import bridge
from bridge.config.model import Config
from bridge.config.sections.section import Enabled
from bridge.daemon.notify import ENVIRONMENT as NOTIFY_ENVIRONMENT
from bridge.worker import Worker

VARIABLE = "MIDSPAN_WORKERS"


@dataclass(frozen=True, slots=True)
class WorkerKind:
    """One kind of worker.

    Attributes:
        name: as in ``midspan worker NAME``.
        factory: ``module:Class``, imported in the worker's own process alone.
        arguments: what the class is called with.
        sections: the configuration's sections that it uses; a change elsewhere does not touch it.
        environment: module with ``available(config)`` and ``worker_environment(config, environ)``, "" where it needs
            nothing of its own.
        outlives: it goes on when the daemon dies, and the next daemon adopts it.
    """

    name: str
    factory: str
    arguments: tuple[str, ...] = ()
    sections: frozenset[str] = frozenset()
    environment: str = ""
    outlives: bool = False

    def create(self) -> Worker:
        """Import and make the worker, in the process that runs it."""
        module, _, name = self.factory.partition(":")
        worker: Worker = getattr(importlib.import_module(module), name)(*self.arguments)
        return worker

    def enabled(self, config: Config) -> Enabled:
        """What the configuration says; without a dialect there is no zenoh side to speak of, nor a YARP side unused."""
        if self.name == "zenoh" and not config.zenoh.dialects:
            return False
        if self.name == "yarp" and config.yarp.enabled == "auto" and self.missing(config):
            return False
        if self.name == "modules":
            return config.modules.enabled if config.hosted or config.store.enabled is True else False
        return config.hub.router if self.name == "router" else getattr(config, self.name).enabled

    def missing(self, config: Config) -> str:
        """Why it cannot run on this machine, "" where it can."""
        if not self.environment:
            return ""
        reason: str = importlib.import_module(self.environment).available(config)
        return reason

    def child_environment(self, config: Config, environ: Mapping[str, str] = os.environ) -> dict[str, str]:
        """The environment that its process is started with; raises `RuntimeError` where it has none here."""
        if self.environment:
            env: dict[str, str] = importlib.import_module(self.environment).worker_environment(config, environ)
        else:
            env = {**environ, "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}  # spares the wheels' second start of Python
        for name in (*NOTIFY_ENVIRONMENT, "JOURNAL_STREAM"):
            env.pop(name, None)
        return _importable(env)

    def config_part(self, config: Config) -> dict[str, Any]:
        """The part of the configuration that it uses, for comparison."""
        part = {name: getattr(config, name) for name in sorted({"name", "state", "hub", "log", *self.sections})}
        if self.name != "router":
            return {**part, "hub": config.hub.indoors}
        # the rules tell its door what commands are
        return {**part, "routing": config.rules} if config.hub.open.opened else part


def _side(name: str) -> WorkerKind:
    return WorkerKind(
        name,
        "bridge.adapters.worker:BridgeWorker",
        (name,),
        frozenset({name, "types", "routing", "navigation"}),
        f"bridge.adapters.{name}.environment",
    )


WORKERS = (
    WorkerKind("router", "bridge.hub.router:RouterWorker", outlives=True),
    _side("ros1"),
    _side("ros2"),
    _side("yarp"),
    _side("zenoh"),
    WorkerKind(
        "modules",
        "bridge.modules.worker:ModulesWorker",
        sections=frozenset({"modules", "navigation", "store", "types", "limits", "yarp"}),
    ),
    WorkerKind(
        "sim",
        "sim.worker:SimWorker",
        sections=frozenset({"sim", "clock", "types", "limits", "yarp"}),
        environment="sim.environment",
    ),
)


def worker_kinds(environ: Mapping[str, str] = os.environ) -> dict[str, WorkerKind]:
    """All workers by name, in the order in which they start."""
    kinds = {kind.name: kind for kind in WORKERS}
    for entry in filter(None, environ.get(VARIABLE, "").split(",")):
        name, _, factory = entry.partition("=")
        if name not in kinds or ":" not in factory:
            msg = f"${VARIABLE}: {entry!r} is not NAME=module:Class with a NAME of {', '.join(kinds)}"
            raise RuntimeError(msg)
        kinds[name] = replace(kinds[name], factory=factory, arguments=(), environment="")
    return kinds


def child_command(worker: str, *options: str) -> list[str]:
    """The command of a worker's process. ``-P``: nothing is imported from the working directory."""
    return [sys.executable, "-P", "-m", "bridge.cli.main", "worker", worker, *options]


def _importable(env: dict[str, str]) -> dict[str, str]:
    """Where Midspan runs from a checkout that is not installed, its folder must be on the child's path."""
    root = str(Path(bridge.__file__).parents[1])
    if root not in site.getsitepackages():
        paths = [path for path in env.get("PYTHONPATH", "").split(os.pathsep) if path and path != root]
        env["PYTHONPATH"] = os.pathsep.join([*paths, root])
    return env
