"""The state of each endpoint to other machines, with the reason if it connects none.

An endpoint is connected if zenoh reports a link for it. Why it has no link is found by test connections
(`bridge.hub.security.handshake`) at a limited rate, or in zenoh's log if these succeed or the protocol cannot be
tested. Why a listener refuses a machine can be found only in zenoh's log (`bridge.hub.security.zenoh_log`).
"""

from __future__ import annotations

import logging
import re
import threading
import time
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import psutil
from typing_extensions import override

from bridge.clock import steady
from bridge.concurrency import WorkerPool
from bridge.hub.listeners import has_address
from bridge.hub.security.handshake import Attempt, HostPort, Identity, attempt, resolve_only
from bridge.hub.security.reasons import EndpointState, Reason, refusal_in_log
from bridge.hub.security.zenoh_log import ZenohLog

_log = logging.getLogger(__name__)

POLL_SECONDS = 1.0
FIRST_SECONDS = 2.0
"""Seconds without a link before the first test; zenoh connects within this time if nothing is wrong."""

TEST_SECONDS = 10.0
"""Seconds between two tests of one endpoint."""

REFUSAL_SECONDS = 15.0
"""Seconds after its last refusal for which a listener counts as refusing; a refused peer retries at least every 4 s."""

_ADDRESS_SECONDS = 3.0
"""Seconds to search for the refused machine's address before the refusal is reported without it."""

_PASSES = 2
"""Successful tests without a link until the state is "no session", or "not answering" for a protocol without a test.

After only one, zenoh may still be connecting.
"""

_TROUBLE_SECONDS = 60.0
"""Seconds between two checks of this machine's certificate."""

_THREADS = 4
_MOST_CAUSES, _MOST_CALLERS, _MOST_LOGGED = 8, 5, 1000


class ZenohLink(Protocol):
    """The part of `zenoh.Link` that is used here."""

    @property
    def dst(self) -> str:
        """Locator of the other end: protocol, address and port."""

    @property
    def auth_identifier(self) -> str | None:
        """Name in the other machine's certificate."""


@dataclass(frozen=True, slots=True)
class Owner:
    """The part of Midspan to which endpoints belong.

    Attributes:
        prefix: precedes ``connect`` or ``listen`` in log lines.
        cure: reported for a refused certificate, the only reason that then has a cure; "": use each reason's own cure.
    """

    prefix: str = "hub.open."
    cure: str = ""

    def cure_of(self, reason: Reason) -> str:
        """Return the cure for a reason."""
        if not self.cure:
            return reason.cure
        return self.cure if reason.state is EndpointState.REFUSED else ""


HUB_OPEN = Owner()


@dataclass(frozen=True, slots=True)
class EndpointStatus:
    """One endpoint as reported in the router's status document.

    Attributes:
        way: ``connect`` or ``listen``.
        machine: the name in the other machine's certificate; "" if it is unknown or the endpoint is a listener.
        since: when the state began, in s: within this module on the steady clock, else system time (`as_of_now`).
    """

    endpoint: str
    way: str
    state: str
    reason: str
    cure: str
    machine: str
    since: float

    @property
    def good(self) -> bool:
        """Whether the state requires no action."""
        return EndpointState(self.state).good

    @override
    def __str__(self) -> str:
        return self.text(HUB_OPEN.prefix)

    def as_of_now(self) -> EndpointStatus:
        """Return the status with ``since`` as system time; the age stays right if the system clock was set since."""
        return replace(self, since=round(time.time() - (steady() - self.since), 1))

    def text(self, prefix: str) -> str:
        """Return the status for people, without the time and the cure; it begins with the prefix."""
        text = f"{prefix}{self.way} {self.endpoint}: {self.state}"
        if self.reason:
            return f"{text}: {self.reason}"
        return f"{text} to {self.machine}" if self.machine else text


def closed_endpoints(listen: Sequence[str], connect: Sequence[str], reason: str, since: float) -> list[EndpointStatus]:
    """Return the statuses of a router's endpoints that it could not open; ``since`` is on the steady clock."""
    places = [(place, "listen") for place in listen] + [(place, "connect") for place in connect]
    return [
        EndpointStatus(place, direction, EndpointState.CLOSED, reason, "", "", since).as_of_now()
        for place, direction in places
    ]


