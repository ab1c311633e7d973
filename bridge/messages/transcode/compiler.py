"""Compiles the program that converts between a pair of types, or that checks one type.

The program writes fields in the target's order. It reads them sequentially if the source has the same order; if not,
it first scans the whole source structure for their positions.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from bridge.messages.definitions.schema import (
    PRIMITIVE_SIZES,
    STRING_TYPES,
    STRUCT_FORMATS,
    TIME_TYPES,
    DefaultValue,
    Definition,
    FieldType,
    Schema,
    Shape,
    World,
)
from bridge.messages.errors import MessageTypeError
from bridge.messages.transcode.opcodes import MAX_STEP, Op
from bridge.messages.transcode.program import ConversionProgram, Instruction

FieldPath = tuple[str, ...]
FieldPaths = Sequence[tuple[FieldPath, FieldPath]]
Match = Callable[[str, str], FieldPaths]
"""Returns the corresponding fields of a pair of types, as paths in the source and in the target."""

MAX_STEPS = 100_000  # maximum number of fields of a type, including those of each occurrence of its nested types
MAX_DEFAULT = 16 << 20  # maximum bytes of default values in one message


def compile_pair(source: Schema, target: Schema, match: Match) -> ConversionProgram:
    """Compile the program that converts messages of ``source`` into messages of ``target``."""
    compiler = _Compiler(
        source, target, match, ConversionProgram(source.name, source.world is World.ROS2, target.world is World.ROS2)
    )
    compiler.structure(source.root, target.root, ())
    return compiler.program


def compile_check(schema: Schema) -> ConversionProgram:
    """Compile the program that checks messages of a ROS 2 type, and writes them in their normal form."""
    return compile_pair(schema, schema, lambda name, _: [((f.name,), (f.name,)) for f in schema.types[name].fields])


@dataclass(frozen=True, slots=True)
class _Part:
    """A field of a structure: ``wanted`` if it has a counterpart, else to be skipped (source) or filled (target)."""

    path: FieldPath
    type: FieldType
    wanted: bool
    default: DefaultValue | None = None


class _Compiler:
    def __init__(self, source: Schema, target: Schema, match: Match, program: ConversionProgram) -> None:
        self.source = source
        self.target = target
        self.match = match
        self.program = program
        self._defaults = 0
        self._steps = 0
        self._least: dict[str, int] = {}

    def structure(self, source: Definition, target: Definition, at: FieldPath) -> None:
        """Convert the structure ``source`` into ``target``."""
        fields = self.match(source.name, target.name)
        wanted = {path for path, _ in fields}
        origins = {path2: path1 for path1, path2 in fields}
        if self._hidden_member(source, self.source) and self._hidden_member(target, self.target):
            self.program.emit(Instruction(Op.COPY, size=1, field=_name(at)))
            return
        source_parts = list(_parts(source, self.source, wanted, ()))
        target_parts = list(_parts(target, self.target, set(origins), ()))
        order = [part.path for part in source_parts if part.wanted]
        if order == [origins[part.path] for part in target_parts if part.wanted]:
            self._stream(source_parts, target_parts, at)
        else:
            self._reorder(source, wanted, origins, target_parts, at)
        if self._hidden_member(source, self.source):
            self.program.emit(Instruction(Op.SKIP, size=1, field=_name(at)))
        if self._hidden_member(target, self.target):
            self.program.emit(Instruction(Op.ZERO, size=1, field=_name(at)))

    def _hidden_member(self, definition: Definition, schema: Schema) -> bool:
        """Whether a structure has ROS 2's hidden byte, because structures without fields need a member in C and IDL."""
        return not definition.fields and schema.world is World.ROS2

    def _stream(self, source_parts: list[_Part], target_parts: list[_Part], at: FieldPath) -> None:
        """Convert fields that both sides have in the same order."""
        reading = iter(source_parts)
        for part in target_parts:
            if not part.wanted:
                self.default(part.type, part.default, (*at, *part.path))
                continue
            for passed in reading:
                if passed.wanted:
                    self.value(passed.type, part.type, (*at, *passed.path))
                    break
                self.skip(passed.type, (*at, *passed.path))
        for passed in reading:
            self.skip(passed.type, (*at, *passed.path))

    def _reorder(
        self,
        source: Definition,
        wanted: set[FieldPath],
        origins: dict[FieldPath, FieldPath],
        target_parts: list[_Part],
        at: FieldPath,
    ) -> None:
        """Convert fields whose order differs: mark their positions, then read them in the target's order."""
        slots: dict[FieldPath, tuple[int, FieldType]] = {}

        def mark() -> int:
            slot = self.program.new_slot()
            self.program.barrier()
            self.program.emit(Instruction(Op.MARK, link=slot, field=_name(at)))
            return slot

        def walk(definition: Definition, prefix: FieldPath) -> None:
            for field in definition.fields:
                path = (*prefix, field.name)
                if path in wanted:
                    slots[path] = mark(), field.type
                inner = self.source.of(field.type)
                if inner is not None and any(_within(other, path) for other in wanted):
                    walk(inner, path)
                else:
                    self.skip(field.type, (*at, *path))

        walk(source, ())
        end = mark()
        for part in target_parts:
            if part.wanted:
                path = origins[part.path]
                slot, kind = slots[path]
                self._seek(slot, at)
                self.value(kind, part.type, (*at, *path))
            else:
                self.default(part.type, part.default, (*at, *part.path))
        self._seek(end, at)

    def _seek(self, slot: int, at: FieldPath) -> None:
        self.program.barrier()
        self.program.emit(Instruction(Op.SEEK, link=slot, field=_name(at)))
        self.program.barrier()

    def value(self, source: FieldType, target: FieldType, at: FieldPath) -> None:
        """Convert one field."""
        self._step()
        name = _name(at)
        bound = min(filter(None, (_bound(source), _bound(target))), default=0)
        strings = min(filter(None, (source.string_bound, target.string_bound)), default=0)
        match source.shape:
            case Shape.SINGLE:
                self._element(source, target, strings, at)
            case Shape.ARRAY:
                least = self.least(source.element)
                with self.program.loop(Instruction(Op.REPEAT, size=least, bound=source.length, field=name)):
                    self._element(source, target, strings, (*at, ""))
            case Shape.SEQUENCE if source.base == "string":
                self.program.emit(Instruction(Op.STRINGS, size=strings, bound=bound, field=name))
            case Shape.SEQUENCE if source.base == "bool":
                self.program.emit(Instruction(Op.BOOLS, size=1, bound=bound, field=name))
            case Shape.SEQUENCE:
                least = self.least(source.element)
                with self.program.loop(Instruction(Op.LOOP, size=least, bound=bound, field=name)):
                    self._element(source, target, strings, (*at, ""))

    def _element(self, source: FieldType, target: FieldType, strings: int, at: FieldPath) -> None:
        name = _name(at)
        if source.base in TIME_TYPES or target.base in TIME_TYPES:
            self.program.emit(Instruction(Op.COPY, 3, 8, field=name))
        elif source.nested and target.nested:
            self.structure(self.source.types[source.base], self.target.types[target.base], at)
        elif source.base == "string":
            self.program.emit(Instruction(Op.STRING, bound=strings, field=name))
        elif source.base == "wstring":
            # Fast CDR writes a count of UTF-16 units, each in four bytes, and no NUL
            self.program.emit(Instruction(Op.SEQUENCE, 3, 4, strings, field=name))
        elif source.base == "bool":
            self.program.emit(Instruction(Op.BOOL, size=1, field=name))
        else:
            size = PRIMITIVE_SIZES[source.base]
            self.program.emit(Instruction(Op.COPY, size - 1, size, field=name))

    def skip(self, kind: FieldType, at: FieldPath) -> None:
        """Skip one field of the source."""
        self._step()
        name = _name(at)
        if kind.shape is Shape.ARRAY:
            start = Instruction(Op.REPEAT, size=self.least(kind.element), bound=kind.length, field=name)
        elif kind.shape is Shape.SEQUENCE:
            start = Instruction(Op.SKIP_LOOP, size=self.least(kind.element), bound=kind.length, field=name)
        else:
            self._skip_element(kind, at)
            return
        with self.program.loop(start):
            self._skip_element(kind.element, (*at, ""))

    def _skip_element(self, kind: FieldType, at: FieldPath) -> None:
        name = _name(at)
        if kind.base in TIME_TYPES:
            self.program.emit(Instruction(Op.SKIP, 3, 8, field=name))
        elif kind.nested:
            definition = self.source.types[kind.base]
            for field in definition.fields:
                self.skip(field.type, (*at, field.name))
            if self._hidden_member(definition, self.source):
                self.program.emit(Instruction(Op.SKIP, size=1, field=name))
        elif kind.base == "string":
            self.program.emit(Instruction(Op.SKIP_STRING, bound=kind.string_bound, field=name))
        elif kind.base == "wstring":
            self.program.emit(Instruction(Op.SKIP_SEQUENCE, 3, 4, kind.string_bound, field=name))
        else:
            size = PRIMITIVE_SIZES[kind.base]
            self.program.emit(Instruction(Op.SKIP, size - 1, size, field=name))

    def default(self, kind: FieldType, default: DefaultValue | None, at: FieldPath) -> None:
        """Write a field that the source lacks, with the definition's default value, or else empty or zero."""
        self._step()
        if kind.shape is Shape.SINGLE:
            self._default_element(kind, default, at)
        elif kind.shape is Shape.SEQUENCE or isinstance(default, tuple):
            values = default if isinstance(default, tuple) else ()
            if kind.shape is Shape.SEQUENCE:
                self._literal(3, struct.pack("<I", len(values)), at)
            for value in values:
                self._default_element(kind, value, at)
        else:
            before = self._defaults
            with self.program.loop(Instruction(Op.REPEAT, size=-1, bound=kind.length, field=_name(at))):
                self._default_element(kind, None, at)
            self._count_defaults((self._defaults - before) * (kind.length - 1), at)

    def _default_element(self, kind: FieldType, default: DefaultValue | None, at: FieldPath) -> None:
        if kind.base in TIME_TYPES:
            self._literal(3, bytes(8), at)
        elif kind.nested:
            definition = self.target.types[kind.base]
            for field in definition.fields:
                self.default(field.type, field.default, (*at, field.name))
            if self._hidden_member(definition, self.target):
                self._literal(0, bytes(1), at)
        elif kind.base in STRING_TYPES:
            self._literal(3, self._text(kind.base, str(default or "")), at)
        else:
            size = PRIMITIVE_SIZES[kind.base]
            self._literal(size - 1, self._number(kind.base, default, at), at)

    def _number(self, base: str, default: DefaultValue | None, at: FieldPath) -> bytes:
        try:
            return struct.pack("<" + STRUCT_FORMATS[base], default or 0)
        except (struct.error, OverflowError):
            msg = f"{self.target.name} cannot be created: the default {default!r} of {_name(at)} is not a {base}"
            raise MessageTypeError(msg) from None

    def _text(self, base: str, text: str) -> bytes:
        if base == "wstring":
            units = text.encode("utf-16-le")
            units32 = b"".join(units[k : k + 2] + b"\0\0" for k in range(0, len(units), 2))
            return struct.pack("<I", len(units) // 2) + units32
        content = text.encode() + (b"\0" if self.target.world is World.ROS2 else b"")
        return struct.pack("<I", len(content)) + content

    def _literal(self, mask: int, content: bytes, at: FieldPath) -> None:
        self._count_defaults(len(content), at)
        self.program.literal(mask, content, _name(at))

    def _count_defaults(self, size: int, at: FieldPath) -> None:
        self._defaults += size
        if self._defaults > MAX_DEFAULT:
            raise MessageTypeError(
                f"{self.target.name} cannot be created from {self.source.name}: the fields that only the former has, up"
                f" to {_name(at)}, take more than {MAX_DEFAULT} bytes"
            )

    def least(self, kind: FieldType) -> int:
        """Return the minimum size of a source value in bytes, capped at `MAX_STEP`."""
        if kind.shape is Shape.SEQUENCE:
            return 4
        if kind.base in TIME_TYPES:
            size = 8
        elif kind.nested:
            size = self._least_of(kind.base)
        else:
            size = 4 if kind.base in STRING_TYPES else PRIMITIVE_SIZES[kind.base]
        return min(size * (kind.length if kind.shape is Shape.ARRAY else 1), MAX_STEP)

    def _least_of(self, name: str) -> int:
        if name not in self._least:
            definition = self.source.types[name]
            size = sum(self.least(field.type) for field in definition.fields)
            self._least[name] = size + self._hidden_member(definition, self.source)
        return self._least[name]

    def _step(self) -> None:
        """Count a field; raises `MessageTypeError` for a type with too many, which would take too long to compile."""
        self._steps += 1
        if self._steps > MAX_STEPS:
            msg = f"{self.program.name} is too large to be converted: it has more than {MAX_STEPS} fields in all"
            raise MessageTypeError(msg)


def _parts(definition: Definition, schema: Schema, wanted: set[FieldPath], prefix: FieldPath) -> Iterator[_Part]:
    """Yield a structure's fields in byte order; a nested structure is expanded if only fields of it are wanted."""
    for field in definition.fields:
        path = (*prefix, field.name)
        inner = schema.of(field.type)
        if path in wanted:
            yield _Part(path, field.type, wanted=True)
        elif inner is not None and any(_within(other, path) for other in wanted):
            yield from _parts(inner, schema, wanted, path)
        else:
            yield _Part(path, field.type, wanted=False, default=field.default)


def _within(path: FieldPath, outer: FieldPath) -> bool:
    return len(path) > len(outer) and path[: len(outer)] == outer


def _bound(kind: FieldType) -> int:
    return kind.length if kind.shape is Shape.SEQUENCE else 0


def _name(path: FieldPath) -> str:
    """Format ``("transforms", "", "header")`` as ``transforms[].header``."""
    return "".join(f".{step}" if step else "[]" for step in path).removeprefix(".")
