"""A name server's memory as the bytes of a file."""

from __future__ import annotations

import json

from yarp_compat.naming.registry import Registry


def dumps(registry: Registry) -> bytes:
    """A registry's state as a file holds it."""
    return json.dumps({"version": 1, **registry.state()}, indent=1).encode()


def loads(registry: Registry, data: bytes) -> None:
    """Restore a registry from what `dumps` gave.

    Raises:
        ValueError: it is something else.
    """
    try:
        state = json.loads(data)
        if state["version"] != 1:
            msg = f"it is of version {state['version']!r}, not 1"
            raise ValueError(msg)
        registry.restore(state)
    except (AttributeError, KeyError, OverflowError, TypeError, RecursionError) as err:
        msg = f"it is not a name server's state ({type(err).__name__}: {err})"
        raise ValueError(msg) from None
