"""A side whose programs send JSON in datagrams. Until a worker joins it, Midspan imports only this descriptor."""

from bridge.sides import Side

SIDE = Side(
    name="datagrams",
    label="datagrams",
    edges="datagrams.edge:DatagramEdge",
    section="datagrams.edge:DatagramSection",
    private_topics=((r"/debug/.*", "programs' own notes"),),
    checks="datagrams.edge:CHECKS",
)
