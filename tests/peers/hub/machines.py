"""A robot with an external router, and sessions of machines that connect to it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import zenoh

from bridge.hub.node import Hub
from bridge.hub.security.certificates import Authority
from bridge.hub.session import HubSettings
from bridge.hub.zenoh_config import make_config, session_tree
from tests.peers.hub.network import HubNetwork
from tests.support.ports import free_port
from tests.support.zenoh_router import open_router

FLOAT = "std_msgs/msg/Float64"
ARM = {"rules": [{"topic": "/arm/drive", "type": FLOAT, "priority": "command"}]}


class Machines:
    """A robot with an external router, and sessions of machines that connect to it."""

    def __init__(self, folder: Path, **opened: Any) -> None:
        self.folder = folder
        self.port = free_port()
        external = {"listen": [self.place], "keys": str(folder), "trusted": ["friend"], **opened}
        self.network = HubNetwork(run=False, external=external, routing=ARM)
        self._sessions: list[zenoh.Session] = []

    @property
    def place(self) -> str:
        return f"tls/127.0.0.1:{self.port}"

    def zenoh_config(self, name: str) -> dict[str, Any]:
        tls: dict[str, Any] = {"root_ca_certificate": str(self.folder / "ca.pem"), "enable_mtls": True}
        if name:
            tls |= {
                "connect_certificate": str(self.folder / f"{name}.pem"),
                "connect_private_key": str(self.folder / f"{name}.key"),
            }
        refused = name in ("", "stranger")  # the attempt must fail, so it has a short timeout
        wait = {"timeout_ms": 1000 if refused else 30_000}
        return {"mode": "client", "connect": wait, "transport": {"link": {"tls": tls}}}

    def settings(self, name: str) -> HubSettings:
        return HubSettings(router=self.place, zenoh=self.zenoh_config(name), node=name or "nobody", shared_memory=False)

    def hub(self, name: str) -> Hub:
        return Hub.open(self.settings(name))

    def session(self, name: str | None, mode: str = "client") -> zenoh.Session:
        """Open a plain zenoh session on another machine, or, for None, on this machine."""
        place, over = (self.network.endpoint, {}) if name is None else (self.place, self.zenoh_config(name))
        over["mode"] = mode
        tree = session_tree(place, shared_memory=False, max_payload=1 << 20)
        session = open_router(make_config(tree, over))
        self._sessions.append(session)
        return session

    def close(self) -> None:
        for session in self._sessions:
            session.close()
        self._sessions.clear()


def make_keys(folder: Path) -> Path:
    """Write certificates of the robot (``test``), a ``friend``, a ``guest``, and another authority's ``stranger``."""
    authority = Authority(folder)
    authority.make()
    for name in ("test", "friend", "guest"):
        authority.issue(name, ["127.0.0.1"])
    other = Authority(folder / "other")
    other.make()
    other.issue("friend")
    for end in ("pem", "key"):
        (folder / f"stranger.{end}").write_bytes((folder / "other" / f"friend.{end}").read_bytes())
    return folder
