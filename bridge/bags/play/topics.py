"""Which topics of bags are played, under which names and types, and what is left out and why."""

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
from bridge.routing.limits import COMMAND_NAME, COMMAND_TYPES, Priority, default_priority
from bridge.routing.rewrites import TF_TYPE
from bridge.routing.rules import RuleSet

STATIC = "/tf_static"
_GOAL = "Goal"


@dataclass(frozen=True, eq=False)
class PlayTopic:
    """A topic of one bag as it is played.

    Attributes:
        topic: as the bag has it.
        name: on the hub.
        convert: makes CDR of the bag's bytes, or checks them; raises `bridge.messages.errors.ConversionError`.
        definition: of the type, for those on the hub who do not know it; "" where it is not known.
        command: it moves the robot.
        static: transforms that are published whole at the beginning, and no more.
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
        """Whether a zero of its type ends what was commanded."""
        return self.type_name in COMMAND_TYPES

    @property
    def priority(self) -> str:
        """The class of its messages on the hub."""
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
    """Tells what moves a robot by type and name: what the hub's door knows (docs/operate/security.md), and more.

    A door that is too strict cuts a state off; here `--commands` is at hand. So a name that says command is enough,
    whatever the type, and the joints that this configuration drives are known by their topics.
    """

    def __init__(self, config: Config) -> None:
        section, modules = config.navigation, config.modules
        self._parts: dict[str, set[str]] = {}
        for type_name, parts in commands(config.rules).items():
            self._parts.setdefault(_short(type_name), set()).update(parts)
        self._rules = RuleSet(config.rules)
        velocities = {section.velocity, *(planner.velocity for planner in section.others.values())}
        joints = {modules.base_control.wheel_command, *(board.command for board in modules.control_boards.boards)}
        self._driven = (velocities | joints) - {""}

    def has(self, name: str, type_name: str) -> bool:
        """Whether messages of this type (ROS 2's name) on this topic of the hub move a robot."""
        if type_name.endswith(_GOAL) or name in self._driven or COMMAND_NAME.search(name):
            return True
        last = name.rpartition("/")[2]
        if any(_fits(last, part) for part in self._parts.get(_short(type_name), ())):
            return True
        return self._rules.enter("zenoh", name, type_name).priority == Priority.COMMAND.value


def _short(type_name: str) -> str:
    """Without its package: types of the same name in others count, too."""
    return type_name.rpartition("/")[2]


def _fits(last: str, part: str) -> bool:
    return part == EVERY or (last.startswith(part[:-1]) if part.endswith("*") else last == part)


@dataclass(frozen=True)
class PlayChoice:
    """What a person asked for.

    Attributes:
        name: whether a topic of this name, as the bag has it, is wanted.
        remap: other names, by those in the bag.
        commands: play what moves a robot too.
        clock: ``/clock`` is made, and not taken of the bag.
    """

    name: Callable[[str], bool]
    remap: Mapping[str, str]
    commands: bool = False
    clock: bool = False


def choose(
    bags: Iterable[Bag], registry: Registry, config: Config, wanted: PlayChoice
) -> tuple[dict[Bag, list[PlayTopic]], list[LeftOut]]:
    """What is played of each bag, and what is left out of all that was asked for."""
    moving = CommandTopics(config)
    found: dict[Bag, list[PlayTopic]] = {}
    left: dict[LeftOut, None] = {}
    for bag in bags:
        found[bag] = []
        chosen = [topic for topic in bag.topics if wanted.name(_absolute(topic.name))]
        unfit = misfits(bag, chosen, registry)
        for topic in chosen:
            made = _made(bag.path, topic, registry, moving, wanted, unfit.get(topic))
            if isinstance(made, PlayTopic):
                found[bag].append(made)
            else:
                left[made] = None
    return found, list(left)


def _absolute(name: str) -> str:
    return name if name.startswith("/") else f"/{name}"


def _made(
    path: Path, topic: BagTopic, registry: Registry, moving: CommandTopics, wanted: PlayChoice, unfit: BagError | None
) -> PlayTopic | LeftOut:
    source = _absolute(topic.name)
    name = wanted.remap.get(source, source)

    def left(why: str, *, command: bool = False) -> LeftOut:
        return LeftOut(name, topic.type_name, why, command)  # the type as the bag spells it

    if wanted.clock and name == CLOCK_TOPIC:
        return left("--clock takes its place")
    if name.startswith(TAPS) or not ROS2_NAME.fullmatch(name):
        return left("it is no name of a topic: letters, digits and underscores make its parts; --remap gives another")
    try:
        if unfit is not None:
            raise unfit
        form = to_hub(registry, topic, path)
    except BagError as err:
        return left(err.what + (f"; {err.cure}" if err.cure else ""))
    command = moving.has(name, form.type_name)
    if command and not wanted.commands:
        return left("it moves the robot (--commands plays it)", command=True)
    type_hash, convert = form.type_hash or UNKNOWN_HASH, form.convert
    if convert is None:
        # who does not know the type hands its bytes on; those who do, check them
        with suppress(MessageTypeError):
            convert = registry.hub_check(form.type_name, form.type_hash)
    static = form.type_name == TF_TYPE and name.endswith(STATIC)
    # a command that was kept would move whoever comes late
    qos = Qos(topic.qos.reliability, depth=1) if command else LATCHED if static else topic.qos
    return PlayTopic(topic, name, form.type_name, type_hash, convert, form.definition, qos, command, static)


def twice(topics: Sequence[PlayTopic]) -> set[str]:
    """Names that are played with several types, which no subscriber hears all."""
    kinds: dict[str, set[str]] = {}
    for topic in topics:
        kinds.setdefault(topic.name, set()).add(topic.type_name)
    return {name for name, types in kinds.items() if len(types) > 1}