class _Endpoint:
    """The state of one endpoint."""

    def __init__(self, endpoint: str, way: str, state: EndpointState, owner: Owner) -> None:
        self._owner = owner
        self.status = EndpointStatus(endpoint, way, state, "", "", "", steady())
        self.place = HostPort.of(endpoint)

    @property
    def has_tls(self) -> bool:
        """Whether both ends must present certificates."""
        return self.place is not None and self.place.protocol in ("tls", "quic")

    def set(self, reason: Reason, machine: str = "") -> bool:
        """Set the state and its reason; return False if nothing has changed."""
        before = self.status
        since = before.since if reason.state == before.state else steady()
        self.status = EndpointStatus(
            before.endpoint, before.way, reason.state, reason.text, self._owner.cure_of(reason), machine, since
        )
        return self.status != before


class _Connect(_Endpoint):
    """An endpoint to which the router connects."""

    def __init__(self, endpoint: str, identity: Identity | None, owner: Owner = HUB_OPEN) -> None:
        super().__init__(endpoint, "connect", EndpointState.CONNECTING, owner)
        self._identity = identity
        self._addresses: Collection[str] = frozenset()
        self._machine = ""
        self._test: Future[Attempt] | None = None
        self._unlinked = self._due = time.monotonic()
        self._passes = 0
        self._reported = ""

    def poll(
        self, links: Collection[ZenohLink], pool: WorkerPool, zenoh_log: ZenohLog | None, now: float,
        own_trouble: Reason | None = None,
    ) -> None:  # fmt: skip
        """Compare the endpoint with the links, and test it if it has had no link for a while.

        ``own_trouble`` is why no machine accepts this machine's certificate, which explains a refusal exactly.
        """
        if self.place is None:
            return
        if self._test is not None and self._test.done():
            test, self._test = self._test, None
            self._addresses = test.result().addresses or self._addresses
        else:
            test = None
        link = self._link(links)
        if link is not None:
            self._unlinked, self._passes = now, 0
            self._due = now + FIRST_SECONDS
            self._enter(Reason(EndpointState.CONNECTED), str(link.auth_identifier or ""))
            return
        if self.status.state == EndpointState.CONNECTED:
            self._machine = ""
            self._enter(Reason(EndpointState.CONNECTING))
        if test is not None:
            result = test.result()
            refused = result.reason.state is EndpointState.REFUSED
            self._judge(
                replace(result, reason=own_trouble) if refused and own_trouble else result, links, zenoh_log, now
            )
        elif self._test is None and now >= self._due:
            self._start_test(pool, now)

    def _link(self, links: Collection[ZenohLink]) -> ZenohLink | None:
        """Return the endpoint's link, or another link to the same machine: zenoh opens one in each direction."""
        matching = (link for link in links if re.split(r"[?#]", link.dst)[0] in self._addresses)
        others = (link for link in links if self._machine and link.auth_identifier == self._machine)
        return next(matching, None) or next(others, None)

    def _start_test(self, pool: WorkerPool, now: float) -> None:
        place, identity = self.place, self._identity
        assert place is not None
        if now < self._unlinked + FIRST_SECONDS or not place.can_be_tested:
            self._test = pool.submit(lambda: resolve_only(place))
        else:
            self._test = pool.submit(lambda: attempt(place, identity))
        self._due = self._unlinked + FIRST_SECONDS if now < self._unlinked + FIRST_SECONDS else now + TEST_SECONDS

    def _judge(self, result: Attempt, links: Collection[ZenohLink], zenoh_log: ZenohLog | None, now: float) -> None:
        """Enter the state that follows from a test."""
        assert self.place is not None
        if result.reason.state is not EndpointState.CONNECTING:
            self._passes = 0
            self._enter(result.reason, result.machine)
            return
        if now < self._unlinked + FIRST_SECONDS:
            return
        self._machine = result.machine
        if (link := self._link(links)) is not None:
            self._enter(Reason(EndpointState.CONNECTED), str(link.auth_identifier))
            return
        self._passes += 1
        if self._passes >= _PASSES:
            logged = zenoh_log.failure(self.status.endpoint, now - TEST_SECONDS) if zenoh_log is not None else ""
            state = EndpointState.NO_SESSION if self.place.can_be_tested else EndpointState.NOT_ANSWERING
            self._enter(Reason(state, logged or result.reason.text), result.machine)

    def _enter(self, reason: Reason, machine: str = "") -> None:
        """Enter a state, and log it once."""
        if not self.set(reason, machine) or reason.state is EndpointState.CONNECTING:
            return
        text = self.status.text(self._owner.prefix)
        if text != self._reported:
            level = logging.INFO if reason.state.good else logging.WARNING
            _log.log(level, "%s%s", text, f"; {self.status.cure}" if self.status.cure else "")
        self._reported = text


