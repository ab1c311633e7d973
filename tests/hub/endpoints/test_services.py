"""Servers and clients on the hub: each call gets one reply or one clear error."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import pytest
import zenoh

from bridge.hub.endpoints import calls as queries
from bridge.hub.endpoints.calls import Abandon, CallError, Done
from bridge.hub.endpoints.services import HubClient, abandon_key
from bridge.hub.node import Hub
from bridge.hub.wire.keys import NO_HASH, pack_attachment, topic_key, unpack_attachment
from tests.peers.hub.endpoints import see_each_other
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until

SERVICE, HASH = "std_srvs/srv/SetBool", "RIHS01_" + "5e" * 32


class Called:
    """Records the end of one call: a reply or an error."""

    def __init__(self) -> None:
        self.ends: list[bytes | CallError] = []
        self._ended = threading.Event()

    def done(self, result: bytes | CallError) -> None:
        self.ends.append(result)
        self._ended.set()

    def wait(self, seconds: float = 40.0) -> bytes | str:
        """Return the reply, or the error's text."""
        assert self._ended.wait(seconds), "the call has not ended"
        (result,) = self.ends
        return str(result) if isinstance(result, CallError) else result


class Serving:
    """A server that replies as the test requests: at once with ``answer``, or later through `held`."""

    def __init__(
        self,
        hub: Hub,
        name: str = "/do",
        answer: Callable[[bytes], bytes | None] = lambda _: None,
        type_name: str = SERVICE,
        type_hash: str = HASH,
    ) -> None:
        self.held: list[tuple[bytes, Done]] = []
        self.abandoned: list[bytes] = []
        self._answer = answer
        self.server = hub.server(name, type_name, type_hash, self._call)

    def _call(self, request: bytes, done: Done) -> Abandon:
        reply = self._answer(request)
        if reply is None:
            self.held.append((request, done))
        else:
            done(reply)
        return lambda: self.abandoned.append(request)


def client(hub: Hub, name: str = "/do") -> HubClient:
    service_client = hub.client(name, SERVICE, HASH)
    until(lambda: service_client.ready, "the client sees its server")
    return service_client


def call(caller: HubClient, request: bytes = b"go") -> tuple[Called, Abandon]:
    called = Called()
    return called, caller.call(request, called.done)


def test_a_call_is_answered_once(network: HubNetwork) -> None:
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        Serving(a, answer=lambda request: b"re " + request)
        caller = client(b)
        assert [call(caller, text)[0].wait() for text in (b"one", b"", b"x" * 1_000_000)] == [
            b"re one",
            b"re ",
            b"re " + b"x" * 1_000_000,
        ]


def test_servers_and_clients_are_on_the_graph(network: HubNetwork) -> None:
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        server = Serving(a).server
        caller = client(b)
        until(lambda: b.graph.servers("/do") and a.graph.clients("/do"), "server and client are seen")
        (seen,), (asking,) = b.graph.servers("/do"), a.graph.clients("/do")
        assert (seen.gid, asking.gid) == (server.gid, caller.gid)
        assert (seen.type_name, seen.type_hash, seen.node) == (SERVICE, HASH, "a")
        server.close()
        caller.close()
        until(lambda: not b.graph.servers() and not a.graph.clients(), "server and client are gone")


def test_a_slow_call_does_not_delay_others(network: HubNetwork) -> None:
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        serving = Serving(a, answer=lambda request: None if request == b"slow" else b"quick")
        caller = client(b)
        slow, _ = call(caller, b"slow")
        assert [call(caller)[0].wait() for _ in range(20)] == [b"quick"] * 20
        assert slow.ends == []
        serving.held[0][1](b"at last")
        assert slow.wait() == b"at last"


def test_many_calls_at_once_end_each_with_its_own_reply(network: HubNetwork) -> None:
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        serving = Serving(a)
        caller = client(b)
        calls = [call(caller, b"%d" % n)[0] for n in range(1000)]
        until(lambda: len(serving.held) == 1000, "all requests have arrived")
        for request, done in reversed(serving.held):
            done(request)
        assert [called.wait() for called in calls] == [b"%d" % n for n in range(1000)]


