"""Sessions of the hub whose listeners in the user's settings cannot be opened, for example at a missing address.

By default zenoh opens no session if one of its listeners fails. A session of the hub works without, because it connects
to the router. zenoh could retry listeners in the background, but then a session does not close for 10 s while one of
them fails (observed with 1.10.2); so the listener stays closed until the worker restarts. The workers of sides restart
when the machine gets a missing address.
"""

from __future__ import annotations

import ipaddress
import json
import logging
import re
import socket
import threading

import psutil
import zenoh

from bridge.hub.errors import zenoh_reason
from bridge.hub.opening import open_session
from bridge.hub.shared_memory import RESTART
from bridge.hub.zenoh_config import LISTENERS

_log = logging.getLogger(__name__)

_lock = threading.Lock()
_closed: dict[str, str] = {}
"""The reason why a listener is closed, by endpoint."""
_absent: dict[str, str] = {}
"""The IP address of a closed listener that this machine lacks, by endpoint."""


def open_hub_session(config: zenoh.Config) -> zenoh.Session:
    """Open a session of the hub, if necessary without the user's listeners; raises `zenoh.ZError`.

    The caller promises to call `bridge.hub.opening.prepare_to_send` before each message that may be large.
    """
    try:
        return open_session(config, prepares=True)
    except zenoh.ZError as err:
        endpoints = listen_endpoints(config)
        if not endpoints:
            raise
        reason = zenoh_reason(err)
    config.insert_json5("listen/exit_on_failure", "false")
    session = open_session(config, prepares=True)
    closed = [endpoint for endpoint in endpoints if not _is_open(endpoint)]
    addresses = {endpoint: address for endpoint in closed if (address := _ip_address(endpoint))}
    with _lock:
        _closed.update(dict.fromkeys(closed, reason))
        _absent.update({endpoint: address for endpoint, address in addresses.items() if not has_address(address)})
    if text := trouble():
        _log.warning("%s", text)
    return session


def listen_endpoints(config: zenoh.Config) -> list[str]:
    """Return the listeners of a peer that the user's settings name; [] if it has only Midspan's own."""
    endpoints = json.loads(config.get_json("listen/endpoints"))
    if isinstance(endpoints, dict):
        endpoints = endpoints.get("peer")
    if json.loads(config.get_json("mode")) != "peer":
        return []
    return [str(endpoint) for endpoint in endpoints or () if endpoint not in LISTENERS]


def trouble() -> str:
    """Return which listeners of this process are closed, why, and how to fix that; "" if none."""
    with _lock:
        if not _closed:
            return ""
        reason = next(iter(_closed.values()))
        return f"no program can connect at {', '.join(_closed)} (hub.zenoh): {reason}; correct it, or {RESTART}"


def arrived() -> str:
    """Return a closed listener whose IP address this machine lacked and has now; "" if none."""
    with _lock:
        absent = tuple(_absent.items())
    return next((endpoint for endpoint, address in absent if has_address(address)), "")


def _ip_address(endpoint: str) -> str:
    """Return an endpoint's IP address; "" if it has a host name."""
    host = re.split(r"[?#]", endpoint)[0].partition("/")[2].rpartition(":")[0].strip("[]")
    try:
        return str(ipaddress.ip_address(host))
    except ValueError:
        return ""


def has_address(address: str) -> bool:
    """Return whether a program on this machine can listen at an IP address; True for one that needs an interface."""
    return (ipaddress.ip_address(address).is_link_local and ":" in address) or can_bind(address)


def can_bind(address: str) -> bool:
    """Return whether a socket of this machine can have an IP address; False for one that needs an interface."""
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    try:
        with socket.socket(family, socket.SOCK_DGRAM) as sock:
            sock.bind((address, 0))
    except OSError:
        return False
    return True


def _is_open(endpoint: str) -> bool:
    """Return whether this process uses an endpoint's port; True if that cannot be found out."""
    port = re.split(r"[?#]", endpoint)[0].rpartition(":")[2]
    if not port.isdecimal() or port == "0":
        return True
    try:
        connections = psutil.Process().net_connections("inet")
    except psutil.Error:
        return True
    return any(connection.laddr and connection.laddr[1] == int(port) for connection in connections)
