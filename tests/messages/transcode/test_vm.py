"""The virtual machine, compiled and as Python, where an access out of bounds raises IndexError."""

from __future__ import annotations

import random
import struct
import sys
import threading
import time
from typing import Any

import pytest

from bridge.messages.registry import Registry
from bridge.messages.transcode import vm
from bridge.messages.transcode.opcodes import FRAMES, SLOTS, Op
from bridge.messages.transcode.program import ConversionProgram, Instruction
from tests.messages.transcode.programs import TYPES, damaged, programs
from tests.support.uncompiled import uncompiled

FORMS = pytest.mark.parametrize("form", [vm, uncompiled("bridge.messages.transcode.vm")], ids=["imported", "as Python"])
ROUNDS = 400


def ready(form: Any, program: ConversionProgram) -> Any:
    """Return a program in one form of the machine, which raises `ValueError` with a fault's numbers."""
    return form.VirtualMachine(*program.assemble(), ValueError)


def outcome(form: Any, program: ConversionProgram, message: bytes, way: str) -> bytes | str:
    """Return the converted message, or the error's text."""
    try:
        converted: bytes = getattr(ready(form, program), way)(message)
    except ValueError as err:
        return str(err)
    return converted


@pytest.mark.parametrize("name", TYPES)
def test_compiled_and_python_forms_agree_on_damaged_messages(name: str, registry: Registry):
    dice = random.Random(7)
    accepted = refused = 0
    for program, good in programs(registry, name):
        method = "check" if program.source_cdr and program.target_cdr else "convert"
        forms = [getattr(ready(form, program), method) for form in (vm, uncompiled("bridge.messages.transcode.vm"))]
        for _ in range(ROUNDS):
            message = damaged(good, dice)
            outcomes = []
            for run in forms:
                try:
                    outcomes.append(run(message))
                except ValueError as err:
                    outcomes.append(err.args)
            assert outcomes[0] == outcomes[1]
            accepted += isinstance(outcomes[0], bytes)
            refused += isinstance(outcomes[0], tuple)
    assert accepted > 50
    assert refused > 50


@FORMS
def test_loops_nest_as_deep_as_a_program_may(form: Any):
    program = ConversionProgram("deep", source_cdr=False, target_cdr=False)

    def nest(depth: int) -> None:
        with program.loop(Instruction(Op.LOOP, size=4)):
            if depth > 1:
                nest(depth - 1)
            else:
                program.emit(Instruction(Op.STRING))

    nest(FRAMES)
    message = struct.pack("<I", 2) + struct.pack("<I", 1) * FRAMES + b"a" + struct.pack("<I", 1) * FRAMES + b"b"
    assert outcome(form, program, message, "convert") == message


@FORMS
def test_a_program_may_store_the_maximum_number_of_positions(form: Any):
    program = ConversionProgram("reversed", source_cdr=False, target_cdr=False)
    slots = [program.new_slot() for _ in range(SLOTS)]
    for slot in slots:
        program.emit(Instruction(Op.MARK, link=slot))
        program.emit(Instruction(Op.SKIP, size=1))
        program.barrier()
    for slot in reversed(slots[:-1]):
        program.emit(Instruction(Op.SEEK, link=slot))
        program.emit(Instruction(Op.COPY, size=1))
        program.barrier()
    program.emit(Instruction(Op.SEEK, link=slots[-1]))
    program.emit(Instruction(Op.COPY, size=1))
    message = bytes(range(SLOTS))
    assert outcome(form, program, message, "convert") == message[-2::-1] + message[-1:]


@pytest.mark.skipif(vm.__file__.endswith(".py"), reason="the uncompiled machine keeps the GIL")
def test_large_messages_are_converted_while_other_threads_run():
    program = ConversionProgram("blob", source_cdr=False, target_cdr=True)
    program.emit(Instruction(Op.SEQUENCE, size=1))
    convert = ready(vm, program).convert
    message = struct.pack("<I", 1 << 24) + bytes(1 << 24)
    before = sys.getswitchinterval()
    ran, go = threading.Event(), threading.Event()
    thread = threading.Thread(target=lambda: go.wait() and ran.set(), name="other")
    thread.start()
    try:
        sys.setswitchinterval(100.0)  # so that this thread keeps the GIL unless `convert` releases it
        go.set()
        end = time.monotonic() + 40  # without pauses, which would release the GIL, too
        while not ran.is_set() and time.monotonic() < end:
            convert(message)
        assert ran.is_set()
    finally:
        sys.setswitchinterval(before)
        thread.join()


