"""The TLS certificate of the servers for browsers and apps, which is the hub's certificate (`bridge.hub.security`)."""

from __future__ import annotations

import logging
import ssl

from bridge.config.model import Config
from bridge.hub.security.certificates import read_certificate, trouble
from bridge.hub.security.external_router import key_files
from bridge.hub.security.key_watch import KeyWatch
from bridge.web.section import WebSection
from bridge.worker import WorkerFailedError

_log = logging.getLogger("midspan.web")


class ServerTls:
    """The TLS context of a server.

    Raises `RuntimeError` if a file is missing, unreadable, expired or inconsistent with the others.

    Args:
        what: the server's name, for errors and the log.

    Attributes:
        context: for the server; clients may present a certificate of the same authority.
        names: names by which browsers open the console.
    """

    def __init__(self, config: Config, what: str = "the console") -> None:
        self._files, self._what = key_files(config), what
        reason = trouble(self._files)
        if reason:
            raise RuntimeError(f"{what} cannot use TLS: {reason}")
        self.names = config.section(WebSection).names or read_certificate(self._files.certificate).names
        self.context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        self.context.minimum_version = ssl.TLSVersion.TLSv1_2
        self.context.verify_mode = ssl.CERT_OPTIONAL
        self._load()
        self._watch = KeyWatch(self._files)
        self._authority = self._files.ca.read_bytes()

    def refresh(self) -> None:
        """Load the files if they were renewed; one thread calls this periodically.

        Raises `WorkerFailedError` for a new authority: the context would still trust the previous one, and clients with
        its certificates would stay connected.
        """
        if not self._watch.renewed():
            return
        if reason := trouble(self._files):
            _log.error("%s keeps its certificate, because the new one cannot be used: %s", self._what, reason)
        elif self._files.ca.read_bytes() != self._authority:
            raise WorkerFailedError(f"{self._what} has a new authority, {self._files.ca}: restarting")
        else:
            self._load()
            _log.info("%s has loaded a new certificate", self._what)

    def _load(self) -> None:
        try:
            self.context.load_verify_locations(self._files.ca)
            self.context.load_cert_chain(self._files.certificate, self._files.key, password="")
        except (OSError, ssl.SSLError) as err:
            raise RuntimeError(f"{self._what} cannot use TLS: {self._files.trouble() or err}") from None
