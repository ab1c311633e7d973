"""ROS 2: its packages, and whether this shell uses the daemon's domain and middleware."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from pathlib import Path

import psutil

from bridge.adapters.ros2 import discovery, receive_buffers
from bridge.adapters.ros2.environment import CYCLONE, STATIC_PEERS, available, domain
from bridge.adapters.ros2.security import ENABLE, KEYSTORE, is_enabled
from bridge.doctor.check import Check, Finding, Findings, fail, ok, packages, skip, warn
from bridge.doctor.checks import cyclone, releases
from bridge.doctor.context import CheckContext, environment_of
from bridge.text import listed

_KNOWN_RMW = ("rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp", "rmw_cyclonedds_cpp", "rmw_connextdds", "rmw_zenoh_cpp")


def check_packages(context: CheckContext) -> Findings:
    """Check that rclpy is installed."""
    return packages("ros2", "rclpy", context.config.ros2.enabled, available(context.config))


def check_environment(context: CheckContext) -> Findings:
    """Check that this shell's programs use the daemon's domain, discovery settings and security."""
    if context.config.ros2.enabled is False:
        return skip("ros2.enabled is false")
    text = context.environ.get("ROS_DOMAIN_ID") or "0"
    if not (text.isascii() and text.isdigit() and int(text) <= 232):
        return fail(f"ROS_DOMAIN_ID is {text!r}, not a number from 0 to 232", "export ROS_DOMAIN_ID=0, or unset it")
    findings: list[Finding] = []
    meant, by = _daemons_domain(context)
    if int(text) != meant:
        seen = f"this shell's ROS_DOMAIN_ID is {text}, {by} uses {meant}: its ROS 2 programs do not see the daemon"
        findings.append(warn(seen, f"export ROS_DOMAIN_ID={meant}, or set ros2.domain to {text}"))
    findings += _range(context)
    set_to = (context.environ.get(f"{dds}_DEFAULT_PROFILES_FILE") for dds in ("FASTRTPS", "FASTDDS"))
    profile = next(filter(None, set_to), None)
    if profile and not Path(profile).is_file():
        findings.append(warn(f"the Fast DDS profile {profile} of this shell does not exist", "unset the variable"))
    findings += (
        _discovery(context) + _servers(context) + _restarted_server(context) + _peers(context) + _security(context)
    )
    return findings or ok(f"domain {meant}")


def check_rmw(context: CheckContext) -> Findings:
    """Check that this shell's ROS 2 programs use DDS, like the ROS 2 side."""
    name = context.environ.get("RMW_IMPLEMENTATION", "")
    if not name or name.startswith("rmw_fastrtps"):
        return ok(f"RMW_IMPLEMENTATION is {name or 'not set (Fast DDS)'}")
    if name == "rmw_zenoh_cpp":
        cure = "nothing to do if that is intended; else unset RMW_IMPLEMENTATION"
        return warn("RMW_IMPLEMENTATION is rmw_zenoh_cpp: this shell's programs are on the hub, not on DDS", cure)
    if name == "rmw_cyclonedds_cpp":
        return ok("RMW_IMPLEMENTATION is rmw_cyclonedds_cpp: this shell's programs are bridged; messages use UDP")
    if name in _KNOWN_RMW:
        cure = "nothing to do for topics; only Fast DDS (rmw_fastrtps_cpp) on both ends is tested"
        return warn(f"RMW_IMPLEMENTATION is {name}: not Midspan's DDS; large messages use UDP", cure)
    return fail(f"RMW_IMPLEMENTATION is {name}, which is not a ROS 2 middleware", "unset it")


