"""Every call of IMap2D: its bytes by the rules of YARP's generated code, and Midspan's client with its server."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from tests.peers.yarp.map_server import KeptMaps
from tests.yarp_compat.dev.written import Bytes, Returning, listed, text
from tests.yarp_compat.ports.conftest import MakePort, make_port, naming
from yarp_compat.dev.imap2d import IMap2DMsgs
from yarp_compat.dev.locations import Map2DArea, Map2DLocation, Map2DObject, Map2DPath
from yarp_compat.dev.map2d_client import IMap2D, Map2DClient
from yarp_compat.dev.mapgrid import MapFlag, MapGrid2D
from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnCode, ReturnValue
from yarp_compat.dev.server import Server
from yarp_compat.os.data.stdvector import SVector
from yarp_compat.ports.naming import LocalNaming
from yarp_compat.sig.vec2d import Vec2D
from yarp_compat.wire.generation import Generation, Generations
from yarp_compat.wire.profile import Profile

__all__ = ["make_port", "naming"]

KITCHEN = Map2DLocation("m1", 1.0, 2.0, 90.0, "by the door")
CUP = Map2DObject("m1", 1, 2, 3, 4, 5, 6, "a cup")
ROOM = Map2DArea("m1", [Vec2D(0, 0), Vec2D(1, 0), Vec2D(1, 1)], "a room")
PATH = Map2DPath([KITCHEN, Map2DLocation("m1", 3, 4)], "a path")
PLACES: dict[str, Any] = {"object": CUP, "location": KITCHEN, "area": ROOM, "path": PATH}


def small_map() -> MapGrid2D:
    grid = MapGrid2D.of(np.arange(6).reshape(2, 3), name="m1", resolution=0.5, origin=(1, 2, 0))
    grid.enable_map_compression_over_network(False)
    return grid


def every_call() -> Iterator[tuple[str, tuple[Any, ...], tuple[Any, ...]]]:
    """Yield each method with its arguments, and its results after the outcome."""
    grid = small_map()
    for name in ("clear_all_maps", "clear_all_maps_temporary_flags", "reload_maps_collection"):
        yield name, (), ()
    yield "reload_locations_and_extras", (), ()
    yield "store_map", (grid,), ()
    yield "get_map", ("m1",), (grid,)
    yield "get_map_names", (), (["m1", "m2"],)
    for name in ("remove_map", "clear_map_temporary_flags", "load_map_from_disk"):
        yield name, ("m1",), ()
    yield "save_map_to_disk", ("m1", "m1.map"), ()
    yield "enable_maps_compression", (False,), ()
    for name in ("maps_collection", "locations_and_extras"):
        yield f"save_{name}", ("some.ini",), ()
        yield f"load_{name}", ("some.ini",), ()
    for kind, value in PLACES.items():
        yield f"store_{kind}", ("a name", value), ()
        yield f"get_{kind}", ("a name",), (value,)
        yield f"get_{kind}s_list", (), (["one", "two"],)
        yield f"get_all_{kind}s", (), ([value, value],)
        yield f"rename_{kind}", ("old", "new"), ()
        yield f"delete_{kind}", ("a name",), ()
        yield f"clear_all_{kind}s", (), ()


CALLS = {f"{name}_RPC": (arguments, results) for name, arguments, results in every_call()}


def test_the_list_of_calls_is_complete() -> None:
    assert set(CALLS) == set(IMap2DMsgs.calls())
    assert len(CALLS) == 44


@pytest.mark.parametrize("generation", Generation)
@pytest.mark.parametrize("name", CALLS)
def test_a_call_has_the_bytes_of_generated_code(name: str, generation: Generation) -> None:
    arguments, results = CALLS[name]
    call, rules = IMap2DMsgs.calls()[name], Bytes(generation)
    request = rules.request(name, *arguments)
    assert call.request(arguments, generation.profile) == request
    server = Returning.of(IMap2DMsgs, (OK, *results) if results else OK)
    reply = Server(server, Generations(generation)).answer(request, "/peer", generation.profile)
    assert list(server.arguments) == list(arguments)
    assert reply == rules.reply(OK, *results)
    assert call.read_reply(reply, generation).results == [OK, *results]


@pytest.mark.parametrize("generation", Generation)
@pytest.mark.parametrize("name", CALLS)
def test_a_failed_call_returns_defaults_after_its_outcome(name: str, generation: Generation) -> None:
    arguments, results = CALLS[name]
    rules, failed = Bytes(generation), ReturnValue(ReturnCode.METHOD_FAILED)
    reply = Server(Returning.of(IMap2DMsgs, CallFailed()), Generations(generation)).answer(
        rules.request(name, *arguments), "/peer"
    )
    assert IMap2DMsgs.calls()[name].read_reply(reply, generation).results == [
        failed,
        *([type(result)() for result in results]),
    ]
    assert reply.startswith(rules.reply(failed, *results)[: 8 if results else None])


# -- a client and a server --------------------------------------------------------------------------------------------


@pytest.fixture
def kept() -> KeptMaps:
    return KeptMaps()


@pytest.fixture(params=Generation)
def client(
    request: pytest.FixtureRequest, kept: KeptMaps, make_port: MakePort, naming: LocalNaming
) -> Iterator[Map2DClient]:
    generation: Generation = request.param
    server = Server(kept, Generations(generation))
    make_port("/maps/rpc", server, rpc=True, on_event=server.on_event, profile=generation.profile)
    with Map2DClient("fast_tcp://maps/rpc", "/client", naming=naming) as connected:
        yield connected


def test_the_methods_of_yarp_call_the_server(client: Map2DClient, kept: KeptMaps) -> None:
    names, grid = SVector(), MapGrid2D()
    assert client.store_map(small_map())
    assert client.get_map("m1", grid)
    assert grid == small_map()
    assert client.get_map("none", grid).code is ReturnCode.METHOD_FAILED
    assert grid == small_map()
    assert client.get_map_names(names)
    assert names == ["m1"]
    assert client.clearMapTemporaryFlags("m1")
    assert MapFlag.TEMPORARY_OBSTACLE not in kept.kept["map"]["m1"].flags
    for kind, value in PLACES.items():
        called = {name: getattr(client, name.format(kind.capitalize())) for name in
                  ("store{}", "get{}", "get{}sList", "getAll{}s", "rename{}", "delete{}", "clearAll{}s")}  # fmt: skip
        assert called["store{}"]("a", value)
        assert called["rename{}"]("a", "b")
        assert not called["rename{}"]("a", "c")
        item, names, everything = type(value)(), SVector(["x"]), [1, 2]
        assert called["get{}"]("b", item)
        assert called["get{}sList"](names)
        assert called["getAll{}s"](everything)
        assert (item, names, everything) == (value, ["b"], [value])
        assert called["delete{}"]("b")
        assert not called["delete{}"]("b")
        assert called["store{}"]("c", value)
        assert called["clearAll{}s"]()
        assert kept.kept[kind] == {}
    files = {"saveMapToDisk": ("m1", "f"), "loadMapFromDisk": ("f",), "saveMapsCollection": ("f",),
             "loadMapsCollection": ("f",), "saveLocationsAndExtras": ("f",), "loadLocationsAndExtras": ("f",),
             "reloadMapsCollection": (), "reloadLocationsAndExtras": (), "enableMapsCompression": (False,)}  # fmt: skip
    for name, arguments in files.items():
        assert getattr(client, name)(*arguments), name
    assert [arguments[1:] for arguments in kept.files] == list(files.values())
    assert client.clearAllMapsTemporaryFlags()
    assert client.store_map(small_map())
    assert client.remove_map("m1")
    assert client.clearAllMaps()


def test_maps_and_places_are_mappings(client: Map2DClient, kept: KeptMaps) -> None:
    client.maps["m1"] = small_map()
    assert client.maps["m1"] == small_map()
    assert list(client.maps) == ["m1"]
    with pytest.raises(ValueError, match="own name"):
        client.maps["other"] = small_map()
    with pytest.raises(KeyError):
        client.maps["none"]
    for kind, value in PLACES.items():
        views: dict[str, Any] = {name: getattr(client, f"{name}s") for name in PLACES}
        view = views[kind]
        view["a"] = value
        assert dict(view) == {"a": value}
        assert view.everything() == [value]
        view.rename("a", "b")
        assert "a" not in view
        del view["b"]
        with pytest.raises(KeyError):
            del view["b"]
        assert len(view) == 0
        view.clear()
    client.maps.save("m1", "f")
    client.maps.load("f")
    client.maps.save_collection("f")
    client.maps.load_collection("f")
    client.maps.reload()
    client.maps.compress(True)
    client.save_places("f")
    client.load_places("f")
    client.reload_places()
    client.maps.clear_temporary_flags("m1")
    assert len(kept.files) == 9
    del client.maps["m1"]
    client.maps.clear()


def test_a_client_reconnects_to_a_restarted_server(make_port: MakePort, naming: LocalNaming) -> None:
    first = make_port("/maps/rpc", Server(KeptMaps()), rpc=True)
    with Map2DClient("/maps/rpc", "/client", naming=naming, timeout=10) as client:
        client.locations["kitchen"] = KITCHEN
        first.close()
        assert client.clearAllMaps().code is ReturnCode.COMMUNICATION
        with pytest.raises(ConnectionError):
            client.locations["kitchen"]
        make_port("/maps/rpc", Server(KeptMaps()), rpc=True)
        assert list(client.locations) == []


def test_the_client_has_every_method_of_the_service() -> None:
    """The client's methods have YARP's names."""
    methods = [name for name, _ in inspect.getmembers(IMap2D, inspect.isfunction) if not name.startswith("_")]
    assert len(methods) == 44
    assert {"getAllLocations", "store_map", "reloadLocationsAndExtras", "enableMapsCompression"} <= set(methods)


def test_a_method_name_in_one_word_is_accepted() -> None:
    """``yarp rpc`` sends names in this form."""
    kept = KeptMaps()
    kept.kept["map"]["m1"] = small_map()
    reply = Server(kept).answer(listed(text("get_map_names_RPC")), "/peer", Profile.YARP3)
    assert reply == Bytes(Generation.YARP_3_6).reply(OK, ["m1"]), "the reply is a Bottle, which yarp rpc can print"
