"""The ends of goals that a planner received from its own clients."""

from __future__ import annotations

from bridge.messages.actions import GoalState
from navigation.gateway.foreign import ForeignEnd, ForeignGoals, GoalMark
from navigation.gateway.goal_list import GoalList
from navigation.status import State

FIRST, SECOND = b"the first goal..", b"the second goal."


class Seen:
    """A planner's lists, as the gateway reads them."""

    def __init__(self) -> None:
        self.mark = GoalMark("test")
        self.goals = ForeignGoals(self.mark, "lost")
        self._list = GoalList(always=True)

    def read(self, statuses: dict[bytes, GoalState]) -> ForeignEnd | None:
        """Read a list; return the end that it shows."""
        self._list.receive(b"publisher", statuses)
        self.goals.update(self._list)
        end, self.goals.end = self.goals.end, None
        return end


def test_a_goal_that_no_list_showed_as_active_ends():
    seen = Seen()
    assert seen.read({FIRST: GoalState.ABORTED}) is None, "it ended before the gateway started"
    ended = {FIRST: GoalState.ABORTED, SECOND: GoalState.SUCCEEDED}
    assert seen.read(ended) == ForeignEnd(SECOND, State.REACHED, "")
    assert seen.read(ended) is None, "it ends once"


def test_the_later_of_two_goals_that_end_together_counts():
    seen = Seen()
    seen.read({FIRST: GoalState.EXECUTING})
    assert seen.read({FIRST: GoalState.ABORTED, SECOND: GoalState.SUCCEEDED}) == ForeignEnd(SECOND, State.REACHED, "")


def test_own_goals_and_ends_while_the_list_was_invalid_do_not_count():
    seen = Seen()
    seen.read({})
    assert seen.read({seen.mark.new_id(): GoalState.SUCCEEDED}) is None
    seen.goals.doubt()
    assert seen.read({SECOND: GoalState.SUCCEEDED}) is None
