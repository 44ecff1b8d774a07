"""The run over a data set: what is written, what an interrupted run goes on with, and many processes as one."""

import dataclasses
import json
import random
import signal
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from threading import Event, main_thread
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
import torch
from tests.evaluation.samples import EVERYWHERE, FactorSource, photo

from zoedepth.data.augment import kitti_crop
from zoedepth.data.sample import Sample, Samples
from zoedepth.errors import InputError
from zoedepth.evaluation.dataset_scores import DatasetScores, Processes, score_dataset, score_files
from zoedepth.evaluation.predictions import ModelSource, Prediction, PredictionSource
from zoedepth.evaluation.protocols import OUTDOOR, PLAIN, Protocol
from zoedepth.evaluation.score_files import ScoreFiles
from zoedepth.evaluation.scoring import Score, score
from zoedepth.evaluation.summary import summarise
from zoedepth.model.zoedepth import ZoeDepth

PROTOCOLS = {"indoor": EVERYWHERE, "outdoor": PLAIN}
FACTORS = {f"{i}.jpg": 1 + 0.11 * i for i in range(7)}


def photos(n: int, *, without_truth: Sequence[int] = ()) -> list[Sample]:
    """Make photos "0.jpg", "1.jpg" ... of rooms and streets by turns, of several sizes."""
    samples = [photo((130 + i, 20), seed=i, domain=("indoor", "outdoor")[i % 2], name=f"{i}.jpg") for i in range(n)]
    return [
        replace(s, target=0 * s.target, mask=s.mask & False) if i in without_truth else s for i, s in enumerate(samples)
    ]


def asked(source: FactorSource) -> list[str]:
    """Return the names of the photos that were predicted since the last call."""
    names = list(source.asked)
    source.asked.clear()
    return names


# ---------------------------------------------------------------------------------------------------- scores


def test_scores_are_by_number_with_names_and_the_domain_of_the_head(tiny_model: ZoeDepth) -> None:
    with torch.no_grad():  # takes every photo for an outdoor one
        tiny_model.router.classifier.mlp[-1].bias.copy_(torch.tensor([0.0, 1000.0]))
    found = score_dataset(ModelSource(tiny_model), photos(3, without_truth=[1]), PROTOCOLS)
    assert list(found.scores) == [0, 1, 2]
    assert [s.name for s in found.scores.values()] == ["0.jpg", "1.jpg", "2.jpg"]
    assert [s.domain for s in found.scores.values()] == ["indoor", "outdoor", "indoor"]
    assert [s.sums is None for s in found.scores.values()] == [False, True, False]
    assert [s.routed for s in found.scores.values()] == ["outdoor", None, "outdoor"]
    assert found.failures == []


def test_score_is_that_of_the_prediction_under_the_protocol_of_its_domain() -> None:
    samples = photos(2)
    source = FactorSource({"0.jpg": 1.5, "1.jpg": 1.5})
    scores = score_dataset(source, samples, PROTOCOLS).scores
    for index, protocol in enumerate((EVERYWHERE, PLAIN)):
        assert scores[index] == score(source.predict(samples[index], protocol), samples[index], protocol)
    # At 9 m one is clipped to 10, the other is not.
    assert scores[0].sums.metrics().rel < 0.5 == pytest.approx(scores[1].sums.metrics().rel, abs=1e-6)


def test_kitti_photos_are_cut_to_their_bottom_centre_first(tiny_model: ZoeDepth) -> None:
    sample = photo((375, 1242), domain="outdoor")
    cropped = kitti_crop()(sample, np.random.default_rng(0))
    uncut = replace(OUTDOOR, kitti_crop=False)
    source = ModelSource(tiny_model)
    ours, expected, other = (
        score_dataset(source, [given], {"outdoor": protocol}).scores[0]
        for given, protocol in ((sample, OUTDOOR), (cropped, uncut), (sample, uncut))
    )
    assert ours == expected
    assert ours != other
    assert ours.sums.n_pixels == 232_574


def test_photos_without_truth_are_counted_and_never_predicted() -> None:
    source = FactorSource()
    scores = score_dataset(source, photos(4, without_truth=[0, 3]), PROTOCOLS).scores
    assert asked(source) == ["1.jpg", "2.jpg"]
    assert scores[0] == Score("0.jpg", "indoor", None, None)
    assert scores[3] == Score("3.jpg", "outdoor", None, None)


def test_truth_that_the_mask_hides_is_scored_where_the_protocol_ignores_masks() -> None:
    (sample,) = photos(1)
    hidden = replace(sample, mask=sample.mask & False)
    source = FactorSource()
    assert score_dataset(source, [hidden], PROTOCOLS).scores[0].sums is None
    found = score_dataset(source, [hidden], {"indoor": replace(EVERYWHERE, use_mask=False)}).scores[0]
    assert found.sums == score_dataset(source, [sample], PROTOCOLS).scores[0].sums


