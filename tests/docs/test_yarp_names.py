"""The example of docs/yarp/names.md, and its numbers."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.support.ports import free_port
from yarp_compat.naming import client, registry, server, subscriptions
from yarp_compat.wire import contact

PAGE = (Path(__file__).parents[2] / "docs" / "yarp" / "names.md").read_text(encoding="utf-8")


def test_the_example_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    exec(code.replace("10100", str(min(free_port(), 60000))), {})
    assert capsys.readouterr().out == (
        "['/root'] True\nsource port /robot/camera is not registered at the name server\n"
    )


def test_the_limits_match_the_code() -> None:
    for number, text in (
        (registry.MAX_PORTS, "{:,} ports"),
        (registry.MAX_PROPERTY_CHARACTERS, "{:,} characters of\nproperties per port"),
        (subscriptions.MAX_SUBSCRIPTIONS, "{:,} persistent connections"),
        (server.LIMIT // 1024, "{} KiB per command"),
        (contact.MAX_NAME, "{:,} characters at most"),
        (round(client.TIMEOUT), "fails after {} seconds"),
    ):
        assert text.format(number) in PAGE
