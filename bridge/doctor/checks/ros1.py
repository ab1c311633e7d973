"""ROS 1: its packages, its master, this shell's master and the daemon's, and names that do not resolve.

Every ROS 1 node registers its address from ROS_HOSTNAME, ROS_IP or the machine's name (rosgraph.network) with the
master, and its subscribers must reach it under that address. If host names resolve differently on the machines, data
may flow in only one direction.
"""

from __future__ import annotations

import ipaddress
import queue
import socket
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar
from urllib.parse import urlsplit

import psutil

from bridge.adapters.ros1.environment import available, is_local, master_uri
from bridge.adapters.ros1_peers import Ros1Error
from bridge.doctor.check import Check, Finding, Findings, fail, ok, packages, skip, warn
from bridge.doctor.context import CheckContext, environment_of, read_master


def check_packages(context: CheckContext) -> Findings:
    """Check that the side can run as configured; it needs no ROS 1 packages."""
    enabled, lacking = context.config.ros1.enabled, available(context.config)
    if enabled is False or lacking:
        return packages("ros1", "ROS 1", enabled, lacking)
    return ok("Midspan joins ROS 1 without its packages")


def why_not(context: CheckContext) -> str:
    """Return why the ROS 1 side is not checked, "" if it is."""
    if context.config.ros1.enabled is False:
        return "ros1.enabled is false"
    return "" if context.hub.of_side("ros1") else available(context.config)


def check_master(context: CheckContext) -> Findings:
    """Check that the master's host name resolves, and that the master responds."""
    if reason := why_not(context):
        return skip(reason)
    uri = context.master
    state = context.master_state()
    if not isinstance(state, Ros1Error):
        return ok(f"{uri} answers: {len(state.uris)} nodes, {len(state.types)} topics")
    host = urlsplit(uri).hostname or ""
    try:
        addresses = sorted({str(info[4][0]) for info in socket.getaddrinfo(host, None, socket.AF_INET)})
    except (OSError, UnicodeError):
        cure = f"add '{host}' with its address to /etc/hosts, or give the address itself in ros1.master"
        return fail(f"{uri}: the host name '{host}' does not resolve on this machine", cure)
    seen = f"{state} (it resolves to {', '.join(addresses)})"
    cure = "start roscore there, check ROS_MASTER_URI or ros1.master, and that no firewall blocks its port"
    meant = context.config.ros1.master or context.environ.get("ROS_MASTER_URI")
    if meant or context.config.ros1.enabled is True:
        return fail(seen, cure)
    return skip(f"the ROS 1 side waits for a master at {uri}")


def check_environment(context: CheckContext) -> Findings:
    """Check that this shell's programs and the daemon use the same master."""
    if reason := why_not(context):
        return skip(reason)
    shell = context.environ.get("ROS_MASTER_URI")
    config = context.config.ros1.embedded_uri or context.config.ros1.master
    findings: list[Finding] = []
    if shell and config and not _is_same_master(shell, config):
        cure = "set both to the same master: export ROS_MASTER_URI, or change ros1.master"
        findings.append(warn(f"this shell's ROS_MASTER_URI is {shell}, but ros1.master is {config}", cure))
    findings += _against_worker(context, shell or master_uri(context.config, {}))
    return findings or ok(f"this shell and the daemon use {shell or context.master}")


def _against_worker(context: CheckContext, shell: str) -> list[Finding]:
    """Check that this shell's programs would join the running daemon's network."""
    mine = next((worker for worker in context.hub.of_side("ros1", context.config.name) if worker.network), None)
    if mine is None:
        return []
    network = _network(shell)
    if network is None or network == mine.network:
        return []
    theirs = environment_of(context.process(mine)).get("ROS_MASTER_URI", "another master")
    cure = f"export ROS_MASTER_URI={theirs}" if "://" in theirs else "start the daemon with this shell's ROS_MASTER_URI"
    return [fail(f"the running daemon is on {theirs}; this shell's programs use {shell}", cure)]


def _network(uri: str) -> str | None:
    state = read_master(uri)
    return None if isinstance(state, Ros1Error) else state.network


def _is_same_master(one: str, other: str) -> bool:
    def host_and_port(uri: str) -> tuple[str | None, int | None]:
        parts = urlsplit(uri)
        host = "localhost" if parts.hostname == "127.0.0.1" else parts.hostname
        return host, parts.port

    try:
        return host_and_port(one) == host_and_port(other)
    except ValueError:
        return one == other


MAX_NODES = 200
_CONNECT_SECONDS = 1.0
_AT_ONCE = 16
_SHOWN = 5


def check_address(context: CheckContext) -> Findings:
    """Check that the address announced to ROS 1 peers belongs to this machine, and is reachable for them."""
    if reason := why_not(context):
        return skip(reason)
    name, value = _announced_address(context)
    remote = not is_local(urlsplit(context.master).hostname or "")
    if not name and not remote:
        return ok("the master is on this machine: 127.0.0.1 is announced")
    if not name:
        name, value = "the machine's name", socket.gethostname()
    try:
        addresses = _resolve(value)
    except OSError:
        cure = f"set ROS_IP to this machine's address, or add {value} to /etc/hosts"
        return fail(f"{name} is '{value}', which does not resolve", cure)
    local = _own_addresses()
    if not addresses & local:
        seen = f"{name} is '{value}' ({', '.join(sorted(addresses))}), which is not an address of this machine"
        return fail(seen, f"set it to one of {', '.join(sorted(a for a in local if ':' not in a))}")
    if remote and all(ipaddress.ip_address(a).is_loopback for a in addresses):
        seen = f"the master is on another machine, but {name} '{value}' resolves to {', '.join(sorted(addresses))} here"
        cure = "set ros1.ip (ROS_IP) to the address at which the other machine reaches this one"
        return fail(f"{seen}: nodes on the other machine cannot reach this machine", cure)
    return ok(f"{name} is {value}")


