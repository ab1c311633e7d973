"""The section ``foxglove``: a live server for the Foxglove app."""

from __future__ import annotations

from pydantic import model_validator

from bridge.config.sections.section import Section, setting
from bridge.config.sections.web import is_loopback_address, split


class FoxgloveSection(Section):
    """The server for the Foxglove app."""

    enabled: bool = setting(False, "Whether it runs.")
    listen: str = setting(
        "127.0.0.1:8765", "Address and port that the app opens, of loopback; see [Foxglove](foxglove.md). Port 0: any."
    )

    @model_validator(mode="after")
    def _safe(self) -> FoxgloveSection:
        address, _ = split(self.listen)
        if not is_loopback_address(address):
            msg = (
                f"listen: other machines reach {address}, and the server asks nobody who they are: listen on"
                " 127.0.0.1:8765, and reach it by a tunnel (ssh -L 8765:127.0.0.1:8765 robot)"
            )
            raise ValueError(msg)
        return self