@dataclass(slots=True)
class _Refusals:
    """The refusals of one listener for one cause."""

    error: str
    first: float
    last: float
    callers: set[str] = field(default_factory=set)

    def reason(self) -> Reason | None:
        """Return the cause, with the addresses of the refused machines."""
        return refusal_in_log(self.error, ", ".join(sorted(self.callers)))


class _Listen(_Endpoint):
    """An endpoint to which other machines connect."""

    def __init__(self, endpoint: str, owner: Owner = HUB_OPEN) -> None:
        super().__init__(endpoint, "listen", EndpointState.LISTENING, owner)
        self.refused = 0
        self._read = time.monotonic()
        self._active: dict[str, _Refusals] = {}
        self._closed: set[tuple[str, int]] | None = None
        self._logged: set[str] = set()

    def poll(self, zenoh_log: ZenohLog | None, own_trouble: Reason | None, now: float) -> None:
        """Read the refusals since the last call from zenoh's log."""
        protocol = self.place.protocol if self.place is not None else ""
        errors = set()
        for refusal in zenoh_log.refusals(self._read) if zenoh_log is not None else ():
            self._read = refusal.at
            reason = refusal_in_log(refusal.error) if refusal.protocol == protocol else None
            if reason is not None and (reason.text in self._active or len(self._active) < _MOST_CAUSES):
                self.refused += 1
                active = self._active.setdefault(reason.text, _Refusals(refusal.error, now, now))
                active.last = now
                errors.add(reason.text)
        if errors:
            self._note_callers([self._active[text] for text in errors])
        self._active = {text: entry for text, entry in self._active.items() if now < entry.last + REFUSAL_SECONDS}
        due = [entry for entry in self._active.values() if entry.callers or now > entry.first + _ADDRESS_SECONDS]
        for entry in due:
            self._log_refusals(entry, own_trouble)
        reasons = [own_trouble] if own_trouble else [reason for entry in due if (reason := entry.reason())]
        self._enter(reasons if (absent := self._absent_address()) is None else [absent])

    def _absent_address(self) -> Reason | None:
        """Return a reason if this machine has lost the address: the listener is open, but reachable for nobody."""
        host = self.place.host if self.place is not None else ""
        try:
            absent = not has_address(host)
        except ValueError:  # a host name
            return None
        if not absent:
            return None
        text = f"this machine does not have the address {host} now"
        return Reason(EndpointState.UNREACHABLE, text, "connect this machine to that network, or correct the address")

    def _log_refusals(self, refusals: _Refusals, own_trouble: Reason | None) -> None:
        """Log a cause once, and again for each additional machine that is refused for it.

        If this machine's certificate is the known cause, other machines' alerts are less exact than that.
        """
        key, reason = f"{refusals.error} {sorted(refusals.callers)[1:]}", refusals.reason()
        if own_trouble is not None:
            key, reason = own_trouble.text, own_trouble
        if reason is not None and key not in self._logged:
            if len(self._logged) >= _MOST_LOGGED:
                self._logged.clear()
            self._logged.add(key)
            place, cure = f"{self._owner.prefix}listen {self.status.endpoint}", self._owner.cure_of(reason)
            _log.warning("%s: %s; %s", place, reason.text, cure)

    def _enter(self, reasons: Sequence[Reason]) -> None:
        before = self.status.state
        if reasons:
            cures = "; ".join(dict.fromkeys(reason.cure for reason in reasons if reason.cure))
            changed = self.set(Reason(reasons[0].state, "; ".join(reason.text for reason in reasons), cures))
            if changed and reasons[0].state is EndpointState.UNREACHABLE:
                _log.warning("%s; %s", self.status.text(self._owner.prefix), cures)
        elif self.set(Reason(EndpointState.LISTENING)):
            lost = before == EndpointState.UNREACHABLE
            text = "this machine has the address again" if lost else "machines are no longer refused"
            _log.info("%slisten %s: %s", self._owner.prefix, self.status.endpoint, text)
        if not self._active:
            self._logged.clear()
            self._closed = None

    def _note_callers(self, active: Sequence[_Refusals]) -> None:
        """Find the refused machines, which zenoh does not log, in the system's list of recently closed connections.

        New addresses are recorded only if there was one cause, because the list does not show the cause.
        """
        closed, before = self._closed_connections(), self._closed
        self._closed = closed
        if before is None or len(active) != 1:
            return
        for host, _ in sorted(closed - before):
            if len(active[0].callers) < _MOST_CALLERS:
                active[0].callers.add(host)

    def _closed_connections(self) -> set[tuple[str, int]]:
        if self.place is None or self.place.protocol != "tls":
            return set()
        try:
            table = psutil.net_connections("tcp")
        except (psutil.Error, OSError):
            return set()
        return {
            (str(connection.raddr[0]).removeprefix("::ffff:"), int(connection.raddr[1]))
            for connection in table
            if connection.status == psutil.CONN_TIME_WAIT
            and connection.raddr
            and tuple(connection.laddr)[1:2] == (self.place.port,)
        }


