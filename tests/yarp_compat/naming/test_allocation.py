"""The name server's allocation of numbers, names and groups."""

from __future__ import annotations

import json

from yarp_compat.naming.allocation import Allocator


def test_a_name_keeps_its_number() -> None:
    """Numbers ascend from two above the name server's; a freed number is reserved for the name that had it."""
    allocator = Allocator(10000)
    assert [allocator.number(name) for name in ("/a", "/b")] == [10002, 10003]
    allocator.free("/a", "127.0.0.1", 10002)
    assert allocator.number("/c") == 10004
    assert allocator.number("/a") == 10002


def test_numbers_chosen_by_ports_are_skipped() -> None:
    """A number that a port registered explicitly is not allocated."""
    allocator = Allocator(10000)
    assert allocator.number("/a", taken={10002, 10003}) == 10004


def test_a_port_cannot_free_the_number_of_another() -> None:
    """This is the case of a port that chose another port's number and unregisters."""
    allocator = Allocator(10000)
    allocator.number("/a")
    allocator.free("/b", "127.0.0.1", 10002)
    assert allocator.state()["used"] == [10002]


def test_freed_numbers_are_reused_only_after_the_last_one() -> None:
    """9,998 numbers are allocated in order, then the freed ones, then none."""
    allocator = Allocator(10000)
    numbers = [allocator.number(f"/p{i}") for i in range(9998)]
    assert (numbers[0], numbers[-1]) == (10002, 19999)
    assert allocator.number("/late") is None
    allocator.free("/p7", "127.0.0.1", 10009)
    assert allocator.number("/late") == 10009
    assert allocator.number("/p7") is None
    allocator.free("/late", "127.0.0.1", 10009)
    assert allocator.number("/p7") == 10009


def test_high_name_servers_have_fewer_numbers() -> None:
    """No number exceeds 65535."""
    allocator = Allocator(65530)
    assert [allocator.number(f"/p{i}") for i in range(5)] == [65532, 65533, 65534, 65535, None]


def test_anonymous_names_and_groups_are_reused() -> None:
    """The names are those of yarpserver."""
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


def test_the_state_survives_a_file() -> None:
    """A restored allocator continues like the original."""
    allocator = Allocator(10000)
    for name in ("/a", "/b"):
        allocator.number(name)
    allocator.name()
    allocator.group()
    allocator.free("/a", "h", 10002)
    state = json.loads(json.dumps(allocator.state()))
    restored = Allocator(10000)
    restored.restore(state)
    assert restored.state() == allocator.state()
    assert [restored.number("/c"), restored.number("/a"), restored.name(), restored.group()] == [
        10004,
        10002,
        "/tmp/port/2",
        "224.1.1.4",
    ]
    elsewhere = Allocator(20000)
    elsewhere.restore(state)
    assert elsewhere.number("/a") == 20002
