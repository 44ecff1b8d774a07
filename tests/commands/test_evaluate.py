"""``zoedepth evaluate``: how its options choose protocols and sources, and what it prints and writes."""

import json
import re
import sys
from collections.abc import Callable
from dataclasses import asdict, fields, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from tests.folders import write_disparity_pairs, write_pairs
from tests.processes import beside

from zoedepth.cli import main
from zoedepth.config import ModelConfig
from zoedepth.data.pairs import PairDataset
from zoedepth.evaluation.dataset_scores import score_dataset
from zoedepth.evaluation.predictions import FolderSource, ModelSource, PredictionSource
from zoedepth.evaluation.protocols import INDOOR, OUTDOOR, PLAIN, PROTOCOLS, Protocol
from zoedepth.metrics import Metrics, mean_metrics
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.outputs.depth import write_depth_png
from zoedepth.runtimes.fast import Fast
from zoedepth.weights.load import load_model
from zoedepth.weights.save import save_model

METRICS = {f.name for f in fields(Metrics)}


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make the folder that keeps the file of the model for all tests."""
    return tmp_path_factory.mktemp("models")


@pytest.fixture
def model(request: pytest.FixtureRequest, models: Path) -> Path:
    """Return the file of a model that takes every photo for an indoor one."""
    path = models / "tiny.safetensors"
    if not path.exists():
        tiny_model: ZoeDepth = request.getfixturevalue("tiny_model")
        with torch.no_grad():
            tiny_model.router.classifier.mlp[-1].bias.copy_(torch.tensor([1000.0, 0.0]))
        save_model(tiny_model, path)
    return path


def write_predictions(folder: Path, *paths: Path) -> Path:
    """Write depth maps of lists' photos: the truth times 1.1 (left) to 1.3 (right), and 2 m where it is unknown."""
    folder.mkdir()
    for dataset, index in ((each, i) for each in map(PairDataset, paths) for i in range(len(each))):
        sample = dataset[index]
        truth = sample.target[0].numpy()
        depth = np.where(truth > 0, truth * np.linspace(1.1, 1.3, truth.shape[1], dtype=np.float32), np.float32(2))
        np.save(folder / f"{Path(sample.name).stem}.npy", depth)
    return folder


def run(capsys: pytest.CaptureFixture[str], *arguments: object, code: int = 0) -> list[dict]:
    """Run the command and return the JSON objects that it prints; it may print nothing else."""
    found = main(["evaluate", "--json", *map(str, arguments)])
    output = capsys.readouterr()
    assert found == code, output.err
    return [json.loads(line) for line in output.out.splitlines()]


