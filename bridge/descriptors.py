"""The workers and modules of Midspan, each described by one object in its own package.

To add a worker or module, write a package with a `WorkerDescriptor` or a `ModuleDescriptor`, and add a line to
`WORKERS` or `MODULES`; see docs/develop/add_a_worker.md and docs/develop/add_a_module.md. A package outside this tree
registers its descriptor as `bridge.registration` describes. A descriptor names its code, which is imported only when it
is used.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

from bridge.registration import imported, registered
from bridge.sides import all_sides

NODE = frozenset({"clock", "limits", "types"})
"""The sections of the configuration that a node on the hub uses."""

DIAGNOSTICS = frozenset({"metrics", "modules", "navigation"})
"""The sections of the configuration that a worker uses to publish on ``/diagnostics``."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerDescriptor:
    """A worker. Names like ``package.module:name`` are imported only when used.

    Attributes:
        name: the worker's name, and the key of its section in the configuration.
        factory: ``package.module:Class``; the worker's own process imports it, and calls it with ``arguments``.
        section: ``package.module:Model`` of its section, whose key ``enabled`` enables the worker; "" if it has none.
        about: description of the section.
        sections: sections of the configuration; the worker is reloaded if one of them changes.
        uses: ``package.module:function`` that takes a configuration and returns further values of it, by name; the
            worker is reloaded if one of them changes.
        switch: ``package.module:function`` that decides whether the worker is enabled, instead of ``enabled``.
        environment: a module with ``available(config)`` and ``worker_environment(config, environ)``.
        needs: the packages that must be importable if ``environment`` is empty; the pip extra ``extra`` installs them.
        outlives: whether the worker continues if the daemon dies, so that the next daemon adopts it.
        node: whether it is a node on the hub, and reports its status there.
        hosts: whether it hosts the modules.
        checks: ``package.module:name`` of the doctor's checks.
    """

    name: str
    factory: str
    arguments: tuple[str, ...] = ()
    section: str = ""
    about: str = ""
    sections: frozenset[str] = frozenset()
    uses: str = ""
    switch: str = ""
    environment: str = ""
    needs: tuple[str, ...] = ()
    extra: str = ""
    outlives: bool = False
    node: bool = True
    hosts: bool = False
    checks: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ModuleDescriptor:
    """A hosted module. Names like ``package.module:name`` are imported only when used.

    Attributes:
        name: the module's name on the hub, and the key of its section under ``modules``.
        factory: ``package.module:Class``, imported only in the process that runs it.
        section: ``package.module:Model`` of its section; "" for the gateway, whose section is ``navigation``.
        about: description of the section.
        checks: ``package.module:name`` of the doctor's checks.
        cause: ``package.module:function`` for the doctor. It takes the input of the checks and the module's status
            document, and returns why the module waits or warns, with the cure; or None.
        accepts: ``package.module:function`` for the doctor. It takes the input of the checks, a side's status document
            and a route that this side refused, and returns why the refusal is harmless; or "".
    """

    name: str
    factory: str
    section: str = ""
    about: str = ""
    checks: str = ""
    cause: str = ""
    accepts: str = ""


WORKERS = (
    "bridge.hub:WORKER",
    "bridge.adapters.ros1.master:WORKER",
    "bridge.modules:WORKER",
    "sim:WORKER",
    "bridge.record:WORKER",
    "bridge.web:WORKER",
    "bridge.foxglove:WORKER",
    "bridge.metrics:WORKER",
)
"""The workers that come with Midspan, except those of the sides, in the order in which they start.

The sides start after the workers that outlive the daemon.
"""

MODULES = (
    "navigation.base_control:MODULE",
    "bridge.boards:MODULE",
    "navigation.gateway:MODULE",
    "navigation.localization_server:MODULE",
    "navigation.map2d_server:MODULE",
    "navigation.mapper2d:MODULE",
    "navigation.mapper3d:MODULE",
    "navigation.robot_goto:MODULE",
    "navigation.robot_path_planner:MODULE",
    "bridge.transform_server:MODULE",
)
"""The modules that come with Midspan."""


@functools.cache
def all_workers() -> tuple[WorkerDescriptor, ...]:
    """Return all workers except those of the sides, in the order in which they start."""
    built_in: tuple[WorkerDescriptor, ...] = tuple(map(imported, WORKERS))
    names = [*(worker.name for worker in built_in), *(side.name for side in all_sides())]
    return (*built_in, *registered(WorkerDescriptor, "worker", names))


@functools.cache
def all_modules() -> dict[str, ModuleDescriptor]:
    """Return all modules by name, except those in the configuration's ``modules.own``."""
    built_in: tuple[ModuleDescriptor, ...] = tuple(map(imported, MODULES))
    names = (descriptor.name for descriptor in built_in)
    return {module.name: module for module in (*built_in, *registered(ModuleDescriptor, "module", names))}
