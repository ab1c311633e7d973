"""The parameter tree: names, subtrees, limits, and updates of subscribers."""

from __future__ import annotations

import xmlrpc.client
from typing import Any

import pytest

from bridge.adapters.ros1.master import parameters
from bridge.adapters.ros1.master.names import canonical, join, resolve
from bridge.adapters.ros1.master.parameters import MAX_DEPTH, ParameterTree


@pytest.mark.parametrize(
    ("name", "node", "resolved"),
    [
        ("scan", "/robot/node", "/robot/scan"),
        ("/scan", "/robot/node", "/scan"),
        ("~rate", "/robot/node", "/robot/node/rate"),
        ("~/rate", "/robot/node", "/robot/node/rate"),
        ("~", "/robot/node", "/robot/node"),
        ("a//b/", "/node", "/a/b"),
        ("//", "/node", "/"),
        ("scan", "node", "/scan"),
        ("scan", "", "/scan"),
    ],
)
def test_names_resolve_relative_to_the_node(name: str, node: str, resolved: str):
    assert resolve(name, node) == resolved


def test_names_are_joined_and_made_canonical():
    assert [join("/a", "b"), join("/a/", "b"), join("/a", "/b"), join("/a", "~b"), join("~", "b"), join("", "b")] == [
        "/a/b", "/a/b", "/b", "~b", "~b", "b",
    ]  # fmt: skip
    assert [canonical(n) for n in ("", "/", "/a//b/", "a//b/")] == ["", "/", "/a/b", "a/b"]


def test_values_are_set_read_and_deleted_with_their_subtrees():
    tree = ParameterTree()
    tree.set("/a/b/c", 1)
    tree.set("/a/d", [1, {"x": 2}])
    before = tree.get("/a")
    assert before == {"b": {"c": 1}, "d": [1, {"x": 2}]}
    tree.set("/a/b", "value")  # replaces the namespace
    tree.set("/a/d/e", 2.5)  # turns the value into a namespace
    assert tree.get("/a") == {"b": "value", "d": {"e": 2.5}}
    assert before == {"b": {"c": 1}, "d": [1, {"x": 2}]}
    assert tree.names() == ["/a/b", "/a/d/e"]
    assert [tree.has(key) for key in ("/", "/a", "/a/b", "/a/b/c", "/x")] == [True, True, True, False, False]
    tree.delete("/a/d")
    assert tree.get("/") == {"a": {"b": "value"}}
    for key in ("/", "/a/d", "/a/b/c", "/x/y"):
        with pytest.raises(KeyError):
            tree.delete(key)


def test_the_root_is_replaced_by_a_structure_only():
    tree = ParameterTree({"a": 1})
    with pytest.raises(TypeError):
        tree.set("/", 5)
    tree.set("/", {"b": 2})
    assert tree.names() == ["/b"]


@pytest.mark.parametrize(
    ("node", "key", "name"),
    [
        ("/ns/node", "x", "/ns/x"),
        ("/ns/node", "x/deep", "/ns/x/deep"),
        ("/ns/node", "y", "/ns/node/y"),
        ("/ns/node", "z", "/z"),
        ("/ns/node", "none", ""),
        ("/ns/node", "/z", "/z"),
        ("/ns/node", "/none", ""),
        ("/", "z", "/z"),
    ],
)
def test_a_search_goes_up_the_namespaces(node: str, key: str, name: str):
    tree = ParameterTree({"z": 0, "x": 0, "ns": {"x": {"a": 1}, "node": {"y": 2}}})
    assert tree.search(node, key) == name


@pytest.mark.parametrize(("node", "key"), [("/n", "~x"), ("n", "x")])
def test_invalid_searches_are_errors(node: str, key: str):
    with pytest.raises(ValueError, match=r"invalid key|must be global"):
        ParameterTree().search(node, key)


@pytest.mark.parametrize("value", [None, [None], {"a": {"b": None}}, 2**31, [-(2**31) - 1], object()])
def test_values_that_xmlrpc_cannot_return_are_refused(value: object):
    tree = ParameterTree()
    with pytest.raises(TypeError):
        tree.set("/a", value)
    assert tree.names() == []


def test_depth_is_limited():
    tree = ParameterTree()
    tree.set("/a" * MAX_DEPTH, 1)
    with pytest.raises(ValueError, match="deeper"):
        tree.set("/a" * (MAX_DEPTH + 1), 1)
    value: Any = 1
    for _ in range(MAX_DEPTH):
        value = [value]
    with pytest.raises(ValueError, match="deeper"):
        tree.set("/a", value)


def test_size_is_limited_and_freed_by_replacement_and_deletion(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(parameters, "MAX_BYTES", 10_000)
    tree = ParameterTree()
    for _ in range(5):
        tree.set("/a/text", "x" * 6000)
        with pytest.raises(ValueError, match="larger"):
            tree.set("/b", xmlrpc.client.Binary(b"x" * 6000))
        with pytest.raises(ValueError, match="larger"):
            tree.set("/", {"b": "x" * 20_000})
        tree.set("/a", 1)
        tree.set("/b", "x" * 6000)
        tree.delete("/b")
    assert tree.get("/") == {"a": 1}


@pytest.mark.parametrize(
    ("key", "value", "subscribed", "updates"),
    [
        ("/a", 1, ["/a/"], [("/a/", "/a/", 1)]),
        ("/a", 1, ["/"], [("/", "/a/", 1)]),
        ("/a", 1, ["/b/", "/ab/"], []),
        ("/a/b", 1, ["/a/"], [("/a/", "/a/b/", 1)]),
        ("/a", {"b": {"c": 1}}, ["/a/b/", "/a/b/c/"], [("/a/b/", "/a/b/", {"c": 1}), ("/a/b/c/", "/a/b/c/", 1)]),
        ("/a", {"b": 1}, ["/a/x/"], [("/a/x/", "/a/x/", {})]),
        ("/a", {}, ["/a/", "/a/x/"], [("/a/", "/a/", {}), ("/a/x/", "/a/x/", {})]),
    ],
)
def test_a_changed_parameter_updates_only_the_subscribers_of_its_path(
    key: str, value: Any, subscribed: list[str], updates: list[tuple[str, str, Any]]
):
    assert [u[:3] for u in ParameterTree().updates(key, value, subscribed)] == updates