def error(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Run the command with something wrong and return what it says."""
    assert main(["evaluate", *map(str, arguments)]) == 2
    output = capsys.readouterr()
    assert output.out == ""
    return output.err


def expected(source: PredictionSource, path: Path, protocol: Protocol) -> dict[str, float]:
    """Compute the means over images under a protocol."""
    dataset = PairDataset(path)
    scores = score_dataset(source, dataset, dict.fromkeys(dataset.domains, protocol)).scores
    return asdict(mean_metrics([score.sums.metrics() for score in scores.values() if score.sums is not None]))


def metrics_of(record: dict) -> dict[str, float]:
    return {name: record[name] for name in METRICS}


class TestProtocol:
    @pytest.mark.parametrize(
        ("domain", "size", "protocol"), [("indoor", (64, 96), INDOOR), ("outdoor", (375, 1242), OUTDOOR)]
    )
    def test_follows_from_the_domain(self, model, tmp_path: Path, capsys, domain: str, size, protocol: Protocol):
        path = write_pairs(tmp_path, n=2, size=size, domain=domain, split="test")
        (record,) = run(capsys, "--model", model, "--data", path)
        assert metrics_of(record) == pytest.approx(expected(ModelSource(load_model(model)), path, protocol))
        assert record["protocols"] == {domain: protocol.label}

    def test_domain_of_ones_own_has_no_crop(self, tmp_path: Path, capsys):
        path = write_pairs(tmp_path / "attic", n=1, split="test")
        path.write_text(path.read_text().replace(",indoor", ",attic"))
        (record,) = run(capsys, "--predictions", write_predictions(tmp_path / "theirs", path), "--data", path)
        assert record["protocols"] == {"attic": PLAIN.label}

    @pytest.mark.parametrize(
        ("arguments", "protocol"),
        [
            (("--crop", "none"), replace(INDOOR, crop="none")),
            (("--crop", "garg"), replace(INDOOR, crop="garg")),
            (("--max-depth", "3"), replace(INDOOR, max_depth=3.0)),
            (("--min-depth", "2"), replace(INDOOR, min_depth=2.0)),
            (("--protocol", "nyu"), PROTOCOLS["nyu"]),
            (("--protocol", "rooms=ibims"), PROTOCOLS["ibims"]),
            (("--protocol", "plain", "rooms=ibims", "--pad", "yes"), replace(PROTOCOLS["ibims"], pad=True)),
            (("--protocol", "rooms=ibims", "plain"), PROTOCOLS["ibims"]),
        ],
    )
    def test_is_chosen_and_overridden(self, tmp_path: Path, capsys, arguments, protocol: Protocol):
        path = write_pairs(tmp_path, n=1, size=(64, 160), split="test")
        theirs = write_predictions(tmp_path / "theirs", path)
        (record,) = run(capsys, "--predictions", theirs, "--data", f"rooms={path}", *arguments)
        assert metrics_of(record) == pytest.approx(expected(FolderSource(theirs), path, protocol))
        assert record["protocols"] == {"indoor": protocol.label}
        assert protocol.label != INDOOR.label

    @pytest.mark.parametrize(
        ("arguments", "protocol"),
        [
            (("--no-flip",), replace(INDOOR, flip_average=False)),
            (("--pad", "yes"), replace(INDOOR, pad=True)),
            (("--resize", "squeeze"), replace(INDOOR, resize="squeeze")),
        ],
    )
    def test_model_is_run_as_it_says(self, model: Path, tmp_path: Path, capsys, arguments, protocol: Protocol):
        path = write_pairs(tmp_path, n=1, size=(64, 160), split="test")
        (record,) = run(capsys, "--model", model, "--data", path, *arguments)
        source = ModelSource(load_model(model))
        assert metrics_of(record) == pytest.approx(expected(source, path, protocol))
        assert metrics_of(record) != pytest.approx(expected(source, path, INDOOR))
        assert record["protocols"] == {"indoor": protocol.label}

    def test_pooled_mean(self, tmp_path: Path, capsys):
        """Both photos have equally many known pixels, so REL is the same both ways, and RMSE is not."""
        path = write_pairs(tmp_path, n=2, split="test")
        theirs = write_predictions(tmp_path / "theirs", path)
        (images,) = run(capsys, "--predictions", theirs, "--data", path)
        (pixels,) = run(capsys, "--predictions", theirs, "--data", path, "--mean", "pixels")
        assert pixels["rel"] == pytest.approx(images["rel"])
        assert pixels["rmse"] > images["rmse"]

    def test_aligned_numbers_say_so(self, tmp_path: Path, capsys):
        path = write_pairs(tmp_path, n=2, split="test")
        theirs = str(write_predictions(tmp_path / "theirs", path))
        (record,) = run(capsys, "--predictions", theirs, "--data", path, "--align", "median")
        assert record["alignment"] == "median"
        assert main(["evaluate", "--predictions", theirs, "--data", str(path), "--align", "median"]) == 0
        assert "median-aligned" in capsys.readouterr().out.replace("\n", "")

    def test_unknown_names_are_errors(self, tmp_path: Path, capsys):
        path = write_pairs(tmp_path, n=1, split="test")
        assert "'nuy'" in error(capsys, "--data", path, "--protocol", "nuy")
        assert "attic" in error(capsys, "--data", path, "--protocol", "attic=nyu")

    def test_of_a_data_set_is_its_own(self, tmp_path: Path, capsys):
        path = write_pairs(tmp_path / "rooms", n=1, split="test")
        theirs = write_predictions(tmp_path / "theirs", path)
        data = [f"{name}={path}" for name in "abc"]
        records = run(capsys, "--predictions", theirs, "--data", *data, "--protocol", "b=nyu", "plain")
        labels = [PLAIN.label, PROTOCOLS["nyu"].label, PLAIN.label]
        assert [record["protocols"]["indoor"] for record in records] == labels


class TestSources:
    def test_several_models_have_a_row_each_under_their_labels(self, model: Path, tmp_path: Path, capsys):
        path = write_pairs(tmp_path, n=1, split="test")
        options = ["--model", model, "--model", f"again={model}", "--model", "zoed-lite"]
        records = run(capsys, *options, "--data", path)
        assert [record["source"] for record in records] == [str(model), "again", "zoed-lite"]
        assert metrics_of(records[0]) == metrics_of(records[1]) != metrics_of(records[2])

    @pytest.mark.parametrize(
        "options",
        [
            ("--model", "zoed-lite", "--model", "zoed-lite"),
            ("--model", "a=zoed-lite", "--predictions", "a=theirs"),
            ("--model", "mean depth map=zoed-lite", "--trivial", "rooms/test.csv"),
        ],
        ids=["models", "model and predictions", "model and guess"],
    )
    def test_two_of_one_name_are_an_error(self, tmp_path: Path, capsys, monkeypatch, options: tuple[str, ...]):
        monkeypatch.chdir(tmp_path)
        path = write_pairs(tmp_path / "rooms", n=1, split="test")
        (tmp_path / "theirs").mkdir()
        assert "name them" in error(capsys, *options, "--data", path)

    def test_scores_belong_to_model_behaviours_and_data(self, model: Path, tmp_path: Path, capsys):
        path = write_pairs(tmp_path / "rooms", n=1, split="test")
        options = ["--data", path, "--out", tmp_path / "out", "--no-pictures"]
        run(capsys, "--model", f"tiny={model}", "--compat", "batch-vote", *options)
        header = json.loads((tmp_path / "out/tiny/rooms/scores-0-of-1.jsonl").read_text().splitlines()[0])
        assert header["about"] == {
            "source": "tiny",
            "model": str(model),
            "compat": ["batch-vote"],
            "data": str(path),
        }

    def test_other_peoples_depth_maps(self, tmp_path: Path, capsys):
        path = write_pairs(tmp_path / "rooms", n=2, split="test")
        dataset = PairDataset(path)
        for index in range(2):
            sample = dataset[index]
            write_depth_png(tmp_path / "theirs" / f"{Path(sample.name).stem}.png", 1.25 * sample.target[0].numpy())
        (record,) = run(capsys, "--predictions", f"theirs={tmp_path / 'theirs'}", "--data", path)
        assert record["source"] == "theirs"
        assert record["rel"] == pytest.approx(0.25, abs=1e-3)
        assert record["router"] is None

    def test_missing_depth_map_is_listed_and_the_rest_scored(self, tmp_path: Path, capsys):
        path = write_pairs(tmp_path / "rooms", n=2, split="test")
        sample = PairDataset(path)[0]
        write_depth_png(tmp_path / "theirs" / f"{Path(sample.name).stem}.png", sample.target[0].numpy())
        options = ["--predictions", f"theirs={tmp_path / 'theirs'}", "--data", str(path)]
        assert main(["evaluate", "--json", *options]) == 1
        output = capsys.readouterr()
        record = json.loads(output.out)
        assert (record["images"], record["failed"]) == (1, 1)
        assert "test_001" in output.err.replace("\n", "")

    def test_what_can_be_said_without_looking(self, tmp_path: Path, capsys):
        train = write_pairs(tmp_path / "rooms", n=3, split="train")
        path = write_pairs(tmp_path / "rooms", n=2, split="test")
        constant, mean = run(capsys, "--trivial", train, "--data", path)
        assert (constant["source"], mean["source"]) == ("best constant", "mean depth map")
        assert 0 < mean["rel"] < constant["rel"]
        (tmp_path / "lists").mkdir()
        lists = [path.rename(tmp_path / "lists" / path.name) for path in (train, path)]
        moved = run(capsys, "--trivial", lists[0], "--data", lists[1], "--root", tmp_path / "rooms")
        assert [record["rel"] for record in moved] == [constant["rel"], mean["rel"]]

    def test_disparity_says_nothing_without_looking(self, tmp_path: Path, capsys):
        train = write_pairs(tmp_path / "rooms", n=2, split="train")
        path = write_pairs(tmp_path / "rooms", n=1, split="test")
        expected = run(capsys, "--trivial", train, "--data", path)
        write_disparity_pairs(tmp_path / "stills", n=1)
        for kind in ("image", "disparity"):
            (tmp_path / "stills" / kind).rename(tmp_path / "rooms" / f"still-{kind}")
        header, *lines = train.read_text().splitlines()
        more = "still-image/still_000.jpg,,,indoor,still-disparity/still_000.png"
        train.write_text("\n".join([f"{header},disparity", *(f"{line}," for line in lines), more]) + "\n")
        assert run(capsys, "--trivial", train, "--data", path) == expected

    def test_relative_model_needs_alignment(self, tiny_model: ZoeDepth, tmp_path: Path, capsys):
        bare = ZoeDepth(replace(tiny_model.config, domains=()))
        save_model(bare, tmp_path / "bare.safetensors")
        path = write_pairs(tmp_path, n=1, split="test")
        options = ["--model", str(tmp_path / "bare.safetensors"), "--data", str(path)]
        assert main(["evaluate", "--json", *options]) == 1
        output = capsys.readouterr().err
        assert "image 0: relative depth has no metres: score it with --align disparity" in output
        assert "known pixel" not in output
        (record,) = run(capsys, *options, "--align", "disparity")
        assert np.isfinite(record["rel"])

    def test_model_of_one_domain_has_no_router_to_score(self, tiny_config: ModelConfig, tmp_path: Path, capsys):
        torch.manual_seed(0)
        save_model(ZoeDepth(replace(tiny_config, domains=tiny_config.domains[:1])), tmp_path / "one.safetensors")
        path = write_pairs(tmp_path, n=1, split="test")
        (record,) = run(capsys, "--model", tmp_path / "one.safetensors", "--data", path)
        assert record["router"] is None

    def test_router_share_is_that_of_photos_sent_to_their_own_head(self, model: Path, tmp_path: Path, capsys):
        domains = ("indoor", "outdoor")
        paths = [write_pairs(tmp_path / domain, n=2, domain=domain, split="test") for domain in domains]
        records = run(capsys, "--model", model, "--data", *paths)
        assert [record["router"] for record in records] == [1.0, 0.0]


class TestCamera:
    @pytest.fixture
    def one_lens(self, model: Path, tmp_path: Path) -> Path:
        """Return the file of the model, which learned from photos with focal lengths of 80 pixels."""
        loaded = load_model(model)
        domains = tuple(replace(each, focal_px=80.0) for each in loaded.config.domains)
        loaded.config = replace(loaded.config, domains=domains)
        save_model(loaded, tmp_path / "lens.safetensors")
        return tmp_path / "lens.safetensors"

    def test_of_the_data_is_told_where_it_is_wanted(self, one_lens: Path, tmp_path: Path, capsys):
        path = write_pairs(tmp_path / "rooms", n=2, size=(64, 64), split="test", focal_px=(40.0, 160.0))
        (told,) = run(capsys, "--model", one_lens, "--data", path, "--camera", "data")
        (plain,) = run(capsys, "--model", one_lens, "--data", path)
        assert (told["camera"], plain["camera"]) == ("data", "none")
        for record in (told, plain):
            source = ModelSource(load_model(one_lens), camera=record["camera"])
            assert metrics_of(record) == pytest.approx(expected(source, path, INDOOR))
        assert told["rel"] != pytest.approx(plain["rel"])

    def test_is_part_of_what_scores_belong_to_and_of_the_report(self, one_lens: Path, tmp_path: Path, capsys):
        path = write_pairs(tmp_path / "rooms", n=1, size=(64, 64), split="test", focal_px=(40.0,))
        out = tmp_path / "out"
        arguments = ("--model", f"lens={one_lens}", "--data", f"rooms={path}", "--out", out, "--no-pictures")
        run(capsys, *arguments, "--camera", "data")
        assert "| lens (camera of the data) |" in (out / "report.md").read_text()
        assert json.loads((out / "report.json").read_text())["results"][0]["camera"] == "data"
        assert "camera was 'data' and is None" in error(capsys, *arguments)

    def test_that_is_not_known_is_said(self, one_lens: Path, model: Path, tmp_path: Path, capsys):
        path = write_pairs(tmp_path / "rooms", n=1, size=(64, 64), split="test")
        assert main(["evaluate", "--model", str(one_lens), "--data", str(path), "--camera", "data"]) == 1
        assert "the data says no camera for image/test_000.jpg" in capsys.readouterr().err
        said = error(capsys, "--model", model, "--data", path, "--camera", "data")
        assert "with what focal length it was trained" in said
        theirs = write_predictions(tmp_path / "theirs", path)
        said = error(capsys, "--predictions", theirs, "--data", path, "--camera", "data")
        assert "--camera data is for models, and none is scored" in said


class TestFast:
    def test_takes_what_is_fastest_here_and_says_what_it_is(self, model: Path, tmp_path: Path, capsys, monkeypatch):
        path = write_pairs(tmp_path, n=1, split="test")
        arguments = ("--model", f"mine={model}", "--data", f"rooms={path}", "--out", tmp_path / "out", "--no-pictures")

        def load(name: object, **options: object) -> Fast:
            assert str(name) == str(model)
            return Fast(load_model(model), "torch, bfloat16", "measured", "bfloat16", "cpu")

        monkeypatch.setattr("zoedepth.evaluation.predictions.load_fast", load)
        (record,) = run(capsys, *arguments, "--fast")
        assert record["fast"] == "torch, bfloat16"
        assert "| mine (torch, bfloat16) |" in (tmp_path / "out" / "report.md").read_text()
        # Scores of one way of computing are not gone on with in another.
        assert "fast was 'torch, bfloat16' and is None" in error(capsys, *arguments)

    def test_says_what_was_chosen(self, model: Path, tmp_path: Path, capsys, monkeypatch):
        path = write_pairs(tmp_path, n=1, split="test")
        fast = Fast(load_model(model), "torch, float32", "nothing else is installed", "float32", "cpu")
        monkeypatch.setattr("zoedepth.evaluation.predictions.load_fast", lambda name, **options: fast)
        assert main(["evaluate", "--model", str(model), "--data", str(path), "--fast"]) == 0
        assert f"note: {model} is computed by torch, float32 (nothing else is installed)" in capsys.readouterr().err

    def test_is_for_models(self, tmp_path: Path, capsys):
        path = write_pairs(tmp_path, n=1, split="test")
        theirs = write_predictions(tmp_path / "theirs", path)
        said = error(capsys, "--predictions", theirs, "--data", path, "--fast")
        assert "--fast is for models, and none is scored" in said


class TestOutput:
    def test_json_is_one_object_with_metrics_and_counts(self, tmp_path: Path, capsys):
        path = write_pairs(tmp_path, n=3, split="test", without_truth=(1,))
        (record,) = run(capsys, "--predictions", write_predictions(tmp_path / "theirs", path), "--data", path)
        facts = {"router", "alignment", "camera", "fast", "source", "data", "protocols", "holes"}
        counts = {"images", "without_truth", "failed"}
        assert set(record) == METRICS | {"boundary_f1", "ause", "coverage1", "coverage2"} | counts | facts
        assert (record["images"], record["without_truth"]) == (2, 1)
        assert all(isinstance(record[name], float) for name in METRICS)

    def test_json_has_what_is_measured_of_uncertainty_and_edges(self, model: Path, tmp_path: Path, capsys):
        path = write_pairs(tmp_path, n=1, split="test")
        (record,) = run(capsys, "--model", model, "--data", path)
        score = score_dataset(ModelSource(load_model(model)), PairDataset(path), {"indoor": INDOOR}).scores[0]
        assert score.uncertainty is not None
        expected = {**asdict(score.uncertainty), "boundary_f1": score.boundary_f1}
        assert {name: record[name] for name in expected} == pytest.approx(expected)
        (theirs,) = run(capsys, "--predictions", write_predictions(tmp_path / "theirs", path), "--data", path)
        assert (theirs["ause"], theirs["coverage1"], theirs["coverage2"]) == (None, None, None)

    def test_line_without_truth_is_counted(self, tmp_path: Path, capsys):
        """KITTI's test list has 45 of them."""
        path = write_pairs(tmp_path, n=2, split="test")
        theirs = write_predictions(tmp_path / "theirs", path)
        lines = path.read_text().splitlines()
        path.write_text("\n".join([*lines, lines[1].replace("depth/test_000.png", "None")]) + "\n")
        (record,) = run(capsys, "--predictions", theirs, "--data", path)
        assert (record["images"], record["without_truth"]) == (2, 1)

    def test_several_data_sets_are_an_object_each_with_their_names(self, tmp_path: Path, capsys):
        rooms = write_pairs(tmp_path / "rooms", n=1)
        streets = write_pairs(tmp_path / "streets", n=2, size=(360, 1220), domain="outdoor", split="test")
        theirs = write_predictions(tmp_path / "theirs", rooms, streets)
        records = run(capsys, "--predictions", theirs, "--data", rooms, f"cars={tmp_path / 'streets'}")
        assert [(record["data"], record["images"]) for record in records] == [("rooms", 1), ("cars", 2)]

    def test_table_has_the_numbers_for_people(self, model: Path, tmp_path: Path, capsys):
        path = write_pairs(tmp_path / "rooms", n=2, split="test")
        assert main(["evaluate", "--model", f"tiny={model}", "--data", str(path)]) == 0
        output = capsys.readouterr().out
        rel = expected(ModelSource(load_model(model)), path, INDOOR)["rel"]
        for word in ("REL", "RMSE", "rooms", INDOOR.label, f"{rel:.3f}", "100.0 %"):
            assert word in output

    def test_report_has_tables_pictures_and_the_command(self, model: Path, tmp_path: Path, capsys, monkeypatch):
        monkeypatch.setattr(sys, "argv", ["anything", "evaluate", "--data", "a b"])
        path = write_pairs(tmp_path / "rooms", n=3, split="test")
        out = tmp_path / "out"
        assert main(["evaluate", "--model", f"tiny={model}", "--data", str(path), "--out", str(out)]) == 0
        report = (out / "report.md").read_text()
        for file in ("tiny/rooms/examples.png", "rooms-error-by-depth.png"):
            assert file in report
            assert (out / file).read_bytes().startswith(b"\x89PNG")
        assert "zoedepth evaluate --data 'a b'" in report
        assert INDOOR.label in report
        assert INDOOR.hash in (out / "report.tex").read_text()
        (result,) = json.loads((out / "report.json").read_text())["results"]
        rel = expected(ModelSource(load_model(model)), path, INDOOR)["rel"]
        assert result["metrics"]["rel"] == pytest.approx(rel)
        assert len((out / "tiny/rooms/scores-0-of-1.jsonl").read_text().splitlines()) == 4

    def test_the_same_command_goes_on_and_another_protocol_is_refused(self, tmp_path: Path, capsys, monkeypatch):
        path = write_pairs(tmp_path / "rooms", n=2, split="test")
        theirs = write_predictions(tmp_path / "theirs", path)
        options = ["--predictions", theirs, "--data", path, "--out", tmp_path / "out", "--no-pictures"]
        first = run(capsys, *options)
        for others in (("--crop", "none"), ("--predictions-scale", "2"), ("--predictions-kind", "disparity")):
            assert "Give another --out" in error(capsys, *options, *others)
        monkeypatch.setattr("zoedepth.evaluation.dataset_scores.predict", None)  # nothing is predicted again
        assert run(capsys, *options) == first

    @pytest.mark.parametrize("changed", ["predictions", "scale in the list", "scale in the settings", "depth"])
    def test_what_has_changed_is_scored_anew(self, tmp_path: Path, capsys, changed: str):
        """As in a folder of its own; and only where it has changed."""
        path = write_pairs(tmp_path / "rooms", n=2, split="test")
        theirs = write_predictions(tmp_path / "theirs", path)
        settings = path.with_name("dataset.json")
        settings.write_text('{"depth_scale": 1000}')
        if changed == "scale in the settings":
            path.write_text(path.read_text().replace(",1000,", ",,"))
        options = ["--predictions", theirs, "--data", path, "--no-pictures", "--out"]
        (old,) = run(capsys, *options, tmp_path / "out")
        if changed == "predictions":
            one = theirs / "test_001.npy"
            np.save(one, np.load(one) * 0.9)
        elif changed == "scale in the list":
            path.write_text(path.read_text().replace(",1000,", ",900,"))
        elif changed == "scale in the settings":
            settings.write_text('{"depth_scale": 900}')
        else:
            one = tmp_path / "rooms/depth/test_001.png"
            Image.fromarray(np.asarray(Image.open(one)) // 2).save(one)
        assert main(["evaluate", "--json", *map(str, options), str(tmp_path / "out")]) == 0
        output = capsys.readouterr()
        n = 2 if "scale" in changed else 1
        assert f"{n} images are scored anew" in output.err
        (new,) = run(capsys, *options, tmp_path / "fresh")
        assert json.loads(output.out) == new != old
        assert len((tmp_path / "out/theirs/rooms/scores-0-of-1.jsonl").read_text().splitlines()) == 3

    def test_weights_that_were_replaced_in_place_are_scored_anew(self, model: Path, tmp_path: Path, capsys):
        path = write_pairs(tmp_path / "rooms", n=1, split="test")
        weights = tmp_path / "model.safetensors"
        weights.write_bytes(model.read_bytes())
        options = ["--model", f"tiny={weights}", "--data", path, "--no-pictures", "--out", tmp_path / "out"]
        (old,) = run(capsys, *options)
        changed = load_model(weights)
        with torch.no_grad():
            next(changed.parameters()).mul_(3)
        save_model(changed, weights)
        (new,) = run(capsys, *options)
        assert new["rel"] != old["rel"]
        assert metrics_of(new) == pytest.approx(expected(ModelSource(load_model(weights)), path, INDOOR))

    def test_failing_photo_is_left_out_of_the_report_and_its_pictures(self, tmp_path: Path, capsys):
        path = write_pairs(tmp_path / "rooms", n=3, split="test")
        theirs = write_predictions(tmp_path / "theirs", path)
        (tmp_path / "rooms/depth/test_000.png").write_bytes(b"")
        options = ["--predictions", theirs, "--data", path, "--out", tmp_path / "out"]
        (record,) = run(capsys, *options, code=1)
        assert (record["images"], record["failed"]) == (2, 1)
        assert "1 that failed" in (tmp_path / "out/report.md").read_text()
        assert (tmp_path / "out/theirs/rooms/examples.png").is_file()

    def test_report_of_nothing_but_failures_has_no_numbers(self, tmp_path: Path, capsys):
        path = write_pairs(tmp_path / "rooms", n=1, split="test")
        (tmp_path / "theirs").mkdir()
        options = ["--predictions", tmp_path / "theirs", "--data", path, "--out", tmp_path / "out"]
        (record,) = run(capsys, *options, code=1)
        assert (record["images"], record["failed"], "rel" in record) == (0, 1, False)
        assert "not run" in (tmp_path / "out/report.md").read_text()

    def test_missing_matplotlib_is_said_before_anything_is_scored(self, tmp_path: Path, capsys, monkeypatch):
        monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
        path = write_pairs(tmp_path / "rooms", n=1, split="test")
        theirs = write_predictions(tmp_path / "theirs", path)
        options = ["--predictions", theirs, "--data", path, "--out", tmp_path / "out"]
        assert "zoedepth[report]" in error(capsys, *options)
        assert not (tmp_path / "out").exists()
        run(capsys, *options, "--no-pictures")
        assert (tmp_path / "out/report.md").is_file()

    def test_names_are_printed_as_they_are(self, tmp_path: Path, capsys):
        path = write_pairs(tmp_path / "rooms", n=1, split="test")
        theirs = write_predictions(tmp_path / "theirs", path)
        assert main(["evaluate", "--predictions", f"[bold]={theirs}", "--data", f"[/red]={path}"]) == 0
        output = capsys.readouterr().out
        assert "[bold]" in output
        assert "[/red]: protocol" in output

    @pytest.mark.parametrize(("which", "n_rows"), [("best", 1), ("all", 41)])
    def test_the_papers_numbers_beside_ours(self, tmp_path: Path, capsys, monkeypatch, which: str, n_rows: int):
        monkeypatch.setenv("COLUMNS", "200")
        path = write_pairs(tmp_path / "rooms", n=1, split="test")
        theirs = write_predictions(tmp_path / "theirs", path)
        options = ["--predictions", f"theirs={theirs}", "--data", f"nyu={path}", "--with-paper", which]
        assert main(["evaluate", *options, "--out", str(tmp_path / "out"), "--no-pictures"]) == 0
        for text in (capsys.readouterr().out, (tmp_path / "out/report.md").read_text()):
            assert text.count(" (paper) ") == n_rows
            assert re.search(r"ZoeD-M12-N \(paper\).*0\.075.*0\.270", text)

    def test_models_side_by_side_and_their_improvement_over_one(self, tmp_path: Path, capsys):
        path = write_pairs(tmp_path / "rooms", n=2, split="test")
        same = write_predictions(tmp_path / "theirs", path)
        options = ["--predictions", f"new={same}", f"old={same}", "--data", f"rooms={path}", "--no-pictures"]
        out = tmp_path / "out"
        assert main(["evaluate", *options, "--compare", "1", "--mri", "old", "--out", str(out)]) == 0
        text = (out / "report.md").read_text()
        assert "Mean relative improvement over old" in capsys.readouterr().out
        assert "| new | +0.0 | +0.0 |" in text
        assert "rooms-compared.png" in text
        with Image.open(out / "rooms-compared.png") as sheet:
            assert sheet.width > 5 * 280
        assert "--compare makes pictures: give --out" in error(capsys, *options, "--compare", "1")
        assert "--mri is 'older', which is not scored: give one of new, old" in error(
            capsys, *options, "--mri", "older"
        )

    @pytest.mark.parametrize("columns", [40, 80, 200])
    def test_tables_keep_all_headings_names_and_numbers(self, tmp_path: Path, capsys, monkeypatch, columns: int):
        monkeypatch.setenv("COLUMNS", str(columns))
        path = write_pairs(tmp_path / "rooms", n=1, split="test")
        label = "a_name_that_is_too_long_for_a_column" * 2
        theirs = write_predictions(tmp_path / "theirs", path)
        assert main(["evaluate", "--predictions", f"{label}={theirs}", "--data", str(path)]) == 0
        output = capsys.readouterr().out
        assert "…" not in output
        for text in (label, "RMSE (m)", "delta3", "SILog", "RMSE over pixels", "within 2 std", "0.20", "1.000"):
            assert text in output
        assert all(len(line) <= columns or line == label for line in output.splitlines() if "┃" not in line)

    def test_processes_of_torchrun_report_the_same_to_the_last_bit(self, tmp_path: Path):
        """Failures of the second process, too."""
        path = write_pairs(tmp_path / "rooms", n=5, split="test")
        theirs = write_predictions(tmp_path / "theirs", path)
        (theirs / "test_001.npy").unlink()
        arguments = ["evaluate", "--predictions", str(theirs), "--data", str(path), "--no-pictures", "--out"]
        assert main([*arguments, str(tmp_path / "one")]) == 1
        command = [*arguments, str(tmp_path / "two")]
        with beside(command) as second:
            assert main(command) == 1
        assert second.codes == [0], "the first says how it went"
        assert "failed: rooms, image 1" in second.errors
        one, two = (json.loads((tmp_path / name / "report.json").read_text())["results"] for name in ("one", "two"))
        assert one == two
        assert (one[0]["n_scored"], one[0]["n_failed"]) == (4, 1)
        files = sorted((tmp_path / "two/theirs/rooms").glob("*.jsonl"))
        assert [len(file.read_text().splitlines()) for file in files] == [1 + 3, 1 + 1]

    def test_second_process_leaves_it_to_the_first_to_say_how_it_went(self, tmp_path: Path, capsys, monkeypatch):
        """torchrun ends all processes when one fails, and the first has yet to write the report."""
        import torch.distributed as distributed

        path = write_pairs(tmp_path / "rooms", n=2, split="test")
        theirs = write_predictions(tmp_path / "theirs", path)
        (theirs / "test_001.npy").unlink()
        monkeypatch.setenv("RANK", "1")
        monkeypatch.setenv("WORLD_SIZE", "2")
        distributed.init_process_group("gloo", store=distributed.HashStore(), rank=0, world_size=1)
        try:
            assert run(capsys, "--predictions", theirs, "--data", path, "--out", tmp_path / "out") == []
        finally:
            distributed.destroy_process_group()
        # Neither a report nor pictures.
        files = [file.relative_to(tmp_path / "out") for file in (tmp_path / "out").rglob("*") if file.is_file()]
        assert files == [Path("theirs/rooms/scores-1-of-2.jsonl")]


class TestPredictions:
    """Depth maps of other tools, in their own units."""

    @pytest.fixture
    def path(self, tmp_path: Path) -> Path:
        return write_pairs(tmp_path / "rooms", n=2, split="test")

    def write(self, path: Path, folder: Path, change: Callable[[np.ndarray], np.ndarray]) -> Path:
        """Write what becomes of the true depth, 3 m where it is unknown, whole numbers as PNG."""
        folder.mkdir()
        dataset = PairDataset(path)
        for index in range(len(dataset)):
            truth = dataset[index].target[0].numpy()
            values = change(np.where(truth > 0, truth, 3))
            stem = folder / Path(dataset[index].name).stem
            np.save(f"{stem}.npy", values) if values.dtype.kind == "f" else Image.fromarray(values).save(f"{stem}.png")
        return folder

    def test_scale_that_nobody_says_is_proposed_and_taken(self, path: Path, tmp_path: Path, capsys):
        raw = self.write(path, tmp_path / "raw", lambda depth: (256 * depth).round().astype(np.uint16))
        options = ["--predictions", f"raw={raw}", "--data", path]
        assert "add --predictions-scale, 256 fits" in error(capsys, *options, "--out", tmp_path / "out")
        assert not (tmp_path / "out").exists()
        for scale in ("256", "raw=256"):
            (record,) = run(capsys, *options, "--predictions-scale", scale)
            assert record["rel"] < 2e-3

    def test_scales_are_of_their_folders(self, path: Path, tmp_path: Path, capsys):
        raw = self.write(path, tmp_path / "raw", lambda depth: (256 * depth).round().astype(np.uint16))
        mm = self.write(path, tmp_path / "mm", lambda depth: 1000 * depth)
        options = ["--predictions", raw, mm, "--data", path]
        assert "1000 fits" in error(capsys, *options, "--predictions-scale", "raw=256")
        records = run(capsys, *options, "--predictions-scale", "1000", "raw=256")
        assert all(record["rel"] < 2e-3 for record in records)

    def test_disparity_is_aligned_and_not_inverted_again(self, path: Path, tmp_path: Path, capsys):
        inverse = self.write(path, tmp_path / "inverse", lambda depth: (500 / depth - 30).astype(np.float32))
        options = ["--predictions", f"a={inverse}", "--data", path]
        for align in ((), ("--align", "disparity")):
            assert "--predictions-kind disparity" in error(capsys, *options, *align)
            for kind in ("disparity", "a=disparity"):
                (record,) = run(capsys, *options, *align, "--predictions-kind", kind)
                assert record["rel"] < 1e-5
                assert record["alignment"] == "disparity"

    def test_disparity_beside_others_needs_an_alignment_of_all(self, path: Path, tmp_path: Path, capsys):
        theirs = write_predictions(tmp_path / "theirs", path)
        options = ["--predictions", f"a={theirs}", f"b={theirs}", "--data", path, "--predictions-kind", "b=disparity"]
        assert "b has no metres: add --align disparity" in error(capsys, *options)
        assert "--align disparity" in error(capsys, *options, "--align", "none")

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            (("--predictions-scale", "mm"), "must be a number"),
            (("--predictions-scale", "0"), "must be finite and > 0"),
            (("--predictions-scale", "256", "1000"), "says twice what holds for all"),
            (("--predictions-kind", "inverse"), "must be depth or disparity"),
            (("--predictions-scale", "other=256"), "is given for ['other'], but the names are ['theirs']"),
        ],
    )
    def test_options_that_make_no_sense_are_errors(self, path: Path, tmp_path: Path, capsys, options, message: str):
        theirs = write_predictions(tmp_path / "theirs", path)
        assert message in error(capsys, "--predictions", theirs, "--data", path, *options)

    def test_options_for_predictions_need_some(self, path: Path, capsys):
        assert "without --predictions" in error(capsys, "--data", path, "--predictions-scale", "256")

    def test_unit_that_the_user_insists_on_is_noted(self, path: Path, tmp_path: Path, capsys):
        mm = self.write(path, tmp_path / "mm", lambda depth: 1000 * depth)
        assert main(["evaluate", "--predictions", str(mm), "--data", str(path), "--predictions-scale", "1"]) == 0
        assert "note: " in (message := capsys.readouterr().err)
        assert "the median depth is 2,7" in message or "m, and the true one" in message


