"""Interfaces through a channel: every generation, whichever the client expects; typed and invalid requests."""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum
from types import SimpleNamespace
from typing import Annotated, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from yarp_compat.dev.fields import FLOAT32, INT8, INT16, INT64, UINT8, Choice, Structure, VocabEnum, field_of
from yarp_compat.dev.localization2d import LocalizationStatusEnum
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnCode, ReturnValue
from yarp_compat.dev.server import Server
from yarp_compat.dev.service import INTRODUCTION, Service, rpc
from yarp_compat.wire import binary
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.generation import MOST_PEERS, Generation, Generations
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.values import Vocab

FAIL = bytes.fromhex("09010000010000006661696c")


class Status(IntEnum):
    """The counterpart of `IRangefinder2D::Device_status`."""

    STANDBY = 0
    IN_USE = 1


class Places(Service):
    PROTOCOL = 3

    @rpc
    def store_location_RPC(self, name: str, loc: Map2DLocation) -> ReturnValue: ...
    @rpc
    def get_location_RPC(self, name: str) -> tuple[ReturnValue, Map2DLocation]: ...
    @rpc
    def get_names_RPC(self) -> tuple[ReturnValue, list[str]]: ...
    @rpc
    def enable_RPC(self, on: bool) -> tuple[ReturnValue, bool]: ...
    @rpc
    def get_status_RPC(self) -> tuple[ReturnValue, LocalizationStatusEnum]: ...
    @rpc
    def getDeviceStatus_RPC(self) -> tuple[ReturnValue, Annotated[Status, Choice(Status, vocab=True)]]: ...
    @rpc
    def count(self, a: int, b: float) -> int: ...
    @rpc
    def find(self, name: str) -> Map2DLocation: ...
    @rpc
    def names(self) -> list[str]: ...
    @rpc
    def reset(self) -> None: ...
    @rpc
    def clear_RPC(self) -> ReturnValue: ...


class PlacesServer(Places):
    def __init__(self) -> None:
        super().__init__()
        self.at: dict[str, Map2DLocation] = {}
        self.on = False

    def store_location_RPC(self, name: str, loc: Map2DLocation) -> ReturnValue:
        self.at[name] = loc
        return OK

    def get_location_RPC(self, name: str) -> tuple[ReturnValue, Map2DLocation]:
        if name not in self.at:
            raise CallFailed(reason=f"no {name}")
        return OK, self.at[name]

    def get_names_RPC(self) -> Any:
        return (OK, sorted(self.at)) if self.at else ReturnValue(ReturnCode.NOT_READY)

    def enable_RPC(self, on: bool) -> tuple[ReturnValue, bool]:
        self.on = on
        return OK, not on

    def get_status_RPC(self) -> tuple[ReturnValue, LocalizationStatusEnum]:
        return OK, LocalizationStatusEnum.localization_status_localized_ok

    def getDeviceStatus_RPC(self) -> tuple[ReturnValue, Status]:
        return OK, Status.IN_USE

    def count(self, a: int, b: float) -> int:
        return int(a + b)

    def find(self, name: str) -> Map2DLocation:
        return self.at[name]

    def names(self) -> list[str]:
        return sorted(self.at)

    def reset(self) -> None:
        self.at.clear()

    def clear_RPC(self) -> ReturnValue:
        self.at.clear()
        return OK


@dataclass
class Wire:
    """A channel to a server in this process. ``parse`` has to find the end of a reply that other bytes follow."""

    server: Server
    generation: Generation
    peer: str = "/client/rpc"
    sent: list[bytes] = field(default_factory=list)
    received: list[bytes] = field(default_factory=list)

    def request(self, payload: bytes, parse: Callable[[bytes], int]) -> bytes:
        reply = self.server.answer(payload, self.peer)
        assert parse(reply + b"YA\0\0\0\0RP") == len(reply)
        self.sent.append(payload)
        self.received.append(reply)
        return reply


KITCHEN = Map2DLocation("m1", 1.5, -2.0, 90.0, "by the door")


