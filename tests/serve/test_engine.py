import asyncio
import io
import threading
import time
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
from PIL import Image
from tests.serve.running import photo
from tests.servers import PATIENCE

from zoedepth.config import BaselineConfig
from zoedepth.depth_map import DepthMap
from zoedepth.errors import InputError, MissingExtraError
from zoedepth.forward.tensors import TensorForward
from zoedepth.geometry.lens import Lens
from zoedepth.predict import Predictor
from zoedepth.serve.engine import Engine, Wanted, as_problem
from zoedepth.serve.metrics import Metrics
from zoedepth.serve.photos import Decoded
from zoedepth.serve.problems import ClientGone, Problem
from zoedepth.serve.settings import Limits, Settings
from zoedepth.weights.load import load_model

Result = TypeVar("Result")
Held = tuple[list[int], threading.Event]

PATIENT = Limits(max_wait=PATIENCE, max_seconds=PATIENCE)


def play(settings: Settings, game: Callable[[Engine], Awaitable[Result]]) -> Result:
    """Run a test with an engine, in an event loop of its own."""

    async def run() -> Result:
        engine = Engine(settings, Metrics())
        engine.start()
        try:
            return await game(engine)
        finally:
            engine.stop()

    return asyncio.run(run())


def gone() -> asyncio.Future[None]:
    return asyncio.get_running_loop().create_future()


def whole(result: DepthMap, photo: Decoded) -> DepthMap:
    return result


async def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, "it did not come about"
        await asyncio.sleep(0.005)


@pytest.fixture
def held(monkeypatch: pytest.MonkeyPatch) -> Held:
    """The sizes of the batches that came to the model, and the event for which each of them waits there."""
    ran: list[int] = []
    go_on = threading.Event()
    batch = Predictor.batch

    def wait(self: Predictor, images: list, **options: object) -> list[DepthMap]:
        ran.append(len(images))
        assert go_on.wait(PATIENCE)
        return batch(self, images, **options)

    monkeypatch.setattr(Predictor, "batch", wait)
    return ran, go_on


@pytest.mark.parametrize("batch_size", [1, 4])
def test_photos_keep_their_own_heads_cameras_and_depth_together_or_alone(
    batch_size: int, model_file: str, predictor: Predictor
) -> None:
    wishes = [
        (photo(64, 48, seed=1), Wanted()),
        (photo(64, 48, seed=2), Wanted(domain="outdoor")),
        (photo(64, 48, seed=3), Wanted(domain="indoor", camera=Lens(fov_x=40))),
        (photo(64, 48, seed=4), Wanted(camera="none")),
        (photo(48, 64, seed=5), Wanted()),
        (photo(128, 96, seed=6), Wanted(domain="outdoor")),
        (photo(64, 48, seed=7), Wanted(flip=False)),
        (photo(64, 48, seed=8), Wanted()),
    ]

    async def game(engine: Engine) -> list[DepthMap]:
        asked = [engine.compute(content, wanted, whole, gone=gone()) for content, wanted in wishes]
        return [result for result, _ in await asyncio.gather(*asked)]

    results = play(Settings((model_file,), threads=2, batch_size=batch_size, limits=PATIENT), game)
    unflipped = Predictor(predictor.model, flip_average=False)
    for result, (content, wanted) in zip(results, wishes, strict=True):
        used = predictor if wanted.flip else unflipped
        alone = used(io.BytesIO(content), domain=wanted.domain, camera=wanted.camera)
        # The number of threads decides in which order sums are taken, and so the last digits.
        np.testing.assert_allclose(result.depth, alone.depth, rtol=1e-5)
        assert (result.domain, result.camera, result.camera_note) == (alone.domain, alone.camera, alone.camera_note)


def test_photos_of_one_size_go_through_the_model_together(
    model_file: str, monkeypatch: pytest.MonkeyPatch, predictor: Predictor
) -> None:
    sizes: list[int] = []
    batch = Predictor.batch

    def counted(self: Predictor, images: list, **options: object) -> list[DepthMap]:
        sizes.append(len(images))
        return batch(self, images, **options)

    monkeypatch.setattr(Predictor, "batch", counted)
    monkeypatch.setattr(TensorForward, "_one_by_one", False)  # as on an accelerator

    async def game(engine: Engine) -> list[DepthMap]:
        contents = [photo(64, 48, seed=seed) for seed in range(4)]
        asked = [engine.compute(content, Wanted(), whole, gone=gone()) for content in contents]
        return [result for result, _ in await asyncio.gather(*asked)]

    results = play(Settings((model_file,), batch_size=4, batch_wait=PATIENCE, limits=PATIENT), game)
    assert sizes == [4]
    for seed, result in enumerate(results):
        alone = predictor(io.BytesIO(photo(64, 48, seed=seed)))
        assert abs(result.depth - alone.depth).max() < 1e-4  # sums in another order


