"""The hub's router, through which sessions on this machine and on others discover each other.

Any zenoh router works; this one makes an installation of zenohd unnecessary. The workers' data goes over direct links,
not through the router.
"""

from __future__ import annotations

import json
import logging
import os
import socket
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
import zenoh
from typing_extensions import override

from bridge.config.model import Config
from bridge.config.rules import commands
from bridge.config.sections.section import is_loopback
from bridge.hub.control import EVERY_DOMAIN, Control
from bridge.hub.daemons import identity_of
from bridge.hub.errors import HubError, zenoh_reason
from bridge.hub.identity import ask_identity, identity, identity_key
from bridge.hub.links import MEMBERS
from bridge.hub.namesakes import Namesakes
from bridge.hub.opening import open_session
from bridge.hub.rejoin import REJOIN, Rejoins
from bridge.hub.security.external_access import ExternalAccess
from bridge.hub.security.external_router import check_closed
from bridge.hub.security.zenoh_log import ZenohLog, captured
from bridge.hub.zenoh_config import MAX_PAYLOAD, client_session_config, connect_endpoint, make_config, router_tree
from bridge.status import RouterStatus
from bridge.worker import Health, StatusHead, Worker

_log = logging.getLogger(__name__)
_ANSWER_SECONDS = 1.0
_SLOW_SECONDS = 10.0
"""The time for the answer of a router on a busy machine, such as one that starts at boot."""
_MAX_MEMBERS = 1000
"""Maximum number of sessions in the status document."""

_ROUTERS = {"router", "zenohd", "rmw_zenohd"}
"""Words in the command lines of Midspan's router (`midspan worker router`) and of other routers."""


@dataclass(frozen=True, slots=True)
class RouterInfo:
    """The program that answers at a router's endpoint.

    Attributes:
        mode: ``router``, or ``peer`` if a zenoh program that is not a router listens there.
        daemon: name of the Midspan daemon that runs the router, "" for other routers (zenohd, rmw_zenohd).
        pid: id of the router's process on its machine, 0 for routers that are not Midspan's.
    """

    endpoint: str
    zid: str
    mode: str
    daemon: str = ""
    pid: int = 0

    @override
    def __str__(self) -> str:
        if self.daemon:
            return f"the router of Midspan daemon {self.daemon} (process {self.pid})"
        return f"a zenoh {self.mode} that is not Midspan's (zid {self.zid})"


def probe_router(
    endpoint: str, zenoh_config: Mapping[str, Any] | str | Path | None = None, seconds: float = 1.5
) -> RouterInfo | None:
    """Return the zenoh program that answers at an endpoint (``tcp/127.0.0.1:7447``) within ``seconds``, or None.

    ``zenoh_config`` is the workers' configuration, which is needed for TLS.
    """
    endpoint = connect_endpoint(endpoint)
    config = client_session_config(endpoint, zenoh_config, seconds)
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    try:
        session = zenoh.open(config)
    except zenoh.ZError:
        return None
    try:
        return _identify(session, endpoint, seconds)
    finally:
        session.close()  # type: ignore[no-untyped-call]


def port_held(endpoint: str) -> bool:
    """Whether any program accepts TCP connections at a zenoh endpoint."""
    address = connect_endpoint(endpoint).partition("/")[2].partition("?")[0].partition("#")[0]
    host, _, port = address.rpartition(":")
    try:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=0.5):
            return True
    except (OSError, ValueError):
        return False


def port_holder(endpoint: str) -> psutil.Process | None:
    """Return the process that listens on an endpoint's TCP port, None if there is none or this user may not see it."""
    port = connect_endpoint(endpoint).partition("?")[0].rpartition(":")[2]
    try:
        for connection in psutil.net_connections("tcp"):
            listens = connection.status == psutil.CONN_LISTEN and tuple(connection.laddr)[1:] == (int(port),)
            if listens and connection.pid:
                return psutil.Process(connection.pid)
    except (psutil.Error, OSError, ValueError):
        return None
    return None


