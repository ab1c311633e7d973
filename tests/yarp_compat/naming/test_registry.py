"""Commands of a name server and their replies, as recorded from real ones."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.yarp_compat.transcripts import read
from yarp_compat.naming import registry as registry_module
from yarp_compat.naming.registry import OLD, PortRegistry, lines
from yarp_compat.naming.server import dumps, loads
from yarp_compat.naming.subscriptions import WantedConnection
from yarp_compat.wire.contact import PortContact
from yarp_compat.wire.text import from_text, to_text

END = "*** end of message"
ROOT = "registration name /root ip 127.0.0.1 port 10000 type tcp"


class TextRegistry:
    """A registry with commands and replies as text."""

    def __init__(self, port: int = 10000) -> None:
        self.now = 0.0
        self.registry = PortRegistry(PortContact("/root", "127.0.0.1", port), clock=lambda: self.now)
        self.events: list[Any] = []
        self.connections: list[WantedConnection] = []

    def __call__(self, text: str, remote: str = "127.0.0.1") -> list[str]:
        """Return the lines of the reply; a Bottle is one line."""
        answer = self.registry.apply(from_text(text), remote)
        self.events += answer.events
        self.connections += answer.connections
        return lines(answer.values) if answer.values[:1] == [OLD] else [to_text(answer.values)]


@pytest.fixture(name="ask")
def fixture_ask() -> TextRegistry:
    """Return an empty registry."""
    return TextRegistry()


def test_a_registration_is_completed(ask: TextRegistry) -> None:
    """The server fills in the number, the client's address and the name."""
    assert ask("query /foo/auto") == [END]
    assert ask("register /foo/auto") == ["registration name /foo/auto ip 127.0.0.1 port 10002 type tcp", END]
    assert ask("query /foo/auto") == ["registration name /foo/auto ip 127.0.0.1 port 10002 type tcp", END]
    assert ask("register /foo/bar tcp 127.0.0.1 10055") == [
        "registration name /foo/bar ip 127.0.0.1 port 10055 type tcp",
        END,
    ]
    assert ask("register ... tcp ... ...") == ["registration name /tmp/port/1 ip 127.0.0.1 port 10003 type tcp", END]
    assert ask("register /far", remote="10.0.0.9") == ["registration name /far ip 10.0.0.9 port 10004 type tcp", END]
    assert ask("register ... mcast ... 0")[0] == "registration name /tmp/port/2 ip 224.1.1.3 port 10005 type mcast"
    assert ask("unregister /foo/auto") == [END]
    assert ask("query /foo/auto") == [END]
    assert ask("register /new")[0].split()[6] == "10006"
    assert ask("register /foo/auto")[0].split()[6] == "10002"


def test_ports_are_listed_by_name_and_prefix(ask: TextRegistry) -> None:
    """The list is sorted by the bytes of the names, in the form of a Bottle too."""
    for name in ("/b", "/a", "/a/x", "/ab"):
        ask(f"register {name} tcp h 1")
    assert [line.split()[2] for line in ask("list")[:-1]] == ["/a", "/a/x", "/ab", "/b", "/root"]
    assert [line.split()[2] for line in ask("list /a")[:-1]] == ["/a", "/a/x"]
    assert [line.split()[2] for line in ask("list /a/")[:-1]] == ["/a/x"]
    assert ask("NAME_SERVER list /nothing") == [END]
    assert ask("bot list /b") == ['ports (port (name "/b") (ip h) (port_number 1) (carrier tcp))']
    assert ask("bot query /b") == ['port (name "/b") (ip h) (port_number 1) (carrier tcp)']
    assert ask("bot query /c") == ['port (error -2 "port not known")']


