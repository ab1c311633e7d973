"""Warnings about machines that refuse what a command publishes."""

from __future__ import annotations

import sys
from collections.abc import Iterable

from bridge.client.refusals import refusals_of_own
from bridge.client.session import Client
from bridge.text import clean


def warn_of_refusals(client: Client, published: Iterable[tuple[str, str, str]]) -> bool:
    """Report on stderr which machines refuse what this program publishes; return whether any does.

    ``published`` has the name, type and type hash of each topic.
    """
    refused = refusals_of_own(client, published)
    for refusal in refused:
        print(f"midspan: warning: {clean(refusal.text)}; {clean(refusal.cure)}", file=sys.stderr)
    return bool(refused)
