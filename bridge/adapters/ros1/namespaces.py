"""Empty namespaces on a parameter server, which a master keeps until they are deleted."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from bridge.adapters.ros1_peers import Call, XmlRpcClient

_BATCH = 100


def is_empty(tree: object) -> bool:
    """Return whether a namespace has no values; ``tree`` is its content, None if it is not set."""
    return isinstance(tree, dict) and all(map(is_empty, tree.values()))


def delete_empty(client: XmlRpcClient, caller: str, names: Iterable[str]) -> None:
    """Delete namespaces that had no values when they were last read; raises `Ros1Error`.

    A master cannot delete a namespace on the condition that it is empty, and another program may have set a value in it
    since. So the request that deletes a namespace also returns its content, and values in it are set again at once.
    Until then, for about one round trip, other programs do not find them. A value is lost only if the program sets it
    in the microseconds between the two calls on the master, or if the master cannot send it over XML-RPC.
    """
    inner_first = sorted(names, reverse=True)
    for at in range(0, len(inner_first), _BATCH):
        batch = inner_first[at : at + _BATCH]
        calls: list[Call] = [(method, (caller, name)) for name in batch for method in ("getParam", "deleteParam")]
        contents = client.calls(calls)[::2]
        _restore(client, caller, dict(leaf for pair in zip(batch, contents, strict=True) for leaf in _leaves(*pair)))


def _restore(client: XmlRpcClient, caller: str, values: dict[str, Any]) -> None:
    """Set the values that are still missing; their program may have set newer ones."""
    if not values:
        return
    present = client.calls([("hasParam", (caller, name)) for name in values])
    missing = [item for item, exists in zip(values.items(), present, strict=True) if not exists]
    client.calls([("setParam", (caller, name, value)) for name, value in missing])


def _leaves(name: str, content: Any) -> Iterator[tuple[str, Any]]:
    """Yield the names and values in a namespace; ``content`` is None if it is not set."""
    if isinstance(content, dict):
        for part, inner in content.items():
            yield from _leaves(f"{name}/{part}", inner)
    elif content is not None:
        yield name, content
