"""The checks, in the order in which they are shown."""

from __future__ import annotations

from bridge.doctor.checks import (
    bridges,
    clock,
    daemon,
    keys,
    machine,
    ros1,
    ros1_names,
    ros2,
    router,
    sharedmemory,
    types,
    wheels,
    yarp,
)
from bridge.doctor.finding import Check

CHECKS: tuple[Check, ...] = (
    Check("config", "the configuration", daemon.look_at_config),
    Check("daemon", "the daemon and its workers", daemon.look_at_workers),
    Check("router-port", "the router's port", router.look),
    Check("keys", "the certificates by which machines join (`hub.open`)", keys.look),
    Check("wheels", "libraries that have no wheel on this system", wheels.look),
    Check("ros1-packages", "ROS 1 on this machine", ros1.look_at_packages),
    Check("ros1-master", "the ROS 1 master", ros1.look_at_master),
    Check("ros1-environment", "this shell's ROS 1 against the daemon's", ros1.look_at_environment),
    Check("ros1-address", "the address that ROS 1 peers are given", ros1_names.look_at_address),
    Check("ros1-nodes", "the addresses of ROS 1 nodes", ros1_names.look_at_nodes),
    Check("ros2-packages", "ROS 2 on this machine", ros2.look_at_packages),
    Check("ros2-environment", "this shell's ROS 2 against the daemon's", ros2.look_at_environment),
    Check("ros2-rmw", "the ROS 2 middleware of this shell", ros2.look_at_rmw),
    Check("yarp-names", "the YARP name server", yarp.look_at_name_server),
    Check("yarp-environment", "this shell's YARP against the daemon's", yarp.look_at_environment),
    Check("two-bridges", "other bridges on the same networks", bridges.look, seconds=15.0),
    Check("types", "message types that could not be used", types.look_at_refused),
    Check("type-hash", "definitions that differ between machines", types.look_at_hashes),
    Check("compiler", "the compiler for missing message packages (`midspan interfaces build`)", types.look_at_compiler),
    Check("clock", "the clocks of the machines", clock.look),
    Check("shm-users", "users that share Fast DDS's shared memory", sharedmemory.look_at_users),
    Check("shm-size", "room in shared memory", sharedmemory.look_at_size),
    Check("shm-litter", "what dead processes left in shared memory", sharedmemory.look_at_litter),
    Check("descriptors", "the limit of open files", machine.look_at_descriptors),
    Check("state-folder", "the state folder", machine.look_at_state),
)
