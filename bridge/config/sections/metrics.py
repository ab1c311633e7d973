"""The section ``metrics``: figures for Prometheus, at an address of their own."""

from __future__ import annotations

from pydantic import field_validator

from bridge.config.sections.section import Section, setting
from bridge.config.sections.web import WebSection, is_loopback_address, split


class MetricsSection(Section):
    """What Prometheus scrapes; the console answers the same at its own address, whatever stands here."""

    enabled: bool = setting(False, "Whether `/metrics`, `/healthz` and `/readyz` are served without the console, too.")
    listen: str = setting(
        "127.0.0.1:9480",
        "Address and port; port 0: any. One that other machines reach has TLS and asks who comes, as the console does:"
        " by `web.tokens` and `web.trusted`, with the certificate of `hub.open`; see [metrics](metrics.md).",
    )
    diagnostics: bool = setting(
        True,
        "Whether `/diagnostics` of the hub tells how each part is, while somebody hears it.",
    )
    routes: int = setting(
        200, "Routes of each side that are told of at most; of more, only their number.", ge=1, le=5000
    )

    @property
    def reached(self) -> bool:
        """Whether other machines reach the address, so that who comes must say who they are."""
        return not is_loopback_address(split(self.listen)[0])

    def unguarded(self, web: WebSection) -> str:
        """Why it may not be served so, "" where it may."""
        if not self.enabled or not self.reached or web.guarded:
            return ""
        return (
            f"other machines reach {self.listen}, and nobody could get in: give web.tokens"
            " ('midspan web --token NAME --role watch' makes one) or web.trusted, or listen on 127.0.0.1"
        )

    @field_validator("listen")
    @classmethod
    def _is_an_address(cls, value: str) -> str:
        split(value)
        return value
