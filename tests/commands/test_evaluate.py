"""``zoedepth evaluate``: the protocol follows the domain in the list unless told otherwise; what is printed."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import pytest
import torch
from tests.folders import write_disparity_pairs, write_pairs

from zoedepth.cli import main
from zoedepth.config import ModelConfig
from zoedepth.data.pairs import PairDataset
from zoedepth.evaluation.evaluate import evaluate
from zoedepth.evaluation.protocols import INDOOR, OUTDOOR, Protocol
from zoedepth.metrics import mean_metrics
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.pretrained import load_model, save_model

METRICS = {"rel", "rmse", "log10", "delta1", "delta2", "delta3"}


@pytest.fixture
def model(tiny_model: ZoeDepth, tmp_path: Path) -> Path:
    """File of a model that takes every photo for an indoor one."""
    with torch.no_grad():
        tiny_model.router.classifier.mlp[-1].bias.copy_(torch.tensor([1000.0, 0.0]))
    save_model(tiny_model, tmp_path / "tiny.safetensors")
    return tmp_path / "tiny.safetensors"


def run(capsys: pytest.CaptureFixture[str], model: Path, *arguments: object) -> list[dict[str, object]]:
    """The JSON objects that the command prints, and nothing but them."""
    code = main(["evaluate", "--model", str(model), "--json", *map(str, arguments)])
    output = capsys.readouterr()
    assert code == 0, output.err
    return [json.loads(line) for line in output.out.splitlines()]


def expected(model: Path, path: Path, protocol: Protocol) -> dict[str, float]:
    dataset = PairDataset(path)
    scores = evaluate(load_model(model), [dataset[index] for index in range(len(dataset))], protocol)
    return asdict(mean_metrics([score.metrics for score in scores if score.metrics is not None]))


def metrics_of(record: dict[str, object]) -> dict[str, object]:
    return {name: record[name] for name in METRICS}


@pytest.mark.parametrize(
    ("domain", "size", "protocol"), [("indoor", (64, 96), INDOOR), ("outdoor", (375, 1242), OUTDOOR)]
)
def test_protocol_follows_from_the_domain(
    model: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    domain: str,
    size: tuple[int, int],
    protocol: Protocol,
) -> None:
    path = write_pairs(tmp_path, n=2, size=size, domain=domain, split="test")
    (record,) = run(capsys, model, "--data", path)
    assert metrics_of(record) == pytest.approx(expected(model, path, protocol))


def test_json_is_one_object_with_metrics_and_counts(
    model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_pairs(tmp_path, n=3, split="test", without_truth=(1,))
    (record,) = run(capsys, model, "--data", path)
    assert set(record) == {*METRICS, "images", "without_truth", "router"}
    assert (record["images"], record["without_truth"]) == (2, 1)
    assert all(isinstance(record[name], float) for name in METRICS)


@pytest.mark.parametrize(("domain", "share"), [("indoor", 1.0), ("outdoor", 0.0)])
def test_router_share_is_that_of_photos_sent_to_their_own_head(
    model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], domain: str, share: float
) -> None:
    path = write_pairs(tmp_path, n=2, domain=domain, split="test")
    (record,) = run(capsys, model, "--data", path)
    assert record["router"] == share


def test_model_of_one_domain_has_no_router_to_score(
    tiny_config: ModelConfig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    torch.manual_seed(0)
    save_model(ZoeDepth(replace(tiny_config, domains=tiny_config.domains[:1])), tmp_path / "one.safetensors")
    path = write_pairs(tmp_path, n=1, split="test")
    (record,) = run(capsys, tmp_path / "one.safetensors", "--data", path)
    assert record["router"] is None


@pytest.mark.parametrize(
    ("arguments", "protocol"),
    [
        (("--crop", "none"), replace(INDOOR, crop="none")),
        (("--crop", "garg"), replace(INDOOR, crop="garg")),
        (("--max-depth", "3"), replace(INDOOR, max_depth=3.0)),
        (("--no-flip",), replace(INDOOR, flip_average=False)),
    ],
    ids=["no crop", "other crop", "cap", "no flip"],
)
def test_options_override_the_protocol(
    model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], protocol: Protocol
) -> None:
    path = write_pairs(tmp_path, n=1, split="test")
    (record,) = run(capsys, model, "--data", path, *arguments)
    assert metrics_of(record) == pytest.approx(expected(model, path, protocol))
    assert metrics_of(record) != pytest.approx(expected(model, path, INDOOR))


def test_several_data_sets_are_an_object_each_with_their_names(
    model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rooms = write_pairs(tmp_path / "rooms", n=1, split="test")
    write_pairs(tmp_path / "streets", n=2, domain="outdoor", split="test")
    records = run(capsys, model, "--data", rooms, f"cars={tmp_path / 'streets'}")
    assert [(record["data"], record["images"]) for record in records] == [("rooms", 1), ("cars", 2)]


def test_table_has_the_numbers_for_people(model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_pairs(tmp_path / "rooms", n=2, split="test")
    assert main(["evaluate", "--model", str(model), "--data", str(path)]) == 0
    output = capsys.readouterr().out
    for word in ("REL", "RMSE", "rooms", f"{expected(model, path, INDOOR)['rel']:.3f}", "100.0 %"):
        assert word in output


def test_what_cannot_be_scored_is_an_error_that_says_why(
    model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def error(*arguments: object) -> str:
        assert main(["evaluate", *map(str, arguments)]) == 2
        output = capsys.readouterr()
        assert output.out == ""
        return output.err

    good = write_pairs(tmp_path / "good", n=1, split="test")
    assert "nowhere.csv" in error("--model", model, "--data", tmp_path / "nowhere.csv")
    assert "zoed-light" in error("--model", "zoed-light", "--data", good)
    attic = write_pairs(tmp_path / "attic", n=1, split="test")
    attic.write_text(attic.read_text().replace(",indoor", ",attic"))
    assert "attic" in error("--model", model, "--data", attic)
    small = write_pairs(tmp_path / "small", n=1, size=(40, 40), split="test")
    assert "no image" in error("--model", model, "--data", small)
    stills = write_disparity_pairs(tmp_path / "stills")
    assert "disparity" in error("--model", model, "--data", stills)
    stills.write_text(stills.read_text().replace(".png,", ".png,indoor"))
    assert "disparity" in error("--model", model, "--data", stills)
    assert "each name once" in error("--model", model, "--data", f"a={good}", f"a={good}")


def test_data_must_be_given(model: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["evaluate", "--model", str(model)])
    assert stopped.value.code == 2
    assert "--data" in capsys.readouterr().err
