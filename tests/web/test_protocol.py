"""The published JSON Schema of the console's protocol.

In the other tests, `tests.peers.browser.page.TestPage` checks each message and reply of the console against its models.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from tests.peers.browser import protocol
from tests.web.conftest import Desk

DOCS = Path(__file__).parents[2] / "docs" / "operate"
SCHEMA = DOCS / "console_protocol.schema.json"
TEXT = (DOCS / "console_protocol.md").read_text()


def test_the_schema_is_up_to_date() -> None:
    hint = f"python -m tests.peers.browser.protocol > {SCHEMA.relative_to(DOCS.parents[1])}"
    assert SCHEMA.read_text() == protocol.text(), hint
    assert f"({SCHEMA.name})" in TEXT


def test_each_reference_has_a_target() -> None:
    document = json.loads(SCHEMA.read_text())
    names = set(re.findall(r'"#/\$defs/(\w+)"', SCHEMA.read_text()))
    assert names <= set(document["$defs"])


def test_the_schema_has_all_verbs_and_feeds(desk: Desk) -> None:
    verbs = desk.console.verbs.known
    assert set(protocol.VERBS) == set(verbs)
    for name, verb in verbs.items():
        args = protocol.VERBS[name][0]
        assert {key for key, kind in args.items() if isinstance(kind, tuple)} == set(verb.may), name
        assert set(args) == {*verb.needs, *verb.may}, name
    assert set(protocol.FEEDS) == set(desk.console.feeds.fixed)


def table(title: str) -> str:
    return TEXT.partition(f"## {title}\n")[2].partition("\n## ")[0]


def test_the_documentation_has_all_verbs_and_feeds(desk: Desk) -> None:
    rows = [line.split("|") for line in table("Verbs").splitlines() if line.startswith("| `")]
    roles = {name: row[3].strip() for row in rows for name in re.findall(r"`(\w+)`", row[1])}
    verbs = desk.console.verbs.known
    assert roles == {name: "drive" if verb.commands else "watch" for name, verb in verbs.items()}
    feeds = re.findall(r"^\| `(\w+)` \|", table("Feeds"), re.MULTILINE)
    assert set(feeds) == set(protocol.FEEDS)


@pytest.mark.parametrize(
    "message",
    [{"op": "hello"}, {"op": "value", "feed": "robot", "n": 1, "value": {"pose": 3}}, {"op": "held", "x": "1"},
     {"op": "value", "feed": "unknown", "n": 1, "value": {}}, {"op": "error", "error": "a", "more": 1}, {}],
)  # fmt: skip
def test_invalid_messages_are_rejected(message: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        protocol.check_said(message)


@pytest.mark.parametrize(
    ("verb", "args", "value"),
    [("goto", {"x": 1.0}, ""), ("goto", {"x": 1.0, "y": 2.0, "z": 1}, ""), ("ping", {}, 1), ("stop", {"a": 1}, "")],
)
def test_invalid_calls_are_rejected(verb: str, args: dict[str, Any], value: Any) -> None:
    with pytest.raises(ValidationError):
        protocol.check_done(verb, args, value)
