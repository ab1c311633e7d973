"""Messages as values: decoded with types of this machine or of the workers, read from YAML, and shown as YAML."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from bridge.cli.client import CliClient
from bridge.cli.output import CliError, near
from bridge.hub.definitions import VERB, definition_among
from bridge.messages.definitions.names import is_ros1_name, is_ros2_name
from bridge.messages.errors import MessageTypeError


class Types:
    """The message types that a verb can use: those installed here, and those that the workers define."""

    def __init__(self, client: CliClient) -> None:
        self._client = client
        self.registry = client.registry()

    def name(self, spelled: str) -> str:
        """Return the ROS 2 name of a type in ROS 1's or ROS 2's spelling; raises `CliError`."""
        if is_ros2_name(spelled):
            return spelled
        if not is_ros1_name(spelled):
            raise CliError(f"{spelled!r} is not a type: it should look like std_msgs/String or std_msgs/msg/String")
        try:
            return self.registry.ros1_to_hub(spelled).target.name
        except MessageTypeError:
            return ros2_spelling(spelled, "msg")

    def hash_of(self, name: str) -> str:
        """Return the hash of a type, from the workers if its definition is not installed; raises `CliError`."""
        self._have(lambda: self.registry.ros2(name), name)
        return self.registry.ros2(name).type_id

    def decode(self, name: str, type_hash: str, cdr: bytes) -> dict[str, Any]:
        """Return a message's fields; raises `CliError` for an unknown type or hash, `ConversionError` for bad bytes."""
        from bridge.messages.json import to_json

        self.prepare(name, type_hash)
        return to_json(self.registry, name, cdr, type_hash)

    def prepare(self, name: str, type_hash: str) -> None:
        """Load the definition of a type with this hash; raises `CliError` if no worker has it."""
        self._have(lambda: self.registry.schema(name, type_hash), name, type_hash)

    def prepare_service(self, name: str, type_hash: str) -> None:
        """Load the definition of a service with this hash; raises `CliError` if no worker has it."""
        self._have(lambda: self.registry.service_schemas(name, type_hash), name, type_hash)

    def _have(self, look: Callable[[], object], name: str, type_hash: str = "") -> None:
        try:
            look()
        except MessageTypeError as err:
            if not self._ask(name, type_hash):
                raise CliError(self._unknown(name, err)) from None

    def _ask(self, name: str, type_hash: str) -> bool:
        definition = definition_among(self._client.ask(VERB, {"name": name}), type_hash)
        if definition is not None:
            self.registry.learn_ros2(name, definition)
        return definition is not None

    def _unknown(self, name: str, err: MessageTypeError) -> str:
        package, _, short = name.rpartition("/")
        files = self.registry.ros2_package_sources(package.partition("/")[0])
        names = [path.removeprefix("msg/").removesuffix(".msg") for path in files if path.startswith("msg/")]
        meant = [f"{package}/{other}" for other in near(short, names)]
        hint = f" Did you mean {', '.join(meant)}?" if meant and short not in names else ""
        cure = f"\n{err.cure}" if err.cure else ""
        return f"{err}, and no worker on the hub has its definition.{hint}{cure}"


MAX_ITEMS = 16
MAX_TEXT = 200


def ros2_spelling(type_name: str, middle: str) -> str:
    """Return a type's ROS 2 name, derived from its name: with ``srv`` as middle, ``std_srvs/srv/SetBool``."""
    return type_name.replace("/", f"/{middle}/") if is_ros1_name(type_name) else type_name


class _Row(list[Any]):
    """A list that is written on one line."""


def message_text(message: Any, *, full: bool = False) -> str:
    """Format a message as YAML; unless ``full``, arrays are cut to `MAX_ITEMS` and texts to `MAX_TEXT` characters."""
    import yaml  # not needed to list topics

    text: str = yaml.dump(
        _shaped(message, full=full), Dumper=_dumper(), sort_keys=False, default_flow_style=False, allow_unicode=True,
        width=1_000_000 if full else 160,
    )  # fmt: skip
    return text


@cache
def _dumper() -> Any:
    """Return a YAML dumper that writes `_Row` in flow style, and rejects other Python objects."""
    import yaml

    class Dumper(yaml.SafeDumper):
        pass

    tag = "tag:yaml.org,2002:seq"
    Dumper.add_representer(_Row, lambda dumper, row: dumper.represent_sequence(tag, row, flow_style=True))
    return Dumper


def _shaped(value: Any, *, full: bool) -> Any:
    if isinstance(value, dict):
        return {name: _shaped(item, full=full) for name, item in value.items()}
    if isinstance(value, list):
        items = value if full else value[:MAX_ITEMS]
        shaped = [_shaped(item, full=full) for item in items]
        if len(items) < len(value):
            shaped.append(f"... ({len(value)} in all)")
        nested = any(isinstance(item, dict | list) for item in items)
        return shaped if nested else _Row(shaped)
    if isinstance(value, str) and not full and len(value) > MAX_TEXT:
        return f"{value[:MAX_TEXT]}... ({len(value)} characters in all)"
    return value


def yaml_fields(text: str) -> dict[str, Any]:
    """Parse a message's fields from YAML 1.2 or JSON; raises `CliError`."""
    import yaml

    from bridge.config.document import Yaml12Loader

    try:
        value = yaml.load(text, Yaml12Loader)  # noqa: S506 - it derives from the safe one
    except (KeyError, RecursionError, TypeError, ValueError, yaml.YAMLError) as err:
        raise CliError(f"the message is neither YAML nor JSON: {err}") from None
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise CliError(f"the message must be a map of fields, for example '{{data: hi}}', not {value!r}")
    return value
