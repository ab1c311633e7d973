"""``Contact`` has the same parts and printed forms as in YARP 3.12.3 and 4.0.0."""

from __future__ import annotations

import pytest

import yarp_compat as yarp

# recorded: the text, then getName, getRegName, getCarrier, getHost, getPort, toString, toURI, toURI(False), isValid
RECORDED = [
    ("/a", "/a", "/a", "", "", -1, "/a", "", "", False),
    ("tcp://a", "/a", "/a", "tcp", "", -1, "tcp://a", "tcp:/", "", False),
    ("tcp://127.0.0.1:10", "/127.0.0.1:10", "", "tcp", "127.0.0.1", 10, "tcp://127.0.0.1:10", "tcp://127.0.0.1:10/",
     "/127.0.0.1:10/", True),
    ("/127.0.0.1:10", "/127.0.0.1:10", "", "tcp", "127.0.0.1", 10, "tcp://127.0.0.1:10", "tcp://127.0.0.1:10/",
     "/127.0.0.1:10/", True),
    ("udp://h:5/p", "/p", "/p", "udp", "h", 5, "udp://p", "udp://h:5/", "/h:5/", True),
    ("/:5", "", "", "tcp", "", 5, "tcp:/", "tcp:/", "", True),
    ("tcp:/", "", "", "tcp", "", -1, "tcp:/", "tcp:/", "", False),
    ("tcp:///a", "//a", "//a", "tcp", "", -1, "tcp:///a", "tcp:/", "", False),
]  # fmt: skip


@pytest.mark.parametrize("recorded", RECORDED, ids=lambda recorded: recorded[0])
def test_contacts_are_parsed_and_printed_as_in_yarp(recorded: tuple[object, ...]) -> None:
    text, *parts = recorded
    c = yarp.Contact.fromString(text)
    assert parts == [
        c.getName(), c.getRegName(), c.getCarrier(), c.getHost(), c.getPort(), c.toString(), c.toURI(), c.toURI(False),
        c.isValid(),
    ]  # fmt: skip


def test_address_without_a_name_has_no_carrier() -> None:
    contact = yarp.Contact("127.0.0.1", 10)
    assert (contact.getCarrier(), contact.toString(), contact.toURI()) == ("", "/127.0.0.1:10", "/127.0.0.1:10/")


def test_an_invalid_host_name_has_no_address() -> None:
    assert yarp.Contact.convertHostToIp("a" * 70) == "a" * 70
    assert yarp.Contact.convertHostToIp("127.0.0.1") == "127.0.0.1"


def test_a_contact_is_read_from_a_property() -> None:
    contact = yarp.Contact.fromConfig(yarp.Property("(name /a) (ip 10.0.0.7) (port_number 5)"))
    assert (contact.getName(), contact.toURI()) == ("/a", "tcp://10.0.0.7:5/")
    assert not yarp.Contact.fromConfig(yarp.Property()).isValid()
