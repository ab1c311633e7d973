"""The workers as the daemon starts them, made from the descriptors of `bridge.descriptors` and `bridge.sides`.

``$MIDSPAN_WORKERS`` (``ros1=package.module:Class,...``) replaces a worker with a custom class, which is called without
arguments and runs in the daemon's environment.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import site
import sys
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import bridge
from bridge.config.model import Config
from bridge.config.sections.section import Enabled
from bridge.daemon.notify import ENVIRONMENT as NOTIFY_ENVIRONMENT
from bridge.descriptors import DIAGNOSTICS, NODE, WorkerDescriptor, all_workers
from bridge.registration import imported
from bridge.sides import Side, all_sides
from bridge.worker import Worker

VARIABLE = "MIDSPAN_WORKERS"


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerKind(WorkerDescriptor):
    """A worker as the daemon starts it."""

    def create(self) -> Worker:
        """Import and create the worker, in the process that runs it."""
        worker: Worker = imported(self.factory)(*self.arguments)
        return worker

    def enabled(self, config: Config) -> Enabled:
        """Return whether a configuration enables the worker; ``auto``: if this machine has what the worker needs."""
        environment = importlib.import_module(self.environment) if self.environment else None
        decide = imported(self.switch) if self.switch else getattr(environment, "enabled", None)
        enabled: Enabled = getattr(config, self.name).enabled if decide is None else decide(config)
        return enabled

    def missing(self, config: Config) -> str:
        """Return why the worker cannot run on this machine, or ""."""
        if self.environment:
            reason: str = importlib.import_module(self.environment).available(config)
            return reason
        missing = [name for name in self.needs if importlib.util.find_spec(name) is None]
        return f"{', '.join(missing)} cannot be imported; pip install 'midspan[{self.extra}]'" if missing else ""

    def child_environment(self, config: Config, environ: Mapping[str, str] = os.environ) -> dict[str, str]:
        """Return the environment of the worker's process; raises `RuntimeError` if this machine lacks what it needs."""
        if self.environment:
            env: dict[str, str] = importlib.import_module(self.environment).worker_environment(config, environ)
        else:
            env = {**environ, "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}  # avoids the wheels' second start of Python
        for name in (*NOTIFY_ENVIRONMENT, "JOURNAL_STREAM"):
            env.pop(name, None)
        return _importable(env)

    def config_part(self, config: Config) -> dict[str, Any]:
        """Return the part of the configuration that the worker uses, for comparison."""
        names = {"name", "state", "log", *self.sections, *([self.name] if self.section else [])}
        part = {name: getattr(config, name) for name in names} | {"hub": config.hub.without_open}
        return part | imported(self.uses)(config) if self.uses else part


def _of_side(side: Side) -> WorkerKind:
    return WorkerKind(
        name=side.name,
        factory="bridge.adapters.worker:BridgeWorker",
        arguments=(side.name,),
        sections=frozenset({side.name, "routing"}) | NODE | DIAGNOSTICS,
        environment=side.environment,
    )


def _kind_of(descriptor: WorkerDescriptor) -> WorkerKind:
    return WorkerKind(**{field.name: getattr(descriptor, field.name) for field in fields(descriptor)})


def worker_kinds(environ: Mapping[str, str] = os.environ) -> dict[str, WorkerKind]:
    """Return all workers by name, in the order in which they start: those that outlive the daemon, sides, others."""
    workers = [_kind_of(descriptor) for descriptor in all_workers()]
    first, others = ([kind for kind in workers if kind.outlives is outlives] for outlives in (True, False))
    kinds = {kind.name: kind for kind in (*first, *map(_of_side, all_sides()), *others)}
    for entry in environ.get(VARIABLE, "").split(","):
        name, equals, factory = entry.partition("=")
        if not equals:  # registers an additional worker: see `bridge.registration`
            continue
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
