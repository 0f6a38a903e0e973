"""Designs that no other beats, against every pair of them compared."""

import numpy as np
import pandas as pd
import pytest

from diffsea import UserError
from diffsea.studies.front import front, goals_of, unbeaten


@pytest.mark.parametrize("goals", [1, 2, 3])
def test_a_design_is_kept_where_no_other_dominates_it(goals):
    costs = np.random.default_rng(goals).integers(0, 12, (200, goals)).astype(float)
    costs = np.unique(costs, axis=0)
    below = (costs[:, None] <= costs).all(-1) & (costs[:, None] < costs).any(-1)  # [other, own]
    np.testing.assert_array_equal(unbeaten(costs), ~below.any(0))


def test_of_equal_designs_one_is_kept():
    assert unbeaten(np.array([[1.0, 2.0], [1.0, 2.0], [2.0, 1.0]])).tolist() == [True, False, True]


def test_a_front_of_parts_is_that_of_all():
    rng = np.random.default_rng(5)
    table = pd.DataFrame(rng.normal(size=(500, 3)), columns=["mass", "speed", "turn"])
    table["outcome"] = "completed"
    table.loc[::7, "turn"] = np.nan  # designs that failed
    goals = goals_of(["turn", "speed:most"])
    whole = front([table], goals)
    parts = front([table.iloc[k : k + 60] for k in range(0, 500, 60)], goals)
    pd.testing.assert_frame_equal(whole, parts)
    assert whole["turn"].is_monotonic_increasing and whole["speed"].is_monotonic_increasing
    assert whole["speed"].iloc[-1] == table["speed"][table["turn"].notna()].max()
    assert whole["turn"].iloc[0] == table["turn"].min()


def test_what_is_no_goal_is_refused():
    table = pd.DataFrame({"turn": [1.0], "outcome": ["completed"]})
    with pytest.raises(UserError, match="no number 'tunr'; did you mean 'turn'"):
        front([table], {"tunr": "least"})
    with pytest.raises(UserError, match="no number 'outcome'"):
        front([table], {"outcome": "least"})
    with pytest.raises(UserError, match="write turn:least or turn:most"):
        goals_of(["turn:best"])
    with pytest.raises(UserError, match="'turn' is given twice"):
        goals_of(["turn", "turn:most"])
