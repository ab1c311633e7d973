"""ROS 1: are its packages here, does the master answer, and does this shell mean the same one as the daemon?"""

from __future__ import annotations

import socket
from collections.abc import Sequence
from urllib.parse import urlsplit

from bridge.adapters.ros1.environment import available, master_uri
from bridge.adapters.ros1.errors import Ros1Error
from bridge.adapters.ros1.graph import Looker
from bridge.adapters.ros1.rpc import RpcClient
from bridge.doctor.around import Around, environment_of
from bridge.doctor.finding import Finding, fail, ok, skip, warn

_SECONDS = 2.0


def look_at_packages(around: Around) -> Sequence[Finding]:
    """Is rospy installed?"""
    enabled = around.config.ros1.enabled
    if enabled is False:
        return [skip("ros1.enabled is false")]
    reason = available(around.config, around.environ)
    if not reason:
        return [ok("rospy is installed")]
    if enabled is True:
        return [fail(f"ros1.enabled is true, but {reason}")]
    return [warn(f"the ROS 1 side stays off: {reason}", "nothing to do where no ROS 1 is wanted: ros1.enabled: false")]


def why_not(around: Around) -> str:
    """Why there is no ROS 1 side to look at, "" where there is."""
    if around.config.ros1.enabled is False:
        return "ros1.enabled is false"
    if available(around.config, around.environ) and not around.hub.of_side("ros1"):
        return "no ROS 1 on this machine"
    return ""


def look_at_master(around: Around) -> Sequence[Finding]:
    """Does the master's name resolve, and does it answer?"""
    reason = why_not(around)
    if reason:
        return [skip(reason)]
    uri = around.master
    look = around.look_at_master()
    if not isinstance(look, Ros1Error):
        return [ok(f"{uri} answers: {len(look.uris)} nodes, {len(look.types)} topics")]
    host = urlsplit(uri).hostname or ""
    try:
        addresses = sorted({str(info[4][0]) for info in socket.getaddrinfo(host, None, socket.AF_INET)})
    except (OSError, UnicodeError):
        return [
            fail(
                f"{uri}: the host name '{host}' does not resolve on this machine",
                f"add '{host}' with its address to /etc/hosts, or give the address itself in ros1.master",
            )
        ]
    seen = f"{look} (it resolves to {', '.join(addresses)})"
    cure = "start roscore there, check ROS_MASTER_URI or ros1.master, and that no firewall holds its port back"
    meant = around.config.ros1.master or around.environ.get("ROS_MASTER_URI")
    return [fail(seen, cure) if meant or around.config.ros1.enabled is True else warn(seen, cure)]


def look_at_environment(around: Around) -> Sequence[Finding]:
    """Do the programs of this shell and the daemon talk to the same master?"""
    reason = why_not(around)
    if reason:
        return [skip(reason)]
    shell = around.environ.get("ROS_MASTER_URI")
    config = around.config.ros1.master
    findings: list[Finding] = []
    if shell and config and not _same_place(shell, config):
        cure = "set both alike: export ROS_MASTER_URI, or change ros1.master"
        findings.append(
            warn(f"this shell's ROS_MASTER_URI is {shell}, the configuration's ros1.master is {config}", cure)
        )
    findings += _against_worker(around, shell or master_uri(around.config, {}))
    return findings or [ok(f"this shell and the daemon mean {shell or around.master}")]


def _against_worker(around: Around, shell: str) -> list[Finding]:
    """Whether the network that this shell's programs would join is the one that the running daemon is on."""
    mine = next((d for d in around.hub.of_side("ros1", around.config.name) if d.get("network")), None)
    if mine is None:
        return []
    here = _network(shell)
    if here is None or here == mine["network"]:
        return []
    theirs = environment_of(around.process(mine)).get("ROS_MASTER_URI", "another master")
    cure = f"export ROS_MASTER_URI={theirs}" if "://" in theirs else "start the daemon with this shell's ROS_MASTER_URI"
    return [fail(f"the running daemon is on {theirs}; this shell's programs use {shell}", cure)]


def _network(uri: str) -> str | None:
    try:
        client = RpcClient(uri, _SECONDS)
        try:
            return Looker(client, "/midspan_doctor").look().network
        finally:
            client.close()
    except Ros1Error:
        return None


def _same_place(one: str, other: str) -> bool:
    def place(uri: str) -> tuple[str | None, int | None]:
        parts = urlsplit(uri)
        host = "localhost" if parts.hostname == "127.0.0.1" else parts.hostname
        return host, parts.port

    try:
        return place(one) == place(other)
    except ValueError:
        return one == other