def test_failing_photo_is_listed_and_the_rest_scored() -> None:
    source = FactorSource(broken=["1.jpg"])
    found = score_dataset(source, photos(3), PROTOCOLS)
    assert list(found.scores) == [0, 2]
    assert found.failures == ["image 1: 1.jpg is broken"]


def test_photo_that_cannot_be_read_is_listed_and_the_rest_scored() -> None:
    class Damaged(list):
        def __getitem__(self, index: int) -> Sample:
            if index == 0:
                raise InputError("0.jpg is cut short")
            return super().__getitem__(index)

    found = score_dataset(FactorSource(), Damaged(photos(3)), PROTOCOLS)
    assert list(found.scores) == [1, 2]
    assert found.failures == ["image 0: 0.jpg is cut short"]


def test_domain_without_a_protocol_and_disparity_are_failures_that_say_so() -> None:
    first, second = photos(2)
    found = score_dataset(
        FactorSource(), [replace(first, domain="attic"), replace(second, kind="disparity")], PROTOCOLS
    )
    assert not found.scores
    assert "'attic' of 0.jpg" in found.failures[0]
    assert "1.jpg has disparity" in found.failures[1]


def test_other_errors_are_not_swallowed() -> None:
    class Wrong(FactorSource):
        def predict(self, sample: Sample, protocol: Protocol) -> Prediction:
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        score_dataset(Wrong(), photos(1), PROTOCOLS)


def test_order_of_the_photos_does_not_matter() -> None:
    samples = photos(7, without_truth=[3])
    shuffled = random.Random(0).sample(samples, 7)
    assert [s.name for s in shuffled] != [s.name for s in samples]
    one, other = (
        summarise("a", "b", list(score_dataset(FactorSource(FACTORS), given, PROTOCOLS).scores.values()), PROTOCOLS)
        for given in (samples, shuffled)
    )
    assert one == other


# ---------------------------------------------------------------------------------------------------- files


def files_of(
    folder: Path,
    source: PredictionSource,
    data: Samples | None = None,
    *,
    protocols: Mapping[str, Protocol] = PROTOCOLS,
    about: Mapping[str, object] = MappingProxyType({"model": "a"}),
    state: Mapping[str, object] = MappingProxyType({}),
) -> ScoreFiles:
    """Open the files of scores; the data is five photos if it is not given."""
    return score_files(source, data or photos(5), protocols, folder, about=about, state=state)


def run(
    folder: Path,
    source: PredictionSource,
    data: Samples | None = None,
    *,
    processes: Processes | None = None,
    track: Callable[[list[int]], Iterable[int]] = iter,
    **options: Any,
) -> DatasetScores:
    files = files_of(folder, source, data, **options)
    protocols = options.get("protocols", PROTOCOLS)
    return score_dataset(source, data or photos(5), protocols, files=files, processes=processes, track=track)


def read_scores(folder: Path, data: Samples | None = None) -> dict[int, Score]:
    return files_of(folder, FactorSource(), data).read()


def lines_of(folder: Path, name: str = "scores-0-of-1.jsonl") -> list[str]:
    return (folder / name).read_text().splitlines()


def test_file_has_a_header_and_a_line_an_image(tmp_path: Path) -> None:
    found = run(tmp_path / "new" / "folder", FactorSource(FACTORS))
    header, *lines = map(json.loads, lines_of(tmp_path / "new" / "folder"))
    assert header == {
        "about": {"model": "a"},
        "protocols": {"indoor": EVERYWHERE.label, "outdoor": PLAIN.label},
    }
    assert [line.pop("index") for line in lines] == [0, 1, 2, 3, 4]
    assert len({line.pop("stamp") for line in lines}) == 5
    assert [Score.from_json(line) for line in lines] == list(found.scores.values())
    assert read_scores(tmp_path / "new" / "folder") == found.scores


def test_lines_are_written_one_by_one(tmp_path: Path) -> None:
    counts = []

    class Watching(FactorSource):
        def predict(self, sample: Sample, protocol: Protocol) -> Prediction:
            counts.append(len(lines_of(tmp_path)))
            return super().predict(sample, protocol)

    run(tmp_path, Watching())
    assert counts == [1, 2, 3, 4, 5]


def test_interrupted_run_goes_on_with_what_is_missing(tmp_path: Path) -> None:
    class Interrupted(FactorSource):
        def predict(self, sample: Sample, protocol: Protocol) -> Prediction:
            if sample.name == "2.jpg":
                raise KeyboardInterrupt
            return super().predict(sample, protocol)

    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, Interrupted(FACTORS))
    source = FactorSource(FACTORS)
    found = run(tmp_path, source)
    assert asked(source) == ["2.jpg", "3.jpg", "4.jpg"]
    assert found.scores == run(tmp_path / "whole", source).scores
    asked(source)
    assert run(tmp_path, source) == found
    assert asked(source) == []
    assert len(lines_of(tmp_path)) == 6


