from pathlib import Path

import pytest

from zoedepth.serve.metrics import FOLDER_VARIABLE, Metrics


def test_requests_are_counted_by_path_and_status() -> None:
    metrics = Metrics()
    metrics.answered({"path": "/v1/depth"}, 200, 0.2)
    metrics.answered({"path": "/v1/depth"}, 200, 0.2)
    metrics.answered({"path": "/made/up"}, 404, 0.2)
    text = metrics.text().decode()
    assert 'zoedepth_requests_total{path="/v1/depth",status="200"} 2.0' in text
    assert 'zoedepth_requests_total{path="other",status="404"} 1.0' in text
    assert "made" not in text


def test_services_do_not_share_their_numbers() -> None:
    one, other = Metrics(), Metrics()
    one.waiting.set(3)
    assert "zoedepth_waiting 3.0" in one.text().decode()
    assert "zoedepth_waiting 0.0" in other.text().decode()


def test_several_processes_answer_with_the_numbers_of_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    assert Metrics().text() == b""  # this process began to count without the folder; another one has written nothing