def check_nodes(context: CheckContext) -> Findings:
    """Check that each registered node can be reached from here under its registered address."""
    if reason := why_not(context):
        return skip(reason)
    state = context.master_state()
    if isinstance(state, Ros1Error):
        return skip("the master does not answer")
    nodes = dict(sorted(state.uris.items())[:MAX_NODES])
    remote = not is_local(urlsplit(context.master).hostname or "")
    troubles = in_parallel(lambda uri: _trouble(uri, remote=remote), list(nodes.values()), _AT_ONCE)
    groups: dict[Finding, list[str]] = {}
    for node, trouble in zip(nodes, troubles, strict=True):
        if trouble is not None:
            groups.setdefault(trouble, []).append(node)
    if not groups:
        return ok(f"all {len(nodes)} nodes can be reached")
    return [_with_nodes(finding, names) for finding, names in groups.items()]


def _trouble(uri: str, *, remote: bool) -> Finding | None:
    try:
        parts = urlsplit(uri)
        host, port = parts.hostname or "", parts.port or 80
    except ValueError:
        return fail(f"the address {uri!r} is invalid")
    try:
        addresses = _resolve(host)
    except OSError:
        cure = f"add '{host}' with its address to /etc/hosts of this machine, or set ROS_IP on their machine"
        return fail(f"their registered host name '{host}' does not resolve here", cure)
    shown = ", ".join(sorted(addresses))
    named = host != "localhost" and not _is_address(host)
    if remote and named and all(ipaddress.ip_address(a).is_loopback for a in addresses):
        seen = f"their registered host name '{host}' resolves to {shown}, this machine"
        return fail(seen, f"correct '{host}' in /etc/hosts of this machine")
    try:
        socket.create_connection((host, port), _CONNECT_SECONDS).close()
    except ConnectionRefusedError:
        cure = "they are dead ('rosnode cleanup' unregisters them), or the name resolves differently here"
        return warn(f"nothing responds at {host} ({shown}) on their registered port", cure)
    except OSError as err:
        cure = "check route and firewall; ROS 1 nodes use any port"
        return fail(f"{host} ({shown}) cannot be reached: {err}", cure)
    return None


def _with_nodes(finding: Finding, nodes: Sequence[str]) -> Finding:
    more = f" and {len(nodes) - _SHOWN} more" if len(nodes) > _SHOWN else ""
    return Finding(finding.result, f"{', '.join(nodes[:_SHOWN])}{more}: {finding.seen}", finding.cure)


def _announced_address(context: CheckContext) -> tuple[str, str]:
    """Return the setting that gives this machine's address for ROS 1, and the address; "" for both if none does."""
    ros1, environ = context.config.ros1, context.environ
    configured: Mapping[str, str | None] = {"ros1.hostname": ros1.hostname, "ros1.ip": ros1.ip}
    inherited = {name: environ.get(name) for name in ("ROS_HOSTNAME", "ROS_IP")}
    for name, value in (configured if ros1.hostname or ros1.ip else inherited).items():
        if value:
            return name, value
    return "", ""


def _resolve(host: str) -> set[str]:
    """Resolve a host's addresses; raises `OSError`."""
    try:
        return {str(info[4][0]).partition("%")[0] for info in socket.getaddrinfo(host, None)}
    except UnicodeError as err:  # an invalid name
        raise OSError(str(err)) from None


def _is_address(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def _own_addresses() -> set[str]:
    interfaces = psutil.net_if_addrs().values()
    own = {
        a.address.partition("%")[0]
        for addresses in interfaces
        for a in addresses
        if a.family in (socket.AF_INET, socket.AF_INET6)
    }
    # all of 127/8 belongs to this machine, including Debian's 127.0.1.1 for the machine's name
    return own | {"127.0.0.1", "127.0.1.1", "::1"}


Item = TypeVar("Item")
Outcome = TypeVar("Outcome")


def in_parallel(work: Callable[[Item], Outcome], items: Sequence[Item], threads: int) -> list[Outcome]:
    """Apply ``work``, which must not raise, to each item; return the results in the items' order.

    Unlike those of `concurrent.futures`, the threads do not delay the exit of the process: the resolver's timeout
    cannot be configured.
    """
    waiting: queue.SimpleQueue[int] = queue.SimpleQueue()
    done: queue.SimpleQueue[tuple[int, Outcome]] = queue.SimpleQueue()
    for number in range(len(items)):
        waiting.put(number)

    def run() -> None:
        while True:
            try:
                number = waiting.get_nowait()
            except queue.Empty:
                return
            done.put((number, work(items[number])))

    for _ in range(min(threads, len(items))):
        threading.Thread(target=run, name="doctor-parallel", daemon=True).start()
    outcomes = dict(done.get() for _ in items)
    return [outcomes[number] for number in range(len(items))]


CHECKS = (
    Check("ros1-packages", "ROS 1 on this machine", check_packages),
    Check("ros1-master", "the ROS 1 master", check_master),
    Check("ros1-environment", "this shell's ROS 1 against the daemon's", check_environment),
    Check("ros1-address", "the address announced to ROS 1 peers", check_address),
    Check("ros1-nodes", "the addresses of ROS 1 nodes", check_nodes),
)
"""The doctor's checks of this side."""
