"""A YARP name server's commands, as lines and as Bottles; its files; and its replies as clients read them."""

from __future__ import annotations

from pathlib import Path

from tests.fuzz.target import JSON_WORDS, Subject, Target, texts
from yarp_compat.naming import config
from yarp_compat.naming.registry import OLD, Command, PortRegistry, lines
from yarp_compat.naming.server import dumps, loads
from yarp_compat.ports.naming import NamingConfigError
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.contact import PortContact
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.text import from_text, to_text

_SERVER = PortContact("/root", "127.0.0.1", 10000)
_RECORDED = Path(__file__).parents[2] / "yarp_compat" / "data" / "name_server.txt"
_COMMANDS = [line[2:] for line in _RECORDED.read_text().splitlines() if line.startswith("> ")]
_WORDS = texts(
    "register ", "unregister ", "query ", "list ", "set ", "get ", "check ", "bot ", "subscribe ", "unsubscribe ",
    "announce ", "topic ", "untopic ", "type ", "owns", "yarprun", "true", "mcast", "tcp", "...", "=", " ", "\n", '"',
    "/a", "/b", "/root", "/net=1/", "topic://t", "udp://a", "from", "to", "10002", "-1", "70000", "224.1.1.3",
    "/tmp/port/1", "(", ")", "[", "]", "\\n", "\r", "\x00", "\u2028", "\x85", "format json", "\u0663",
)  # fmt: skip


def _checked(registry: PortRegistry, answer: Command) -> None:
    """Check that an answer can be sent, and that its registrations can be parsed."""
    if answer.values[:1] == [OLD]:
        reply = lines(answer.values)
        assert reply[-1] == "*** end of message"
        for line in reply:
            assert "\n" not in line, line
            assert "\r" not in line, line
            if line.startswith("registration name "):
                contact = PortContact.from_registration(line)
                assert contact is not None
                assert registry.find(contact.name) == contact
    else:
        to_text(answer.values)
        encode(answer.values, Profile.YARP4)
    for event in answer.events:
        encode(event, Profile.YARP3)
    assert len(answer.connections) < 1000


def _remembered(registry: PortRegistry) -> None:
    """Check that a registry loaded from the stored one is equal."""
    data = dumps(registry)
    again = PortRegistry(_SERVER)
    loads(again, data)
    assert dumps(again) == data


def _lines() -> Subject:
    """Commands to a name server, one per line."""

    def parse(data: bytes) -> None:
        registry = PortRegistry(_SERVER)
        for line in data.split(b"\n")[:40]:
            _checked(registry, registry.apply(from_text(line.decode(errors="surrogateescape")), "127.0.0.1"))
        _remembered(registry)

    seeds = [b"\n".join(texts(*_COMMANDS[i : i + 8])) for i in range(0, len(_COMMANDS), 8)]
    return Subject(parse, seeds, (WireError,), _WORDS, 4096)


def _bottles() -> Subject:
    """A command as a Bottle of arbitrary values."""

    def parse(data: bytes) -> None:
        registry = PortRegistry(_SERVER)
        values = decode(data)
        for _ in range(2):
            _checked(registry, registry.apply(values, "10.0.0.7"))
        _remembered(registry)

    seeds = [encode(from_text(command), profile) for command in _COMMANDS for profile in Profile]
    return Subject(parse, seeds, (WireError,), _WORDS, 2048)


def _conf() -> Subject:
    """``yarp.conf``; a parsed address can be written and parsed again."""

    def parse(data: bytes) -> None:
        address = config.parse(data.decode(errors="replace"))
        assert 0 < address.port <= 0xFFFF
        assert config.parse(f"{address.host} {address.port} {address.mode}\n").port == address.port

    seeds = texts("127.0.0.1 10000 yarp\n", "[name]\nhost icub-head\nport 10006\nmode yarp\n", '"10.1.1.1" "10000"')
    return Subject(
        parse, seeds, (NamingConfigError,), texts("[", "]", "[name]", "host", "port", '"', "//", "\x85", "-1", "0")
    )


def _memory() -> Subject:
    """The file in which a name server stores its registry."""

    def parse(data: bytes) -> None:
        registry = PortRegistry(_SERVER)
        loads(registry, data)
        _checked(registry, registry.apply(["list"], ""))
        _checked(registry, registry.apply(["subscribe"], ""))
        registry.apply(["register", "/new"], "127.0.0.1")

    full = PortRegistry(_SERVER)
    for command in _COMMANDS:
        full.apply(from_text(command), "127.0.0.1")
    tokens = [*JSON_WORDS, *texts('"ports"', '"next"', '"used"', '"live"', '"topics"', "[[", "99999", '"/a"')]
    return Subject(parse, [dumps(full), dumps(PortRegistry(_SERVER))], (ValueError,), tokens)


def _contact() -> Subject:
    """Port names with carriers and addresses, and a name server's lines about them."""

    def parse(data: bytes) -> None:
        text = data.decode(errors="surrogateescape")
        contact = PortContact.parse(text)
        assert contact.port <= 0xFFFF
        if contact.is_valid:
            assert PortContact.parse(contact.uri).port == contact.port
        parsed = PortContact.from_registration(text)
        assert parsed is None or PortContact.from_registration(parsed.registration) == parsed

    seeds = texts(
        "/reader", "udp://reader", "tcp://127.0.0.1:10002/", "/127.0.0.1:10002/r", "fast_tcp+recv.x:/r",
        "registration name /r ip 127.0.0.1 port 10002 type tcp",
    )  # fmt: skip
    return Subject(parse, seeds, (), texts("/", ":", "://", " ", "99999999", "\u0663", "-1"), 300)


TARGETS = (
    Target("yarp_name_lines", 8_000, _lines),
    Target("yarp_name_bottles", 15_000, _bottles),
    Target("yarp_conf", 5_000, _conf),
    Target("yarp_name_memory", 3_000, _memory),
    Target("yarp_contact", 10_000, _contact),
)
