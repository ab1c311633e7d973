"""Conversion programs: collects instructions for `bridge.messages.transcode.vm`, and lays them out in memory."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from bridge.messages.errors import MessageTypeError
from bridge.messages.transcode.opcodes import FRAMES, MAX_INSTRUCTIONS, MAX_STEP, SLOTS, SOURCE_CDR, TARGET_CDR, Op

_FUSED = (Op.COPY, Op.SKIP, Op.ZERO)


@dataclass(slots=True)
class Instruction:
    """One instruction, and the path of the field that it handles."""

    op: Op
    mask: int = 0
    size: int = 0
    bound: int = 0
    link: int = 0
    field: str = ""


@dataclass(slots=True)
class ConversionProgram:
    """A program under construction."""

    name: str
    source_cdr: bool  #: whether the program reads CDR, else the ROS 1 serialization
    target_cdr: bool
    instructions: list[Instruction] = field(default_factory=list)
    _literals: bytearray = field(default_factory=bytearray)
    _barrier: int = 0
    _depth: int = 0
    _slots: int = 0

    def emit(self, instruction: Instruction) -> None:
        """Add an instruction; consecutive instructions over plain bytes are joined into one."""
        if instruction.size > MAX_STEP:
            msg = f"{self.name} cannot be converted: field {instruction.field} is larger than {MAX_STEP} bytes"
            raise MessageTypeError(msg)
        last = self.instructions[-1] if len(self.instructions) > self._barrier else None
        if last is not None and last.op is instruction.op and instruction.op in _FUSED and _joins(last, instruction):
            last.size += instruction.size
            if last.size <= MAX_STEP:
                return
            last.size -= instruction.size
        if len(self.instructions) >= MAX_INSTRUCTIONS:
            raise MessageTypeError(f"{self.name} is too large to be converted: more than {MAX_INSTRUCTIONS} steps")
        self.instructions.append(instruction)

    def literal(self, mask: int, content: bytes, name: str) -> None:
        """Add an instruction that writes fixed bytes."""
        if any(content):
            self.emit(Instruction(Op.LITERAL, mask, len(content), link=len(self._literals), field=name))
            self._literals += content
        else:
            self.emit(Instruction(Op.ZERO, mask, len(content), field=name))

    @contextmanager
    def loop(self, start: Instruction) -> Iterator[None]:
        """Repeat the instructions that are added within the context; ``start`` is a LOOP, SKIP_LOOP or REPEAT."""
        self._depth += 1
        if self._depth > FRAMES:
            msg = f"{self.name} is too deep to be converted: sequences are nested more than {FRAMES} deep"
            raise MessageTypeError(msg)
        outer = self._barrier
        self.barrier()
        self.emit(start)
        self.barrier()
        body = len(self.instructions)
        yield
        self._depth -= 1
        if len(self.instructions) == body + 1 and _flatten(start, self.instructions[body]):
            del self.instructions[body - 1 :]
            self._barrier = outer
            self.emit(start)
            return
        self.barrier()
        self.emit(Instruction(Op.NEXT, link=body, field=start.field))
        self.barrier()
        start.link = len(self.instructions)

    def new_slot(self) -> int:
        """Return a new slot for a read position."""
        if self._slots >= SLOTS:
            raise MessageTypeError(f"{self.name} cannot be converted: more than {SLOTS} fields in a different order")
        self._slots += 1
        return self._slots - 1

    def barrier(self) -> None:
        """Prevent later instructions from being joined with earlier ones."""
        self._barrier = len(self.instructions)

    def assemble(self) -> tuple[bytes, bytes]:
        """Return the virtual machine's arguments: a word of flags with the instructions, and the literals."""
        code = [self.source_cdr * SOURCE_CDR + self.target_cdr * TARGET_CDR]
        for instruction in (*self.instructions, Instruction(Op.END)):
            code += [instruction.op, instruction.mask, instruction.size, instruction.bound, instruction.link]
        return struct.pack(f"={len(code)}q", *code), bytes(self._literals)

    def field_of(self, number: int) -> str:
        """Return the path of the field that an instruction handles; "" past the end."""
        return self.instructions[number].field if number < len(self.instructions) else ""


def _joins(last: Instruction, new: Instruction) -> bool:
    """Whether ``new`` always follows ``last`` without padding."""
    return new.mask <= last.mask and last.size % (new.mask + 1) == 0


def _flatten(start: Instruction, body: Instruction) -> bool:
    """Turn a loop over plain bytes into one instruction if its elements have no padding; return whether it did."""
    if body.op not in _FUSED or body.size % (body.mask + 1):
        return False
    if start.op is Op.LOOP and body.op is Op.COPY:
        start.op = Op.SEQUENCE
    elif start.op is Op.SKIP_LOOP and body.op is Op.SKIP:
        start.op = Op.SKIP_SEQUENCE
    elif start.op is Op.REPEAT:
        start.op, start.size, start.mask, start.bound = body.op, body.size * start.bound, body.mask, 0
        return True
    else:
        return False
    start.size, start.mask = body.size, body.mask
    return True
