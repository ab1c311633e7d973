"""The spellings of a port's name and address."""

from __future__ import annotations

import pytest

from yarp_compat.wire.contact import PortContact, is_name, is_port_name


@pytest.mark.parametrize(
    ("text", "contact", "target"),
    [
        ("/reader", PortContact("/reader", carrier=""), "/reader"),
        ("tcp://reader", PortContact("/reader", carrier="tcp"), "tcp://reader"),
        ("udp:/a/b", PortContact("/a/b", carrier="udp"), "udp://a/b"),
        ("fast_tcp+recv.portmonitor://r", PortContact("/r", carrier="fast_tcp+recv.portmonitor"), None),
        ("topic://chatter", PortContact("/chatter", carrier="topic"), "topic://chatter"),
        ("tcp://127.0.0.1:10005/", PortContact("", "127.0.0.1", 10005, "tcp"), None),
        ("/127.0.0.1:10005/r", PortContact("/r", "127.0.0.1", 10005, "tcp"), None),
        ("tcp://host:99999/", PortContact("", "host", -1, "tcp"), None),
    ],
)
def test_every_spelling_of_a_port_is_parsed(text: str, contact: PortContact, target: str | None) -> None:
    """The parsed contact is converted back to the spelling of admin commands."""
    assert PortContact.parse(text) == contact
    assert target is None or contact.target == target


def test_a_printed_address_is_parsed_again() -> None:
    """YARP prints addresses with their carrier."""
    contact = PortContact("", "10.0.0.7", 10005, "udp")
    assert contact.uri == "udp://10.0.0.7:10005/"
    assert PortContact.parse(contact.uri) == contact
    assert PortContact.parse(contact.uri).is_valid
    assert not PortContact("/p").is_valid


def test_registration_lines_are_parsed_and_formatted() -> None:
    """Other lines are parsed to None."""
    line = "registration name /reader ip 127.0.0.1 port 10002 type tcp"
    contact = PortContact("/reader", "127.0.0.1", 10002, "tcp")
    assert PortContact.from_registration(line) == contact
    assert contact.registration == line
    for other in ("", "*** end of message", "[ok]"):
        assert PortContact.from_registration(other) is None
    for number in ("none", "123456", "-1", "²", "1" * 5000):
        assert PortContact.from_registration(line.replace("10002", number)) is None


@pytest.mark.parametrize("name", ["/a", "/a/b:o", "/tmp/port/1", "/topic+@/node", "/ü"])
def test_valid_port_names_are_accepted(name: str) -> None:
    """YARP accepts them too."""
    assert is_port_name(name)


@pytest.mark.parametrize("name", ["", "/", "a", "/a/", "/a b", '/a"b', "/a\nb", "/" + "x" * 1024])
def test_invalid_port_names_are_rejected(name: str) -> None:
    """Names of other registrations, such as the discovery group's, need no slash."""
    assert not is_port_name(name)
    assert is_name("fallback")