@pytest.mark.parametrize("expected", Generation)
@pytest.mark.parametrize("generation", Generation)
def test_clients_with_any_expectation_read_replies_of_any_generation(
    generation: Generation, expected: Generation
) -> None:
    server = Server(PlacesServer(), Generations(generation))
    wire = Wire(server, expected)
    places = Places(wire)
    if Generation.YARP_3_11 in (generation, expected):
        wire.generation = generation  # untagged numbers of 3.11 look like tags of 3.12
    assert places.get_location_RPC("kitchen")[0].code is ReturnCode.METHOD_FAILED
    if generation is not Generation.YARP_4 or expected is Generation.YARP_4:
        assert wire.generation in (generation, expected)
    assert places.store_location_RPC("kitchen", KITCHEN)
    assert places.get_location_RPC("kitchen") == (OK, KITCHEN)
    assert places.get_names_RPC() == (OK, ["kitchen"])
    assert places.enable_RPC(True) == (OK, False)
    assert places.get_status_RPC() == (OK, LocalizationStatusEnum.localization_status_localized_ok)
    assert places.getDeviceStatus_RPC() == (OK, Status.IN_USE)
    assert places.count(2, 3.0) == 5
    assert places.find("kitchen") == KITCHEN
    assert places.names() == ["kitchen"]
    assert places.reset() is None
    assert places.names() == []


@pytest.mark.parametrize("generation", Generation)
def test_a_client_that_introduces_itself_counts_as_4_0(generation: Generation) -> None:
    server = Server(PlacesServer(), Generations(generation))
    wire = Wire(server, generation)
    assert Places(wire).introduce() == (3, 4, 0, 0)
    assert wire.generation is Generation.YARP_4
    assert wire.received[0].hex() == "00010000010000000300040000000000"
    assert wire.sent[0].hex() == "00010000010000000400000018000000" + b"getRemoteProtocolVersion".hex()
    Places(wire).count(1, 1.0)
    Places(wire).get_names_RPC()
    assert wire.received[-1].hex().startswith("00010000 02000000 00010000 01000000 09000000 65727236".replace(" ", ""))
    assert b"\x14\0\0\0" in wire.sent[1]
    (decision,) = server.generations.explain()
    assert (decision.peer, decision.generation) == ("/client/rpc", Generation.YARP_4)
    assert "asked for the protocol" in decision.reason


def test_an_old_server_rejects_introductions() -> None:
    class Old:
        generation = Generation.YARP_3_12

        def request(self, _payload: bytes, parse: Callable[[bytes], int]) -> bytes:
            assert parse(FAIL + b"YA") == len(FAIL)
            return FAIL

    old = Old()
    assert Places(old).introduce() is None
    assert old.generation is Generation.YARP_3_12


def test_a_server_of_3_12_is_recognized_by_its_version() -> None:
    """The generated services of YARP 3.12 reply to ``getRemoteProtocolVersion`` with their release of YARP."""

    class Older:
        generation = Generation.YARP_4

        def request(self, _payload: bytes, parse: Callable[[bytes], int]) -> bytes:
            reply = bytes.fromhex("00010000 01000000 0000 0300 0c00 0300")
            assert parse(reply + b"YA") == len(reply)
            return reply

    older = Older()
    assert Places(older).introduce() == (0, 3, 12, 3)
    assert older.generation is Generation.YARP_3_12


REPLIES = {
    Generation.YARP_3_6: "00010000 02000000 09000000 6f6b0000 09000000 6c6f6379",
    Generation.YARP_3_11: "00010000 02000000 00000000 00000000 09000000 6c6f6379",
    Generation.YARP_3_12: "00010000 02000000 01000000 00000000 09000000 6c6f6379",
    Generation.YARP_4: "00010000 02000000 00010000 01000000 09000000 6f6b0000 09000000 6c6f6379",
}
SINGLE = {
    Generation.YARP_3_6: "00010000 01000000 09000000 6f6b0000",
    Generation.YARP_3_11: "00000000 00000000",
    Generation.YARP_3_12: "01000000 00000000",
    Generation.YARP_4: "00010000 01000000 09000000 6f6b0000",
}


@pytest.mark.parametrize("generation", Generation)
def test_replies_have_the_bytes_of_each_generation(generation: Generation) -> None:
    server = Server(PlacesServer(), Generations(generation))
    status = Places.calls()["get_status_RPC"].request([], generation.profile)
    store = Places.calls()["store_location_RPC"].request(["a", KITCHEN], generation.profile)
    assert server.answer(status) == bytes.fromhex(REPLIES[generation])
    assert server.answer(store) == bytes.fromhex(SINGLE[generation])


