"""The configuration file."""

from __future__ import annotations

from collections.abc import Callable

from bridge.config.document import ConfigError
from tests.fuzz.target import Subject, Target, scratch, texts

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
    """A whole file as text; an accepted configuration can be sent to a worker, and its rules can be applied."""
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
    from bridge.config.load import load

    file = scratch() / "midspan.yaml"

    def parse(data: bytes) -> None:
        file.write_bytes(data)
        load(file)

    return Subject(parse, _SEEDS, (ConfigError,), [*_WORDS, b"\xff", b"\xff\xfe", b"\x80"], largest=512)


def _peers(bridge: str) -> Callable[[], Subject]:
    """Return a target that converts another bridge's configuration to a valid Midspan configuration."""

    def make() -> Subject:
        from bridge.config.importers import domain_bridge, ros1_bridge
        from bridge.config.load import loads

        file = scratch() / "peer.yaml"

        def parse(data: bytes) -> None:
            file.write_bytes(data)
            drafts = domain_bridge.drafts(file)[0] if bridge == "domain_bridge" else [ros1_bridge.draft(file)[0]]
            for draft in drafts:
                loads(draft.text())

        return Subject(parse, _PEERS[bridge], (ConfigError,), [*_WORDS, *_PEER_WORDS], 768)

    return make


_PEERS = {
    "domain_bridge": texts(
        "name: my_bridge\nfrom_domain: 2\nto_domain: 3\ntopics:\n  chatter:\n    type: std_msgs/msg/String\n"
        "    remap: talk\n"
        "  /clock:\n    type: rosgraph_msgs/msg/Clock\n    from_domain: 1\n    bidirectional: true\n"
        "    qos: {reliability: best_effort, depth: 1, deadline: -1}\n",
        "name: b\nmode: compress\ntopics:\n  a: {type: a_msgs/msg/A, from_domain: 0, to_domain: 5, reversed: true}\n"
        "services:\n  s: {type: a/srv/B}\n",
    ),
    "ros1_bridge": texts(
        "topics:\n  - {topic: /chatter, type: std_msgs/msg/String, queue_size: 1}\n  -\n    topic: /map\n"
        "    type: nav_msgs/OccupancyGrid\n    qos:\n      history: keep_all\n      durability: transient_local\n"
        "      deadline: {secs: 10, nsecs: 2}\nservices_2_to_1:\n  - {service: /add, type: a/Add}\n",
    ),
}
_PEER_WORDS = texts(
    "topics:\n", "type: ", "remap: ", "qos: ", "queue_size: ", "from_domain: ", "~/", "topics: []",
    "services_1_to_2:\n", "~", "-1", "1e9", "- 5\n", "ros1_package_name: a\n",
)  # fmt: skip

TARGETS = (
    Target("domain_bridge", 400, _peers("domain_bridge")),
    Target("ros1_bridge", 400, _peers("ros1_bridge")),
    Target("config", 700, _config),
    Target("config_file", 500, _file),
)
