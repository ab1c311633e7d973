"""Bottles to bytes and back.

A Bottle is ``int32 256 | unit``, ``int32 n``, n elements, little-endian. Where all elements are of one type other than
a list, ``unit`` is their tag and they have none of their own. (`yarp/os/impl/BottleImpl.cpp`)
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

from yarp_compat.wire.decoder import Data, Decoder, array
from yarp_compat.wire.encoder import Encoder
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.message import Buffer
from yarp_compat.wire.profile import Profile

_ENCODER3 = Encoder(Profile.YARP3)
_ENCODER4 = Encoder(Profile.YARP4)
_DECODER3 = Decoder(Profile.YARP3)
_DECODER4 = Decoder(Profile.YARP4)
_ARRAYS3 = Decoder(Profile.YARP3, array)
_ARRAYS4 = Decoder(Profile.YARP4, array)


def encode(values: Sequence[Any], profile: Profile) -> bytes:
    """A whole Bottle of these values (`values` says which there are).

    Raises:
        WireError: there is a value that no Bottle can hold.
    """
    return b"".join(encode_parts(values, profile))


def encode_parts(values: Sequence[Any], profile: Profile) -> list[Buffer]:
    """The same in pieces, in which large arrays and blobs are not copied.

    Raises:
        WireError: there is a value that no Bottle can hold.
    """
    out: list[Buffer] = []
    try:
        (_ENCODER3 if profile is Profile.YARP3 else _ENCODER4).bottle(values, out)
    except (struct.error, OverflowError) as err:
        raise WireError(f"a number is too large for its type: {err}") from None
    return out


def decode(data: Data, profile: Profile | None = None) -> list[Any]:
    """The values of exactly one Bottle.

    Args:
        data: its bytes.
        profile: whose they are; None: the one that accounts for every byte, YARP 3 where both do.

    Raises:
        WireError: they are no Bottle of that profile.
    """
    values: list[Any] = _decoded(data, profile, _DECODER3, _DECODER4)
    return values


def decode_arrays(data: Data, profile: Profile | None = None) -> Any:
    """The same with numpy arrays for lists of numbers of one type, the Bottle's own among them.

    They are views into the data, writable where it is: nothing is copied.

    Raises:
        WireError: they are no Bottle of that profile.
    """
    return _decoded(data, profile, _ARRAYS3, _ARRAYS4)


def decode_prefix(data: Data, profile: Profile, offset: int = 0) -> tuple[list[Any], int]:
    """The values of the Bottle that begins at an offset, and where it ends.

    Raises:
        WireError: it is none; Incomplete: it may be one when more bytes have come.
    """
    return (_DECODER3 if profile is Profile.YARP3 else _DECODER4).bottle(data, offset)


def _decoded(data: Data, profile: Profile | None, decoder3: Decoder, decoder4: Decoder) -> Any:
    if profile is not None:
        return _whole(decoder3 if profile is Profile.YARP3 else decoder4, data)
    try:
        return _whole(decoder3, data)
    except WireError as err:
        try:
            return _whole(decoder4, data)
        except WireError:
            raise err from None


def _whole(decoder: Decoder, data: Data) -> Any:
    values, end = decoder.bottle(data, 0)
    if end != len(data):
        raise WireError(f"the Bottle ends at byte {end}, but {len(data) - end} bytes follow")
    return values
