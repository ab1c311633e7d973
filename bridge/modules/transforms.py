"""Receives the frames of all sides for a module."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from bridge.client.authorities import Authorities
from bridge.hub.wire.qos import Durability, Qos
from bridge.modules.endpoints import Endpoints, Subscription
from bridge.tf.stamped import TF, TF_STATIC, TF_TYPE

_TIMED = Qos(depth=1000)  # all publishers of a robot may send at the same time
_STATIC = Qos(durability=Durability.TRANSIENT_LOCAL, depth=100)


class FrameSubscriptions:
    """A module's subscriptions to `/tf` and `/tf_static`, from their creation until `close`.

    Args:
        node: the module's node.
        receive: called on the module's thread with each message as CDR, its publisher's name, and ``static=``.
        at_once: call ``receive`` on the receiving threads, concurrently and without the publisher's name.
    """

    def __init__(self, node: Endpoints, receive: Callable[..., object], *, at_once: bool = False) -> None:
        self._node, self._receive, self._at_once = node, receive, at_once
        self._authorities = None if at_once else Authorities(node.hub.graph)
        self.open()

    def open(self) -> None:
        """Subscribe again after `close`."""
        self._timed, self._static = self._subscribe(TF, _TIMED), self._subscribe(TF_STATIC, _STATIC)

    def _subscribe(self, topic: str, qos: Qos) -> Subscription:
        on_message = partial(self._on_message, static=topic == TF_STATIC)
        return self._node.subscription_cdr(topic, TF_TYPE, on_message, qos, at_once=self._at_once)

    def _on_message(self, cdr: bytes, *, static: bool) -> None:
        authority = ""
        if self._authorities is not None:  # on the module's thread, so not during `open`
            authority = self._authorities.name((self._static if static else self._timed).sender)
        self._receive(cdr, authority, static=static)

    def close(self) -> None:
        for end in (self._timed, self._static):
            self._node.release(end)
