"""Classes of service of IP packets by name (`yarp/os/QosStyle.h`; RFC 2474, RFC 2597, RFC 3246)."""

from __future__ import annotations

PRIORITIES = {"LOW": 10, "NORM": 0, "HIGH": 36, "CRIT": 44}
"""YARP's names for some of the classes."""

DSCP = {
    **{f"CS{n}": 8 * n for n in range(8)},
    **{f"AF{n}{drop}": 8 * n + 2 * drop for n in range(1, 5) for drop in range(1, 4)},
    "VA": 44,
    "EF": 46,
}
