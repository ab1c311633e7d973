"""ROS 1 names are mapped to legal names on the hub."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.adapters.ros1.names import MAX_LENGTH, NameTable, hub_name

LEGAL = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")

CASES = [
    ("/scan", "/scan"),
    ("/camera/rgb/image_raw", "/camera/rgb/image_raw"),
    ("/_hidden/a__b", "/_hidden/a__b"),
    ("/camera/1/image", "/camera/n1/image"),
    ("/3d", "/n3d"),
    ("/a-b/c.d", "/a_b/c_d"),
    ("/a//b", "/a/b"),
    ("/a/", "/a"),
    ("a", "/a"),
    ("/a/~b", "/a/_b"),
    ("/grün", "/gr_n"),
    ("/a b", "/a_b"),
    ("/", "/_"),
    ("/-1", "/_1"),
]


@pytest.mark.parametrize(("side", "hub"), CASES)
def test_names_follow_the_rule(side, hub):
    assert hub_name(side) == hub


def test_long_names_stay_distinct():
    first, second = (hub_name("/" + "a" * 300 + end) for end in "bc")
    assert len(first) == len(second) == MAX_LENGTH
    assert first != second
    assert LEGAL.fullmatch(first)


@given(st.text(max_size=300))
def test_hub_names_are_always_legal_and_stable(name):
    hub = hub_name(name)
    assert LEGAL.fullmatch(hub)
    assert len(hub) <= MAX_LENGTH
    assert hub_name(hub) == hub


def test_hub_names_are_mapped_back():
    table = NameTable()
    table.learn(["/camera/1/image", "/scan", "/b-c", "/b.c"])
    assert table.side_name("/camera/n1/image") == "/camera/1/image"
    assert table.side_name("/scan") == "/scan"
    assert table.side_name("/other") == "/other"
    assert table.side_name("/b_c") == "/b-c", "of two names, the alphabetically first one is used"
    table.learn(["/b_c"])
    assert table.side_name("/b_c") == "/b_c", "a legal name has precedence"
    assert table.side_name("/camera/n1/image") == "/camera/1/image", (
        "the mapping of a name is kept after the name has left"
    )


def test_only_illegal_names_are_kept_when_they_leave():
    table = NameTable()
    table.learn(["/1/here"])
    for number in range(100):
        table.learn([f"/came/and/went_{number}"])
    kept = [name for part in vars(table).values() for name in part if name.startswith("/came")]
    assert kept == ["/came/and/went_99"]
    assert table.side_name("/n1/here") == "/1/here"


def test_too_many_illegal_names_are_dropped(monkeypatch):
    monkeypatch.setattr("bridge.adapters.ros1.names.MAX_NAMES", 10)
    table = NameTable()
    for number in range(100):
        table.learn([f"/{number}"])
        assert table.side_name(f"/n{number}") == f"/{number}"
    assert sum(table.side_name(f"/n{number}") != f"/n{number}" for number in range(100)) <= 10
