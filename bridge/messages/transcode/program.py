"""Conversion programs: instructions for `bridge.messages.transcode.vm`, gathered and laid out in memory."""

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
    """One instruction, and the field that it is about."""

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
    source_cdr: bool  #: whether it reads CDR; else ROS 1's format
    target_cdr: bool
    instructions: list[Instruction] = field(default_factory=list)
    _literals: bytearray = field(default_factory=bytearray)
    _barrier: int = 0
    _depth: int = 0
    _slots: int = 0

    def emit(self, instruction: Instruction) -> None:
        """Add an instruction; runs of plain bytes become one."""
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
        """Write fixed bytes."""
        if any(content):
            self.emit(Instruction(Op.LITERAL, mask, len(content), link=len(self._literals), field=name))
            self._literals += content
        else:
            self.emit(Instruction(Op.ZERO, mask, len(content), field=name))

    @contextmanager
    def loop(self, start: Instruction) -> Iterator[None]:
        """Instructions made within are repeated; ``start`` is a LOOP, SKIP_LOOP or REPEAT."""
        self._depth += 1
        if self._depth > FRAMES:
            msg = f"{self.name} is too deep to be converted: sequences within sequences more than {FRAMES} times"
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
        """A slot to remember a read position in."""
        if self._slots >= SLOTS:
            raise MessageTypeError(f"{self.name} cannot be converted: more than {SLOTS} fields in another order")
        self._slots += 1
        return self._slots - 1

    def barrier(self) -> None:
        """Keep what comes from being joined with what was."""
        self._barrier = len(self.instructions)

    def assemble(self) -> tuple[bytes, bytes]:
        """The program as the virtual machine takes it: a word of flags and the instructions; the literals."""
        code = [self.source_cdr * SOURCE_CDR + self.target_cdr * TARGET_CDR]
        for instruction in (*self.instructions, Instruction(Op.END)):
            code += [instruction.op, instruction.mask, instruction.size, instruction.bound, instruction.link]
        return struct.pack(f"={len(code)}q", *code), bytes(self._literals)

    def field_of(self, number: int) -> str:
        """Path of the field that an instruction is about, "" past the end."""
        return self.instructions[number].field if number < len(self.instructions) else ""


def _joins(last: Instruction, new: Instruction) -> bool:
    """Whether ``new`` always follows ``last`` without padding."""
    return new.mask <= last.mask and last.size % (new.mask + 1) == 0


def _flatten(start: Instruction, body: Instruction) -> bool:
    """Make a loop over plain bytes one instruction, where the elements follow each other without padding."""
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