def test_a_browser_receives_values(ask: TextRegistry) -> None:
    """The command for ``/?req=list&format=json`` also contains the fields of the HTTP request."""
    ask("register /p")
    answer = ask('list (REQUEST_URI "?req=list&format=json") (format json) (req list)')
    assert answer[0].startswith('ports (port (name "/p") (ip "127.0.0.1")')
    assert ask("query (a b)") == [END]
    assert ask("register 5") == [END]


def test_properties_are_set_read_and_checked(ask: TextRegistry) -> None:
    """A key has several words, returned in the order of their bytes; setting replaces all of them."""
    ask("register /p")
    assert ask("set /p key v2 v1 (a b)") == ["port /p property key = a b v1 v2", END]
    assert ask("get /p key") == ["port /p property key = a b v1 v2", END]
    assert ask("get /p other") == ["port /p property other =", END]
    assert ask("bot get /p key") == ['"a b" v1 v2']
    assert ask("check /p key v1") == ["port /p property key value v1 present true", END]
    assert ask("check /p key v3") == ["port /p property key value v3 present false", END]
    assert ask("set /p key 5") == ["port /p property key = 5", END]
    assert ask("bot get /p key") == ["5"]
    assert ask("set /missing key 5") == [END]
    assert ask("bot get /missing key") == [""]
    ask("set /p yarprun true")
    assert ask("runners") == ["registration name /p ip 127.0.0.1 port 10002 type tcp", END]
    ask("unregister /p")
    ask("register /p")
    assert ask("get /p key") == ["port /p property key =", END]


def test_other_commands_reply_like_yarpserver(ask: TextRegistry) -> None:
    """Route, gc, help, unknown commands, and commands about the name server itself."""
    assert ask("route /a /b") == ["port /a route /b = tcp://b", END]
    assert ask("gc") == ["garbage collection done.", END]
    assert ask("help")[:2] == ["Here are some ways to use the name server:", "+ help"]
    for nonsense in ("garbage", "", "register", "set", "get", "query", "register /root", "[register]"):
        assert ask(nonsense)[-1] == END
    assert ask("query /root") == [ROOT, END]
    ask("unregister /root")
    assert ask("query /root") == [ROOT, END]
    assert ask("get /root nameserver") == ["port /root property nameserver = true", END]
    assert ask("query tcp://root") == [ROOT, END]
    assert ask("query /net=eth0/root") == [ROOT, END]
    assert ask("type yarp image rgb") == ["[ok]"]
    assert ask("type yarp image") == ["type yarp image rgb"]
    assert ask("type yarp other") == ["[fail]"]


def test_owned_entries_are_removed_with_their_port(ask: TextRegistry) -> None:
    """A port that writes over mcast owns the entry of its group; entries that own each other are removed too."""
    ask("register /w")
    ask("register /group mcast ... 0")
    ask("set /w owns /group")
    ask("set /group owns /w")
    ask("unregister /w")
    assert ask("query /group") == [END]
    assert [(str(e[0]), e[1]) for e in ask.events] == [("add", "/w"), ("del", "/w")]


def test_a_long_chain_of_owners_does_no_harm(ask: TextRegistry) -> None:
    """Removal stops at a limited depth."""
    for number in range(3000):
        ask(f"register /p{number} tcp h 1")
        ask(f"set /p{number} owns /p{number + 1}")
    assert ask("unregister /p0") == [END]
    assert ask("query /p0") == [END]


def test_a_repeated_registration_changes_nothing(ask: TextRegistry) -> None:
    """Ports that register again at a restarted name server keep their properties, and no event is published."""
    ask("register /p tcp 127.0.0.1 10002")
    ask("set /p key value")
    ask.events.clear()
    answer = ask.registry.apply(["register", "/p", "tcp", "127.0.0.1", 10002], "127.0.0.1")
    assert not answer.changed
    assert not answer.events
    assert ask("get /p key") == ["port /p property key = value", END]
    ask("register /p tcp 127.0.0.1 10099")
    assert [str(e[0]) for e in ask.events] == ["del", "add"]
    assert ask("get /p key") == ["port /p property key =", END]


