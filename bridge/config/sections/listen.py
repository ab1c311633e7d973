"""Addresses and tokens of the servers for browsers, apps and Prometheus."""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Iterable
from typing import Annotated, Any, Literal

from pydantic import Field
from typing_extensions import override

from bridge.config.sections.section import Mistake, Section, matching, setting

Role = Literal["watch", "drive"]
"""What a person may do: only watch, or also command."""

_ADDRESS = re.compile(r"(?:\[(?P<six>[0-9A-Fa-f:.]+)\]|(?P<name>[^\[\]:/\s]+)):(?P<port>\d{1,5})")

PersonName = Annotated[str, matching(r"[A-Za-z0-9][A-Za-z0-9_-]{0,62}", "is not a name: letters, digits, '_' and '-'")]


class TokenSection(Section):
    """A token with which a person or a program logs in."""

    role: Role = setting("drive", "`watch`: only watch; `drive`: also command.")
    sha256: str = Field(
        description="SHA-256 of the token, as `midspan web --token NAME` prints it.", pattern=r"^[0-9a-f]{64}$"
    )


class ServerSection(Section):
    """The section of a worker that listens at an address and port."""

    enabled: bool = setting(False, "Whether the server runs.")
    listen: str = setting(..., "Address and port.")

    def conflict(self, config: Any) -> str:  # noqa: ARG002 - most sections are checked alone
        """Return why the other sections of ``config`` forbid the server to listen at `listen`, "" if they do not."""
        return ""

    @override
    def mistakes(self, config: Any) -> Iterable[Mistake]:
        conflict = self.conflict(config)
        return [(("listen",), conflict)] if conflict else []


def split(listen: str) -> tuple[str, int]:
    """Return address and port; raises `ValueError`."""
    match = _ADDRESS.fullmatch(listen)
    if match is None or int(match["port"]) > 65535:
        msg = f"{listen!r} is not an address with a port: write it as 127.0.0.1:8480 or [::1]:8480"
        raise ValueError(msg)
    return match["six"] or match["name"], int(match["port"])


def is_loopback_address(address: str) -> bool:
    """Whether only programs on this machine can reach a listener at an address."""
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return address == "localhost"