def test_output_of_another_size_is_rejected():
    """Otherwise, a fault in the machine would expose old memory content."""
    program = ConversionProgram("blob", source_cdr=False, target_cdr=False)
    program.emit(Instruction(Op.COPY, size=3))
    python = uncompiled("bridge.messages.transcode.vm")
    runner = ready(python, program)
    with pytest.raises(SystemError, match="measured as 4 bytes wrote 3"):
        runner._write(b"abc", 4)
    with pytest.raises(SystemError, match="measured as 2 bytes wrote more"):
        runner._write(b"abc", 2)


def words(*steps: tuple[int, ...], flags: int = 0) -> bytes:
    """Return a program in memory; numbers that are not given are 0."""
    flat = [flags]
    for step in (*steps, (Op.END,)):
        flat += [*step, *[0] * (5 - len(step))]
    return struct.pack(f"={len(flat)}q", *flat)


BAD = {
    "nothing": b"",
    "flags alone": struct.pack("=q", 0),
    "no end": words((Op.COPY,))[:-40],
    "a cut step": words((Op.COPY,))[:-8],
    "an end within": words((Op.END,), (Op.COPY,)),
    "other flags": words(flags=4),
    "an unknown step": words((18,)),
    "a step below 0": words((-1,)),
    "a mask that is none": words((Op.COPY, 2, 8)),
    "a size below 0": words((Op.COPY, 0, -1)),
    "a size too large": words((Op.SEQUENCE, 0, (1 << 30) + 1)),
    "a bound below 0": words((Op.REPEAT, 0, 1, -1, 2), (Op.NEXT, 0, 0, 0, 1)),
    "bools of two bytes": words((Op.BOOLS, 0, 2)),
    "a slot too far": words((Op.MARK, 0, 0, 0, SLOTS)),
    "a slot below 0": words((Op.MARK, 0, 0, 0, -1)),
    "a slot that is empty": words((Op.SEEK, 0, 0, 0, 3)),
    "a slot filled in a loop": words(
        (Op.LOOP, 0, 1, 0, 3), (Op.MARK, 0, 0, 0, 3), (Op.NEXT, 0, 0, 0, 1), (Op.SEEK, 0, 0, 0, 3)
    ),
    "a literal too far": words((Op.LITERAL, 0, 2, 0, 7)),
    "a literal below 0": words((Op.LITERAL, 0, 2, 0, -1)),
    "the end of no loop": words((Op.NEXT,)),
    "a loop without end": words((Op.LOOP, 0, 1, 0, 1)),
    "a loop to elsewhere": words((Op.LOOP, 0, 1, 0, 9), (Op.COPY, 0, 1), (Op.NEXT, 0, 0, 0, 1)),
    "a loop from elsewhere": words((Op.LOOP, 0, 1, 0, 3), (Op.COPY, 0, 1), (Op.NEXT, 0, 0, 0, 0)),
    "loops too deep": words(
        *((Op.LOOP, 0, 4, 0, 2 * (FRAMES + 1) - k) for k in range(FRAMES + 1)),
        *((Op.NEXT, 0, 0, 0, FRAMES + 1 - k) for k in range(FRAMES + 1)),
    ),
}


@FORMS
@pytest.mark.parametrize("case", BAD)
def test_a_program_that_would_leave_its_memory_is_refused(form: Any, case: str):
    with pytest.raises((ValueError, TypeError)):
        form.VirtualMachine(BAD[case], b"literals", ValueError)


@FORMS
def test_uninitialized_program_does_not_crash(form: Any):
    with pytest.raises((TypeError, AttributeError)):
        form.VirtualMachine.__new__(form.VirtualMachine).convert(b"")
