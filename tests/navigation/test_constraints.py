"""Constraints of goals as text."""

import math

import pytest

from navigation.constraints import Constraints


def test_constraints_survive_the_round_trip_through_text():
    given = Constraints(
        max_lin_speed=0.2, tolerance_lin=0.1, tolerance_ang=5.0, on_obstacle="wait", heading=False, through=True
    )
    assert given.to_text() == (
        "midspan: max_lin_speed=0.2 tolerance_lin=0.1 tolerance_ang=5.0 on_obstacle=wait heading=false through=true"
    )
    assert Constraints.from_text(given.to_text()) == given
    every = Constraints(
        1.0, 0.1, 2.0, 0.2, 3.0, 0.3, 4.0, 0.4, "around", "first floor", heading=False, through=True, map="house"
    )
    assert Constraints.from_text(every.to_text()) == every


def test_no_constraints_give_no_text_and_other_texts_give_no_constraints():
    assert Constraints().to_text() == ""
    assert Constraints.from_text("") == Constraints()
    assert Constraints.from_text("navigate_w_replanning.xml") == Constraints()


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("midspan: speed=1", "unknown constraint 'speed'"),
        ("midspan: max_lin_speed=fast", "max_lin_speed must be a number, not 'fast'"),
        ("midspan: max_lin_speed=nan", "at least 0"),
        ("midspan: tolerance_ang=-1", "at least 0"),
        ("midspan: heading=maybe", "true or false"),
        ("midspan: on_obstacle=ram", "'wait' or 'around'"),
    ],
)
def test_invalid_texts_are_rejected_with_the_reason(text, reason):
    with pytest.raises(ValueError, match=reason):
        Constraints.from_text(text)


def test_a_map_name_with_spaces_is_rejected():
    with pytest.raises(ValueError, match="must not have spaces"):
        Constraints(map="my house")


def test_the_constructor_checks_numbers():
    with pytest.raises(ValueError, match="max_lin_speed"):
        Constraints(max_lin_speed=math.inf)
