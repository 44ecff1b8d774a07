import json

import pytest

from zoedepth.serve.problems import KINDS, PREFIX, Problem


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_a_problem_as_rfc_9457_has_it(kind: str) -> None:
    problem = Problem(kind, "It is “so”.")
    values = json.loads(problem.body)
    assert values == {
        "type": PREFIX + kind,
        "title": KINDS[kind].title,
        "status": problem.status,
        "detail": "It is “so”.",
    }
    assert problem.headers["content-type"] == "application/problem+json"
    assert 400 <= problem.status < 600


def test_only_what_may_go_well_later_says_when_to_come_again() -> None:
    again = {name for name, kind in KINDS.items() if kind.retry_after}
    assert again == {name for name, kind in KINDS.items() if kind.status in (429, 503)}
    assert Problem("busy", "").headers["retry-after"].isdigit()
    assert "retry-after" not in Problem("not-found", "").headers


def test_text_that_no_encoding_has_does_not_break_it() -> None:
    assert json.loads(Problem("not-found", "\udcff").body)["detail"]
