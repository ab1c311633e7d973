"""What an RPC port of ours does with a request whose asker, or service, goes as the call begins."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from bridge.adapters.base import MadeBy
from bridge.adapters.yarp.served import ServedPort
from bridge.hub.call import Abandon, Done
from yarp_compat.ports.message import Message


def test_a_call_that_begins_as_its_service_goes_is_abandoned() -> None:
    ended: list[str] = []
    bottles: Any = SimpleNamespace(
        request_to_hub=lambda payload, profile: (payload, profile), reply_to_yarp=lambda *_: b"no more"
    )
    peer: Any = SimpleNamespace(route=SimpleNamespace(source="/asks"), profile=None)

    def call(_request: bytes, _done: Done) -> Abandon:
        served.close()
        return lambda: ended.append("abandoned")

    served = ServedPort("/lamp", bottles, call, lambda _: MadeBy.NATIVE, lambda *_: None)
    message = Message(b"on", "", peer, wants_reply=True)
    served.on_message(message)
    assert message.wait() == b"no more"
    assert ended == ["abandoned"]
