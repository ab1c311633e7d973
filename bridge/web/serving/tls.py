"""The certificate of what browsers and apps open: that of the hub's door (`bridge.hub.security`)."""

from __future__ import annotations

import logging
import ssl

from bridge.config.model import Config
from bridge.hub.security.certificates import read_certificate, trouble
from bridge.hub.security.door import KeyWatch, key_files

_log = logging.getLogger("midspan.web")


class ServerTls:
    """What the server shows and asks of who comes.

    Raises `RuntimeError`: a file is missing, cannot be read, has expired or fits no other; in words.

    Args:
        what: the server, in errors and the log.

    Attributes:
        context: for the server; who comes may show a certificate of the same authority, and need not.
        names: by which browsers open the console.
    """

    def __init__(self, config: Config, what: str = "the console") -> None:
        self._files, self._what = key_files(config), what
        reason = trouble(self._files)
        if reason:
            raise RuntimeError(f"{what} cannot have TLS: {reason}")
        self.names = config.web.names or read_certificate(self._files.certificate).names
        self.context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        self.context.minimum_version = ssl.TLSVersion.TLSv1_2
        self.context.verify_mode = ssl.CERT_OPTIONAL
        self._load()
        self._watch = KeyWatch(self._files)

    def refresh(self) -> None:
        """Take up new files; to be called by one thread, again and again."""
        if self._watch.renewed():
            self._load()
            _log.info("%s has a new certificate", self._what)

    def _load(self) -> None:
        try:
            self.context.load_verify_locations(self._files.ca)
            self.context.load_cert_chain(self._files.certificate, self._files.key, password="")
        except (OSError, ssl.SSLError) as err:
            raise RuntimeError(f"{self._what} cannot have TLS: {self._files.certificate}: {err}") from None
