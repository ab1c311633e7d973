"""Addresses and tokens of the servers for browsers, apps and Prometheus."""

from __future__ import annotations

import ipaddress
import re
from typing import Annotated, Any, Literal

from pydantic import Field

from bridge.config.sections.section import Section, matching, setting

Role = Literal["watch", "drive"]
"""What a person may do: look, or command too."""

_ADDRESS = re.compile(r"(?:\[(?P<six>[0-9A-Fa-f:.]+)\]|(?P<name>[^\[\]:/\s]+)):(?P<port>\d{1,5})")

PersonName = Annotated[str, matching(r"[A-Za-z0-9][A-Za-z0-9_-]{0,62}", "is not a name: letters, digits, '_' and '-'")]


class TokenSection(Section):
    """A token by which a person or a program gets in."""

    role: Role = setting("drive", "`watch`: only watch; `drive`: also command.")
    sha256: str = Field(
        description="SHA-256 of the token, as `midspan web --token NAME` prints it.", pattern=r"^[0-9a-f]{64}$"
    )


class ServerSection(Section):
    """The section of a worker that listens at an address and port."""

    enabled: bool = setting(False, "Whether it runs.")
    listen: str = setting(..., "Address and port.")

    def conflict(self, config: Any) -> str:  # noqa: ARG002 - most sections are checked alone
        """Return why it may not listen there with the other sections, "" if it may."""
        return ""


def split(listen: str) -> tuple[str, int]:
    """Address and port; raises `ValueError`."""
    match = _ADDRESS.fullmatch(listen)
    if match is None or int(match["port"]) > 65535:
        msg = f"{listen!r} is not an address with a port: write it as 127.0.0.1:8480 or [::1]:8480"
        raise ValueError(msg)
    return match["six"] or match["name"], int(match["port"])


def is_loopback_address(address: str) -> bool:
    """Whether only programs of this machine reach what listens there."""
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return address == "localhost"
