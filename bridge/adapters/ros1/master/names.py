"""Resolution of ROS 1 names, as masters do it (http://wiki.ros.org/Names)."""

from __future__ import annotations

ANY_TYPE = "*"


def namespace_of(name: str) -> str:
    """Return the namespace that contains a name, with a trailing slash: ``/robot/`` for ``/robot/arm``."""
    return name.removesuffix("/").rpartition("/")[0] + "/"


def join(namespace: str, name: str) -> str:
    """Append a name to a namespace; a global or private name is returned unchanged."""
    if name.startswith(("/", "~")) or not namespace:
        return name
    if namespace == "~":
        return f"~{name}"
    return f"{namespace.removesuffix('/')}/{name}"


def canonical(name: str) -> str:
    """Remove empty parts from a name, and a trailing slash."""
    if name in ("", "/"):
        return name
    return "/" * name.startswith("/") + "/".join(split(name))


def split(name: str) -> list[str]:
    """Return the parts of a name."""
    return [part for part in name.split("/") if part]


def resolve(name: str, node: str) -> str:
    """Return the global form of a name that a node uses; a private name (``~x``) is below the node itself."""
    name = canonical(name)
    if name.startswith("/"):
        return name
    if name.startswith("~"):
        return canonical(f"{node}/{name[1:]}")
    return namespace_of(node) + name
