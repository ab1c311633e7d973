"""The checks, in the order in which they are shown."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from bridge.descriptors import ModuleDescriptor, WorkerDescriptor, all_modules, all_workers
from bridge.doctor.check import Check
from bridge.doctor.checks import bridges, daemon, machine, sharedmemory, types
from bridge.registration import imported
from bridge.sides import Side, all_sides


def _registered(descriptors: Iterable[Side | WorkerDescriptor | ModuleDescriptor]) -> Iterator[Check]:
    """Yield the checks to which the descriptors refer."""
    for descriptor in descriptors:
        yield from imported(descriptor.checks) if descriptor.checks else ()


CHECKS: tuple[Check, ...] = (
    Check("config", "the configuration", daemon.check_config),
    Check("daemon", "the daemon and its workers", daemon.check_workers),
    Check("services", "several daemons on this machine (`midspan@.service`)", daemon.check_services),
    *_registered((*all_workers(), *all_modules().values())),
    Check("kernels", "the compiled kernels", machine.check_kernels),
    Check("wheels", "libraries that have no wheel on this system", machine.check_wheels),
    *_registered(all_sides()),
    Check("two-bridges", "other bridges on the same networks", bridges.check, seconds=40.0),
    Check("types", "message types that could not be used", types.check_refused),
    Check("type-hash", "definitions that differ between machines", types.check_hashes),
    Check("compiler", "the compiler for missing message packages (`midspan interfaces build`)", types.check_compiler),
    Check("clock", "the clocks of the machines, and simulated time", machine.check_clocks),
    Check("shm-users", "users that share Fast DDS's shared memory", sharedmemory.check_users),
    Check("shm-size", "room in shared memory", sharedmemory.check_size),
    Check("shm-litter", "what dead processes left in shared memory", sharedmemory.check_litter),
    Check("shm-ports", "ROS 2 programs that receive nothing over shared memory", sharedmemory.check_ports),
    Check("descriptors", "the limit of open files", machine.check_descriptors),
    Check("state-folder", "the state folder", machine.check_state),
)