@pytest.mark.parametrize("cut", [1, 2, 30, 400], ids=lambda n: f"{n} bytes")
def test_half_written_last_line_is_scored_again(tmp_path: Path, cut: int) -> None:
    source = FactorSource(FACTORS)
    expected = run(tmp_path, source)
    asked(source)
    path = tmp_path / "scores-0-of-1.jsonl"
    path.write_bytes(path.read_bytes()[:-cut])
    assert run(tmp_path, source) == expected
    # Of one byte only the end of the line is lost.
    assert asked(source) == ([] if cut == 1 else ["4.jpg"])
    # And what was written behind it is found.
    assert run(tmp_path, source) == expected
    assert asked(source) == []


@pytest.mark.parametrize("kept", [0, 1, 40])
def test_run_that_was_killed_at_its_first_line_begins_anew(tmp_path: Path, kept: int) -> None:
    source = FactorSource(FACTORS)
    expected = run(tmp_path, source)
    path = tmp_path / "scores-0-of-1.jsonl"
    path.write_bytes(path.read_bytes()[:kept])
    assert run(tmp_path, source) == expected
    assert run(tmp_path, source) == expected
    assert len(lines_of(tmp_path)) == 6


def test_header_is_there_before_the_first_photo_is_predicted(tmp_path: Path) -> None:
    class Killed(FactorSource):
        def predict(self, sample: Sample, protocol: Protocol) -> Prediction:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, Killed())
    assert json.loads(lines_of(tmp_path)[0])["about"] == {"model": "a"}


@pytest.mark.parametrize(
    "changes",
    [
        {"about": {"model": "b"}},
        {"about": {"model": "a", "more": 1}},
        {"protocols": {**PROTOCOLS, "indoor": replace(EVERYWHERE, max_depth=9.0)}},
        {"protocols": {"indoor": EVERYWHERE}},
    ],
    ids=["model", "more about it", "protocol", "domains"],
)
def test_scores_of_something_else_are_an_error_that_names_the_file(tmp_path: Path, changes: dict[str, object]) -> None:
    run(tmp_path, FactorSource())
    before = lines_of(tmp_path)
    with pytest.raises(InputError, match=r"(?s)scores-0-of-1\.jsonl.* was .* and is .*Give another --out"):
        files_of(tmp_path, FactorSource(), **changes)
    assert lines_of(tmp_path) == before


def test_failed_photo_is_tried_again(tmp_path: Path) -> None:
    run(tmp_path, FactorSource(FACTORS, broken=["1.jpg", "3.jpg"]))
    source = FactorSource(FACTORS, broken=["3.jpg"])
    found = run(tmp_path, source)
    assert asked(source) == ["1.jpg", "3.jpg"]
    assert list(found.scores) == [0, 1, 2, 4]
    assert found.failures == ["image 3: 3.jpg is broken"]


def test_progress_is_of_what_is_missing(tmp_path: Path) -> None:
    run(tmp_path, FactorSource(broken=["1.jpg", "3.jpg"]))
    seen: list[list[int]] = []
    run(tmp_path, FactorSource(), track=lambda indices: seen.append(indices) or iter(indices))
    assert seen == [[1, 3]]


# ---------------------------------------------------------------------------------------------------- processes


def summary_of(scores: dict[int, Score]):
    return summarise("model", "data", list(scores.values()), PROTOCOLS)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_two_processes_give_exactly_the_numbers_of_one(tmp_path: Path, order: tuple[int, int]) -> None:
    samples = photos(7, without_truth=[4])
    alone = run(tmp_path / "one", FactorSource(FACTORS, domain="indoor"), samples)
    sources = {rank: FactorSource(FACTORS, domain="indoor") for rank in order}
    for rank in order:
        run(tmp_path / "two", sources[rank], samples, processes=Processes(rank, 2))
    assert [asked(sources[rank]) for rank in (0, 1)] == [["0.jpg", "2.jpg", "6.jpg"], ["1.jpg", "3.jpg", "5.jpg"]]
    together = read_scores(tmp_path / "two", samples)
    assert list(together.items()) == list(alone.scores.items())
    numbers = dataclasses.asdict(summary_of(alone.scores))
    assert numbers == dataclasses.asdict(summary_of(together))
    assert None not in (numbers["metrics"], numbers["other_mean"], numbers["router"], numbers["boundary_f1"])
    assert numbers["uncertainty"]
    assert len(numbers["domains"]) == 2