@pytest.mark.parametrize(
    "typed",
    [
        ["enable_RPC", True],
        ["enable", Vocab("RPC"), Vocab("ok")],
        ["enable", Vocab("RPC"), 1],
        ["enable", "RPC", Vocab("yes"), "and", "more"],
        ["__direct__", "enable_RPC", 1],
    ],
)
def test_typed_names_and_arguments_are_accepted(typed: list[Any]) -> None:
    kept = PlacesServer()
    server = Server(kept)
    assert server.answer(binary.encode(typed, Profile.YARP3)) != FAIL
    assert kept.on


def test_a_request_of_only_a_name_is_a_list_of_one_type() -> None:
    assert Server(PlacesServer()).answer(binary.encode(["names"], Profile.YARP3)) == bytes.fromhex(
        "0001000001000000 0401000000000000"
    )


@pytest.mark.parametrize(
    "request_",
    [[], ["nonsense"], ["get", Vocab("loca")], ["enable_RPC"], ["enable_RPC", "x"], ["count", "1", 2], [1], [["names"]],
     ["find", "nowhere"], ["store_location_RPC", "a", ["m", 1, 2]]],
)  # fmt: skip
def test_unknown_requests_get_fail(request_: list[Any], caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        assert Server(PlacesServer()).answer(binary.encode(request_, Profile.YARP3), "/peer") == FAIL
    assert "/peer" in caplog.text


def test_invalid_bytes_get_fail() -> None:
    server = Server(PlacesServer())
    for data in (b"", b"\0" * 8, b"\xff" * 40, bytes.fromhex("00010000ffffff7f")):
        assert server.answer(data) == FAIL


def test_help_lists_and_describes_methods() -> None:
    server = Server(PlacesServer())
    many, lines = binary.decode(server.answer(binary.encode([Vocab("help")], Profile.YARP3)))
    assert (many, lines[0], lines[1], lines[-1]) == ("many", "*** Available commands:", "store_location_RPC", "help")
    _, lines = binary.decode(server.answer(binary.encode(["help", "count"], Profile.YARP3)))
    assert lines == ["i32 count(i32 a, double b)"]
    assert binary.decode(server.answer(binary.encode(["help", "x"], Profile.YARP3)))[1] == ["Command not found"]
    assert "functionName" in binary.decode(server.answer(binary.encode(["help", "help"], Profile.YARP3)))[1][0]


def test_an_exception_of_an_implementation_becomes_an_outcome(caplog: pytest.LogCaptureFixture) -> None:
    class Broken(PlacesServer):
        def get_location_RPC(self, name: str) -> Any:
            if name == "odd":
                return OK, "not a location"
            if name == "many":
                return OK, KITCHEN, 1
            raise RuntimeError("broken inside")

        get_status_RPC = Places.get_status_RPC

    server = Server(Broken(), Generations(Generation.YARP_4))
    places = Places(Wire(server, Generation.YARP_4))
    for name in ("any", "odd", "many"):
        assert places.get_location_RPC(name) == (ReturnValue(ReturnCode.GENERIC), Map2DLocation())
    assert "broken inside" in caplog.text
    assert places.get_status_RPC() == (
        ReturnValue(ReturnCode.NOT_IMPLEMENTED),
        LocalizationStatusEnum.localization_status_not_yet_localized,
    )
    with pytest.raises(WireError):
        places.find("kitchen")
    with pytest.raises(WireError, match="takes 1 arguments"):
        places.find()  # type: ignore[call-arg]
    with pytest.raises(WireError, match="name"):
        places.find(5)  # type: ignore[arg-type]
    with pytest.raises(NotImplementedError, match="neither has a channel"):
        Places().find("a")


def test_the_dialect_of_a_request_shows_the_generation() -> None:
    server = Server(PlacesServer())
    store = Places.calls()["store_location_RPC"]
    assert server.answer(store.request(["a", KITCHEN], Profile.YARP4), "/new") == bytes.fromhex(
        SINGLE[Generation.YARP_4]
    )
    assert server.answer(store.request(["a", KITCHEN], Profile.YARP3), "/old") == bytes.fromhex(
        SINGLE[Generation.YARP_3_12]
    )
    assert [(known.peer, known.generation) for known in server.generations.explain()] == [("/new", Generation.YARP_4)]
    server = Server(PlacesServer(), Generations(Generation.YARP_4))
    assert server.answer(store.request(["a", KITCHEN], Profile.YARP3), "/old") == bytes.fromhex(
        SINGLE[Generation.YARP_3_12]
    )
    assert "YARP 3" in server.generations.of("/old").reason
    server.generations.introduced("/new")
    server.generations.recognized("/new", Profile.YARP3)
    assert server.generations.of("/new").generation is Generation.YARP_3_12


@pytest.mark.parametrize("generation", Generation)
@pytest.mark.parametrize("profile", Profile)
def test_no_number_is_misread_with_any_expectation(generation: Generation, profile: Profile) -> None:
    """YARP 3's tag for doubles is YARP 4's tag for floats, which are half as long."""
    server = Server(PlacesServer(), Generations(generation))
    for number in (0.0, 2.0, 1e9):
        reply = server.answer(Places.calls()["count"].request([1, number], profile))
        assert binary.decode(reply) == [1 + number]


def test_a_text_carrier_gets_a_bottle_in_every_generation() -> None:
    for generation in Generation:
        server = Server(PlacesServer(), Generations(generation))
        replies = []
        peer = SimpleNamespace(
            route=SimpleNamespace(source="admin"),
            carrier=SimpleNamespace(text=True, ack=True),
            address=("127.0.0.1", 1),
            profile=Profile.YARP3,
        )
        ask = binary.encode(["get_status_RPC"], Profile.YARP3)
        server(SimpleNamespace(payload=ask, peer=peer, reply=replies.append))
        assert binary.decode(replies[0], Profile.YARP3) == ["ok", "locy"]
        server(SimpleNamespace(payload=binary.encode([INTRODUCTION], Profile.YARP3), peer=peer, reply=replies.append))
        assert binary.decode(replies[1], Profile.YARP3) == [3, 4, 0, 0]
        assert peer.profile is Profile.YARP3
        assert server.generations.explain() == []


def test_a_request_sets_the_dialect_of_its_connection() -> None:
    server = Server(PlacesServer())
    replies = []
    peer = SimpleNamespace(
        route=SimpleNamespace(source="/c"),
        carrier=SimpleNamespace(text=False, ack=True),
        address=("127.0.0.1", 1),
        profile=None,
    )
    ask = Places.calls()["count"].request([1, 2.0], Profile.YARP4)
    server(SimpleNamespace(payload=ask, peer=peer, reply=replies.append))
    assert binary.decode(replies[0]) == [3]
    assert peer.profile is Profile.YARP4


def test_introductions_override_rules_and_rules_the_default() -> None:
    generations = Generations(Generation.YARP_3_12, [("/cer/*", Generation.YARP_3_6), ("/c*", Generation.YARP_3_11)])
    assert [generations.of(peer).generation.value for peer in ("/cer/x", "/cx", "/x")] == ["3.6", "3.11", "3.12"]
    assert "/cer/*" in generations.of("/cer/x").reason
    generations.introduced("/cer/x")
    assert generations.of("/cer/x").generation is Generation.YARP_4
    generations.forget("/cer/x")
    assert generations.of("/cer/x").generation is Generation.YARP_3_6
    for number in range(MOST_PEERS + 10):
        generations.introduced(f"/p{number}")
    assert len(generations.explain()) == MOST_PEERS
    assert generations.explain()[0].peer == "/p10"


@pytest.mark.parametrize(
    ("version", "generation"),
    [("3.6", "3.6"), ("3.9.1", "3.6"), ("3.10.0", "3.6"), ("3.11", "3.11"), ("3.12.3", "3.12"), ("3", "3.12"),
     ("4", "4.0"), ("4.0.0+", "4.0"), ("5.1", "4.0")],
)  # fmt: skip
def test_versions_have_a_generation(version: str, generation: str) -> None:
    assert Generation.of(version).value == generation


@pytest.mark.parametrize("version", ["", "3.5", "x", "3.9.1.2.3", "9" * 30, "-4"])
def test_an_invalid_version_is_rejected(version: str) -> None:
    with pytest.raises(ValueError, match="not a supported version of YARP"):
        Generation.of(version)


class Kind(VocabEnum):
    GLOBAL = "glob"
    LOCAL = "loca"


@dataclass
class Everything(Structure):
    flag: bool = False
    byte: Annotated[int, INT8] = 0
    positive: Annotated[int, UINT8] = 0
    short: Annotated[int, INT16] = 0
    number: int = 0
    long: Annotated[int, INT64] = 0
    single: Annotated[float, FLOAT32] = 0.0
    double: float = 0.0
    text: str = ""
    data: bytes = b""
    kind: Kind = Kind.GLOBAL
    status: Status = Status.STANDBY
    place: Map2DLocation = field(default_factory=Map2DLocation)
    flags: list[bool] = field(default_factory=list)
    bytes_: list[Annotated[int, UINT8]] = field(default_factory=list)
    doubles: list[float] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)
    kinds: list[Kind] = field(default_factory=list)
    places: list[Map2DLocation] = field(default_factory=list)
    lists: list[list[int]] = field(default_factory=list)


