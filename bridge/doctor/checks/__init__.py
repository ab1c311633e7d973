"""The checks, in the order in which they are shown."""

from __future__ import annotations

from bridge.doctor.check import Check
from bridge.doctor.checks import bridges, connections, console, cyclone, hub, machine, sharedmemory, types
from bridge.sides import all_sides, imported

CHECKS: tuple[Check, ...] = (
    Check("config", "the configuration", hub.look_at_config),
    Check("daemon", "the daemon and its workers", hub.look_at_workers),
    Check("services", "several daemons on this machine (`midspan@.service`)", hub.look_at_services),
    Check("router-port", "the router's port", hub.look_at_port),
    Check(
        "keys",
        "the certificates and connections of other machines (`hub.open`)",
        connections.look_at_connections,
        seconds=connections.SECONDS,
    ),
    Check("console", "the certificate of the console (`web`)", console.look_at_certificate),
    Check("kernels", "the compiled kernels", machine.look_at_kernels),
    Check("wheels", "libraries that have no wheel on this system", machine.look_at_wheels),
    *(check for side in all_sides() if side.checks for check in imported(side.checks)),
    *cyclone.CHECKS,
    Check("two-bridges", "other bridges on the same networks", bridges.check, seconds=15.0),
    Check("types", "message types that could not be used", types.look_at_refused),
    Check("type-hash", "definitions that differ between machines", types.look_at_hashes),
    Check("compiler", "the compiler for missing message packages (`midspan interfaces build`)", types.look_at_compiler),
    Check("clock", "the clocks of the machines, and simulated time", machine.look_at_clocks),
    Check("shm-users", "users that share Fast DDS's shared memory", sharedmemory.look_at_users),
    Check("shm-size", "room in shared memory", sharedmemory.look_at_size),
    Check("shm-litter", "what dead processes left in shared memory", sharedmemory.look_at_litter),
    Check("descriptors", "the limit of open files", machine.look_at_descriptors),
    Check("state-folder", "the state folder", machine.look_at_state),
)
