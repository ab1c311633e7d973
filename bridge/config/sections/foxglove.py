"""The section ``foxglove``: a live server for the Foxglove app."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from bridge.config.sections.section import Section, setting
from bridge.config.sections.web import PersonName, TokenSection, is_loopback_address, split


class FoxgloveSection(Section):
    """The server for the Foxglove app."""

    enabled: bool = setting(False, "Whether it runs.")
    listen: str = setting(
        "127.0.0.1:8765",
        "Address and port that the app opens; port 0: any. One that other machines reach (`0.0.0.0:8765`) has TLS, with"
        " the certificate of `hub.open`, and needs `tokens`; see [Foxglove](foxglove.md).",
    )
    drive: bool = setting(
        False,
        "Whether the programs of this machine may publish, call and set, or look alone; with `tokens` those say it.",
    )
    tokens: dict[PersonName, TokenSection] = setting(
        {}, 'Who gets in by a token, by name: `anna: {role: drive, sha256: "..."}`; with one, loopback has TLS, too.'
    )
    origins: tuple[Annotated[str, Field(min_length=1, max_length=255)], ...] = setting(
        ("https://app.foxglove.dev", "file://"),
        "Pages that may ask where there are no `tokens`, by the `Origin` that browsers send; a program that is no"
        " browser sends none.",
    )

    @property
    def guarded(self) -> bool:
        """Whether it has TLS, and who comes must say who they are."""
        return bool(self.tokens)

    @property
    def commanded(self) -> bool:
        """Whether anybody may publish, call and set."""
        return self.drive or any(token.role == "drive" for token in self.tokens.values())

    @model_validator(mode="after")
    def _safe(self) -> FoxgloveSection:
        address, _ = split(self.listen)
        if self.tokens and self.drive:
            raise ValueError("drive: with tokens each of them says who may drive (role: drive); leave drive out")
        if not self.tokens and not is_loopback_address(address):
            msg = (
                f"listen: other machines reach {address}, and nobody is asked who they are: give foxglove.tokens"
                " ('midspan web --token NAME' makes one), or listen on 127.0.0.1:8765 and reach it by a tunnel"
                " (ssh -L 8765:127.0.0.1:8765 robot)"
            )
            raise ValueError(msg)
        return self