class EndpointMonitor:
    """Watches the endpoints of one session, on a separate thread.

    Args:
        session: the `zenoh.Session`, asked for its links.
        identity: the certificate and key for TLS connections.
        zenoh_log: zenoh's log, None if this process does not capture it.
        own_trouble: returns why no machine accepts this machine's certificate, "" if other machines may accept it.
        owner: how log lines name the endpoints.
    """

    def __init__(
        self, session: Any, listen: Sequence[str], connect: Sequence[str], identity: Identity | None = None,
        zenoh_log: ZenohLog | None = None, own_trouble: Callable[[], str] | None = None, owner: Owner = HUB_OPEN,
    ) -> None:  # fmt: skip
        self._session, self._zenoh_log, self._own_trouble = session, zenoh_log, own_trouble
        self._listen = [_Listen(endpoint, owner) for endpoint in listen]
        self._connect = [_Connect(endpoint, identity, owner) for endpoint in connect]
        if zenoh_log is not None and listen:
            zenoh_log.reports_refusals = True
        self._trouble: Reason | None = None
        self._trouble_due = 0.0
        self._pool = WorkerPool(_THREADS, "hub-endpoint-test")
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="hub-endpoints", daemon=True)
        self._thread.start()

    def statuses(self) -> list[EndpointStatus]:
        """Return the state of each endpoint."""
        return [endpoint.status.as_of_now() for endpoint in (*self._listen, *self._connect)]

    def refused(self) -> int:
        """Return the number of connections that the listeners refused because of a certificate."""
        return sum(endpoint.refused for endpoint in self._listen)

    def close(self) -> None:
        """End the thread; a running test ends by itself."""
        self._end.set()
        self._pool.close()
        self._thread.join(2.0)

    def _run(self) -> None:
        while not self._end.is_set():
            try:
                self._poll(time.monotonic())
            except Exception:
                if not self._end.is_set():  # a session that is being closed stops answering before this thread ends
                    _log.exception("cannot check the endpoints")
            self._end.wait(POLL_SECONDS)

    def _poll(self, now: float) -> None:
        links = self._session.info.links()
        if self._own_trouble is not None and now >= self._trouble_due:
            self._trouble_due = now + _TROUBLE_SECONDS
            text = self._own_trouble()
            self._trouble = (
                Reason(EndpointState.REFUSED, text, "'midspan doctor --only keys' checks the files") if text else None
            )
        for connect in self._connect:
            connect.poll(links, self._pool, self._zenoh_log, now, self._trouble if connect.has_tls else None)
        for listen in self._listen:
            listen.poll(self._zenoh_log, self._trouble if listen.has_tls else None, now)
