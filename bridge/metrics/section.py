"""The ``metrics`` section: a separate address for Prometheus."""

from __future__ import annotations

from typing import Any

from pydantic import field_validator
from typing_extensions import override

from bridge.config.sections.listen import ServerSection, is_loopback_address, split
from bridge.config.sections.section import setting


class MetricsSection(ServerSection):
    """The address that Prometheus scrapes; the console always serves the same figures at its own address."""

    enabled: bool = setting(False, "Whether `/metrics`, `/healthz` and `/readyz` are served without the console, too.")
    listen: str = setting(
        "127.0.0.1:9480",
        "Address and port; port 0: any. An address that other machines reach requires TLS with the certificate of"
        " `hub.open`, and a login by `web.tokens` or `web.trusted`, as the console does; see [metrics](metrics.md).",
    )
    diagnostics: bool = setting(
        True,
        "Whether the state of each part is published on the hub's `/diagnostics` while it has a subscriber.",
    )
    routes: int = setting(
        200, "Maximum number of routes reported per side; further routes are only counted.", ge=1, le=5000
    )

    @property
    def reached(self) -> bool:
        """Whether other machines reach the address, so that clients must authenticate."""
        return not is_loopback_address(split(self.listen)[0])

    @override
    def conflict(self, config: Any) -> str:
        guarded: bool = config.web.guarded  # untyped: this lower layer cannot import the console's section
        if not self.reached or guarded:
            return ""
        return (
            f"other machines reach {self.listen}, but it has no login: give web.tokens"
            " ('midspan web --token NAME --role watch' makes one) or web.trusted, or listen on 127.0.0.1"
        )

    @field_validator("listen")
    @classmethod
    def _is_an_address(cls, value: str) -> str:
        split(value)
        return value
