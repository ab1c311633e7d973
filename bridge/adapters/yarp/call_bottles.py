"""A service as Bottles: its request and its reply, each as nested lists of its fields or as chosen fields.

A reply without fields is ``[ok]``. A call that fails is answered ``[fail]`` and the reason, and such an answer is an
error, as YARP's modules use it.
"""

from __future__ import annotations

from collections.abc import Sequence

from bridge.hub.call import CallError
from bridge.messages.errors import ConversionError
from bridge.messages.registry import Registry
from bridge.messages.yarp.bottle import RosBottle, ros1_schema
from bridge.messages.yarp.codec import Codec
from bridge.messages.yarp.fields import Entry, FieldsCodec
from yarp_compat.wire import binary
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.message import Buffer
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.values import Vocab

OK, FAIL = Vocab("ok"), Vocab("fail")


class CallBottles:
    """Converts the calls of one service in one content and profile. Methods may be called from any thread.

    Args:
        registry: of types.
        type_name: ROS 2 name of the service's type.
        type_hash: its hash, "" for the one known here.
        request: what stands in the request's Bottle; none for all fields as nested lists.
        reply: the same for the reply.
        profile: whose bytes are written where a peer's are not known.

    Raises:
        MessageTypeError: the type is unknown, or cannot be said so.
    """

    def __init__(
        self,
        registry: Registry,
        type_name: str,
        type_hash: str,
        request: Sequence[Entry],
        reply: Sequence[Entry],
        profile: Profile,
    ) -> None:
        schemas = registry.service_schemas(type_name, type_hash)
        ways = registry.service_hub_to_ros1(type_name, type_hash)
        texts = ways.side.definition.partition("\n---\n")[::2]
        converts = ((ways.request_to_side, ways.request_to_hub), (ways.response_to_side, ways.response_to_hub))
        made: list[dict[Profile, Codec]] = []
        for schema, entries, text, (there, back), part in zip(
            schemas, (request, reply), texts, converts, ("Request", "Response"), strict=True
        ):
            made.append({})
            for known in Profile:
                if entries:
                    made[-1][known] = FieldsCodec(schema, entries, known)
                else:
                    assert there is not None
                    assert back is not None
                    made[-1][known] = RosBottle(ros1_schema(f"{ways.side.name}{part}", text), there, back, known)
        self._request, self._reply = made
        self._profile = profile
        self._silent = not schemas[1].root.fields and not reply

    def request_to_yarp(self, cdr: bytes, profile: Profile | None) -> list[Buffer]:
        """A request for a port, in its dialect; raises `ConversionError`."""
        return self._request[profile or self._profile].to_yarp(cdr).payload

    def request_to_hub(self, payload: Buffer, profile: Profile | None) -> tuple[bytes, Profile]:
        """A port's request for the hub, and the dialect that it is in: its bytes tell where a port does not, or errs.

        Raises:
            ConversionError: it is no request of this service in either.
        """
        likely = profile or self._profile
        first: ConversionError | None = None
        for known in (likely, Profile.YARP3 if likely is Profile.YARP4 else Profile.YARP4):
            try:
                return self._request[known].to_hub(payload, known, None), known
            except ConversionError as err:
                first = first or err
        assert first is not None
        raise first

    def reply_to_yarp(self, reply: bytes | CallError, profile: Profile | None) -> list[Buffer]:
        """A reply, or an error, for a port that asked; raises `ConversionError`."""
        used = profile or self._profile
        if isinstance(reply, CallError):
            return [binary.encode([FAIL, str(reply)], used)]
        return [binary.encode([OK], used)] if self._silent else self._reply[used].to_yarp(reply).payload

    def reply_to_hub(self, payload: Buffer, profile: Profile | None) -> bytes:
        """A port's reply for the hub; raises `ConversionError`, or `CallError` where it tells of a failure."""
        try:
            values = binary.decode(bytes(payload), profile)
        except WireError:
            values = []
        if values and values[0] == FAIL and isinstance(values[0], Vocab):
            words = " ".join(str(value) for value in values[1:])
            raise CallError(words or "the port answered [fail]")
        if self._silent:
            payload = binary.encode([], profile or self._profile)
        return self._reply[profile or self._profile].to_hub(payload, profile, None)
