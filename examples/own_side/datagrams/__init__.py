"""A side of one's own: datagrams of JSON. The descriptor is all that Midspan reads of it until a worker joins it."""

from bridge.sides import Side

SIDE = Side(
    name="datagrams",
    label="datagrams",
    edges="datagrams.edge:DatagramEdge",
    section="datagrams.edge:DatagramSection",
    private_topics=((r"/debug/.*", "programs' own notes"),),
    checks="datagrams.edge:CHECKS",
)
