"""The errors of the client library."""

from __future__ import annotations


class ClientError(Exception):
    """A request to Midspan failed for a reason that the user can fix; the text gives fact, place and cure."""


class UnreachableHubError(ClientError):
    """No router answers at the hub's endpoint; ``hint`` names the likely cause and the cure."""

    def __init__(self, text: str, hint: str) -> None:
        super().__init__(f"{text}\n{hint}")
        self.text, self.hint = text, hint
