"""The valid parts of a configuration file with problems."""

from __future__ import annotations

from pathlib import Path

import pytest

from bridge.config.load import load
from bridge.config.model import Config
from bridge.config.partial import load_partly

GOOD = "name: robot1\nhub:\n  listen: tcp/127.0.0.1:7555\n  domain: 7\nnavigation:\n  velocity: /base/cmd_vel\n"


@pytest.mark.parametrize(
    "text",
    [
        GOOD + "logg: {level: info}\n",
        GOOD + "sim: {start: [1]}\n",
        GOOD + "zenoh:\n  zenoh: /no/such/file.json5\n",
        GOOD + "routing:\n  rules:\n    - {topic: /a\n",
        GOOD + "log:\n\tlevel: info\n",
        "} {\n" + GOOD,
        "# a comment\n---\n" + GOOD + "name: [\n",
        GOOD.replace("domain: 7", "domain: 7\n  zenoh: /no/such/file.json5"),
        GOOD.replace("domain: 7", "domain: 7\n  unknown: {a: [1, {b: 2}]}"),
    ],
)
def test_the_valid_sections_and_keys_are_used(tmp_path: Path, text: str) -> None:
    file = tmp_path / "midspan.yaml"
    file.write_text(text)
    config = load_partly(file)
    assert (config.name, config.hub.listen, config.hub.domain) == ("robot1", "tcp/127.0.0.1:7555", 7)
    assert config.navigation.velocity == "/base/cmd_vel"
    assert "name" in config.model_fields_set, "the state folder must not replace it"


def test_a_valid_file_is_used_as_a_whole(tmp_path: Path) -> None:
    file = tmp_path / "midspan.yaml"
    file.write_text(GOOD)
    assert load_partly(file) == load(file)


@pytest.mark.parametrize("content", [None, b"", b"\xff\xfe\x00", b"- 1\n- 2\n", b"hub: 3\n", b"x" * 2_000_000])
def test_a_useless_file_yields_the_defaults(tmp_path: Path, content: bytes | None) -> None:
    file = tmp_path / "midspan.yaml"
    if content is not None:
        file.write_bytes(content)
    assert load_partly(file) == Config()