def check_cyclone(context: CheckContext) -> Findings:
    """Check what a ROS 2 side on Cyclone DDS (``ros2.rmw``) needs, and which nodes' services it cannot call."""
    if context.config.ros2.enabled is False or context.config.ros2.rmw != CYCLONE:
        return skip(f"ros2.rmw is not {CYCLONE}, or ros2.enabled is false")
    lacking = available(context.config)
    if lacking:
        return fail(f"the ROS 2 side stays off: {lacking}")
    workers = context.hub.of_side("ros2", context.config.name)
    reports = [worker.cyclone for worker in workers if worker.cyclone is not None]
    if not reports:
        return ok(f"{CYCLONE} is installed; the worker does not report, so the nodes on another DDS are unknown")
    findings = [
        warn(_uncallable(report.foreign, report.uncallable), "remove ros2.rmw, or run these nodes on Cyclone DDS")
        for report in reports
        if report.foreign
    ]
    return findings or ok(f"{CYCLONE} is installed, and no discovered node serves on another DDS")


def check_buffers(context: CheckContext) -> Findings:
    """Check the kernel's limit of receive buffers, if the configuration lets the ROS 2 side receive much over UDP."""
    ros2, proc = context.config.ros2, context.proc
    if ros2.enabled is False:
        return skip("ros2.enabled is false")
    if ros2.localhost_only and ros2.profile is None and ros2.transport != "udp" and ros2.rmw != CYCLONE:
        return skip("ros2.localhost_only is true: large messages use shared memory")
    limit, default = (receive_buffers.setting(name, proc) for name in (receive_buffers.LIMIT, receive_buffers.DEFAULT))
    if limit is None:
        return skip(f"{receive_buffers.LIMIT} is not visible here; in a container, see the host's")
    if too_small := receive_buffers.too_small(proc):
        return warn(f"{too_small}: large best-effort ROS 2 messages over UDP are lost", receive_buffers.CURE)
    return ok(
        f"{receive_buffers.LIMIT} is {limit}; ROS 2 programs with Fast DDS's default settings use"
        f" {receive_buffers.DEFAULT}, which is {default}"
    )


def _uncallable(nodes: list[str], services: list[str]) -> str:
    named = f" ({listed(services)})" if services else ""
    return f"services{named}, actions and parameters of {listed(nodes)} cannot be called: they are not on Cyclone DDS"


def _daemons_domain(context: CheckContext) -> tuple[int, str]:
    """Return the running worker's domain if it can be read, else the configuration's; and its source."""
    for document in context.hub.of_side("ros2", context.config.name):
        running = environment_of(context.process(document)).get("ROS_DOMAIN_ID", "")
        if running.isdigit():
            return int(running), "the running daemon"
    if context.config.ros2.domain is not None:
        return context.config.ros2.domain, "the configuration (ros2.domain)"
    return domain(context.config, context.environ), "the daemon"


def _range(context: CheckContext) -> list[Finding]:
    """Check that this shell's programs discover others, including on other machines if the daemon does."""
    environ, local = context.environ, context.config.ros2.localhost_only
    reach = environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper()
    if reach == "OFF":
        return [fail("ROS_AUTOMATIC_DISCOVERY_RANGE is OFF: this shell's ROS 2 programs discover nothing", "unset it")]
    shell_local = environ.get("ROS_LOCALHOST_ONLY") == "1" or reach == "LOCALHOST"
    if shell_local and not local:
        cure = "unset ROS_LOCALHOST_ONLY and ROS_AUTOMATIC_DISCOVERY_RANGE, or set ros2.localhost_only: true"
        return [warn("this shell's ROS 2 programs discover only this machine, but ros2.localhost_only is false", cure)]
    return []


def _discovery(context: CheckContext) -> list[Finding]:
    """Check that this shell and the running worker use the same discovery server, or none."""
    mine = context.environ.get("ROS_DISCOVERY_SERVER", "")
    for document in context.hub.of_side("ros2", context.config.name):
        environment = environment_of(context.process(document))
        theirs = environment.get("ROS_DISCOVERY_SERVER", "")
        if environment and mine != theirs:
            seen = f"ROS_DISCOVERY_SERVER is {mine or 'not set'} in this shell, {theirs or 'not set'} for the daemon"
            cure = "set the same value in this shell and for the daemon, and restart the daemon (docs/sides/ros2.md)"
            return [warn(f"{seen}: this shell's ROS 2 programs and the daemon may not discover each other", cure)]
    return []


