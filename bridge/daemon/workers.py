"""Midspan's workers by name: their code, their requirements, and the sections of the configuration that they use.

``$MIDSPAN_WORKERS`` (``ros1=package.module:Class,...``) replaces a worker by a custom class, which is called without
arguments and runs in the daemon's environment.
"""

from __future__ import annotations

import importlib
import importlib.util
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
from bridge.sides import Side, all_sides
from bridge.worker import Worker

VARIABLE = "MIDSPAN_WORKERS"


@dataclass(frozen=True, slots=True)
class WorkerKind:
    """One kind of worker.

    Attributes:
        factory: ``module:Class``, imported in the worker's own process.
        sections: the worker is reloaded only if one of these sections of the configuration changes.
        environment: a module with ``available(config)`` and ``worker_environment(config, environ)``.
        needs: without ``environment``, the packages that must be importable; pip's ``extra`` installs them.
        outlives: the worker continues if the daemon dies, and the next daemon adopts it.
    """

    name: str
    factory: str
    arguments: tuple[str, ...] = ()
    sections: frozenset[str] = frozenset()
    environment: str = ""
    needs: tuple[str, ...] = ()
    extra: str = ""
    outlives: bool = False

    def create(self) -> Worker:
        """Import and create the worker, in the process that runs it."""
        module, _, name = self.factory.partition(":")
        worker: Worker = getattr(importlib.import_module(module), name)(*self.arguments)
        return worker

    def enabled(self, config: Config) -> Enabled:
        """Return the configuration's value, or what the side's environment derives from it."""
        decide = getattr(importlib.import_module(self.environment), "enabled", None) if self.environment else None
        if decide is not None:
            enabled: Enabled = decide(config)
            return enabled
        if self.name == "ros1_master":
            return config.ros1.enabled is not False and bool(config.ros1.embedded_uri)
        if self.name == "modules":
            return config.modules.enabled if config.hosted or config.store.enabled is True else False
        return config.hub.router if self.name == "router" else getattr(config, self.name).enabled

    def missing(self, config: Config) -> str:
        """Return why it cannot run on this machine, or ""."""
        if self.environment:
            reason: str = importlib.import_module(self.environment).available(config)
            return reason
        missing = [name for name in self.needs if importlib.util.find_spec(name) is None]
        return f"{', '.join(missing)} cannot be imported; pip install 'midspan[{self.extra}]'" if missing else ""

    def child_environment(self, config: Config, environ: Mapping[str, str] = os.environ) -> dict[str, str]:
        """Return the environment of its process; raises `RuntimeError` if this machine has none for it."""
        if self.environment:
            env: dict[str, str] = importlib.import_module(self.environment).worker_environment(config, environ)
        else:
            env = {**environ, "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}  # avoids the wheels' second start of Python
        for name in (*NOTIFY_ENVIRONMENT, "JOURNAL_STREAM"):
            env.pop(name, None)
        return _importable(env)

    def config_part(self, config: Config) -> dict[str, Any]:
        """Return the part of the configuration that it uses, for comparison."""
        part = {name: getattr(config, name) for name in sorted({"name", "state", "hub", "log", *self.sections})}
        if self.name in ("web", "metrics") and config.web.guarded:  # both show the certificate of hub.open
            listener = config.hub.open
            part["keys"] = (listener.keys, listener.ca, listener.certificate, listener.key)
        if self.name != "router":
            return {**part, "hub": config.hub.indoors}
        # its access rules depend on the rules for commands
        return {**part, "routing": config.rules} if config.hub.open.opened else part


def _of_side(side: Side) -> WorkerKind:
    sections = frozenset({side.name, "types", "limits", "routing", "navigation", "metrics", "modules", "clock"})
    return WorkerKind(side.name, "bridge.adapters.worker:BridgeWorker", (side.name,), sections, side.environment)


_WEB = ("starlette", "uvicorn", "websockets")

WORKERS = (
    WorkerKind("router", "bridge.hub.router:create_router", outlives=True),
    WorkerKind(
        "ros1_master", "bridge.adapters.ros1.master.worker:MasterWorker", sections=frozenset({"ros1"}), outlives=True
    ),
    *map(_of_side, all_sides()),
    WorkerKind(
        "modules",
        "bridge.modules.worker:ModulesWorker",
        sections=frozenset({"modules", "navigation", "store", "types", "limits", "yarp", "metrics", "clock"}),
    ),
    WorkerKind(
        "sim",
        "sim.simulator:SimWorker",
        sections=frozenset({"sim", "clock", "types", "limits", "yarp"}),
        environment="sim.environment",
    ),
    WorkerKind(
        "record",
        "bridge.record.worker:RecordWorker",
        sections=frozenset({"record", "clock", "types", "limits", "yarp"}),
    ),
    WorkerKind(
        "web",
        "bridge.web.worker:WebWorker",
        sections=frozenset({"web", "metrics", "navigation", "modules", "types", "limits", "clock", "routing"}),
        needs=_WEB,
        extra="web",
    ),
    WorkerKind(
        "foxglove",
        "bridge.foxglove.worker:FoxgloveWorker",
        sections=frozenset(
            {"foxglove", "web", "metrics", "navigation", "modules", "types", "limits", "clock", "routing"}
        ),
        needs=("foxglove",),
        extra="foxglove",
    ),
    WorkerKind(
        "metrics",
        "bridge.web.metrics_worker:MetricsWorker",
        sections=frozenset({"metrics", "web", "clock", "types", "modules", "navigation"}),
        needs=_WEB,
        extra="web",
    ),
)


def worker_kinds(environ: Mapping[str, str] = os.environ) -> dict[str, WorkerKind]:
    """Return all workers by name, in the order in which they start."""
    kinds = {kind.name: kind for kind in WORKERS}
    for entry in filter(None, environ.get(VARIABLE, "").split(",")):
        name, _, factory = entry.partition("=")
        if name not in kinds or ":" not in factory:
            raise RuntimeError(f"${VARIABLE}: {entry!r} is not NAME=module:Class; NAME is one of {', '.join(kinds)}")
        kinds[name] = replace(kinds[name], factory=factory, arguments=(), environment="", needs=())
    return kinds


def child_command(worker: str, *options: str) -> list[str]:
    """Return the command of a worker's process. ``-P`` avoids imports from the working directory."""
    return [sys.executable, "-P", "-m", "bridge.cli.main", "worker", worker, *options]


def supervised_command(worker: str, *options: str) -> list[str]:
    """Return the command of a worker that the daemon starts: it reports its progress from the beginning."""
    return [sys.executable, "-P", "-m", "bridge.cli.child", "worker", worker, "--supervised", *options]


def _importable(env: dict[str, str]) -> dict[str, str]:
    """Put Midspan's folder on the child's path, for a checkout that is not installed."""
    root = str(Path(bridge.__file__).parents[1])
    if root not in site.getsitepackages():
        paths = [path for path in env.get("PYTHONPATH", "").split(os.pathsep) if path and path != root]
        env["PYTHONPATH"] = os.pathsep.join([*paths, root])
    return env