@pytest.mark.parametrize(
    "command",
    [
        f"register /{'x' * 2000}",
        'register "/two words"',
        "register /p tcp host 70000",
        f"register /p tcp {'h' * 2000} 5",
        'register /p "a b" host 5',
    ],
)
def test_invalid_registrations_are_rejected(ask: TextRegistry, command: str) -> None:
    """Names and addresses must be valid, and must not contain line breaks."""
    assert ask(command) == [END]
    assert [e.contact.name for e in ask.registry.entries()] == ["/root"]


def test_the_registry_is_bounded(ask: TextRegistry, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ports, properties and types have limits."""
    monkeypatch.setattr(registry_module, "MAX_PORTS", 3)
    assert [len(ask(f"register /p{i}")) for i in range(3)] == [2, 2, 1]
    assert len(ask("register /p1")) == 2
    ask(f"set /p1 key {'x' * 5000}")
    assert ask(f"set /p1 other {'x' * 5000}") == ["port /p1 property other =", END]
    ask("set /p1 key short")
    assert len(ask(f"set /p1 other {'x' * 5000}")[0]) > 5000
    assert [ask(f"type yarp t{i} x") for i in range(4)] == [["[ok]"], ["[ok]"], ["[ok]"], ["[fail]"]]


def test_every_recorded_exchange_of_two_ports_is_reproduced(ask: TextRegistry) -> None:
    """The replies to two real ports and ``yarp connect`` equal those of a real name server byte for byte."""
    talks = [t for t in read("connect.txt") if t.port == 10000]
    assert len(talks) >= 19
    for talk in talks:
        line = talk.sent_by("C").decode()
        answer = "".join(f"{text}\r\n" for text in ask(line))
        assert answer.encode() == talk.sent_by("S"), line


def recorded() -> list[tuple[str, list[str]]]:
    """Return commands and the lines of their replies, recorded from a real name server."""
    exchanges: list[tuple[str, list[str]]] = []
    for line in (Path(__file__).parents[1] / "data" / "name_server.txt").read_text().splitlines():
        if line.startswith(">"):
            exchanges.append((line[2:], []))
        elif line.startswith("<"):
            exchanges[-1][1].append(line[2:])
    return exchanges


def test_every_recorded_command_gets_the_same_reply() -> None:
    """Sixty commands to yarpserver 3.12.3, in the recorded order."""
    ask = TextRegistry(port=10410)
    commands = recorded()
    assert len(commands) > 50
    for command, answer in commands:
        assert [line.rstrip(" ") for line in ask(command)] == answer, command


WORDS = st.sampled_from(
    re.split(
        " ",
        "register unregister set get query announce subscribe topic bot list ... /a /b topic://t udp://a from to owns"
        " mcast tcp 10.0.0.1 10002 key",
    )
)


@given(st.lists(st.lists(WORDS, min_size=1, max_size=6), max_size=30))
def test_a_restored_registry_replies_like_the_original(commands: list[list[str]]) -> None:
    """This holds for any sequence of commands."""
    original, restored = TextRegistry(), TextRegistry()
    for command in commands:
        original(" ".join(command))
    data = dumps(original.registry)
    loads(restored.registry, data)
    assert dumps(restored.registry) == data
    for question in ("list", "bot list", "subscribe", "topic", "get /a key", "get /b owns"):
        assert restored(question) == original(question)
    for command in commands:
        assert restored(" ".join(command)) == original(" ".join(command))


@pytest.mark.parametrize("data", [b"", b"[]", b"{}", b'{"version": 2}', b'{"version": 1, "ports": [1]}', b"\xff"])
def test_an_invalid_state_is_rejected(data: bytes) -> None:
    """The error gives a reason."""
    with pytest.raises(ValueError, match=r"."):
        loads(PortRegistry(PortContact("/root", "127.0.0.1", 10000)), data)