def test_who_hangs_up_is_dropped_before_the_model_runs(model_file: str, held: Held) -> None:
    ran, go_on = held

    async def game(engine: Engine) -> None:
        first = asyncio.ensure_future(engine.compute(photo(seed=1), Wanted(), whole, gone=gone()))
        await until(lambda: ran == [1])
        left = gone()
        second = asyncio.ensure_future(engine.compute(photo(seed=2), Wanted(), whole, gone=left))
        await until(lambda: engine.gate.n_waiting == 1)
        left.set_result(None)
        with pytest.raises(ClientGone):
            await second
        go_on.set()
        await first
        assert ran == [1]
        assert not engine.is_computing

    play(Settings((model_file,), threads=1, limits=PATIENT), game)


def test_a_full_queue_is_told(model_file: str, held: Held) -> None:
    ran, go_on = held

    async def game(engine: Engine) -> None:
        first = asyncio.ensure_future(engine.compute(photo(), Wanted(), whole, gone=gone()))
        await until(lambda: ran == [1])
        second = asyncio.ensure_future(engine.compute(photo(), Wanted(), whole, gone=gone()))
        await until(lambda: engine.gate.n_waiting == 1)
        with pytest.raises(Problem) as caught:
            engine.admit()
        assert caught.value.kind == "busy"
        go_on.set()
        await asyncio.gather(first, second)

    play(Settings((model_file,), threads=1, limits=replace(PATIENT, queue=1)), game)


def test_a_long_wait_is_told(model_file: str, held: Held) -> None:
    ran, go_on = held

    async def game(engine: Engine) -> None:
        first = asyncio.ensure_future(engine.compute(photo(), Wanted(), whole, gone=gone()))
        await until(lambda: ran == [1])
        with pytest.raises(Problem) as caught:
            await engine.compute(photo(), Wanted(), whole, gone=gone())
        assert caught.value.kind == "waited-too-long"
        go_on.set()
        await first

    play(Settings((model_file,), threads=1, limits=replace(PATIENT, max_wait=0.05)), game)


def test_a_long_work_is_told_and_keeps_its_place_until_it_has_ended(model_file: str, held: Held) -> None:
    _, go_on = held

    async def game(engine: Engine) -> None:
        with pytest.raises(Problem) as caught:
            await engine.compute(photo(), Wanted(), whole, gone=gone())
        assert caught.value.kind == "took-too-long"
        assert engine.gate.n_inside == 1
        go_on.set()
        await until(lambda: engine.gate.n_inside == 0)

    play(Settings((model_file,), threads=1, limits=replace(PATIENT, max_seconds=0.2)), game)


def test_the_time_in_which_the_body_came_counts(model_file: str) -> None:
    async def game(engine: Engine) -> None:
        with pytest.raises(Problem) as caught:
            await engine.compute(photo(), Wanted(), whole, gone=gone(), began=time.perf_counter() - 60)
        assert caught.value.kind == "took-too-long"

    play(Settings((model_file,)), game)


def test_nobody_waits_for_a_turn_that_would_come_too_late(model_file: str, held: Held) -> None:
    ran, go_on = held

    async def game(engine: Engine) -> None:
        first = asyncio.ensure_future(engine.compute(photo(), Wanted(), whole, gone=gone()))
        await until(lambda: ran == [1])
        late = time.perf_counter() - PATIENCE  # it took that long to send the photo
        second = asyncio.ensure_future(engine.compute(photo(), Wanted(), whole, gone=gone(), began=late))
        await asyncio.wait({second}, timeout=PATIENCE / 10)
        go_on.set()
        with pytest.raises(Problem) as caught:
            await second
        assert caught.value.kind == "waited-too-long"
        await first

    play(Settings((model_file,), threads=1, limits=PATIENT), game)


def test_when_it_closes_who_waits_is_refused_and_who_is_computed_gets_an_answer(model_file: str, held: Held) -> None:
    ran, go_on = held

    async def game(engine: Engine) -> None:
        computed = asyncio.ensure_future(engine.compute(photo(), Wanted(), whole, gone=gone()))
        await until(lambda: ran == [1])
        waiting = asyncio.ensure_future(engine.compute(photo(), Wanted(), whole, gone=gone()))
        await until(lambda: engine.gate.n_waiting == 1)
        engine.close()
        for late in (waiting, engine.compute(photo(), Wanted(), whole, gone=gone())):
            with pytest.raises(Problem) as caught:
                await late
            assert caught.value.kind == "shutting-down"
        go_on.set()
        result, _ = await computed
        assert result.size == (48, 64)

    play(Settings((model_file,), threads=1, limits=PATIENT), game)


def test_what_takes_longer_than_the_grace_is_refused_shortly_before_its_end(model_file: str, held: Held) -> None:
    ran, go_on = held

    async def game(engine: Engine) -> None:
        computed = asyncio.ensure_future(engine.compute(photo(), Wanted(), whole, gone=gone()))
        await until(lambda: ran == [1])
        engine.close()
        with pytest.raises(Problem) as caught:
            await computed
        assert caught.value.kind == "shutting-down"
        for task in asyncio.all_tasks() - {asyncio.current_task()}:  # as at the end of the event loop
            task.cancel()
        await until(lambda: engine.gate.n_inside == 0)
        assert engine.is_computing
        go_on.set()
        await until(lambda: not engine.is_computing)

    play(Settings((model_file,), threads=1, limits=replace(PATIENT, grace=1.05)), game)


