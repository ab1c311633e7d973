"""The ``foxglove`` section: a live server for the Foxglove app."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from bridge.config.sections.listen import PersonName, ServerSection, TokenSection, is_loopback_address, split
from bridge.config.sections.section import setting


class FoxgloveSection(ServerSection):
    """The server for the Foxglove app."""

    listen: str = setting(
        "127.0.0.1:8765",
        "Address and port that the app opens; port 0: any. An address that other machines reach (`0.0.0.0:8765`) uses"
        " TLS, with the certificate of `hub.open`, and needs `tokens`; see [Foxglove](foxglove.md).",
    )
    drive: bool = setting(
        False,
        "Whether programs on this machine may publish, call and set parameters, or only watch. With `tokens`, each"
        " token's role decides instead.",
    )
    tokens: dict[PersonName, TokenSection] = setting(
        {}, 'Tokens by name: `anna: {role: drive, sha256: "..."}`; with one, connections on loopback use TLS as well.'
    )
    origins: tuple[Annotated[str, Field(min_length=1, max_length=255)], ...] = setting(
        ("https://app.foxglove.dev", "file://"),
        "Pages that may connect without `tokens`, by the `Origin` header that browsers send; other programs send none.",
    )

    @property
    def guarded(self) -> bool:
        """Whether the server requires TLS and a token."""
        return bool(self.tokens)

    @property
    def commanded(self) -> bool:
        """Whether any client may publish, call services and set parameters."""
        return self.drive or any(token.role == "drive" for token in self.tokens.values())

    @model_validator(mode="after")
    def _safe(self) -> FoxgloveSection:
        address, _ = split(self.listen)
        if self.tokens and self.drive:
            raise ValueError("drive: the roles of the tokens decide who may drive (role: drive); remove drive")
        if not self.tokens and not is_loopback_address(address):
            msg = (
                f"listen: other machines reach {address}, so it would be open to anyone; set foxglove.tokens"
                " ('midspan web --token NAME' creates one), or listen on 127.0.0.1:8765 and reach it by a tunnel"
                " (ssh -L 8765:127.0.0.1:8765 robot)"
            )
            raise ValueError(msg)
        return self
