"""The configuration file."""

from __future__ import annotations

from bridge.config.problems import ConfigError
from tests.fuzz.target import Subject, Target, texts

_SEEDS = texts(
    "name: robot\nhub: {domain: 3, listen: tcp/127.0.0.1:7447, zenoh: {mode: peer}}\n"
    "ros1: {master: http://h:11311, poll: 0.1}\n",
    "routing:\n  default: deny\n  private: false\n  rules:\n"
    "    - {topic: /camera/**, to: ros2, rate: 5, qos: {reliability: best_effort}}\n"
    "    - {regex: '/a/(.*)', rename: '/b/\\1', priority: command, timeout: 0.2, depth: 4}\n"
    "    - {topic: '**', deny: true}\n",
    "# only comments\nlog:\n  level: debug\nlimits: {message: 16}\nros2: {transport: udp, domain: 7}\n",
)
_WORDS = texts(
    "rules:\n", "- ", ": ", "{", "}", "[", "]", "&a ", "*a", "<<: ", "!!python/name:os ", "!!binary ", "? ", "| ",
    "> ", "'", '"', "#", "---\n",
    "...\n", "~", "null", "2001-12-14", "0x7f", "1_000", ".inf", ".nan", "\t", "\ufeff", "topic:", "regex: '('",
    "rename: '\\9'", "from: ", "state:",
)  # fmt: skip


def _config() -> Subject:
    """A whole file as text; what is taken can be told to a worker and read back, and its rules decide."""
    from bridge.config.load import loads
    from bridge.config.model import Config
    from bridge.daemon.protocol import config_json
    from bridge.routing.rules import RuleSet

    def parse(data: bytes) -> None:
        config = loads(data.decode(errors="replace"))
        assert Config.model_validate(config_json(config)) == config
        rules = RuleSet(config.routing)
        for topic in ("/camera/1/image", "/a/b"):
            rules.enter("ros1", topic, "sensor_msgs/msg/Image")
            rules.leave("ros1", "ros2", topic, "sensor_msgs/msg/Image")

    return Subject(parse, _SEEDS, (ConfigError,), _WORDS, largest=1024)


def _file() -> Subject:
    """A whole file as bytes."""
    import tempfile
    from pathlib import Path

    from bridge.config.load import load

    file = Path(tempfile.mkdtemp(prefix="midspan-fuzz-")) / "midspan.yaml"

    def parse(data: bytes) -> None:
        file.write_bytes(data)
        load(file)

    return Subject(parse, _SEEDS, (ConfigError,), [*_WORDS, b"\xff", b"\xff\xfe", b"\x80"], largest=512)


TARGETS = (
    Target("config", 700, _config),
    Target("config_file", 500, _file),
)