def test_an_error_of_the_server_has_its_text(network: HubNetwork) -> None:
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        serving = Serving(a)
        called, _ = call(client(b))
        until(lambda: serving.held, "the request has arrived")
        serving.held[0][1](CallError("the map is ünknown"))
        assert called.wait() == "the map is ünknown"


def test_second_reply_to_a_call_is_ignored(network: HubNetwork) -> None:
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        serving = Serving(a)
        caller = client(b)
        called, abandon = call(caller)
        until(lambda: serving.held, "the request has arrived")
        for result in (b"first", b"second", CallError("third")):
            serving.held[0][1](result)
        assert called.wait() == b"first"
        abandon()
        abandon()
        assert call(caller, b"other")[0].ends == called.ends[1:] == []
        assert serving.abandoned == []


def test_without_a_server_a_call_ends_at_once(network: HubNetwork) -> None:
    with Hub.open(network.settings("a")) as a:
        called, abandon = call(a.client("/do", SERVICE, HASH))
        assert called.wait(0) == "no server of /do is on the hub"
        abandon()


def test_calls_may_wait_for_the_first_server(network: HubNetwork, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(HubClient, "first_server", 40.0)
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        caller = b.client("/do", SERVICE, HASH)
        (first, _), (second, abandon) = call(caller, b"one"), call(caller, b"two")
        abandon()
        serving = Serving(a, answer=lambda request: b"re " + request)
        assert first.wait() == b"re one"
        assert call(caller, b"three")[0].wait() == b"re three"
        serving.server.close()
        until(lambda: not caller.ready, "the server's end is seen")
        assert call(caller)[0].wait(0) == "no server of /do is on the hub"
        assert second.ends == []


def test_calls_that_wait_for_the_first_server_end_without_one(
    network: HubNetwork, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(HubClient, "first_server", 0.2)
    with Hub.open(network.settings("a")) as a:
        caller = a.client("/do", SERVICE, HASH)
        assert call(caller)[0].wait() == "no server of /do is on the hub"
        monkeypatch.setattr(HubClient, "first_server", 40.0)
        caller = a.client("/do", SERVICE, HASH)
        called, _ = call(caller)
        caller.close()
        assert called.wait(0) == "the call of /do was ended: its client was closed"
        assert call(caller)[0].wait(0) == "no server of /do is on the hub"


def test_a_server_that_closes_ends_its_calls(network: HubNetwork) -> None:
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        serving = Serving(a)
        caller = client(b)
        called, _ = call(caller)
        until(lambda: serving.held, "the request has arrived")
        serving.server.close()
        assert called.wait() == "the server of /do left before it answered"
        until(lambda: serving.abandoned == [b"go"], "the server is notified, which waits until its `_call` returns")
        serving.held[0][1](b"too late")
        until(lambda: not caller.ready, "the server's end is seen")
        assert call(caller)[0].wait(0) == "no server of /do is on the hub"
        assert len(called.ends) == 1


@pytest.mark.parametrize("mode", ["peer", "client"])
def test_dead_server_ends_its_calls_and_its_successor_is_called(network: HubNetwork, mode: str) -> None:
    with Hub.open(network.settings("b", zenoh={"mode": mode})) as b:
        caller = b.client("/do", SERVICE, HASH)
        for _ in range(2):
            with network.hub_peer("server") as peer:
                peer.ask("serve", name="/do", type=SERVICE, hash=HASH, hold=True)
                until(lambda: caller.ready, "the server is seen")
                called, _ = call(caller)
                until(lambda peer=peer: peer.ask("requests")["count"], "the request has arrived")
                peer.signal(9)
                assert str(called.wait()).startswith("the server of /do left before it answered")
            until(lambda: not caller.ready, "the server's end is seen")


def test_lost_server_ends_calls_while_other_threads_query_and_declare(network: HubNetwork) -> None:
    """A query waits for the lock that zenoh holds while it ends calls, and a declaration waits for the query."""
    with network.hub_peer("server") as server, network.hub_peer("client") as caller:
        server.ask("serve", name="/do", type=SERVICE, hash=HASH, hold=True)
        caller.ask("collide")
        call_id = caller.ask("call", name="/do", type=SERVICE, hash=HASH)["id"]
        until(lambda: server.ask("requests")["count"], "the request has arrived")
        server.signal(9)
        result = caller.ask("result", id=call_id, seconds=20.0)["result"]
        assert result.startswith("the server of /do left before it answered")


def test_lost_server_ends_its_calls_after_its_successor_has_joined(network: HubNetwork) -> None:
    """The client never lacks a server then, but the successor must not execute the call again."""
    with (
        Hub.open(network.settings("b")) as b,
        network.hub_peer("server") as server,
        network.hub_peer("next") as successor,
    ):
        server.ask("serve", name="/do", type=SERVICE, hash=HASH, hold=True)
        caller = client(b)
        called, _ = call(caller)
        until(lambda: server.ask("requests")["count"], "the request has arrived")
        successor.ask("serve", name="/do", type=SERVICE, hash=HASH)
        until(lambda: len(b.graph.servers("/do")) == 2, "the successor is seen")
        server.signal(9)
        assert str(called.wait()).startswith("the server of /do left before it answered")
        until(lambda: len(b.graph.servers("/do")) == 1, "the loss is seen")
        assert successor.ask("requests")["count"] == 0
        assert call(caller)[0].wait() == b"go"


def test_abandoned_call_notifies_only_the_server(network: HubNetwork) -> None:
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        serving = Serving(a)
        caller = client(b)
        called, abandon = call(caller, b"dull")
        kept, _ = call(caller, b"kept")
        until(lambda: len(serving.held) == 2, "both requests have arrived")
        abandon()
        until(lambda: serving.abandoned, "the server is notified")
        for _, done in serving.held:
            done(b"reply")
        assert kept.wait() == b"reply"
        assert (called.ends, serving.abandoned) == ([], [b"dull"])


def test_calls_under_another_hash_share_the_clients_numbers_and_are_abandoned(network: HubNetwork) -> None:
    """These calls have the client's GID, and servers distinguish calls by GID and number."""
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        hashless = Serving(a, type_hash=NO_HASH)
        caller = client(b)
        _, abandon = call(caller, b"1")
        until(lambda: hashless.held, "the hashless server is called")
        same = Serving(a)
        until(lambda: caller._reachable, "the server with the client's hash is seen")
        call(caller, b"2")
        until(lambda: same.held, "the server with the hash is called")
        numbers = [number for serving in (hashless, same) for _, number in serving.server._callers]
        assert len(set(numbers)) == 2, numbers
        abandon()
        until(lambda: hashless.abandoned == [b"1"], "the call is abandoned")
        assert same.abandoned == []


def test_dead_client_abandons_its_calls(network: HubNetwork) -> None:
    with Hub.open(network.settings("a")) as a:
        serving = Serving(a)
        with network.hub_peer("caller") as peer:
            peer.ask("call", name="/do", type=SERVICE, hash=HASH)
            until(lambda: serving.held and a.graph.clients("/do"), "the request and the client's token have arrived")
            peer.signal(9)
            until(lambda: serving.abandoned, "the server is notified")
        serving.held[0][1](b"too late")


def test_sizes_are_limited(network: HubNetwork) -> None:
    with Hub.open(network.settings("a", max_payload=1000)) as a, Hub.open(network.settings("b")) as b:
        Serving(a, answer=lambda request: request * 600)
        Serving(b, "/back", answer=lambda _request: bytes(1001))
        caller, back = client(b), client(a, "/back")
        assert call(caller, bytes(1001))[0].wait() == "the request has 1001 bytes, limits.message allows 1000"
        assert call(caller, b"go")[0].wait() == "the reply has 1200 bytes, limits.message allows 1000"
        assert call(back, b"go")[0].wait() == "the reply has 1001 bytes, limits.message allows 1000"
        assert call(back, bytes(1001))[0].wait(0) == "the request has 1001 bytes, limits.message allows 1000"
        assert call(caller, b"a")[0].wait() == b"a" * 600


def test_own_calls_and_other_types_are_not_served(network: HubNetwork) -> None:
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        serving = Serving(a)
        other = b.client("/do", SERVICE, "RIHS01_" + "00" * 32)
        client(b)
        own_client = a.client("/do", SERVICE, HASH)
        assert [call(caller)[0].wait(0) for caller in (own_client, other)] == ["no server of /do is on the hub"] * 2
        assert serving.held == []


def test_a_client_or_session_that_closes_ends_its_calls(network: HubNetwork) -> None:
    with Hub.open(network.settings("a")) as a:
        serving = Serving(a)
        b = Hub.open(network.settings("b"))
        first_client, second_client = client(b), client(b)
        first, _ = call(first_client, b"one")
        second, _ = call(second_client, b"two")
        until(lambda: len(serving.held) == 2, "both requests have arrived")
        first_client.close()
        first_client.close()
        assert first.wait(0) == "the call of /do was ended: its client was closed"
        b.close()
        assert second.wait(0) == "the call of /do was ended: its client was closed"
        assert call(first_client)[0].wait(0) == "no server of /do is on the hub"
        until(lambda: sorted(serving.abandoned) == [b"one", b"two"], "the server is notified")


def test_replies_to_plain_zenoh_programs_and_malformed_requests(network: HubNetwork) -> None:
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b, network.program() as program:
        Serving(a, answer=lambda request: b"re " + request)
        client(b)
        key = topic_key(a.domain, "/do", SERVICE, HASH)

        def ask(**more: Any) -> tuple[bytes, bytes | None]:
            (reply,) = program.get(key, **more)
            if reply.ok is None:
                return reply.err.payload.to_bytes(), None
            attachment = reply.ok.attachment
            return reply.ok.payload.to_bytes(), attachment and attachment.to_bytes()

        until(lambda: list(program.get(key)), "the program's router knows the server")
        assert ask() == (b"re ", None)
        assert ask(payload=b"go") == (b"re go", None)
        text, attachment = ask(payload=b"go", attachment=pack_attachment(7, 1, b"g" * 16))
        number, time_ns, gid = unpack_attachment(attachment)
        assert (text, number, gid) == (b"re go", 7, b"g" * 16)
        assert time_ns > 1
        for bad in (b"", b"short", bytes(33), bytes(200)):
            assert ask(payload=b"go", attachment=bad)[0].startswith(b"attachment with" if len(bad) == 33 else b"attach")
        program.put(abandon_key(key), b"junk")
        program.put(abandon_key(key), pack_attachment(99, 1, bytes(16)))
        assert ask(payload=b"on") == (b"re on", None)


def test_congested_or_invalid_server_ends_a_call_without_a_reply(
    network: HubNetwork, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(queries, "_AT_ONCE", 40.0)  # no matter how slow the machine is
    requests: list[bytes] = []
    with network.program() as program, Hub.open(network.settings("b")) as b:
        key = topic_key(b.domain, "/do", SERVICE, HASH)

        def strange(query: zenoh.Query) -> None:
            requests.append(query.payload.to_bytes())
            with query:
                if query.payload.to_bytes() == b"empty error":
                    query.reply_err(b"")

        program.declare_queryable(key, zenoh.handlers.Callback(strange, indirect=False), complete=True)
        caller = client(b)
        assert str(call(caller, b"none")[0].wait()).startswith(
            "the server of /do left before it answered; or an external listener"
        )
        assert call(caller, b"empty error")[0].wait() == "the server answered with an error"
        assert requests == [b"none", b"empty error"], "no call was repeated"


def test_servers_that_share_a_name_answer_once(network: HubNetwork) -> None:
    with (
        Hub.open(network.settings("a")) as a,
        Hub.open(network.settings("b")) as b,
        Hub.open(network.settings("c")) as c,
    ):
        requests: list[tuple[str, bytes]] = []
        Serving(a, answer=lambda request: requests.append(("a", request)) or b"re " + request)
        Serving(b, answer=lambda request: requests.append(("b", request)) or b"re " + request)
        see_each_other(a, b, c)
        caller = client(c)

        def both() -> bool:
            called, _ = call(caller)
            assert called.wait() == b"re go"
            return {server for server, _ in requests} == {"a", "b"}

        until(both, "both servers were called")
        called, _ = call(caller, b"last")
        assert called.wait() == b"re last"
        until(lambda: {("a", b"last"), ("b", b"last")} <= set(requests), "both servers were called again")
        assert len(called.ends) == 1
