"""The batches of a training depend on the seed and the step alone, and are shared among processes."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import pytest
import torch

from zoedepth.data.sample import Batch
from zoedepth.errors import InputError
from zoedepth.train.batches import Batches, _ignore_the_first_signal, load_batches
from zoedepth.train.config import SourceConfig, TrainConfig
from zoedepth.train.sources import load_sources

MakeConfig = Callable[..., TrainConfig]
Data = dict[str, Path]


class OneOfSeveral:
    """Fabric's place in this file: one of several processes, on the CPU."""

    def __init__(self, rank: int = 0, n: int = 1) -> None:
        self.global_rank, self.world_size = rank, n

    def setup_dataloaders(self, loader: Any, *, use_distributed_sampler: bool) -> Any:
        assert not use_distributed_sampler, "the sampler shares the samples already"
        return loader


def read(config: TrainConfig, data: Data, *, first_step: int = 0, rank: int = 0, n: int = 1) -> list[Batch]:
    """Return one process's batches of all steps from the first on."""
    training, _ = load_sources(config, data)
    return list(load_batches(config, OneOfSeveral(rank, n), training, first_step=first_step))


@pytest.mark.parametrize("accumulate", [1, 2, 4])
def test_resumed_training_reads_the_samples_that_were_left(
    make_config: MakeConfig, data: Data, accumulate: int
) -> None:
    config = make_config(batch_size=4, accumulate=accumulate, steps=5)
    whole = read(config, data)
    assert len(whole) == 5 * accumulate
    for step in range(5):
        left = read(config, data, first_step=step)
        assert [batch.names for batch in left] == [batch.names for batch in whole[step * accumulate :]]
        assert all(torch.equal(a.pixels, b.pixels) for a, b in zip(left, whole[step * accumulate :], strict=True))


def test_accumulated_batches_are_the_parts_of_the_whole_one(make_config: MakeConfig, data: Data) -> None:
    whole = read(make_config(batch_size=4, steps=3), data)
    parts = read(make_config(batch_size=4, steps=3, accumulate=2), data)
    assert [len(batch.names) for batch in parts] == [2] * 6
    for step, batch in enumerate(whole):
        pair = parts[2 * step : 2 * step + 2]
        assert pair[0].names + pair[1].names == batch.names
        assert torch.equal(torch.cat([part.target for part in pair]), batch.target)


def test_processes_share_every_batch(make_config: MakeConfig, data: Data) -> None:
    config = make_config(batch_size=4, steps=3)
    shares = [read(config, data, rank=rank, n=2) for rank in (0, 1)]
    for whole, first, second in zip(read(config, data), *shares, strict=True):
        assert len(first.names) == len(second.names) == 2
        assert sorted(first.names + second.names) == sorted(whole.names)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT], ids=["SIGTERM", "Ctrl-C"])
def test_a_signal_to_all_processes_leaves_the_samples_of_the_last_step(
    make_config: MakeConfig, data: Data, number: int
) -> None:
    before = multiprocessing.active_children()
    training, _ = load_sources(make_config(n_workers=1, steps=30), data)
    batches = iter(load_batches(make_config(n_workers=1, steps=30), OneOfSeveral(), training, first_step=0))
    next(batches)
    (worker,) = (child for child in multiprocessing.active_children() if child not in before)
    os.kill(cast(int, worker.pid), number)
    assert len(list(batches)) == 29
    worker.join(60)
    assert worker.exitcode == 0


def test_a_second_signal_ends_a_process_that_reads_samples() -> None:
    both = (signal.SIGTERM, signal.SIGINT)
    before = [signal.getsignal(number) for number in both]
    try:
        _ignore_the_first_signal(0)
        for number in both:
            signal.raise_signal(number)
            assert signal.getsignal(number) is signal.SIG_DFL
    finally:
        for number, handler in zip(both, before, strict=True):
            signal.signal(number, handler)


@pytest.mark.parametrize("n_workers", [2])
def test_samples_do_not_depend_on_the_number_of_workers(make_config: MakeConfig, data: Data, n_workers: int) -> None:
    alone, shared = read(make_config(), data), read(make_config(n_workers=n_workers), data)
    assert len(alone) == 4
    for first, second in zip(alone, shared, strict=True):
        assert first.names == second.names
        assert torch.equal(first.pixels, second.pixels)
        assert torch.equal(first.target, second.target)


def test_seed_decides_on_order_and_augmentation(make_config: MakeConfig, data: Data) -> None:
    first, second = (read(make_config(batch_size=4, seed=seed), data) for seed in (1, 2))
    assert [batch.names for batch in first] != [batch.names for batch in second]


def test_reading_draws_no_global_random_numbers(make_config: MakeConfig, data: Data) -> None:
    before = torch.get_rng_state()
    read(make_config(), data)
    assert torch.equal(torch.get_rng_state(), before)


def test_weights_and_turns_of_the_data_sets(make_config: MakeConfig, data: Data) -> None:
    weighted = (SourceConfig("indoor", weight=3), SourceConfig("outdoor"))
    (batch, *_) = read(make_config(sources=weighted, batch_size=4), data)
    assert sorted(batch.source.tolist()) == [0, 0, 0, 1]
    batches = read(make_config(mix_by="batch", batch_size=2), data)
    assert [batch.source.tolist() for batch in batches] == [[0, 0], [1, 1], [0, 0], [1, 1]]
    # Turns are as long as a step, however many batches it is split into.
    batches = read(make_config(mix_by="batch", batch_size=2, accumulate=2, steps=2), data)
    assert [batch.source.tolist() for batch in batches] == [[0], [0], [1], [1]]


def test_domains_are_those_of_the_model_and_unknown_to_stage_1(make_config: MakeConfig, data: Data) -> None:
    (batch, *_) = read(make_config(), data)
    assert batch.domain.tolist() == [0, 1]
    (batch, *_) = read(make_config("relative"), data)
    assert batch.domain.tolist() == [0, 0]
    assert batch.kind == "disparity"


def test_pixels_are_in_the_order_of_channels_last(make_config: MakeConfig, data: Data) -> None:
    (batch, *_) = read(make_config(), data)
    assert batch.pixels.is_contiguous(memory_format=torch.channels_last)


def test_waiting_is_measured_between_two_questions(make_config: MakeConfig, data: Data, monkeypatch) -> None:
    (batch, *_) = read(make_config(), data)
    clock = iter([10.0, 12.0, 20.0, 23.0, 30.0, 31.0])
    monkeypatch.setattr("zoedepth.train.batches.monotonic", lambda: next(clock))
    batches = Batches([batch] * 3)
    next(batches), next(batches)
    assert batches.take_waited() == 5
    next(batches)
    assert batches.take_waited() == 1
    assert batches.take_waited() == 0


def test_closed_batches_are_at_their_end(make_config: MakeConfig, data: Data) -> None:
    (batch, *_) = read(make_config(), data)
    batches = Batches([batch] * 2)
    batches.close()
    assert list(batches) == []


def test_an_error_of_a_process_that_reads_is_one_line() -> None:
    def fail() -> Iterator[Batch]:
        raise RuntimeError("Caught ValueError in process 1.\nTraceback (most recent call last):\nValueError: no disk\n")
        yield

    with pytest.raises(InputError) as raised:
        next(Batches(fail()))
    assert str(raised.value) == "samples cannot be read: ValueError: no disk"
