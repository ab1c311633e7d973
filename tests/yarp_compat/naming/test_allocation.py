"""What the name server gives out."""

from __future__ import annotations

import json

from yarp_compat.naming.allocation import Allocator


def test_numbers_begin_two_above_and_stick() -> None:
    """Two above the name server's, one after another; a name gets the one that it had, others do not get that."""
    allocator = Allocator(10000)
    assert [allocator.number(name) for name in ("/a", "/b")] == [10002, 10003]
    allocator.free("/a", "127.0.0.1", 10002)
    assert allocator.number("/c") == 10004
    assert allocator.number("/a") == 10002


def test_numbers_that_ports_chose_are_left_out() -> None:
    """A number that a port registered for itself is given to nobody."""
    allocator = Allocator(10000)
    assert allocator.number("/a", taken={10002, 10003}) == 10004


def test_nobody_gives_back_what_is_not_his() -> None:
    """A port that chose a number which another one has, and ends."""
    allocator = Allocator(10000)
    allocator.number("/a")
    allocator.free("/b", "127.0.0.1", 10002)
    assert allocator.state()["used"] == [10002]


def test_freed_numbers_are_given_again_only_when_all_are_gone() -> None:
    """9,998 numbers, then the freed ones; then none."""
    allocator = Allocator(10000)
    numbers = [allocator.number(f"/p{i}") for i in range(9998)]
    assert numbers[0], numbers[-1] == (10002, 19999)
    assert allocator.number("/late") is None
    allocator.free("/p7", "127.0.0.1", 10009)
    assert allocator.number("/late") == 10009
    assert allocator.number("/p7") is None
    allocator.free("/late", "127.0.0.1", 10009)
    assert allocator.number("/p7") == 10009


def test_high_name_servers_have_fewer_numbers() -> None:
    """No number is above what TCP has."""
    allocator = Allocator(65530)
    assert [allocator.number(f"/p{i}") for i in range(5)] == [65532, 65533, 65534, 65535, None]


def test_anonymous_names_and_groups() -> None:
    """As yarpserver names them; what is given back is given again."""
    allocator = Allocator(10000)
    assert [allocator.name(), allocator.name(), allocator.group(), allocator.group()] == [
        "/tmp/port/1",
        "/tmp/port/2",
        "224.1.1.3",
        "224.1.1.4",
    ]
    allocator.free("/tmp/port/1", "127.0.0.1", 10002)
    allocator.free("/m", "224.1.1.3", 10003)
    assert (allocator.name(), allocator.group()) == ("/tmp/port/1", "224.1.1.3")
    many = [allocator.group() for _ in range(300)]
    assert len(set(many)) == 300
    assert many[-1] is not None
    assert many[-1].startswith("224.1.2.")


def test_memory() -> None:
    """All of it survives a file."""
    allocator = Allocator(10000)
    for name in ("/a", "/b"):
        allocator.number(name)
    allocator.name()
    allocator.group()
    allocator.free("/a", "h", 10002)
    state = json.loads(json.dumps(allocator.state()))
    again = Allocator(10000)
    again.restore(state)
    assert again.state() == allocator.state()
    assert [again.number("/c"), again.number("/a"), again.name(), again.group()] == [
        10004,
        10002,
        "/tmp/port/2",
        "224.1.1.4",
    ]
    elsewhere = Allocator(20000)
    elsewhere.restore(state)
    assert elsewhere.number("/a") == 20002
