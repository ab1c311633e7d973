"""Bottle and Value with YARP's methods."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from yarp_compat.os.data.bottle import Bottle, Property, Value
from yarp_compat.os.data.vocab import Vocab32, Vocab64, createVocab32
from yarp_compat.os.ports.connection import ConnectionWriter
from yarp_compat.wire.elements import ElementReader
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.values import Float32, Int8, Int64, Vocab


def test_a_bottle_filled_as_in_scripts_has_values_of_each_type() -> None:
    bottle = Bottle()
    bottle.addString("count")
    bottle.addInt8(-1)
    bottle.addInt16(300)
    bottle.addInt32(5)
    bottle.addInt64(7)
    bottle.addFloat32(1.5)
    bottle.addFloat64(2)
    bottle.addVocab32("set")
    bottle.addVocab32("s", "e", "t")
    bottle.addVocab32(createVocab32("s", "e", "t"))
    inner = bottle.addList()
    inner.addString("a b")
    bottle.addDict().put("x", 1)
    bottle.add(Value.makeBlob(b"\x01\x02"))
    bottle.add(Value(True))
    assert bottle.toString() == 'count -1 300 5 7 1.5 2.0 [set] [set] [set] ("a b") ((x 1)) {1 2} 1'
    assert bottle.toString_c() == str(bottle) == bottle.toString()
    assert bottle.size() == len(bottle) == 14
    kinds = ["isString", "isInt8", "isInt16", "isInt32", "isInt64", "isFloat32", "isFloat64", "isVocab32"]
    assert all(getattr(bottle.get(at), kind)() for at, kind in enumerate(kinds))
    assert sum(getattr(bottle.get(3), kind)() for kind in kinds) == 1
    assert (bottle.get(10).isList(), bottle.get(11).isDict(), bottle.get(12).isBlob()) == (True, True, True)
    for profile in Profile:
        assert Bottle.from_bytes(bottle.to_bytes(profile)) == bottle


def test_methods_of_yarp_2_still_work() -> None:
    bottle = Bottle()
    bottle.addInt(1)
    bottle.addDouble(1.5)
    bottle.addVocab("set")
    assert (bottle.get(0).asInt(), bottle.get(1).asDouble()) == (1, 1.5)
    assert bottle.get(0).isInt()
    assert bottle.get(1).isDouble()
    assert bottle.get(2).asVocab() == Vocab32.encode("set")


@pytest.mark.parametrize(
    ("method", "wrong", "error"),
    [
        ("addInt32", 2**31, OverflowError), ("addInt8", 200, OverflowError), ("addInt32", 1.5, TypeError),
        ("addFloat64", "x", ValueError), ("addString", 5, TypeError), ("add", object(), WireError),
    ],
)  # fmt: skip
def test_invalid_values_cannot_be_added(method: str, wrong: Any, error: type[Exception]) -> None:
    bottle = Bottle("kept")
    with pytest.raises(error):
        getattr(bottle, method)(wrong)
    assert bottle.toString() == "kept"


def test_lists_and_dicts_are_changed_in_place() -> None:
    bottle = Bottle("(1 2) x")
    inner = bottle.get(0).asList()
    assert inner is not None
    inner.addInt32(3)
    bottle.addDict().addGroup("G").put("a", 1)
    entries = bottle.get(2).asDict()
    assert entries is not None
    entries.put("b", 2)
    assert bottle.toString() == "(1 2 3) x ((G (a 1)) (b 2))"
    copied = Bottle(bottle)
    inner.clear()
    entries.clear()
    assert copied.toString() == "(1 2 3) x ((G (a 1)) (b 2))"
    assert bottle.toString() == "() x ()"


def test_values_are_found_by_key() -> None:
    bottle = Bottle('(k v) (k2 5 6) z 7 1 "one" last ([set] 8)')
    assert bottle.find("k").asString() == "v"
    assert bottle.find("k2").asInt32() == 5
    assert bottle.find("z").asInt32() == 7
    assert bottle.find("1").asString() == "one"
    assert bottle.find("set").asInt32() == 8
    assert bottle.findGroup("k2").toString() == "k2 5 6"
    assert [bottle.check(key) for key in ("k", "k2", "z", "last", "no", "v")] == [True, True, True, True, False, False]
    assert "z" in bottle
    assert bottle.check("no", Value(3)).asInt32() == 3
    assert bottle.check("z", Value(3), "a comment").asInt32() == 7
    assert bottle.check("z", "a comment") is True
    assert bottle.find("no").isNull()
    assert bottle.findGroup("z").isNull()
    assert Bottle("(x (y 5))").findGroup("x").find("y").asInt32() == 5
    assert Bottle("(x (y 5))").get(0).find("y").asInt32() == 5
    assert Bottle("x").check("x") is False


def test_copy_append_tail_and_pop_work_as_in_yarp() -> None:
    bottle = Bottle("a b c d")
    part = Bottle()
    part.copy(bottle, 1, 2)
    assert part.toString() == "b c"
    part.append(bottle)
    assert part.toString() == "b c a b c d"
    part.append(part)
    assert part.size() == 12
    bottle.copy(bottle, 2)
    assert bottle.toString() == "c d"
    assert bottle.tail().toString() == "d"
    assert (bottle.pop().asString(), bottle.pop().asString(), bottle.pop().isNull()) == ("d", "c", True)
    assert bottle.tail().size() == 0
    bottle.fromString("1 2")
    bottle.clear()
    assert (bottle.size(), bottle.isNull()) == (0, False)


def test_null_bottle_cannot_be_changed() -> None:
    null = Bottle("x").findGroup("no")
    assert null.isNull()
    assert not null
    assert Bottle.getNullBottle().isNull()
    with pytest.raises(RuntimeError, match="missing list"):
        null.addInt32(1)
    taken = Bottle("x")
    taken.copy(null)
    assert taken.isNull()
    taken.addInt32(1)
    assert not taken.isNull()
    taken.setReadOnly(True)
    with pytest.raises(RuntimeError):
        taken.clear()


def test_values_beyond_the_end_are_null() -> None:
    for value in (Bottle("x").get(1), Bottle("x").get(-1), Value.getNullValue(), Value.makeValue("")):
        assert value.isNull()
        assert not value
        assert (value.asInt32(), value.asFloat64(), value.asString(), value.toString()) == (0, 0.0, "", "")
        assert value.asList() is value.asDict() is value.asBlob() is None
        assert value.find("x").isNull()
        assert value.findGroup("x").isNull()
        assert value.getCode() == -1


def test_a_bottle_is_a_list_in_python() -> None:
    bottle = Bottle(
        ["x", 1, 2.5, [1, (2, 3)], {"k": 1}, True, np.arange(2.0), np.float32(1.5), Bottle("a"), Value("v")]
    )
    assert bottle.toString() == "x 1 2.5 (1 (2 3)) ((k 1)) true (0.0 1.0) 1.5 (a) v"
    assert bottle[1:3] == [1, 2.5]
    assert [type(value) for value in bottle][:3] == [str, int, float]
    bottle[0] = Vocab("set")
    del bottle[1:]
    assert bottle == [Vocab("set")]
    assert repr(bottle) == "Bottle('[set]')"
    assert bottle == Bottle("[set]")
    assert Bottle("1").isEqual(Bottle([Int64(1)]))
    assert Bottle("1").notEqual(Bottle("2"))
    assert Bottle(), "an empty Bottle is true, because scripts test received Bottles that way"


def test_a_bottle_is_read_from_and_written_to_bytes_and_connections() -> None:
    bottle = Bottle("a 1.5 (2 [set])")
    for profile in Profile:
        again = Bottle()
        again.fromBinary(bottle.toBinary(profile) + b"more", len(bottle.toBinary(profile)))
        assert again == bottle
        writer = ConnectionWriter(profile)
        assert bottle.write(writer)
        assert Bottle("5").write(writer)
        source = ElementReader(writer.writer.payload(), profile)
        first, second, third = Bottle(), Bottle(), Bottle("stays")
        assert first.read(source)
        assert second.read(source)
        assert (first, second) == (bottle, Bottle("5"))
        assert not third.read(source)
        assert third.toString() == "stays"
    with pytest.raises(WireError):
        again.from_wire(b"nothing")
    assert again == bottle
    again.from_text("x 1")
    assert again.to_text() == "x 1"


def test_a_bottle_reports_the_common_type_of_its_values() -> None:
    assert Bottle("1 2").getSpecialization() == 1
    assert Bottle("1 a").getSpecialization() == 0
    assert [Bottle.describeBottleCode(code) for code in (1, 256, 256 + 10, 512, 99)] == [
        "int", "list of mixed", "list of float", "dict of mixed", "unknown",
    ]  # fmt: skip


CONVERSIONS: list[tuple[Value, dict[str, Any]]] = [
    (Value(300), {"asInt8": 44, "asInt16": 300, "asFloat64": 300.0, "asBool": True, "asString": "", "asVocab32": 300}),
    (Value(-1.9), {"asInt8": -1, "asInt32": -1, "asInt64": -1, "asBool": False, "asVocab32": 0, "asString": ""}),
    (Value(3e9), {"asInt32": -(2**31), "asInt64": 3000000000}),
    (Value(math.nan), {"asInt32": -(2**31), "asInt64": -(2**63)}),
    (Value(math.inf), {"asInt64": -(2**63), "asFloat32": math.inf}),
    (Value(1e300), {"asFloat32": math.inf}),
    (Value(-1e300), {"asFloat32": -math.inf}),
    (Value(0.1), {"asFloat32": 0.10000000149011612, "asFloat64": 0.1}),
    (Value("set"), {"asString": "set", "asInt32": 0, "asVocab32": 7628147, "asBool": False, "toString": "set"}),
    (Value("set", True), {"asString": "set", "asInt32": 7628147, "asFloat64": 7628147.0, "asBool": True}),
    (Value(7628147, True), {"asString": "set", "isVocab32": True, "isBool": False, "isString": False}),
    (Value.makeValue("true"), {"asBool": True, "asInt32": 49, "isBool": True, "isVocab32": True, "asString": "true"}),
    (Value.makeValue("false"), {"asBool": False, "asInt32": 0, "isBool": True, "asVocab32": 0}),
    (Value.makeValue("a b"), {"asString": "a b", "isString": True}),
    (Value.makeInt64(5), {"isInt64": True, "isInt32": False, "asInt32": 5, "getCode": 17}),
    (Value(2**40), {"isInt64": True, "asInt32": 0}),
    (Value(), {"isList": True, "isNull": False, "toString": "", "getCode": 256}),
    (Value.makeList("1 (2 a)"), {"isList": True, "toString": "1 (2 a)", "getCode": 256, "asString": ""}),
    (Value.makeBlob(b"abc", 2), {"asBlob": b"ab", "asBlobLength": 2, "toString": "97 98", "getCode": 12}),
    (Value(Vocab("setmap")), {"isVocab64": True, "isVocab32": False, "asString": "setmap", "asVocab32": 1836344691}),
    (Value(Int8(5)), {"isInt8": True, "asBool": True}),
    (Value(True), {"isInt32": True, "asInt32": 1, "isBool": False}),
    (Value.makeFloat32(1.5), {"isFloat32": True, "isFloat64": False, "getCode": 128}),
]
"""The conversions of the values in YARP's Value (`yarp/os/impl/Storable.h`)."""


