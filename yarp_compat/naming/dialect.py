"""Which YARP a port is of: asked of the port itself.

YARP 3's ports answer the questions that ROS puts to its nodes, YARP 4's know none of them any more (``PortCore.cpp``;
measured on 3.12.3: ``getPid`` is answered by ``1 "" <pid>``, and on 4.0: by ``[fail] "send [help] ..."``).
"""

from __future__ import annotations

from yarp_compat.naming import talk
from yarp_compat.naming.errors import PortError
from yarp_compat.wire.contact import Contact
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.profile import Profile

QUESTION = "getPid"
PATIENCE = 1.0
"""Seconds that a port has to tell what it is."""


def asked(contact: Contact, timeout: float = PATIENCE) -> Profile | None:
    """The dialect of a port; None where it does not answer in time, or in no way that a YARP does.

    Not of a port that waits for a reply: C++ ports answer nobody meanwhile.
    """
    try:
        answer = talk.admin(contact, [QUESTION], timeout)
    except (PortError, WireError):
        return None
    if answer[:2] == [1, ""]:
        return Profile.YARP3
    return Profile.YARP4 if answer[:1] == ["fail"] else None
