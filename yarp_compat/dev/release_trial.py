"""Determines the YARP release of a remote client.

A client on this machine has loaded a YARP library, which names its release. For any other client, a trial sends a reply
that not all releases can read.

The name server has the process of each C++ port (property ``process``), so a finding about one device applies to all
devices of its process. A trial uses the port ``<local>/user_commands/rpc`` of a ``navigation2D_nwc_yarp``: the client's
reply to ``listLocations`` contains the names from its map server (``Navigation2D_nwc_yarp.cpp``, 3.6 to 4.0). During a
trial, a map server of this package sends the names in the format of 3.6 to 3.10. If the client's reply then contains
the names, the client could read that format.
"""

from __future__ import annotations

import contextlib
import logging
import threading
import time

from yarp_compat.ports.client_process import inspect_client
from yarp_compat.ports.naming import Naming
from yarp_compat.ports.text_client import ask
from yarp_compat.wire.contact import PortContact
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.generation import Generation, Generations, PeerAddress, ReleaseFinding, Trial, device_of
from yarp_compat.wire.text import from_text

log = logging.getLogger(__name__)

COMMANDS = "/user_commands/rpc"
_PORTS = ("/navigation/rpc", "/locations/rpc", "/localization/rpc")
_OPENING = 5.0  # seconds for the client to open its last port
_STEPS = 0.02, 0.5  # seconds between the first two attempts, and the maximum
_PATIENCE = 2.0  # seconds for the client's reply


class ReleaseTrials:
    """Trials that determine the releases of clients as they connect, each on a thread that ends by itself."""

    def __init__(self, generations: Generations, naming: Naming) -> None:
        self._generations, self._naming = generations, naming
        self._closed = threading.Event()
        self._threads: list[threading.Thread] = []

    @property
    def running(self) -> bool:
        """Whether a trial is in progress."""
        return any(thread.is_alive() for thread in self._threads)

    def connected(self, peer: str, link: PeerAddress) -> None:
        """Start a trial for a connected port of an unknown release; ``link`` is the client's address, if known."""
        if peer.startswith("/") and not self._closed.is_set() and not self._generations.of(peer, link=link).sure:
            trial = threading.Thread(target=self._run, args=(peer, link), name=f"release of {peer}", daemon=True)
            self._threads = [*(thread for thread in self._threads if thread.is_alive()), trial]
            trial.start()

    def close(self) -> None:
        """Stop starting trials, and end the waiting ones."""
        self._closed.set()

    def _run(self, peer: str, link: PeerAddress) -> None:
        findings, device = self._generations.findings, device_of(peer)
        with contextlib.suppress(OSError, WireError):
            self._join(peer)
        if not peer.endswith(_PORTS):
            return
        end, step = time.monotonic() + _OPENING, _STEPS[0]
        while self._is_unknown(peer, link) and time.monotonic() < end and not self._closed.is_set():
            with contextlib.suppress(OSError, WireError):  # the port does not listen yet, or the client has ended
                contact = self._naming.query(device + COMMANDS)
                trial = None if contact is None else findings.begin(device, Trial(Generation.YARP_3_6))
                if contact is not None and trial is not None:
                    try:
                        self._try(peer, link, contact, trial)
                    finally:
                        findings.end(device)
                    return
            self._closed.wait(step)
            step = min(2 * step, _STEPS[1])

    def _join(self, peer: str) -> None:
        contact, process = self._naming.query(peer), self._naming.get_property(peer, "process")
        if contact is not None and process:
            self._generations.findings.join(peer, f"{contact.host} {process[0]}")

    def _is_unknown(self, peer: str, link: PeerAddress) -> bool:
        if link[0]:
            inspect_client(self._generations, peer, None, link)
        return not self._generations.of(peer, link=link).sure and self._generations.findings.get(peer, link) is None

    def _try(self, peer: str, link: PeerAddress, contact: PortContact, trial: Trial) -> None:
        lines = ask(contact, ["listLocations"], timeout=_PATIENCE)
        names = from_text(lines[0])[1:] if lines else []
        if not trial.answered:
            return  # another map server answered, or the store has no locations
        if names:
            reason = "it read a reply in the format of 3.6 to 3.10"
            finding = ReleaseFinding(trial.generation, reason)
        else:
            reason = "a guess: it did not read a reply in the format of 3.6 to 3.10"
            finding = ReleaseFinding(Generation.YARP_3_12, reason, sure=False)
        self._generations.findings.add(peer, finding, link)
        log.info(
            "%s: its calls are answered in the format of YARP %s (%s)",
            device_of(peer),
            finding.generation.value,
            reason,
        )
