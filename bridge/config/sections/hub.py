"""The section ``hub``: the hub, and its endpoints for other machines."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, field_validator, model_validator
from typing_extensions import override

from bridge.config.sections.section import (
    Enabled,
    Section,
    ZenohDestination,
    ZenohEndpoint,
    is_loopback,
    same_port,
    setting,
    subsection,
)


def zenoh_files(settings: dict[str, Any] | Path | None) -> Iterator[Path]:
    """Yield the file of zenoh settings, if they are in one, and the files that the settings name."""
    if settings:
        from bridge.config.zenoh_files import files_of  # most configurations have no zenoh settings

        yield from files_of(settings)


class OpenSection(Section):
    """The hub's endpoints for other machines, none until `listen` or `connect` is set; see docs/operate/security.md."""

    listen: tuple[ZenohEndpoint, ...] = setting((), "Where other machines connect, for example `tls/0.0.0.0:7448`.")
    connect: tuple[ZenohDestination, ...] = setting(
        (), "Machines to connect to, for example `tls/robot1:7448`; use a name or address that is in their certificate."
    )
    trusted: tuple[Annotated[str, Field(min_length=1, max_length=64)], ...] = setting(
        (), "Machines that may send commands, goals, cancels and calls, as named in their certificates; `*`: all."
    )
    keys: Path | None = setting(
        None, "Folder of `ca.pem` and this daemon's `<name>.pem` and `<name>.key`; default /etc/midspan/keys."
    )
    certificate: Path | None = setting(None, "This machine's certificate (PEM), if it is not in `keys`.")
    key: Path | None = setting(None, "This machine's private key (PEM), if it is not in `keys`.")
    ca: Path | None = setting(None, "Certificate of the authority that signed all others (PEM), if not in `keys`.")
    insecure: bool = setting(
        False, "Allow endpoints without TLS: any machine that reaches them may join, and `trusted` cannot name it."
    )
    zenoh: dict[str, Any] | Path | None = setting(None, "zenoh configuration of this router, like `hub.router_zenoh`.")

    @override
    def named_files(self) -> Iterator[Path]:
        """Return the files of `zenoh`; the router itself watches the others (`bridge.hub.security.key_watch`)."""
        return zenoh_files(self.zenoh)

    @property
    def opened(self) -> bool:
        """Whether the hub is open to other machines."""
        return bool(self.listen or self.connect)

    @model_validator(mode="after")
    def _safe(self) -> OpenSection:
        plain = [endpoint for endpoint in (*self.listen, *self.connect) if not endpoint.startswith(("tls/", "quic/"))]
        named = [name for name in self.trusted if name != "*"]
        if plain and not self.insecure:
            msg = (
                f"{plain[0]} has no TLS: anybody on that network could join; write tls/{plain[0].partition('/')[2]} and"
                " make certificates with 'midspan keys', or set 'insecure: true'"
            )
        elif plain and named:
            msg = f"without TLS no machine presents a certificate, so none can be recognized as {named[0]!r}; use TLS"
        elif (self.trusted or self.insecure) and not self.opened:
            msg = "'trusted' and 'insecure' have no effect without endpoints; set 'listen' or 'connect'"
        else:
            return self
        raise ValueError(msg)


class HubSection(Section):
    """The hub: one ROS 2 graph on zenoh in rmw_zenoh's format."""

    domain: int = setting(0, "ROS domain id of the hub, the first part of each key.", ge=0, le=232)
    listen: ZenohDestination = setting(
        "tcp/127.0.0.1:7447", "Where the daemon's router listens, for this machine only; `open` lets others in."
    )
    router: Enabled = setting("auto", "Whether the daemon runs a router; `auto`: unless one answers at `listen`.")
    open: OpenSection = subsection(
        OpenSection,
        "Endpoints for other machines, closed until `listen` or `connect` is set; see [security](security.md).",
    )
    zenoh: dict[str, Any] | Path | None = setting(
        None,
        "zenoh configuration of the workers' sessions, inline or a JSON5 or YAML file, merged into the defaults: mode"
        " (peer, client), connect, listen, transport/link/tls, access_control.",
    )
    router_zenoh: dict[str, Any] | Path | None = setting(None, "The same for the daemon's router.")
    shared_memory: bool = setting(
        True, "Send large messages on zenoh between this machine's sessions through shared memory."
    )
    lane: bool = setting(
        True,
        "Send messages between the daemon's own workers over a Unix socket in the state folder, if the system has such"
        " sockets (Linux); `false`: send all messages over zenoh.",
    )

    @override
    def named_files(self) -> Iterator[Path]:
        yield from zenoh_files(self.zenoh)
        yield from zenoh_files(self.router_zenoh)

    @property
    def without_open(self) -> HubSection:
        """The section without `open`: what this machine's own programs depend on."""
        return self.model_copy(update={"open": OpenSection()})

    @field_validator("listen")
    @classmethod
    def _listens_on_this_machine(cls, value: str) -> str:
        if not is_loopback(value):
            raise ValueError(
                f"{value!r} is open to other machines; listen on 127.0.0.1, and let others in through hub.open"
                " ('midspan config migrate' moves the address there)"
            )
        return value

    @model_validator(mode="after")
    def _check_open(self) -> HubSection:
        same = [endpoint for endpoint in self.open.listen if same_port(endpoint, self.listen)]
        if self.open.opened and self.router is False:
            msg = "hub.open needs the daemon's router, but hub.router is false"
        elif self.open.opened and self.listen.startswith(("tls/", "quic/")):
            msg = (
                "hub.listen cannot use TLS if hub.open is set, because this machine's own programs join without TLS;"
                " write hub.listen: tcp/127.0.0.1:7447"
            )
        elif same:
            free = 7449 if same_port(self.listen, "tcp/127.0.0.1:7448") else 7448
            msg = f"{same[0]} uses the same port as hub.listen ({self.listen}); choose another, such as {free}"
        else:
            return self
        raise ValueError(msg)
