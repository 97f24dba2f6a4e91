"""A run of ``make test`` has a third of the cases of long tests: three in a row have all of them."""

from __future__ import annotations

from itertools import chain

import pytest

from tests import live


@pytest.mark.parametrize("num", [1, 2, 3, 4, 37, 169])
def test_three_turns_in_a_row_have_every_case(monkeypatch: pytest.MonkeyPatch, num: int) -> None:
    turns = []
    for turn in ("1071", "1072", "1073"):
        monkeypatch.setenv("NSQ_GPU_TURN", turn)
        turns.append(live.in_turn(range(num)))
    assert all(turns), "no turn is empty"
    assert sorted(set(chain(*turns))) == list(range(num))
    if num >= 3:
        assert sum(map(len, turns)) == num


def test_all_cases_are_taken_without_a_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NSQ_GPU_TURN", "all")
    assert live.in_turn(range(7)) == list(range(7))
    monkeypatch.delenv("NSQ_GPU_TURN")
    assert live.in_turn(range(7)) == list(range(7))