texts = st.text(max_size=9)
doubles = st.floats(allow_nan=False)
places = st.builds(Map2DLocation, texts, doubles, doubles, doubles, texts)
numbers = st.integers(-(2**31), 2**31 - 1)
everything = st.builds(
    Everything, st.booleans(), st.integers(-128, 127), st.integers(0, 255), st.integers(-(2**15), 2**15 - 1), numbers,
    st.integers(-(2**63), 2**63 - 1), st.floats(width=32, allow_nan=False), doubles, texts, st.binary(max_size=9),
    st.sampled_from(Kind), st.sampled_from(Status), places, st.lists(st.booleans()), st.lists(st.integers(0, 255)),
    st.lists(doubles), st.lists(texts), st.lists(st.sampled_from(Kind)), st.lists(places, max_size=3),
    st.lists(st.lists(numbers, max_size=3), max_size=3),
)  # fmt: skip


@given(everything, st.sampled_from(Profile))
def test_every_field_survives_a_round_trip(value: Everything, profile: Profile) -> None:
    data = value.to_bytes(profile)
    assert Everything.from_bytes(data, profile) == value
    assert len(binary.decode(data, profile)) == 20
    assert Everything.from_bytes(binary.encode(binary.decode(data, profile), profile), profile) == value


@pytest.mark.parametrize(
    ("name", "wrong"),
    [("byte", 128), ("positive", -1), ("short", 2**15), ("number", 2**31), ("long", 2**63), ("number", "1"),
     ("double", "x"), ("single", 1e300), ("text", 5), ("kind", "none"), ("place", None), ("places", [1])],
)  # fmt: skip
def test_an_error_on_writing_names_the_field(name: str, wrong: Any) -> None:
    value = Everything()
    setattr(value, name, wrong)
    with pytest.raises(WireError, match=f"Everything.{name}"):
        value.to_bytes()