@pytest.mark.parametrize(("value", "results"), CONVERSIONS, ids=[repr(value) for value, _ in CONVERSIONS])
def test_values_are_converted_as_in_yarp(value: Value, results: dict[str, Any]) -> None:
    assert {name: getattr(value, name)() for name in results} == results


def test_value_is_also_a_message() -> None:
    for profile in Profile:
        for value in (Value(5), Value("x"), Value(Float32(1.5)), Value.makeList("1 2")):
            assert Value.from_bytes(value.to_bytes(profile), profile) == value
    with pytest.raises(WireError, match="expected one value"):
        Value.from_bytes(Bottle("1 2").to_bytes())
    value = Value(1)
    value.fromString("2.5")
    assert value == 2.5
    assert value == Value(2.5)
    assert value != Value(2)
    assert (int(value), float(value), repr(value)) == (2, 2.5, "Value(2.5)")
    listed = Value(Bottle("a"))
    twin = listed.clone()
    inner = twin.asList()
    assert inner is not None
    inner.addInt32(1)
    assert (listed.toString(), twin.toString()) == ("a", "a 1")
    assert Value(Property("(a 1)")).asSearchable().find("a").asInt32() == 1  # type: ignore[union-attr]


def test_vocabs_are_numbers() -> None:
    assert Vocab32.encode("set") == createVocab32("s", "e", "t") == 7628147
    assert Vocab32.decode(7628147) == "set"
    assert Vocab32.encode("setmap") == Vocab32.encode("setm")
    assert Vocab64.decode(Vocab64.encode("setmap")) == "setmap"
    assert Vocab32.decode(0) == ""
    assert Vocab32.decode(Vocab32.encode("\udce9")) == "\udce9"
