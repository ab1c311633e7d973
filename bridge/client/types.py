"""Message types of a program on the hub: those installed here, and those that the workers know."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from bridge.client.errors import ClientError
from bridge.client.session import ASK_SECONDS, Client
from bridge.hub.definitions import VERB, definition_among
from bridge.hub.node import Hub
from bridge.messages.definitions.names import is_ros1_name, is_ros2_name
from bridge.messages.errors import MessageTypeError
from bridge.text import near

if TYPE_CHECKING:
    from bridge.messages.registry import Registry


class Types:
    """The message types that a program can use; messages are JSON values (`bridge.messages.json`)."""

    def __init__(self, client: Client) -> None:
        self._hub = client.hub
        self.registry = client.registry()
        self._hub.versions = self.registry.releases

    def name(self, spelled: str) -> str:
        """Return the ROS 2 name of a type in ROS 1's or ROS 2's spelling; raises `ClientError`."""
        return ros2_name(self.registry, spelled)

    def hash_of(self, name: str) -> str:
        """Return the hash of a type, from the workers if its definition is not installed; raises `ClientError`."""
        self._have(lambda: self.registry.ros2(name), name)
        return self.registry.ros2(name).type_id

    def decode(self, name: str, type_hash: str, cdr: bytes) -> dict[str, Any]:
        """Return a message's fields.

        Raises `ClientError` for an unknown type or hash, `ConversionError` for bad bytes.
        """
        from bridge.messages.json import to_json

        self.prepare(name, type_hash)
        return to_json(self.registry, name, cdr, type_hash)

    def prepare(self, name: str, type_hash: str) -> None:
        """Load the definition of a type with this hash; raises `ClientError` if no worker has it."""
        self._have(lambda: self.registry.schema(name, type_hash), name, type_hash)

    def prepare_service(self, name: str, type_hash: str) -> None:
        """Load the definition of a service with this hash; raises `ClientError` if no worker has it."""
        self._have(lambda: self.registry.service_schemas(name, type_hash), name, type_hash)

    def _have(self, load: Callable[[], object], name: str, type_hash: str = "") -> None:
        try:
            load()
        except MessageTypeError as err:
            if not learn(self._hub, self.registry, name, type_hash):
                raise ClientError(self._unknown(name, err)) from None

    def _unknown(self, name: str, err: MessageTypeError) -> str:
        package, _, short = name.rpartition("/")
        files = self.registry.ros2_package_sources(package.partition("/")[0])
        names = [path.removeprefix("msg/").removesuffix(".msg") for path in files if path.startswith("msg/")]
        meant = [f"{package}/{other}" for other in near(short, names)]
        hint = f" Did you mean {', '.join(meant)}?" if meant and short not in names else ""
        cure = f"\n{err.cure}" if err.cure else ""
        return f"{err}, and no worker on the hub has its definition.{hint}{cure}"


def learn(hub: Hub, registry: Registry, name: str, type_hash: str = "", seconds: float = ASK_SECONDS) -> bool:
    """Ask the workers for a type's definition, of any version if the hash is ""; return whether a worker has it.

    Raises `HubError`, and `MessageTypeError` if the definition is invalid.
    """
    definition = definition_among(hub.ask(VERB, {"name": name}, timeout=seconds), type_hash)
    if definition is not None:
        registry.learn_ros2(name, definition)
    return definition is not None


def ros2_name(registry: Registry, spelled: str) -> str:
    """Return the ROS 2 name of a message type in ROS 1's or ROS 2's spelling; raises `ClientError`."""
    if is_ros2_name(spelled):
        return spelled
    if not is_ros1_name(spelled):
        raise ClientError(
            f"{spelled[:80]!r} is not a type name: it should look like std_msgs/String or std_msgs/msg/String"
        )
    try:
        return registry.ros1_to_hub(spelled).target.name
    except MessageTypeError:
        return ros2_spelling(spelled, "msg")


def ros2_spelling(type_name: str, middle: str) -> str:
    """Return the ROS 2 name of a type: with middle ``srv``, ``std_srvs/srv/SetBool`` for ``std_srvs/SetBool``."""
    return type_name.replace("/", f"/{middle}/") if is_ros1_name(type_name) else type_name
