"""The spellings of a port's name and address."""

from __future__ import annotations

import pytest

from yarp_compat.wire.contact import Contact, is_name, is_port_name


@pytest.mark.parametrize(
    ("text", "contact", "target"),
    [
        ("/reader", Contact("/reader", carrier=""), "/reader"),
        ("tcp://reader", Contact("/reader", carrier="tcp"), "tcp://reader"),
        ("udp:/a/b", Contact("/a/b", carrier="udp"), "udp://a/b"),
        ("fast_tcp+recv.portmonitor://r", Contact("/r", carrier="fast_tcp+recv.portmonitor"), None),
        ("topic://chatter", Contact("/chatter", carrier="topic"), "topic://chatter"),
        ("tcp://127.0.0.1:10005/", Contact("", "127.0.0.1", 10005, "tcp"), None),
        ("/127.0.0.1:10005/r", Contact("/r", "127.0.0.1", 10005, "tcp"), None),
        ("tcp://host:99999/", Contact("", "host", -1, "tcp"), None),
    ],
)
def test_spellings(text: str, contact: Contact, target: str | None) -> None:
    """Each of YARP's ways to name a port, and the way back to an admin command's."""
    assert Contact.parse(text) == contact
    assert target is None or contact.target == target


def test_addresses() -> None:
    """An address with its carrier, as YARP prints it, can be read again."""
    contact = Contact("", "10.0.0.7", 10005, "udp")
    assert contact.uri == "udp://10.0.0.7:10005/"
    assert Contact.parse(contact.uri) == contact
    assert Contact.parse(contact.uri).is_valid
    assert not Contact("/p").is_valid


def test_registration_lines() -> None:
    """The name server's line, both ways; what is none is None."""
    line = "registration name /reader ip 127.0.0.1 port 10002 type tcp"
    contact = Contact("/reader", "127.0.0.1", 10002, "tcp")
    assert Contact.from_registration(line) == contact
    assert contact.registration == line
    for other in ("", "*** end of message", "[ok]", line.replace("10002", "none"), line.replace("10002", "123456")):
        assert Contact.from_registration(other) is None


@pytest.mark.parametrize("name", ["/a", "/a/b:o", "/tmp/port/1", "/topic+@/node", "/ü"])
def test_port_names(name: str) -> None:
    """What YARP takes as a port's name."""
    assert is_port_name(name)


@pytest.mark.parametrize("name", ["", "/", "a", "/a/", "/a b", '/a"b', "/a\nb", "/" + "x" * 1024])
def test_no_port_names(name: str) -> None:
    """What it does not; names of other registrations, such as the discovery group's, need no slash."""
    assert not is_port_name(name)
    assert is_name("fallback")