def test_an_error_of_one_photo_is_its_own(model_file: str) -> None:
    async def game(engine: Engine) -> list[object]:
        contents = [photo(), photo()[:900], b"x"]
        asked = [engine.compute(content, Wanted(), whole, gone=gone()) for content in contents]
        return await asyncio.gather(*asked, return_exceptions=True)

    good, short, none = play(Settings((model_file,), batch_size=4), game)
    assert isinstance(good, tuple)
    assert isinstance(short, Problem)
    assert short.kind == "unreadable-photo"
    assert isinstance(none, Problem)
    assert none.kind == "unsupported-format"


def test_a_camera_of_one_photo_spoils_no_other_photo_of_its_batch(model_file: str) -> None:
    async def game(engine: Engine) -> list[object]:
        cameras = [Lens(fov_x=60), Lens(focal_px=0.1), Lens(fov_x=60)]
        asked = [engine.compute(photo(), Wanted(camera=camera), whole, gone=gone()) for camera in cameras]
        return await asyncio.gather(*asked, return_exceptions=True)

    # The batch of two is full when both good ones are in it.
    one, bad, other = play(Settings((model_file,), batch_size=2, batch_wait=PATIENCE, limits=PATIENT), game)
    assert isinstance(one, tuple)
    assert isinstance(other, tuple)
    assert isinstance(bad, Problem)
    assert bad.kind == "invalid-request"


def test_a_photo_that_is_too_narrow_is_refused_by_its_header(model_file: str, monkeypatch: pytest.MonkeyPatch) -> None:
    async def game(engine: Engine) -> None:
        with pytest.raises(Problem, match="too long and narrow") as caught:
            await engine.compute(photo(), Wanted(), whole, gone=gone())
        assert caught.value.kind == "invalid-request"

    monkeypatch.setattr("zoedepth.predict.MAX_NETWORK_AREA", 0.1)
    play(Settings((model_file,)), game)


def test_a_photo_may_be_too_narrow_only_until_its_notes_turn_it(
    model_file: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6
    lying = photo(48, 64, exif=exif, format="JPEG")
    size_of = Predictor.network_size

    def network_size(self: Predictor, size: tuple[int, int]) -> tuple[int, int]:
        if size[0] > size[1]:
            raise InputError("too long and narrow")
        return size_of(self, size)

    async def game(engine: Engine) -> None:
        result, _ = await engine.compute(lying, Wanted(), whole, gone=gone())
        assert result.size == (48, 64)
        with pytest.raises(Problem, match="Too long and narrow"):
            await engine.compute(photo(48, 64), Wanted(), whole, gone=gone())

    monkeypatch.setattr(Predictor, "network_size", network_size)
    play(Settings((model_file,)), game)


def test_models_must_give_metres_and_have_names_of_their_own(model_file: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="two models"):
        Engine(Settings((model_file, model_file)), Metrics()).start()
    with pytest.raises(InputError, match=r"missing\.pt"):
        Engine(Settings((str(tmp_path / "missing.pt"),)), Metrics()).start()


def test_names_keep_what_stands_behind_a_dot_unless_it_is_a_suffix(
    model_file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    network = load_model(model_file)
    monkeypatch.setattr("zoedepth.serve.engine.load_for_prediction", lambda source, **_: network)
    monkeypatch.setattr("zoedepth.serve.engine.weights_of", lambda source, **_: "")
    (tmp_path / "v1.2").mkdir()
    sources = ("lab/depth-v1.0", "lab/depth-v1.1", str(tmp_path / "v1.2"), model_file)
    engine = Engine(Settings(sources), Metrics())
    engine.start()
    engine.stop()
    assert list(engine.models) == ["depth-v1.0", "depth-v1.1", "v1.2", "tiny"]


def test_only_what_a_client_can_mend_or_wait_for_is_told() -> None:
    for error, kind in (
        (InputError("a fault"), "invalid-request"),
        (MissingExtraError("exr", "writing EXR"), "not-acceptable"),
        (MemoryError(), "no-room"),
        (RuntimeError("CUDA out of memory. Tried"), "no-room"),
        (RuntimeError("/srv/a.onnx: Failed to allocate memory for requested buffer of size 400"), "no-room"),
        (OSError(28, "No space left on device"), "no-room"),
    ):
        problem = as_problem(error)
        assert problem is not None
        assert problem.kind == kind
        assert "/srv" not in problem.detail
    assert as_problem(RuntimeError("a bug")) is None


def test_votes_of_a_batch_are_not_mixed(model_file: str) -> None:
    async def game(engine: Engine) -> bool:
        model = engine.models["tiny"]
        before = model.votes_together
        config = model.network.config
        assert not isinstance(config, BaselineConfig)
        model.network.config = replace(config, router=replace(config.router, vote="batch"))
        return model.votes_together and not before

    assert play(Settings((model_file,)), game)
