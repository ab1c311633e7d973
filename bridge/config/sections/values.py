"""Values of the configuration that are checked alike wherever they stand: endpoints, URIs, names."""

from __future__ import annotations

import ipaddress
import re
from typing import Annotated
from urllib.parse import urlsplit

from pydantic import AfterValidator

ROS2_NAME = re.compile(r"(?:/[A-Za-z_][A-Za-z0-9_]*)+")


def _zenoh_endpoint(value: str) -> str:
    """Where zenoh listens or connects: ``protocol/address``."""
    if not re.fullmatch(r"[a-z][a-z0-9_-]*/\S+", value):
        msg = f"{value!r} is not a zenoh endpoint; give protocol and address, for example tcp/127.0.0.1:7447"
        raise ValueError(msg)
    return value


def _master_uri(value: str) -> str:
    parts = urlsplit(value)
    if parts.scheme not in {"http", "https"} or not parts.hostname:
        msg = f"{value!r} is not a master's URI; give for example http://robot:11311"
        raise ValueError(msg)
    try:
        port = parts.port
    except ValueError:
        port = None
    if port is None:
        msg = f"{value!r} has no valid port; a master's is 11311 by default, for example http://{parts.hostname}:11311"
        raise ValueError(msg)
    return value


def _node_name(value: str) -> str:
    """A node's base name that ROS 1 and ROS 2 both take."""
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", value):
        msg = f"{value!r} is not a node name; use letters, digits and underscores, a letter first"
        raise ValueError(msg)
    return value


def is_loopback(endpoint: str) -> bool:
    """Whether only programs of this machine reach what listens at a zenoh endpoint."""
    protocol, _, rest = endpoint.partition("/")
    if protocol.startswith(("unixsock", "unixpipe")):
        return True
    host = re.split(r"[?#]", rest)[0].rpartition(":")[0].strip("[]")
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def same_port(one: str, other: str) -> bool:
    """Whether two endpoints have one port of TCP (0 is any free one)."""
    ports = [re.split(r"[?#]", place)[0].rpartition(":")[2] for place in (one, other)]
    return ports[0] == ports[1] != "0" and not one.startswith("quic/")


ZenohEndpoint = Annotated[str, AfterValidator(_zenoh_endpoint)]
MasterUri = Annotated[str, AfterValidator(_master_uri)]
NodeName = Annotated[str, AfterValidator(_node_name)]
