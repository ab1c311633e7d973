"""One topic as commands receive it."""

from __future__ import annotations

from typing import Any
from unittest.mock import MagicMock

import pytest

from bridge.client import feed
from bridge.client.errors import ClientError


@pytest.mark.parametrize("options", [{}, {"option": "--duration"}])
def test_the_error_names_the_option_that_waits_for_the_topic(
    options: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    client: Any = MagicMock()
    client.publishers.return_value = client.ask.return_value = []
    decision = MagicMock(worker="ros1", decision="unseen", why="it is not published")
    monkeypatch.setattr(feed, "ask_decisions", lambda *_: [decision])
    topic = feed.TopicFeed(client, "/scan", **options)  # type: ignore[arg-type]
    with pytest.raises(ClientError, match=f"wait for it with {options.get('option', '--timeout')} SECONDS"):
        topic.open(0.0)
