"""Constraints of goals as text."""

import math

import pytest

from navigation.constraints import Constraints


def test_they_come_back_from_their_text():
    given = Constraints(
        max_lin_speed=0.2, tolerance_lin=0.1, tolerance_ang=5.0, on_obstacle="wait", heading=False, through=True
    )
    assert given.to_text() == (
        "midspan: max_lin_speed=0.2 tolerance_lin=0.1 tolerance_ang=5.0 on_obstacle=wait heading=false through=true"
    )
    assert Constraints.from_text(given.to_text()) == given
    every = Constraints(1.0, 0.1, 2.0, 0.2, 3.0, 0.3, 4.0, 0.4, "around", heading=False, through=True, map="house")
    assert Constraints.from_text(every.to_text()) == every


def test_nothing_said_is_no_text_and_other_texts_say_nothing():
    assert Constraints().to_text() == ""
    assert Constraints.from_text("") == Constraints()
    assert Constraints.from_text("navigate_w_replanning.xml") == Constraints()


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("midspan: speed=1", "'speed' is no constraint"),
        ("midspan: max_lin_speed=fast", "max_lin_speed is a number, not 'fast'"),
        ("midspan: max_lin_speed=nan", "at least 0"),
        ("midspan: tolerance_ang=-1", "at least 0"),
        ("midspan: heading=maybe", "true or false"),
        ("midspan: on_obstacle=ram", "'wait' or 'around'"),
    ],
)
def test_what_cannot_be_is_refused_with_the_reason(text, why):
    with pytest.raises(ValueError, match=why):
        Constraints.from_text(text)


def test_a_map_is_one_word():
    with pytest.raises(ValueError, match="no spaces"):
        Constraints(map="my house")


def test_numbers_are_checked_where_they_are_made():
    with pytest.raises(ValueError, match="max_lin_speed"):
        Constraints(max_lin_speed=math.inf)
