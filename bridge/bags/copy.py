"""Copies a bag into another format, or copies a part of a bag, or what is readable of a damaged bag."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import chain
from operator import attrgetter
from pathlib import Path
from typing import TypeVar

from bridge.bags.bag import Bag, BagError, BagMessage, BagTopic, Columns, Kind, in_columns
from bridge.bags.conversion import FileTopics, TopicForm, to_hub, to_ros1
from bridge.bags.known_types import misfits
from bridge.bags.mcap_copy import McapCopy, Ros2Mcap
from bridge.bags.mcap_reader import McapBag
from bridge.bags.rows import Lists
from bridge.bags.writers import COMPRESSIONS, BagWriter, check_compression, complete_file, open_writer
from bridge.messages.definitions.schema import World
from bridge.messages.errors import ConversionError
from bridge.messages.registry import Registry
from bridge.routing.rules import NameFilter

_LATCHED_DEPTH = 100
_FOREVER = 1 << 64


@dataclass(frozen=True)
class BagSelection:
    """The messages to copy.

    Attributes:
        names: a filter of topic names.
        start_ns, end_ns: ``start_ns <= time < end_ns``.
        latched: also copy the last messages of latched topics before the start, with the start as their time.
    """

    names: NameFilter | None = None
    start_ns: int | None = None
    end_ns: int | None = None
    latched: bool = False

    def chosen(self, bag: Bag) -> list[BagTopic]:
        """Return the selected topics of a bag; raises `BagError` for a name that matches no topic."""
        if self.names is None:
            return list(bag.topics)
        for name in self.names.idle(topic.name for topic in bag.topics):
            raise BagError(bag.path, f"has no topic {name}", None, "'midspan bag info' lists them")
        return [topic for topic in bag.topics if self.names.matches(topic.name)]


@dataclass
class UndefinedTopic:
    """A topic of a type without a definition: number of its messages, the reason and the cure."""

    type_name: str
    reason: str
    cure: str
    messages: int = 0


@dataclass
class CopyResult:
    """The result of a copy.

    Attributes:
        messages: number of copied messages.
        data: size of their data in bytes, as read; for chunks that are copied as they are, including record headers.
        unknown: topics that were left out because the format cannot hold them, with the reason.
        refused: number of messages by topic that were left out because their bytes do not match their type.
        lost: fields of ROS 1 types without a counterpart in ROS 2, by type.
        damage: the damaged places that were skipped.
        renamed: new names of topics, by their names in the bag.
        undefined: topics whose messages were copied without a definition, which readers need to decode them.
        left_out: texts that name topics of other encodings, which were not copied.
    """

    messages: int = 0
    data: int = 0
    unknown: dict[str, str] = field(default_factory=dict)
    refused: dict[str, int] = field(default_factory=dict)
    lost: dict[str, tuple[str, ...]] = field(default_factory=dict)
    damage: list[BagError] = field(default_factory=list)
    renamed: dict[str, str] = field(default_factory=dict)
    undefined: dict[str, UndefinedTopic] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()


Convert = Callable[[bytes], bytes]

Block = TypeVar("Block")

OnProgress = Callable[[int, int], None]
"""Receives the progress: messages and bytes so far."""


def _quiet(_messages: int, _data: int) -> None:
    """Ignore the progress."""


def convert(
    bag: Bag, target: Path, kind: Kind, registry: Registry, choice: BagSelection = BagSelection(),
    compression: str = "", *, skip_unknown: bool = False, skip_bad: bool = False, on_progress: OnProgress = _quiet,
) -> CopyResult:  # fmt: skip
    """Copy a bag into any format, using the bridge's conversions between ROS 1 and ROS 2.

    Raises `BagError` for a topic that the format cannot hold (unless ``skip_unknown``), a message that does not match
    its type (unless ``skip_bad``), a damaged bag, and a target that exists or cannot be written.
    """
    done = CopyResult()
    _check_sound(bag)
    forms: dict[BagTopic, TopicForm] = {}
    topics = FileTopics(bag.path)
    chosen = choice.chosen(bag)
    unfit = misfits(bag, chosen, registry)
    for topic in chosen:
        try:
            if topic in unfit:
                raise unfit[topic]
            form = (to_ros1 if kind == "bag" else to_hub)(registry, topic, bag.path)
            if kind != "bag":
                topics.add(topic, form)
        except BagError as err:
            if not skip_unknown:
                more = "; " if err.cure else ""
                raise BagError(bag.path, err.what, None, f"{err.cure}{more}--skip-unknown leaves it out") from None
            done.unknown[topic.name] = err.what
        else:
            forms[topic] = form
            if form.left_out:
                done.lost[topic.type_name] = form.left_out
            if form.name not in ("", topic.name):
                done.renamed[topic.name] = form.name
            if form.undefined is not None:
                reason = form.undefined
                done.undefined.setdefault(topic.name, UndefinedTopic(topic.type_name, reason.what, reason.cure))
    check_compression(target, kind, compression or COMPRESSIONS[kind][0])
    with complete_file(target, kind) as temporary:
        usual = compression or COMPRESSIONS[kind][0]
        columns = _columns(bag, list(forms), choice)
        _copy(bag, _writer(temporary, kind, usual), forms, columns, done, skip_bad=skip_bad, on_progress=on_progress)
    done.left_out = bag.left_out
    return done


def cut(
    bag: Bag, target: Path, choice: BagSelection = BagSelection(), compression: str = "", *, mend: bool = False,
    on_progress: OnProgress = _quiet,
) -> CopyResult:  # fmt: skip
    """Copy a part of a bag into the same format, without changing messages and types.

    Topics of other encodings are copied from a single MCAP file, unless the topics are chosen by name. With ``mend``,
    damaged data is left out and listed in `CopyResult.damage`. Raises `BagError`.
    """
    done = CopyResult()
    if not mend:
        _check_sound(bag)
    if mend:
        bag.skip_damage(done.damage.append)
    if mend and bag.trouble is not None:
        done.damage.append(bag.trouble)
    forms = {topic: TopicForm(topic.type_name, topic.type_hash, topic.definition, None) for topic in choice.chosen(bag)}
    if bag.kind == "mcap" and not isinstance(bag, McapBag) and any(t.world is World.ROS1 for t in forms):
        raise BagError(bag.path, "is a folder of ROS 1's MCAP", None, "cut or mend its files one by one")
    usual = bag.compression if bag.compression in COMPRESSIONS[bag.kind] else COMPRESSIONS[bag.kind][0]
    packing = compression or usual
    columns = _columns(bag, list(forms), choice)
    check_compression(target, bag.kind, packing)
    with complete_file(target, bag.kind) as temporary:
        if isinstance(bag, McapBag) and choice.names is None:
            copier = McapCopy(temporary, packing, bag)
            if mend or choice.latched:
                _copy_all(bag, copier, choice, done, on_progress, mend=mend)
            else:
                _copy_chunks(bag, copier, choice, packing, done, on_progress)
        else:
            writer = (
                McapCopy(temporary, packing, bag) if isinstance(bag, McapBag) else _writer(temporary, bag.kind, packing)
            )
            _copy(
                bag,
                writer,
                forms,
                _without_damage(columns, done.damage) if mend else columns,
                done,
                on_progress=on_progress,
            )
            done.left_out = bag.left_out
    done.damage[:] = {str(err): err for err in done.damage}.values()  # a chunk may have been read twice
    return done


def _writer(path: Path, kind: Kind, compression: str) -> BagWriter:
    return Ros2Mcap(path, compression) if kind == "mcap" else open_writer(path, kind, compression)


def _check_sound(bag: Bag) -> None:
    """Raise the error of a damaged bag, unless only its end is missing; such a bag is read up to there."""
    if bag.trouble is not None and not bag.unfinished:
        raise BagError(bag.trouble.path, bag.trouble.what, bag.trouble.offset, "'midspan bag mend' saves the rest")


def _copy_chunks(
    bag: McapBag, copier: McapCopy, choice: BagSelection, compression: str, done: CopyResult, on_progress: OnProgress
) -> None:
    """Copy all channels, even those of other encodings.

    Chunks that lie within the times and have the target's compression are copied as they are.
    """
    start = 0 if choice.start_ns is None else choice.start_ns
    end = _FOREVER if choice.end_ns is None else choice.end_ns
    try:
        for number in bag.channels:
            copier.add_number(number)
        for span in bag.spans():
            if span.end < start or span.start >= end:
                continue
            inside = start <= span.start and span.end < end
            chunk = bag.whole_chunk(span) if inside else None
            if chunk is not None and (chunk.compression or "none") == compression:
                copier.copy_chunk(chunk)
                done.messages += sum(chunk.counts.values())
                done.data += chunk.size
            else:
                for block in bag.span_rows(span).within(start, end).blocks():
                    copier.write(*block.lists())
                    done.messages += len(block.table)
                    done.data += int(block.table[:, 4].sum())
            on_progress(done.messages, done.data)
        copier.finish()
    except BaseException:
        copier.abandon()
        raise


def _copy_all(
    bag: McapBag, copier: McapCopy, choice: BagSelection, done: CopyResult, on_progress: OnProgress, *, mend: bool
) -> None:
    """Copy the messages of all channels, even those of other encodings."""
    blocks = map(bag.lists, bag.blocks(bag.channels.keys(), choice.start_ns, choice.end_ns))
    try:
        for number in bag.channels:
            copier.add_number(number)
        for block in chain(_latched_lists(bag, choice), _without_damage(blocks, done.damage) if mend else blocks):
            copier.write(*block)
            done.messages += len(block[3])
            done.data += sum(map(len, block[3]))
            on_progress(done.messages, done.data)
        copier.finish()
    except BaseException:
        copier.abandon()
        raise


def _latched_lists(bag: McapBag, choice: BagSelection) -> Iterator[Lists]:
    """Yield the latched messages from before the start, if they are wanted."""
    if choice.latched and choice.start_ns is not None:
        numbers = {topic: number for number, topic in bag.topic_of.items()}
        for block in in_columns(_latched_before(bag, list(bag.topics), choice.start_ns)):
            yield [numbers[topic] for topic in block.topics], [*block.times], [*block.publish_times], [*block.data]


def _without_damage(blocks: Iterator[Block], damage: list[BagError]) -> Iterator[Block]:
    try:
        yield from blocks
    except BagError as err:
        damage.append(err)


def _columns(bag: Bag, topics: list[BagTopic], choice: BagSelection) -> Iterator[Columns]:
    columns = bag.columns(topics, choice.start_ns, choice.end_ns)
    if not choice.latched or choice.start_ns is None:
        return columns
    return chain(in_columns(_latched_before(bag, topics, choice.start_ns)), columns)


def _latched_before(bag: Bag, topics: list[BagTopic], start_ns: int) -> list[BagMessage]:
    latched = [topic for topic in topics if topic.qos.latched]
    last: dict[BagTopic, deque[BagMessage]] = {
        topic: deque(maxlen=min(topic.qos.depth, _LATCHED_DEPTH)) for topic in latched
    }
    for message in bag.messages(latched, None, start_ns):
        last[message.topic].append(message)
    messages = [message._replace(time_ns=start_ns) for messages_ in last.values() for message in messages_]
    return sorted(messages, key=attrgetter("publish_ns"))


def _copy(
    bag: Bag, writer: BagWriter, forms: dict[BagTopic, TopicForm], columns: Iterator[Columns], done: CopyResult,
    *, skip_bad: bool = False, on_progress: OnProgress,
) -> None:  # fmt: skip
    try:
        handles = {topic: writer.add(topic, form) for topic, form in forms.items()}
        changes = {topic: form.convert for topic, form in forms.items()}
        for block in columns:
            try:
                data = _convert_all(block, changes)
            except ConversionError:
                block, data = _valid_only(bag, block, changes, done, skip_bad=skip_bad)
            writer.write([handles[topic] for topic in block.topics], block.times, block.publish_times, data)
            done.messages += len(data)
            done.data += sum(map(len, block.data))
            if done.undefined:
                for topic, count in Counter(block.topics).items():
                    if topic.name in done.undefined:
                        done.undefined[topic.name].messages += count
            on_progress(done.messages, done.data)
        writer.finish()
    except BaseException:
        writer.abandon()
        raise


def _convert_all(block: Columns, changes: Mapping[BagTopic, Convert | None]) -> list[bytes]:
    """Return the messages' data in the forms of their topics; raises `ConversionError`."""
    pairs = zip(map(changes.__getitem__, block.topics), block.data, strict=True)
    return [data if change is None else change(data) for change, data in pairs]


def _valid_only(
    bag: Bag, block: Columns, changes: Mapping[BagTopic, Convert | None], done: CopyResult, *, skip_bad: bool
) -> tuple[Columns, list[bytes]]:
    """Return the messages that match their types, and their converted data.

    The others are counted and left out; without ``skip_bad``, raise `BagError` for the first of them.
    """
    sound, converted = list[BagMessage](), list[bytes]()
    for message in map(BagMessage, *block):
        topic, change = message.topic, changes[message.topic]
        try:
            converted.append(message.data if change is None else change(message.data))
            sound.append(message)
        except ConversionError as err:
            if not skip_bad:
                problem = f"a message of {topic.name} at {message.time_ns} ns is bad: {err}"
                raise BagError(bag.path, problem, None, "--skip-bad leaves it out") from None
            done.refused[topic.name] = done.refused.get(topic.name, 0) + 1
    return Columns(*zip(*sound, strict=True)) if sound else Columns((), (), (), ()), converted