def _servers(context: CheckContext) -> list[Finding]:
    """Check that the worker reaches its discovery servers."""
    if context.config.ros2.rmw == CYCLONE:
        return []
    listed = discovery.servers(_worker_environment(context))
    findings: list[Finding] = []
    local = context.config.ros2.localhost_only and context.config.ros2.profile is None
    if seen := discovery.excluded(listed) if local else "":
        findings.append(warn(seen, discovery.LOCALHOST_CURE))
    return findings + [warn(discovery.silent(server), discovery.START_CURE) for server in discovery.failing(listed)]


def _restarted_server(context: CheckContext) -> list[Finding]:
    """Check that a local discovery server has not restarted since the worker started; Fast DDS may not survive that."""
    for document in context.hub.of_side("ros2", context.config.name):
        worker = context.process(document)
        for _, port in discovery.servers(environment_of(worker)):
            server = _udp_process(port)
            if worker is not None and server is not None and server.create_time() > worker.create_time():
                seen = f"the discovery server at port {port} (process {server.pid}) {discovery.RESTARTED}"
                return [warn(seen, discovery.RESTARTED_CURE)]
    return []


def _udp_process(port: int) -> psutil.Process | None:
    """Return this machine's process that receives at a UDP port; None if there is none, or it is another user's."""
    with contextlib.suppress(psutil.Error):
        for connection in psutil.net_connections("udp"):
            if connection.laddr and connection.laddr.port == port and connection.pid:
                return psutil.Process(connection.pid)
    return None


def _worker_environment(context: CheckContext) -> Mapping[str, str]:
    """Return the running worker's environment if it can be read, else this shell's."""
    running = (environment_of(context.process(worker)) for worker in context.hub.of_side("ros2", context.config.name))
    return next(filter(None, running), context.environ)


def _peers(context: CheckContext) -> list[Finding]:
    """Check that the worker announces itself to the static peers."""
    mine, theirs = (environ.get(STATIC_PEERS, "") for environ in (context.environ, _worker_environment(context)))
    findings: list[Finding] = []
    if theirs and context.config.ros2.localhost_only:
        seen = f"{STATIC_PEERS} is {theirs} for the daemon, but ros2.localhost_only keeps the daemon on this machine"
        findings.append(warn(seen, "set ros2.localhost_only: false, unless that is intended"))
    if mine and mine != theirs:
        seen = f"{STATIC_PEERS} is {mine} in this shell, {theirs or 'not set'} for the daemon"
        cure = "set it for the daemon, too, and restart the daemon (docs/sides/ros2.md)"
        findings.append(warn(f"{seen}: the daemon may not discover nodes that do not use multicast", cure))
    return findings


def _security(context: CheckContext) -> list[Finding]:
    """Check that this shell and the daemon are both in a secured domain, or neither is."""
    theirs = _worker_environment(context)
    if is_enabled(context.environ) == is_enabled(theirs):
        mine, other = context.environ.get(KEYSTORE, ""), theirs.get(KEYSTORE, "")
        if not is_enabled(theirs) or mine == other:
            return []
        seen = f"{KEYSTORE} is {mine or 'not set'} in this shell, {other or 'not set'} for the daemon"
        cure = "nothing to do if both are copies of one keystore; else set the same"
        return [warn(f"{seen}: programs with certificates of two authorities do not discover each other", cure)]
    inside, outside = ("this shell", "the daemon") if is_enabled(context.environ) else ("the daemon", "this shell")
    seen = f"{ENABLE} is true for {inside}, not for {outside}: their ROS 2 programs do not discover each other"
    return [fail(seen, "set ROS 2's security variables to the same values in both, and restart the daemon")]


CHECKS = (
    Check("ros2-packages", "ROS 2 on this machine", check_packages),
    Check("ros2-environment", "this shell's ROS 2 against the daemon's", check_environment),
    Check("ros2-rmw", "the ROS 2 middleware of this shell", check_rmw),
    Check("ros2-buffers", "the kernel's receive buffers for ROS 2 over UDP", check_buffers),
    Check("ros2-cyclone", "a ROS 2 side on Cyclone DDS", check_cyclone),
    *releases.CHECKS,
    *cyclone.CHECKS,
)
"""The doctor's checks of this side."""