def test_an_error_on_reading_names_the_field() -> None:
    good = Everything().to_values()
    for place, wrong, name in [(0, "x", "flag"), (1, 500, "byte"), (8, 1.0, "text"), (10, Vocab("nope"), "kind"),
                               (11, 7, "status"), (9, "x", "data"), (12, [1], "place")]:  # fmt: skip
        with pytest.raises(WireError, match=f"Everything.{name}"):
            Everything().from_values([*good[:place], wrong, *good[place + 1 :]])
    with pytest.raises(TypeError, match="not a type"):
        field_of(complex)


def test_concurrent_first_calls_read_the_whole_interface() -> None:
    """Several threads may use a client; no thread sees an incomplete interface."""
    errors: list[BaseException] = []
    switch = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        for _ in range(50):
            kind = type(
                "Fresh", (Service,), {name: method for name, method in vars(Places).items() if hasattr(method, "rpc")}
            )
            start = threading.Barrier(4)

            def ask(kind: type[Service] = kind, start: threading.Barrier = start) -> None:
                start.wait()
                try:
                    assert "store_location_RPC" in kind.calls()
                except BaseException as err:
                    errors.append(err)

            threads = [threading.Thread(target=ask) for _ in range(4)]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
    finally:
        sys.setswitchinterval(switch)
    assert not errors