class TestOutFolder:
    """An --out that cannot be used is refused before any work."""

    @pytest.fixture
    def options(self, tmp_path: Path, monkeypatch) -> list[object]:
        path = write_pairs(tmp_path / "rooms", n=1, split="test")
        monkeypatch.setattr("zoedepth.evaluation.evaluation_set.open_evaluation_set", None)  # nothing is opened
        return ["--model", "zoed-lite", "--data", path, "--no-pictures", "--out"]

    def test_file_in_its_place(self, options: list[object], tmp_path: Path, capsys):
        (tmp_path / "out").write_text("mine")
        assert "is no folder" in error(capsys, *options, tmp_path / "out")
        assert "is no folder" in error(capsys, *options, tmp_path / "out/report")
        assert (tmp_path / "out").read_text() == "mine"

    def test_report_of_somebody_else(self, options: list[object], tmp_path: Path, capsys):
        (tmp_path / "report.md").write_text("mine")
        assert "is no evaluation's" in error(capsys, *options, tmp_path)
        assert (tmp_path / "report.md").read_text() == "mine"


class TestErrors:
    def test_what_cannot_be_scored_says_why(self, tmp_path: Path, capsys):
        good = write_pairs(tmp_path / "good", n=1, split="test")
        assert "nowhere.csv" in error(capsys, "--data", tmp_path / "nowhere.csv")
        assert "zoed-light" in error(capsys, "--model", "zoed-light", "--data", good)
        stills = write_disparity_pairs(tmp_path / "stills")
        assert "disparity" in error(capsys, "--data", stills)
        stills.write_text(stills.read_text().replace(".png,", ".png,indoor"))
        assert "disparity" in error(capsys, "--data", stills)
        assert "each name once" in error(capsys, "--data", f"a={good}", f"a={good}")

    def test_published_set_in_its_official_folder_has_the_papers_protocol(self, tmp_path: Path, capsys):
        scene = tmp_path / "official_splits/test/kitchen"
        scene.mkdir(parents=True)
        Image.new("RGB", (640, 480), (90, 60, 30)).save(scene / "rgb_00045.jpg")
        Image.fromarray(np.full((480, 640), 2500, np.uint16)).save(scene / "sync_depth_00045.png")
        (tmp_path / "theirs").mkdir()
        np.save(tmp_path / "theirs/rgb_00045.npy", np.full((480, 640), 2.0, np.float32))
        options = ["--predictions", tmp_path / "theirs", "--data", f"nyu={tmp_path}"]
        for arguments, name in (((), "nyu"), (("--protocol", "plain"), "plain")):
            (found,) = run(capsys, *options, *arguments)
            assert found["protocols"] == {"indoor": PROTOCOLS[name].label}
            assert found["rel"] == pytest.approx(0.2)

    def test_masks_are_left_out_where_the_protocol_says_so(self, tmp_path: Path, capsys):
        stem = tmp_path / "val/indoors/scene_00019/scan_00183/00019_00183_indoors_000_010"
        stem.parent.mkdir(parents=True)
        Image.new("RGB", (640, 480), (90, 60, 30)).save(f"{stem}.png")
        np.save(f"{stem}_depth.npy", np.full((480, 640, 1), 2.5, np.float32))
        np.save(f"{stem}_depth_mask.npy", np.zeros((480, 640)))
        (tmp_path / "theirs").mkdir()
        np.save(tmp_path / f"theirs/{stem.name}.npy", np.full((480, 640), 2.0, np.float32))
        arguments = ["--predictions", str(tmp_path / "theirs"), "--data", f"diode-indoor={tmp_path}"]
        (found,) = run(capsys, *arguments, "--protocol", "diode-indoor-released")
        assert found["images"] == 1
        assert main(["evaluate", *arguments, "--protocol", "diode-indoor"]) == 1  # nothing is known

    def test_set_without_a_pixel_in_the_crop_is_no_silent_success(self, tmp_path: Path, capsys):
        small = write_pairs(tmp_path / "small", n=1, size=(40, 40), split="test")
        theirs = write_predictions(tmp_path / "theirs", small)
        assert main(["evaluate", "--predictions", str(theirs), "--data", str(small), "--crop", "eigen"]) == 1
        assert "no image has a known pixel" in capsys.readouterr().err

    def test_several_processes_must_have_a_folder_to_meet_in(self, tmp_path: Path, capsys, monkeypatch):
        monkeypatch.setenv("WORLD_SIZE", "2")
        path = write_pairs(tmp_path / "rooms", n=1, split="test")
        theirs = write_predictions(tmp_path / "theirs", path)
        assert "--out" in error(capsys, "--predictions", theirs, "--data", path)

    def test_data_must_be_given(self, capsys):
        with pytest.raises(SystemExit) as stopped:
            main(["evaluate", "--model", "zoed-lite"])
        assert stopped.value.code == 2
        assert "--data" in capsys.readouterr().err
