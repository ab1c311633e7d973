"""All known message types, and the conversions of their bytes between ROS 1 and the hub.

Definitions are read from disk when a type is first requested. A definition from the network (a ROS 1 connection header,
the hub) or from a bag applies to endpoints with its md5 or hash; a name may have several definitions.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol, Self

from bridge.messages.definitions.library import DefinitionLibrary
from bridge.messages.definitions.names import is_ros1_name, is_ros2_name
from bridge.messages.definitions.parts import CONTENTS
from bridge.messages.definitions.schema import Definition, Schema, World
from bridge.messages.definitions.sources import DefinitionFolder, ros1_sources, ros2_sources
from bridge.messages.definitions.text import closure, own_text
from bridge.messages.definitions.versions import TypeVersions
from bridge.messages.errors import MessageTypeError
from bridge.messages.mapping.actions import ActionMapping, ActionTopicTypes
from bridge.messages.mapping.messages import ANY_MD5, MessageMapping
from bridge.messages.mapping.releases import ReleaseConversions
from bridge.messages.mapping.rule_check import rule_errors
from bridge.messages.mapping.rules import Rules
from bridge.messages.mapping.services import ServiceMapping, ServiceSchema, ros1_service, ros2_service
from bridge.messages.mapping.version_rules import VersionRules
from bridge.messages.transcode.conversion import Conversion, Convert, ServiceConversion, SideType, check_cdr


class _Types(Protocol):
    """The ``types`` section of a configuration."""

    @property
    def folders(self) -> Sequence[Path]: ...

    @property
    def mapping_rules(self) -> Sequence[Path]: ...


class Registry:
    """The registry of types; every method may be called from any thread.

    The configuration's ``.msg`` folders serve both ROS 1 and ROS 2. ``prefixes`` hold the ROS 2 packages that were
    built here (``share/<package>/msg/*.msg``), and ``ros1_packages`` holds ROS 1's Python packages (None: the usual
    folders). The methods raise `MessageTypeError` if a type is unknown, has a different md5 or hash here, or has no
    counterpart.

    Attributes:
        releases: the conversions between the versions of ROS 2 types.
    """

    def __init__(
        self,
        folders: Sequence[Path] = (),
        mapping_rules: Sequence[Path] = (),
        *,
        prefixes: Sequence[Path] = (),
        ros1_packages: Path | None = None,
    ) -> None:
        self._ros1 = DefinitionLibrary(World.ROS1, ros1_sources(folders, ros1_packages))
        self._sources2 = ros2_sources(folders, prefixes)
        self._ros2 = DefinitionLibrary(World.ROS2, self._sources2)
        self._lock = threading.RLock()
        versions = TypeVersions(self._ros2, folders, self._sources2)
        self._ros2.versions = versions.of
        self._versions, self._version_rules = versions, VersionRules(mapping_rules)
        self.releases = ReleaseConversions(self._ros2, versions, self._version_rules, self._lock)
        self._answers: dict[tuple[str, str, str], Conversion] = {}
        self._service_answers: dict[tuple[str, str, str], ServiceConversion] = {}
        self._checks: dict[str, Convert] = {}
        self._messages = MessageMapping(self._ros1, self._ros2, Rules(mapping_rules))
        self._services = ServiceMapping(self._messages)
        self._actions = ActionMapping(self._messages)

    @classmethod
    def of(cls, types: _Types) -> Self:
        """Return the registry for a configuration's ``types`` section."""
        return cls(types.folders, types.mapping_rules)

    def rule_errors(self) -> list[MessageTypeError]:
        """Return an error for each of the configuration's version rules that cannot apply."""
        with self._lock:
            return list(rule_errors(self._version_rules, self._versions))

    def ros1(self, name: str) -> SideType:
        """Return the ROS 1 type ``name``, derived from the ROS 2 type if only ROS 2 has it."""
        with self._lock:
            return self._messages.side(self._messages.find_ros1(name))

    def ros2(self, name: str) -> SideType:
        """Return the ROS 2 type ``name``, derived from the ROS 1 type if only ROS 1 has it."""
        with self._lock:
            return self._messages.side(self.schema(name))

    def schema(self, name: str, type_hash: str = "") -> Schema:
        """Return the ROS 2 type with all types that it nests, for decoders."""
        with self._lock:
            return self._find_ros2(name, type_hash)

    def ros1_schema(self, name: str, md5: str = "") -> Schema:
        """Return the ROS 1 type with all types that it nests; an md5 of "" or "*" means any."""
        with self._lock:
            return self._messages.find_ros1(name, md5)

    def learn_ros1(self, name: str, definition: str, md5: str = "") -> str:
        """Add the full definition from a ROS 1 connection header or a bag, and return its md5."""
        with self._lock:
            if not is_ros1_name(name):
                raise MessageTypeError(f"{name!r} is not a ROS 1 message type")
            if md5 not in ANY_MD5 and md5 in self._ros1.fingerprints(name):
                return md5
            known = self._ros1.learn(name, definition, "" if md5 in ANY_MD5 else md5)
            self._clear_caches()
            return known

    def learn_ros2(self, name: str, definition: str) -> str:
        """Add the full definition of a ROS 2 type from the hub or a bag, and return its hash."""
        with self._lock:
            if not is_ros2_name(name):
                raise MessageTypeError(f"{name!r} is not a ROS 2 message type")
            known = self._ros2.learn(name, definition)
            self._clear_caches()
            return known

    def ros1_to_hub(self, name: str, md5: str = "", definition: str = "") -> Conversion:
        """Return the conversion of a ROS 1 publisher's messages to the hub's; an md5 of "" or "*" means any.

        The name may be an action's ``pkg/action/Name_FeedbackMessage``; ``definition`` is from the connection header.
        """
        key = ("ros1", name, md5)
        with self._lock:
            if key not in self._answers:
                if definition and md5 not in self._ros1.fingerprints(name):
                    self.learn_ros1(name, definition, md5)
                if _is_feedback(name):
                    other, ros1_parts, ros2_parts = self._actions.of_ros1(name)
                    self._answers[key] = self._messages.conversion(
                        closure(ros1_parts[name], ros1_parts), closure(ros2_parts[other], ros2_parts)
                    )
                else:
                    source = self._messages.find_ros1(name, md5)
                    self._answers[key] = self._messages.conversion(source, self._messages.to_ros2(source))
            return self._answers[key]

    def hub_to_ros1(self, type_name: str, type_hash: str = "") -> Conversion:
        """Return the conversion of the hub's messages to ROS 1 messages."""
        key = ("ros2", type_name, type_hash)
        with self._lock:
            if key not in self._answers:
                if _is_feedback(type_name):
                    other, ros1_parts, ros2_parts = self._actions.of_ros2(type_name, type_hash)
                    self._answers[key] = self._messages.conversion(
                        closure(ros2_parts[type_name], ros2_parts), closure(ros1_parts[other], ros1_parts)
                    )
                else:
                    source = self._find_ros2(type_name, type_hash)
                    self._answers[key] = self._messages.conversion(source, self._messages.to_ros1(source))
            return self._answers[key]

    def hub_check(self, type_name: str, type_hash: str = "") -> Callable[[bytes], bytes]:
        """Return a function that checks CDR bytes against their type: lengths, bounds and truncation.

        The function raises `ConversionError`, or returns the message in its normal form, for example without the slack
        that rclpy's serializer appends.
        """
        with self._lock:
            return self._check(self._find_ros2(type_name, type_hash))

    def service_ros1_to_hub(self, name: str, md5: str = "") -> ServiceConversion:
        """Return the conversion of a ROS 1 service, which may be part of an action; an md5 of "" or "*" means any."""
        wanted = "" if md5 in ANY_MD5 else md5
        key = ("ros1", name, wanted)
        with self._lock:
            if key not in self._service_answers:
                if _is_action(name):
                    other, ros1_parts, ros2_parts = self._actions.of_ros1(name)
                    pair = _ros1_part(name, ros1_parts), ros2_service(closure(ros2_parts[other], ros2_parts))
                else:
                    ros1 = self._services.of_ros1(name, wanted)
                    pair = ros1, self._services.to_ros2(ros1)
                self._service_answers[key] = self._services.conversion(*pair)
            return self._service_answers[key]

    def service_hub_to_ros1(self, type_name: str, type_hash: str = "") -> ServiceConversion:
        """Return the conversion of a hub service, which may be part of an action, to ROS 1."""
        key = ("ros2", type_name, type_hash)
        with self._lock:
            if key not in self._service_answers:
                if _is_action(type_name):
                    other, ros1_parts, ros2_parts = self._actions.of_ros2(type_name, type_hash)
                    pair = _ros1_part(other, ros1_parts), ros2_service(closure(ros2_parts[type_name], ros2_parts))
                else:
                    ros2 = self._services.of_ros2(type_name, type_hash)
                    pair = self._services.to_ros1(ros2), ros2
                self._service_answers[key] = self._services.conversion(*pair)
            return self._service_answers[key]

    def service_ros2(self, type_name: str, type_hash: str = "") -> SideType:
        """Return the ROS 2 service ``pkg/srv/Name`` or ``pkg/action/Name_SendGoal``."""
        with self._lock:
            return self._find_service(type_name, type_hash).side_type

    def service_schemas(self, type_name: str, type_hash: str = "") -> tuple[Schema, Schema]:
        """Return the request and response of a ROS 2 service with all types that they nest, for decoders."""
        with self._lock:
            service = self._find_service(type_name, type_hash)
            return service.request, service.response

    def hub_service_check(self, type_name: str, type_hash: str = "") -> tuple[Convert, Convert]:
        """Return functions that check a service's requests and responses; see `hub_check`."""
        with self._lock:
            service = self._find_service(type_name, type_hash)
            return self._check(service.request), self._check(service.response)

    def action_to_ros1(self, type_name: str) -> str:
        """Return the ROS 1 action for a ROS 2 action."""
        with self._lock:
            return self._actions.ros1_name(type_name)

    def ros1_action(self, name: str) -> ActionTopicTypes:
        """Return the types of a ROS 1 action's topics, such as those of ``move_base_msgs/MoveBase``."""
        with self._lock:
            return self._actions.topics(name)

    def ros1_action_feedback(self, name: str) -> SideType:
        """Return the type of a ROS 1 action's feedback topic; the action's goal and result may be unknown."""
        with self._lock:
            return self._actions.topic(name, "Feedback")

    def ros2_package_sources(self, package: str) -> dict[str, str]:
        """Return the definition files from which a ROS 2 package is built: texts by path (``msg/Name.msg``)."""
        with self._lock:
            files: dict[str, str] = {}
            for source in self._sources2:
                if isinstance(source, DefinitionFolder):
                    files = {**source.files(package), **files}
            for name in self._ros2.names(package):
                short = name.split("/")[2]
                if f"msg/{short}.msg" not in files:
                    files[f"msg/{short}.msg"] = own_text(self._find_ros2(name).root)
            for schema in self._messages.derivable(package):
                short = schema.name.split("/")[2]
                files.setdefault(f"msg/{short}.msg", own_text(schema.root))
            for kind, found in (("srv", self._services), ("action", self._actions)):
                for name in found.names(package):
                    path = f"{kind}/{name.split('/')[2]}.{kind}"
                    contents = [f"{name}_{part}" for part in CONTENTS[kind]]
                    if path not in files:
                        files[path] = "---\n".join(own_text(self._find_ros2(content).root) for content in contents)
            return files

    def _clear_caches(self) -> None:
        """Clear cached conversions: a new definition may change counterparts."""
        self._answers.clear()
        self._service_answers.clear()
        self._messages.clear_cache()

    def _find_ros2(self, name: str, type_hash: str = "") -> Schema:
        """Return a ROS 2 message, which may be part of a service or action."""
        if self._ros2.find(name, type_hash) is None and is_ros2_name(name):
            if _is_action(name):
                return self._actions.schema(name, type_hash)
            if "/srv/" in name:
                return self._services.part(name, type_hash)
        return self._messages.find_ros2(name, type_hash)

    def _find_service(self, name: str, type_hash: str) -> ServiceSchema:
        if _is_action(name):
            return ros2_service(self._find_ros2(name, type_hash))
        return self._services.of_ros2(name, type_hash)

    def _check(self, schema: Schema) -> Convert:
        key = self._ros2.fingerprint(schema)
        if key not in self._checks:
            self._checks[key] = check_cdr(schema)
        return self._checks[key]


def _is_action(name: str) -> bool:
    return "/action/" in name


def _is_feedback(name: str) -> bool:
    """Whether a type is that of an action's feedback topic, which is converted with the action."""
    return _is_action(name) and name.endswith("_FeedbackMessage")


def _ros1_part(name: str, types: dict[str, Definition]) -> ServiceSchema:
    """Return a service of an action as the ROS 1 adapter represents it."""
    return ros1_service(name, *(closure(types[f"{name}_{part}"], types) for part in CONTENTS["srv"]))