def test_process_beside_one_that_has_just_begun_does_not_mind(tmp_path: Path) -> None:
    for name, text in (("scores-0-of-3.jsonl", ""), ("scores-1-of-3.jsonl", '{"abo')):
        (tmp_path / name).write_text(text)
    source = FactorSource()
    run(tmp_path, source, processes=Processes(2, 3))
    assert asked(source) == ["2.jpg"]
    assert list(read_scores(tmp_path)) == [2]


@pytest.mark.parametrize("count", [1, 3])
def test_another_number_of_processes_goes_on(tmp_path: Path, count: int) -> None:
    samples = photos(7)
    run(tmp_path, FactorSource(FACTORS), samples, processes=Processes(1, 2))
    sources = [FactorSource(FACTORS) for _ in range(count)]
    for rank in range(count):
        run(tmp_path, sources[rank], samples, processes=Processes(rank, count))
    assert sorted(name for source in sources for name in asked(source)) == ["0.jpg", "2.jpg", "4.jpg", "6.jpg"]
    assert read_scores(tmp_path, samples) == run(tmp_path / "one", FactorSource(FACTORS), samples).scores


@pytest.mark.parametrize(
    ("environment", "expected"), [({}, (0, 1)), ({"RANK": "3", "WORLD_SIZE": "8"}, (3, 8))], ids=["alone", "torchrun"]
)
def test_processes_are_those_of_torchrun(
    monkeypatch: pytest.MonkeyPatch, environment: dict[str, str], expected: tuple[int, int]
) -> None:
    for name in ("RANK", "WORLD_SIZE"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert dataclasses.astuple(Processes.from_environment()) == expected


# ---------------------------------------------------------------------------------------------------- several at once


@pytest.mark.parametrize("workers", [2, 3])
def test_images_scored_at_the_same_time_give_the_same_in_the_same_order(workers: int, tmp_path: Path) -> None:
    class SlowFirst(FactorSource):
        def __init__(self) -> None:
            super().__init__(FACTORS, broken=["2.jpg"])
            self.second_is_done = Event()

        def predict(self, sample: Sample, protocol: Protocol) -> Prediction:
            if sample.name == "0.jpg":  # in hand until another has its answer
                assert self.second_is_done.wait(60)
            found = super().predict(sample, protocol)
            if sample.name == "1.jpg":
                self.second_is_done.set()
            return found

    source, samples, told = SlowFirst(), photos(7, without_truth=[4]), []

    def track(indices: list[int]) -> Iterable[int]:
        for index in indices:
            yield index
            told.append(index)

    files = score_files(source, samples, PROTOCOLS, tmp_path)
    found = score_dataset(source, samples, PROTOCOLS, files=files, workers=workers, track=track)
    expected = score_dataset(FactorSource(FACTORS, broken=["2.jpg"]), samples, PROTOCOLS)
    assert found == expected
    assert found.failures == ["image 2: 2.jpg is broken"]
    assert told == list(range(7))
    assert score_files(source, samples, PROTOCOLS, tmp_path).read() == expected.scores


def test_interrupted_it_keeps_what_is_in_hand(tmp_path: Path) -> None:
    class Interrupted(FactorSource):
        second_begins = Event()

        def predict(self, sample: Sample, protocol: Protocol) -> Prediction:
            if sample.name == "0.jpg":
                assert self.second_begins.wait(60)
                signal.pthread_kill(main_thread().ident or 0, signal.SIGINT)
            self.second_begins.set()
            return super().predict(sample, protocol)

    source, samples = Interrupted(), photos(2)
    files = score_files(source, samples, PROTOCOLS, tmp_path)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            score_dataset(source, samples, PROTOCOLS, files=files, workers=2)
    finally:
        signal.signal(signal.SIGINT, before)
    assert 0 in score_files(source, samples, PROTOCOLS, tmp_path).read()


def test_an_error_among_several_at_once_ends_all() -> None:
    class Wrong(FactorSource):
        def predict(self, sample: Sample, protocol: Protocol) -> Prediction:
            if sample.name == "1.jpg":
                raise ZeroDivisionError
            return super().predict(sample, protocol)

    source = Wrong()
    with pytest.raises(ZeroDivisionError):
        score_dataset(source, photos(40), PROTOCOLS, workers=2)
    assert len(source.asked) < 10  # those in hand were finished, no other was begun


def test_threads_read_one_after_the_other() -> None:
    class OneAtATime(list):
        inside = 0

        def __getitem__(self, index: int) -> Sample:
            self.inside += 1
            assert self.inside == 1
            time.sleep(0.001)
            self.inside -= 1
            return super().__getitem__(index)

    assert len(score_dataset(FactorSource(), OneAtATime(photos(12)), PROTOCOLS, workers=4).scores) == 12
