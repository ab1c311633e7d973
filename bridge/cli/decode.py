"""Messages from the network as values: by types known here, and by those that the workers know."""

from __future__ import annotations

from typing import Any

from bridge.cli.errors import CliError
from bridge.cli.hubclient import Client
from bridge.cli.text import near
from bridge.messages.errors import MessageTypeError
from bridge.messages.json import to_json
from bridge.messages.names import is_ros1_name, is_ros2_name

_MAX_DEFINITION = 1024 * 1024


class Types:
    """The message types that a verb can use: those installed here, and what the workers tell."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self.registry = client.registry()

    def name(self, spelled: str) -> str:
        """The ROS 2 name of a type spelled as ROS 1 or ROS 2 spells it; raises `CliError`."""
        if is_ros2_name(spelled):
            return spelled
        if not is_ros1_name(spelled):
            msg = f"{spelled!r} is no type: it should look like std_msgs/String or std_msgs/msg/String"
            raise CliError(msg)
        try:
            return self.registry.ros1_to_hub(spelled).target.name
        except MessageTypeError:
            package, _, short = spelled.partition("/")
            return f"{package}/msg/{short}"

    def hash_of(self, name: str) -> str:
        """The hash of a type, asked of the workers where its definition is not installed; raises `CliError`."""
        try:
            return self.registry.ros2(name).type_id
        except MessageTypeError as err:
            if self._ask(name, ""):
                return self.registry.ros2(name).type_id
            raise CliError(self._unknown(name, err)) from None

    def decode(self, name: str, type_hash: str, cdr: bytes) -> dict[str, Any]:
        """The fields of a message.

        Raises:
            CliError: nobody here knows the type with that hash.
            ConversionError: the bytes are no such message.
        """
        self.prepare(name, type_hash)
        return to_json(self.registry, name, cdr, type_hash)

    def prepare(self, name: str, type_hash: str) -> None:
        """Have the definition of a type with this very hash; raises `CliError` where nobody tells it."""
        try:
            self.registry.schema(name, type_hash)
        except MessageTypeError as err:
            if not self._ask(name, type_hash):
                raise CliError(self._unknown(name, err)) from None

    def prepare_service(self, name: str, type_hash: str) -> None:
        """Have the definition of a service with this very hash; raises `CliError` where nobody tells it."""
        try:
            self.registry.service_schemas(name, type_hash)
        except MessageTypeError as err:
            if not self._ask(name, type_hash):
                raise CliError(self._unknown(name, err)) from None

    def _ask(self, name: str, type_hash: str) -> bool:
        for answer in self._client.ask("type", {"name": name}):
            value = answer.value if isinstance(answer.value, dict) else {}
            definition = value.get("definition")
            fits = not type_hash or value.get("hash") == type_hash
            if fits and isinstance(definition, str) and len(definition) < _MAX_DEFINITION:
                self.registry.learn_ros2(name, definition)
                return True
        return False

    def _unknown(self, name: str, err: MessageTypeError) -> str:
        package, _, short = name.rpartition("/")
        files = self.registry.ros2_package_sources(package.partition("/")[0])
        names = [path.removeprefix("msg/").removesuffix(".msg") for path in files if path.startswith("msg/")]
        meant = [f"{package}/{other}" for other in near(short, names)]
        hint = f" Did you mean {', '.join(meant)}?" if meant and short not in names else ""
        cure = f"\n{err.cure}" if err.cure else ""
        return f"{err}, and no worker on the hub tells its definition.{hint}{cure}"