def may_be_slow(endpoint: str) -> bool:
    """Return whether a router that has not answered may still do so, because its port accepts connections.

    If the listening process is visible, its command line must be that of a router.
    """
    if not port_held(endpoint):
        return False
    holder = port_holder(endpoint) if is_loopback(connect_endpoint(endpoint)) else None
    if holder is None:
        return True
    try:
        return any(Path(word).name in _ROUTERS for word in holder.cmdline())
    except psutil.Error:
        return True


def create_router() -> RouterWorker:
    """Create the worker, which reads this process's log of zenoh."""
    log = captured()
    if log is not None:
        log.ignore("Unable to open listener ")  # the worker reports it, and with `hub.router: auto` it is normal
    return RouterWorker(log)


class RouterWorker(Worker):
    """Runs a router at ``hub.listen``.

    With ``hub.router: auto`` and another router at that address, it stands by, and takes over when the other router
    exits. With ``hub.open`` it also runs a second router, for other machines (`ExternalAccess`). If the second router
    cannot be opened, this machine's programs keep the first, and the worker tries again.
    """

    def __init__(self, zenoh_log: ZenohLog | None = None) -> None:
        self._zenoh_log = zenoh_log
        self._config: Config | None = None
        self._external = ExternalAccess(zenoh_log)
        self._session: zenoh.Session | None = None
        self._controls: list[Control] = []
        self._namesakes: Namesakes | None = None
        self._watch: zenoh.Session | None = None  # connected to the other router, in standby
        self._other = ""

    @override
    def start(self, config: Config) -> None:
        """Listen; raises `RuntimeError` if that is impossible and no other router at that address may be used."""
        self._config = config
        hub = config.hub
        try:
            self._open(config)
        except zenoh.ZError as err:
            if not port_held(hub.listen):
                raise RuntimeError(
                    f"the router cannot listen on {hub.listen} (hub.listen): {zenoh_reason(err)}"
                ) from None
            holder = probe_router(hub.listen, hub.zenoh)
            holder_name = "a program that is not zenoh"
            if holder is None and may_be_slow(hub.listen):
                holder = probe_router(hub.listen, hub.zenoh, _SLOW_SECONDS)
                holder_name = f"a program that has not answered as zenoh within {_SLOW_SECONDS:g} s"
            if holder is not None:
                holder_name = str(holder)
            if holder is None or holder.mode != "router" or hub.router is True:
                cure = "" if holder is None else ", or hub.router to auto, which uses that router"
                raise RuntimeError(
                    f"{hub.listen} is held by {holder_name}; set hub.listen to a free port{cure}"
                ) from None
            self._other = holder_name
            _log.info("%s is already at %s: using it", holder_name, hub.listen)
        self._external.open(config)

    @override
    def reload(self, config: Config) -> bool:
        """Apply a new configuration; without a restart, only the router for other machines can change."""
        old = self._config
        if old is None or config.name != old.name or config.hub.without_open != old.hub.without_open:
            return False
        self._config = config
        if config.hub.open != old.hub.open or commands(config.rules) != commands(old.rules):
            self._external.reopen(config)
        return True

    @override
    def health(self) -> Health:
        """Query the router over zenoh, and take over from another router that has exited."""
        assert self._config is not None
        self._external.check(self._config)
        session = self._session
        if session is None:
            session = self._take_over(self._config)
        if session is None:
            warning = self._standby_warning(self._config)
            return Health("standby", f"{self._other} is used{self._external.text()}{warning}")
        if not list(session.get(identity_key(str(session.zid())), timeout=_ANSWER_SECONDS)):
            raise TimeoutError(f"the router does not answer within {_ANSWER_SECONDS:g} s")
        if self._namesakes is not None:
            self._namesakes.check()
        count = len(session.info.transports())
        sessions = "1 session" if count == 1 else f"{count} sessions"
        return Health("running", f"{sessions} at {self._config.hub.listen}{self._external.text()}")

    @override
    def stop(self) -> None:
        """Close the router; its peers keep their direct links."""
        self._external.close()
        self._close_watch()
        controls, self._controls = self._controls, []
        session, self._session = self._session, None
        for control in controls:
            control.close()
        if session is not None:
            session.close()  # type: ignore[no-untyped-call]

    def _take_over(self, config: Config) -> zenoh.Session | None:
        if not port_held(config.hub.listen):
            try:
                self._open(config)
            except zenoh.ZError as err:
                _log.warning(
                    "the other router has exited, and this one cannot listen at %s: %s", config.hub.listen, err
                )
        return self._session

    def _standby_warning(self, config: Config) -> str:
        """Return a warning about other daemons of the same name at the router in use, to append to the state's text."""
        if self._watch is None:
            try:
                self._watch = zenoh.open(client_session_config(config.hub.listen, config.hub.zenoh, _ANSWER_SECONDS))
            except zenoh.ZError:  # the router has just left
                return ""
            self._namesakes = Namesakes(self._watch, config.hub.domain, config.name, identity_of(config))
        assert self._namesakes is not None
        self._namesakes.check()
        return f"; {self._namesakes.warning}" if self._namesakes.warning else ""

    def _close_watch(self) -> None:
        watch, self._watch = self._watch, None
        if watch is not None:
            watch.close()  # type: ignore[no-untyped-call]

    def _open(self, config: Config) -> None:
        hub = config.hub
        try:
            zenoh_config = make_config(router_tree([hub.listen], max_payload=MAX_PAYLOAD), hub.router_zenoh)
            check_closed(zenoh_config)
        except HubError as err:
            raise RuntimeError(f"hub.router_zenoh: {err}") from None
        session = open_session(zenoh_config)
        self._close_watch()
        self._session = session
        own = identity_of(config)
        control = Control(session, hub.domain, config.name, "router", own)
        # daemons of other domains may use this router, and their sessions restore lost links with its help
        links = Control(session, EVERY_DOMAIN, config.name, "router", own)
        self._controls = [control, links]
        answer = identity(config.name, os.getpid())
        key = identity_key(str(session.zid()))

        def identify(query: zenoh.Query) -> None:
            with query:
                query.reply(key, answer)

        session.declare_queryable(key, zenoh.handlers.Callback(identify, indirect=False))
        zid, machine = str(session.zid()), socket.gethostname()
        links.serve(
            MEMBERS,
            lambda _params: {
                "zid": zid, "members": _members(session), "peers": _members(session, peers=True), "machine": machine,
                "domain": hub.domain,
            },
        )  # fmt: skip
        links.serve(REJOIN, Rejoins(session).answer)
        self._namesakes = Namesakes(session, hub.domain, config.name, own)
        head = StatusHead({"daemon": config.name, "worker": "router", "side": "router"})
        control.serve("status", lambda _params: self._status(head, config, session))
        control.serve("time", lambda _params: {"time_ns": time.time_ns()})  # a daemon without sides has a clock, too

    def _status(self, head: StatusHead, config: Config, session: zenoh.Session) -> dict[str, Any]:
        members = _members(session)
        return RouterStatus(
            **head.fields("running"),
            zid=str(session.zid()),
            network=None,
            listen=config.hub.listen,
            sessions=len(members),
            members=members[:_MAX_MEMBERS],
            **self._external.status(self._config or config).document(),
            routes=[],
            refused=[],
            warnings=self._warnings(),
        ).document()

    def _warnings(self) -> list[str]:
        namesakes = self._namesakes.warning if self._namesakes is not None else ""
        return [warning for warning in (self._external.warning(), namesakes) if warning]


def _members(session: zenoh.Session, *, peers: bool = False) -> list[str]:
    """Return the ids of the sessions that are linked to a router, or with ``peers`` only the ids of peers."""
    transports = session.info.transports()
    return [str(transport.zid) for transport in transports if not peers or transport.whatami == zenoh.WhatAmI.PEER]


def _identify(session: zenoh.Session, endpoint: str, seconds: float) -> RouterInfo | None:
    routers = [str(zid) for zid in session.info.routers_zid()]
    peers = [str(zid) for zid in session.info.peers_zid()]
    if not routers:
        return RouterInfo(endpoint, peers[0], "peer") if peers else None
    return RouterInfo(endpoint, routers[0], "router", *ask_identity(session, routers[0], seconds))
