"""Things: messages that are decoded on demand."""

from __future__ import annotations

import yarp_compat as yarp
from yarp_compat.os.ports.connection import ConnectionReader
from yarp_compat.ports.message import PortMessage
from yarp_compat.wire.carriers import CARRIERS
from yarp_compat.wire.contact import ConnectionRoute
from yarp_compat.wire.profile import Profile


class Peer:
    route = ConnectionRoute("/from", "/to", "tcp")
    carrier = CARRIERS["tcp"]
    address = ("127.0.0.1", 1)
    profile = Profile.YARP3


def test_received_message_is_decoded_on_demand() -> None:
    things = yarp.Things()
    assert things.asBottle() is None
    message = PortMessage(yarp.Bottle("1 2").to_bytes(), "", Peer())
    assert things.setConnectionReader(ConnectionReader(message, yarp.Contact("/to")))
    assert not things.hasBeenRead()
    assert things.asBottle() == [1, 2]
    assert things.hasBeenRead()
    assert things.asVector() is None  # already decoded as another type
    things.reset()
    assert things.asBottle() is None


def test_an_object_is_returned_only_as_its_own_type() -> None:
    things, image = yarp.Things(), yarp.ImageRgb()
    things.setPortWriter(image)
    assert things.getPortWriter() is image
    assert things.asImage() is image
    assert things.asImageOfPixelRgb() is image
    assert things.asImageOfPixelMono() is None
    assert things.asMatrix() is None
    value = yarp.Value(5)
    things.reset()
    things.setPortReader(value)
    assert (things.getPortReader(), things.asValue(), things.asProperty()) == (value, value, None)
