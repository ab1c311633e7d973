"""Selects the topics of bags to play, with their names and types, and the reasons for leaving out others."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from bridge.bags.bag import Bag, BagError, BagTopic
from bridge.bags.conversion import to_hub
from bridge.bags.known_types import misfits
from bridge.clock import CLOCK_TOPIC
from bridge.config.model import Config
from bridge.config.rules import EVERY, commands
from bridge.config.sections.section import ROS2_NAME
from bridge.hub.graph.tokens import TAPS, UNKNOWN_HASH
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.messages.errors import MessageTypeError
from bridge.messages.registry import Registry
from bridge.messages.velocities import COMMAND_NAME, VELOCITIES
from bridge.routing.limits import Priority, default_priority
from bridge.routing.rewrites import TF_TYPE
from bridge.routing.rules import RuleSet

STATIC = "/tf_static"
_GOAL = "Goal"


@dataclass(frozen=True, eq=False)
class PlayTopic:
    """A topic of one bag that is played.

    Attributes:
        topic: the topic in the bag.
        name: the name on the hub.
        convert: converts the bag's bytes to CDR, or checks them; raises `bridge.messages.errors.ConversionError`.
        definition: the type's definition, for participants that lack it; "" if unknown.
        command: whether it moves the robot.
        static: whether it has static transforms, which are published once, at the start.
    """

    topic: BagTopic
    name: str
    type_name: str
    type_hash: str
    convert: Callable[[bytes], bytes] | None
    definition: str
    qos: Qos
    command: bool = False
    static: bool = False

    @property
    def velocity(self) -> bool:
        """Whether a zero message of its type stops the robot."""
        return self.type_name in VELOCITIES

    @property
    def priority(self) -> str:
        """The priority class of its messages on the hub."""
        if self.command:
            return Priority.COMMAND.value
        return default_priority(self.name, self.type_name, latched=self.qos.latched).value


@dataclass(frozen=True)
class LeftOut:
    """A topic that is not played."""

    name: str
    type_name: str
    why: str
    command: bool = False


class CommandTopics:
    """Recognizes topics that move a robot, by type and name: those of docs/operate/security.md, and more.

    The access rules of the hub must not block state topics, but a topic left out here can be played with `--commands`.
    So a name like that of a command is enough, whatever the type, on the hub or on a side. Topics that drive this
    configuration's joints, and topics that a rule marks as commands, count too.
    """

    def __init__(self, config: Config) -> None:
        self._parts: dict[str, set[str]] = {}
        for type_name, parts in commands(config.rules).items():
            self._parts.setdefault(_short(type_name), set()).update(parts)
        self._rules = RuleSet(config.rules)
        sections = config.navigation, *config.modules.shipped.values()
        self._driven = {topic for section in sections for topic, _ in section.driven}

    def has(self, name: str, type_name: str) -> bool:
        """Return whether messages of this type (ROS 2's name) on this topic of the hub move a robot."""
        if type_name.endswith(_GOAL) or name in self._driven or COMMAND_NAME.search(name):
            return True
        last = name.rpartition("/")[2]
        if any(_fits(last, part) for part in self._parts.get(_short(type_name), ())):
            return True
        policies = self._rules.native(name, type_name)
        return any(p.priority == Priority.COMMAND.value or COMMAND_NAME.search(p.name) for p in policies)


def _short(type_name: str) -> str:
    """Return the name without its package, since types of the same name in other packages count too."""
    return type_name.rpartition("/")[2]


def _fits(last: str, part: str) -> bool:
    return part == EVERY or (last.startswith(part[:-1]) if part.endswith("*") else last == part)


@dataclass(frozen=True)
class PlayChoice:
    """The options of a play.

    Attributes:
        name: selects topics by their names in the bag.
        remap: new names, by those in the bag.
        commands: whether topics that move a robot are played too.
        clock: whether ``/clock`` is generated instead of played.
    """

    name: Callable[[str], bool]
    remap: Mapping[str, str]
    commands: bool = False
    clock: bool = False


def choose(
    bags: Iterable[Bag], registry: Registry, config: Config, choice: PlayChoice
) -> tuple[dict[Bag, list[PlayTopic]], list[LeftOut]]:
    """Return the topics of each bag to play, and those that were selected but are left out."""
    command_topics = CommandTopics(config)
    playable: dict[Bag, list[PlayTopic]] = {}
    left_out: dict[LeftOut, None] = {}
    for bag in bags:
        playable[bag] = []
        chosen = [topic for topic in bag.topics if choice.name(_absolute(topic.name))]
        unfit = misfits(bag, chosen, registry)
        for topic in chosen:
            topic_ = _resolve(bag.path, topic, registry, command_topics, choice, unfit.get(topic))
            if isinstance(topic_, PlayTopic):
                playable[bag].append(topic_)
            else:
                left_out[topic_] = None
    return playable, list(left_out)


def _absolute(name: str) -> str:
    return name if name.startswith("/") else f"/{name}"


def _resolve(
    path: Path, topic: BagTopic, registry: Registry, commands: CommandTopics, choice: PlayChoice, unfit: BagError | None
) -> PlayTopic | LeftOut:
    source = _absolute(topic.name)
    name = choice.remap.get(source, source)

    def leave_out(why: str, *, command: bool = False) -> LeftOut:
        return LeftOut(name, topic.type_name, why, command)  # with the type's name in the bag

    if choice.clock and name == CLOCK_TOPIC:
        return leave_out("--clock replaces it")
    if name.startswith(TAPS) or not ROS2_NAME.fullmatch(name):
        return leave_out("not a valid topic name (letters, digits and underscores between slashes); --remap renames it")
    try:
        if unfit is not None:
            raise unfit
        form = to_hub(registry, topic, path)
    except BagError as err:
        return leave_out(err.what + (f"; {err.cure}" if err.cure else ""))
    command = commands.has(name, form.type_name)
    if command and not choice.commands:
        return leave_out("it moves the robot (--commands plays it)", command=True)
    type_hash, convert = form.type_hash or UNKNOWN_HASH, form.convert
    if convert is None:
        # bytes of an unknown type pass unchecked
        with suppress(MessageTypeError):
            convert = registry.hub_check(form.type_name, form.type_hash)
    static = form.type_name == TF_TYPE and name.endswith(STATIC)
    # a latched command would move robots that join late
    qos = Qos(topic.qos.reliability, depth=1) if command else LATCHED if static else topic.qos
    return PlayTopic(topic, name, form.type_name, type_hash, convert, form.definition, qos, command, static)


def names_with_several_types(topics: Sequence[PlayTopic]) -> set[str]:
    """Return names that are played with several types, of which a subscriber receives only one."""
    kinds: dict[str, set[str]] = {}
    for topic in topics:
        kinds.setdefault(topic.name, set()).add(topic.type_name)
    return {name for name, types in kinds.items() if len(types) > 1}
