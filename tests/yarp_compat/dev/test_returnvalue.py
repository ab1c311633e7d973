"""Outcomes of calls, as in YARP's bindings."""

from __future__ import annotations

from yarp_compat.dev.returnvalue import OK, ReturnCode, ReturnValue


def test_outcomes_have_the_numbers_and_names_of_the_bindings() -> None:
    failed = ReturnValue(ReturnCode.METHOD_FAILED)
    number = getattr(ReturnValue, "return_code_return_value_error_method_failed")  # noqa: B009 - set from a table
    assert number == int.from_bytes(b"err5", "little")
    assert failed == number
    assert hash(failed) == hash(number), "equal objects have equal hashes"
    assert failed.isEqual(number)
    assert ReturnValue(number) == failed
    assert failed.toString() == "return_value_error_method_failed"
    assert not ReturnValue()
    assert ReturnValue().toString() == "return_value_uninitialized"
    outcome = ReturnValue(OK)
    outcome &= failed
    outcome &= OK
    assert outcome == failed
