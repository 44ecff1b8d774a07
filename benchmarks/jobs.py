"""Jobs of many photos: are they lost, are they done twice, and what does it cost to know?

    python -m benchmarks.jobs kill [--kills 50] [--photos 300] [--shards 1] [--engine process] [--fork]
    python -m benchmarks.jobs lose-a-node [--photos 60]
    python -m benchmarks.jobs overhead [--photos 1000] [--turns 5]
    python -m benchmarks.jobs ray-overhead [--photos 512] [--turns 5] [--workers N]
    python -m benchmarks.jobs many [--photos 100000]
    python -m benchmarks.jobs parts [--photos 50]
    python -m benchmarks.jobs simulate [--machines 1000] [--photos 10000000]

``kill`` and ``lose-a-node`` exit with 0 if every input is done exactly once, no file is half written, and all files
have the bits of a run that was left alone. ``overhead`` counts the processor's time, which others hardly change;
``ray-overhead`` needs a machine that nobody else uses, because Ray's work is in many processes, and only the clock sees
it all.
"""

import json
import os
import random
import re
import resource
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro
from PIL import Image


def kill(
    *,
    kills: int = 50,
    photos: int = 300,
    shards: int = 1,
    engine: Literal["process", "ray"] = "process",
    fork: bool = False,
    seed: int | None = None,
) -> int:
    """Kill the command at random moments with ``kill -9``, type it again each time, and compare.

    Args:
        kills: how often.
        photos: photos of the job.
        shards: commands that work at the same time; each kill is of one of them.
        engine: see `zoedepth predict`.
        fork: begin the command in forks of this process, without the seconds in which Python imports it.
        seed: of the moments.
    """
    seed = random.randrange(1 << 30) if seed is None else seed
    rng = random.Random(seed)
    print(f"seed {seed}", flush=True)
    if fork:
        _import_all()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_photos(folder / "in", photos, size=(120, 160))
        began = time.monotonic()
        _Command(folder, "alone", 0, 1, "process", fork=fork).wait()
        photo_seconds = (time.monotonic() - began) / photos
        print("one run was left alone", flush=True)
        running = [_Command(folder, "killed", index, shards, engine, fork=fork) for index in range(shards)]
        killed = Counter[str]()
        while killed.total() < kills and any(command.code != 0 for command in running):
            command = rng.choice([command for command in running if command.code != 0])
            n_done = _n_done(folder / "killed")
            target = n_done + int(rng.random() * 2 * (photos - n_done) / (kills - killed.total() + 1))
            while _n_done(folder / "killed") < target and not command.ended():
                time.sleep(0.005)
            time.sleep(rng.random() * photo_seconds)  # in the middle of anything: a file, a name, a line
            if not command.ended():
                actors = _actors(command.pid) if engine == "ray" and rng.random() < 0.8 else []
                if actors:
                    os.kill(rng.choice(actors), signal.SIGKILL)
                else:
                    command.kill()
                killed["actors" if actors else "commands"] += 1
            if command.code == -signal.SIGKILL:
                command.start()
            elif command.code:
                break  # it failed by itself, which the report shows
        codes = [command.wait() for command in running]
        print(f"killed: {dict(killed)}; the commands that were left ended with {codes}")
        return _report(folder, photos) or killed.total() < kills


def _actors(pid: int) -> list[int]:
    """Return the processes below another one in which Ray's actors predict photos."""
    import psutil

    found = []
    for process in psutil.Process(pid).children(recursive=True):
        with suppress(psutil.Error):  # it has ended
            if re.match(r"ray::_?MapWorker", "".join(process.cmdline()[:1])):
                found.append(process.pid)
    return found


def _import_all() -> None:
    """Import what the command does, on one thread: a fork has no other."""
    import torch

    import zoedepth.commands.predict
    import zoedepth.jobs.ray_engine
    import zoedepth.weights.load

    torch.set_num_threads(1)
    assert zoedepth.commands.predict.predict
    zoedepth.weights.load.load_model("zoed-lite")


def lose_a_node(*, photos: int = 60) -> int:
    """Take a whole node from a Ray cluster of two while it works, and compare with a run that was left alone."""
    import ray
    from ray.cluster_utils import Cluster

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_photos(folder / "in", photos)
        _Command(folder, "alone", 0, 1, "process", fork=False).wait()
        cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
        node = cluster.add_node(num_cpus=1)
        cluster.wait_for_nodes()
        more = ("--address", str(cluster.address))
        process = _Command(folder, "killed", 0, 1, "ray", *more, fork=False)
        while _n_done(folder / "killed") < photos // 4 and not process.ended():
            time.sleep(0.05)
        cluster.remove_node(node, allow_graceful=False)
        print(f"a node was lost after {_n_done(folder / 'killed')} photos")
        print(f"the command ended with {process.wait()}")
        ray.shutdown()
        cluster.shutdown()
        return _report(folder, photos)


def overhead(*, photos: int = 1000, turns: int = 5, network: bool = True) -> int:
    """Compare, in turns, photos that are only predicted with the same photos as a job: seconds of the processor.

    Args:
        photos: of all turns together.
        turns: how often each is done.
        network: False predicts tiny photos without one, so that nothing but the work around it is counted.
    """
    from zoedepth import Predictor, load_model
    from zoedepth.batch import Request, predict_all
    from zoedepth.jobs.inputs import Sources
    from zoedepth.jobs.place import job_place
    from zoedepth.jobs.run import Tally, run_job
    from zoedepth.jobs.shard import JobShard
    from zoedepth.photos import find_photos
    from zoedepth.threads import share_cores

    request = Request("zoed-lite", ("depth",))
    with tempfile.TemporaryDirectory() as name, share_cores(1):
        folder = Path(name)
        write_photos(folder / "in", photos // turns, size=(480, 640) if network else (8, 8))
        predictor: Any = Predictor(load_model("zoed-lite"), flip_average=False) if network else _Nothing()

        def plain(out: Path) -> None:
            for outcome in predict_all(find_photos([str(folder / "in")], out).photos, predictor, request):
                assert outcome.failure is None

        def job(out: Path) -> None:
            place, tally = job_place(out, JobShard()), Tally()
            with place.opened() as manifest:
                manifest.begin({}, named=False)
                inputs = Sources((str(folder / "in"),), known=manifest.knows).inputs()
                for done in run_job(inputs, predictor, request, manifest=manifest, destination=place.destination,
                                    workers=1, tally=tally):  # fmt: skip
                    assert done.entry.error is None

        plain(folder / "warm")
        seconds: dict[str, list[float]] = {"plain": [], "job": []}
        for turn in range(turns):
            for kind, work in (("plain", plain), ("job", job)) if turn % 2 else (("job", job), ("plain", plain)):
                out = folder / f"{kind}-{turn}"
                seconds[kind].append(_processor_seconds(lambda work=work, out=out: work(out)))
                shutil.rmtree(out)
        ratios = [job / plain for job, plain in zip(seconds["job"], seconds["plain"], strict=True)]
        n = photos // turns
        more = [(job - plain) / n for job, plain in zip(seconds["job"], seconds["plain"], strict=True)]
        print(f"{n} photos in each of {turns} turns, {'zoed-lite' if network else 'without a network'}, one core")
        print(f"processor time of a photo: {1000 * statistics.median(seconds['plain']) / n:.2f} ms plain; a job takes")
        print(f"{1000 * statistics.median(more):.2f} ms more ({1000 * min(more):.2f} - {1000 * max(more):.2f})")
        print(f"a job takes {statistics.median(ratios):.4f} times as long ({min(ratios):.4f} - {max(ratios):.4f})")
    return 0


def ray_overhead(*, photos: int = 512, turns: int = 5, workers: int | None = None) -> int:
    """Compare, in turns, one process with Ray on the same cores: photos a second by the clock, after Ray's start.

    The second half of the photos is timed: by then all actors have their model.

    Args:
        photos: of each turn.
        turns: how often each is done.
        workers: cores; None: all.
    """
    from zoedepth import Predictor, load_model
    from zoedepth.batch import Request
    from zoedepth.jobs.inputs import Sources
    from zoedepth.jobs.place import job_place
    from zoedepth.jobs.ray_engine import run_on_ray
    from zoedepth.jobs.run import Tally, run_job
    from zoedepth.jobs.shard import JobShard
    from zoedepth.threads import cpu_count, share_cores

    n_cores, request = workers or cpu_count(), Request("zoed-lite", ("depth",))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_photos(folder / "in", photos)
        predictor = Predictor(load_model("zoed-lite"), flip_average=False)

        def rate(engine: str, out: Path) -> float:
            """Do all photos, and return how many of the second half are done in a second."""
            place, times = job_place(out, JobShard()), [0.0]
            with place.opened() as manifest, share_cores(n_cores):
                manifest.begin({}, named=False)
                inputs, tally = Sources((str(folder / "in"),)).inputs(), Tally()
                if engine == "ray":
                    results = run_on_ray(inputs, predictor, request, model="zoed-lite", device="cpu", address="local",
                                         manifest=manifest, destination=place.destination, workers=n_cores,
                                         tally=tally)  # fmt: skip
                else:
                    results = run_job(inputs, predictor, request, manifest=manifest, destination=place.destination,
                                      workers=n_cores, tally=tally)  # fmt: skip
                for done in results:
                    assert done.entry.error is None
                    times.append(time.monotonic())
            shutil.rmtree(out)
            return (photos - photos // 2) / (times[-1] - times[photos // 2])

        ratios = []
        for turn in range(turns):
            order = ("process", "ray") if turn % 2 else ("ray", "process")
            rates = {engine: rate(engine, folder / f"{engine}-{turn}") for engine in order}
            ratios.append(rates["process"] / rates["ray"])
            print(f"{rates['process']:.2f} photos a second in one process, {rates['ray']:.2f} with Ray", flush=True)
        print(f"{n_cores} cores: a photo takes {statistics.median(ratios):.3f} times as long with Ray "
              f"({min(ratios):.3f} - {max(ratios):.3f})")  # fmt: skip
    return 0


def many(*, photos: int = 100_000) -> int:
    """Do tiny photos without a network: when the first is there, what memory it takes, and how fast the manifest is."""
    from zoedepth.batch import Request
    from zoedepth.jobs.inputs import Sources
    from zoedepth.jobs.manifest import Entry, Manifest
    from zoedepth.jobs.place import job_place
    from zoedepth.jobs.run import Tally, run_job
    from zoedepth.jobs.shard import JobShard

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        content = _png(np.random.default_rng(0).integers(0, 256, (8, 8, 3), dtype=np.uint8))
        for index in range(photos):
            path = folder / "in" / f"{index // 1000:05d}" / f"{index:08d}.png"
            if index % 1000 == 0:
                path.parent.mkdir(parents=True)
            path.write_bytes(content)
        predictor: Any = _Nothing()
        memory: dict[int, float] = {}
        for attempt in ("first", "second"):
            began, busy, first, tally = time.perf_counter(), time.process_time(), 0.0, Tally()
            place = job_place(folder / "out", JobShard())
            with place.opened() as manifest:
                manifest.begin({}, named=False)
                inputs = Sources((str(folder / "in"),), known=manifest.knows).inputs()
                for _ in run_job(inputs, predictor, Request("nothing", ("npy",)), manifest=manifest,
                                 destination=place.destination, workers=1, tally=tally):  # fmt: skip
                    first = first or time.perf_counter() - began
                    if tally.seen % 10_000 == 0:
                        memory[tally.seen] = _resident()
            seconds, busy = time.perf_counter() - began, time.process_time() - busy
            print(f"{attempt} start: {tally.done} done, {tally.before} done before, {seconds:.1f} s by the clock, "
                  f"{busy:.1f} s of a core", flush=True)  # fmt: skip
            if tally.done:
                print(f"the first result came after {first:.2f} s; {tally.done / seconds:.0f} photos a second")
                print("memory in MB: " + ", ".join(f"{n}: {mb:.0f}" for n, mb in memory.items()))
        manifest = Manifest(folder / "lines.jsonl")
        manifest.begin({}, named=False)
        entry = Entry("/photos/00001/00000001.png", "done", 8, 1, {"npy": ("00001/00000001_depth.npy", 384)}, 0.1)
        began = time.perf_counter()
        for _ in range(20_000):
            manifest.add(entry)
        print(f"the manifest alone: {20_000 / (time.perf_counter() - began):.0f} lines a second")
        manifest.close()
    return 0


def parts(*, photos: int = 50) -> int:
    """Measure decoding, the model and encoding apart: processor time of a photo of 640 x 480, and of 4000 x 3000."""
    from zoedepth import Predictor, load_model
    from zoedepth.batch import Request, predict_maps, write_drafts
    from zoedepth.images import read_image
    from zoedepth.photos import Photo
    from zoedepth.threads import share_cores

    with tempfile.TemporaryDirectory() as name, share_cores(1):
        folder = Path(name)
        predictor = Predictor(load_model("zoed-lite"), flip_average=False)
        for size, n in (((480, 640), photos), ((3000, 4000), max(3, photos // 10))):
            write_photos(folder / f"{size[1]}", 1, size=size)
            path = next((folder / f"{size[1]}").rglob("*.jpg"))
            photo, image = Photo(path, folder / "a"), read_image(path)
            request = Request("zoed-lite", ("depth",))
            predicted = predict_maps(photo, predictor, request)
            works: dict[str, Callable[[], object]] = {
                "decode": lambda path=path: read_image(path),
                "model, with resizing": lambda image=image: predictor(image),
                "encode depth": lambda photo=photo, p=predicted, r=request: write_drafts(photo, p, r, folder),
                "encode depth and preview": lambda photo=photo, p=predicted: write_drafts(
                    photo, p, Request("zoed-lite"), folder
                ),
            }
            for what, work in works.items():
                work()
                seconds = [_processor_seconds(work) for _ in range(n)]
                print(
                    f"{size[1]} x {size[0]}, {what}: {1000 * statistics.median(seconds):.0f} ms of a core", flush=True
                )
    return 0


def simulate(
    *,
    machines: int = 1000,
    photos: int = 10_000_000,
    seconds: float = 0.5,
    start: float = 30.0,
    hours_between_losses: float = 6.0,
    slow: float = 0.02,
    seed: int = 0,
) -> int:
    """Simulate a job on many machines that are lost and come back, with and without the manifest.

    The manifest's own times are measured here, with real files of a shard's length; everything else is drawn.

    Args:
        machines: shards, a machine each.
        photos: inputs of the job.
        seconds: a photo takes on average; the times are log-normal, with a standard deviation of half of it.
        start: seconds until a new machine has begun: container, Python, weights.
        hours_between_losses: mean time after which a machine is lost. It is replaced at once.
        slow: fraction of machines that take four times as long: stragglers.
        seed: of the draws.
    """
    counted = Counter(_shard_of(index, machines) for index in range(photos))
    shares = [counted[index] for index in range(machines)]
    add, load = _manifest_times(int(np.mean(shares)))
    print(f"measured: {1e6 * add:.0f} us to add a line, {1e3 * load:.1f} ms to read {int(np.mean(shares))} lines again")
    print(f"photos of a shard: {min(shares)} to {max(shares)}")
    spread = np.sqrt(np.log(1.25))
    for kind in ("manifest", "none"):
        ends, work, repeated, manifest_seconds, losses = [], 0.0, 0.0, 0.0, 0
        rng = np.random.default_rng(seed)  # the same machines and photos for both
        for share in shares:
            pace = 4.0 if rng.random() < slow else 1.0
            times = pace * seconds * rng.lognormal(-(spread**2) / 2, spread, share)
            clock, done = 0.0, 0
            while done < share:
                life = rng.exponential(3600 * hours_between_losses)
                overhead = start + (load if kind == "manifest" and done else 0.0)
                each = add if kind == "manifest" else 0.0
                needed = np.cumsum(times[done:] + each)
                n = int(np.searchsorted(needed, max(0.0, life - overhead)))
                manifest_seconds += (load if done else 0.0) + each * n if kind == "manifest" else 0.0
                if n >= len(needed):
                    clock += overhead + float(needed[-1])
                    work += float(needed[-1])
                    done = share
                else:
                    losses += 1
                    clock += max(life, overhead)
                    spent = max(0.0, life - overhead)
                    work += spent
                    kept = float(needed[n - 1]) if n else 0.0
                    repeated += spent - kept if kind == "manifest" else spent
                    done = done + n if kind == "manifest" else 0
                if clock > 3600 * 24 * 60:
                    break
            ends.append(clock)
        ends = np.sort(ends)
        print(
            f"{'with the manifest' if kind == 'manifest' else 'from the beginning each time'}: {losses} losses, "
            f"half of the machines after {ends[machines // 2] / 60:.1f} min, 99 % after "
            f"{ends[int(0.99 * machines)] / 60:.1f} min, all after {ends[-1] / 60:.1f} min; "
            f"{100 * repeated / work:.2f} % of the work was done again; "
            f"the manifest took {100 * manifest_seconds / work:.4f} % of it"
        )
    return 0


def write_photos(folder: Path, n: int, *, size: tuple[int, int] = (480, 640)) -> None:
    """Write JPEGs of (height, width) that look a little like photos: smooth, with noise."""
    rng = np.random.default_rng(0)
    ramp = np.linspace(0, 200, size[1])[None, :, None] * np.linspace(0.3, 1, size[0])[:, None, None]
    for index in range(n):
        path = folder / f"day {index % 7}" / f"{index:06d}.jpg"
        path.parent.mkdir(parents=True, exist_ok=True)
        photo = ramp * rng.random(3) + rng.normal(0, 8, (*size, 3)) + 20
        Image.fromarray(photo.clip(0, 255).astype(np.uint8)).save(path, quality=90)


class _Command:
    """A command that runs in a process of its own: a new one, or a fork of this one, which has imported everything."""

    def __init__(self, folder: Path, out: str, index: int, shards: int, engine: str, *more: str, fork: bool) -> None:
        words = [
            "predict", str(folder / "in"), "--out", str(folder / out), "--no-flip", "--save", "depth,npy",
            "--workers", "2" if engine == "ray" else "1", "--engine", engine, *more,
        ]  # fmt: skip
        if shards > 1:
            words += ["--shard", f"{index}/{shards}"]
        self.words, self.log, self.fork = words, folder / f"{out}-{index}.log", fork
        self.start()

    def start(self) -> None:
        self.code: int | None = None
        with self.log.open("ab") as log:
            if self.fork:
                self.pid = os.fork()
                if self.pid == 0:
                    os.setsid()
                    os.dup2(log.fileno(), 1)
                    os.dup2(log.fileno(), 2)
                    os._exit(_run(self.words))
            else:
                # A group of its own, so that everything it has started dies with it.
                command = [sys.executable, "-m", "zoedepth", *self.words]
                # Kept, because whoever forgets a process of subprocess has it waited for there.
                self.process = subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True)
                self.pid = self.process.pid

    def ended(self) -> bool:
        return self.code is not None or self._ask(os.WNOHANG)

    def wait(self) -> int:
        while self.code is None:
            self._ask(0)
        return self.code

    def kill(self) -> None:
        os.killpg(self.pid, signal.SIGKILL)
        self.wait()

    def _ask(self, how: int) -> bool:
        pid, status = os.waitpid(self.pid, how)
        if pid:
            self.code = os.waitstatus_to_exitcode(status)
        return bool(pid)


def _run(words: list[str]) -> int:
    from zoedepth.cli import main as command

    try:
        return command(words)
    except BaseException as error:  # a process of its own tells it to the one that counts
        print(repr(error), file=sys.stderr)
        return 99


def _lines(out: Path) -> list[dict[str, Any]]:
    found = []
    for manifest in out.glob("zoedepth-manifest*.jsonl"):
        for line in manifest.read_bytes().splitlines():
            try:
                values = json.loads(line)
            except ValueError:
                continue
            if "input" in values:
                found.append(values)
    return found


def _n_done(out: Path) -> int:
    return sum(manifest.read_bytes().count(b'"status": "done"') for manifest in out.glob("zoedepth-manifest*.jsonl"))


def _report(folder: Path, n: int) -> int:
    alone, killed = ({
        file.relative_to(folder / out): _content(file)
        for file in (folder / out).rglob("*") if file.is_file() and "zoedepth-manifest" not in file.name
    } for out in ("alone", "killed"))  # fmt: skip
    times = Counter(line["input"] for line in _lines(folder / "killed") if line["status"] == "done")
    left = [str(path) for path in (folder / "killed").iterdir() if path.name.startswith(".zoedepth-drafts")]
    differ = sorted(str(name) for name in alone.keys() | killed.keys() if alone.get(name) != killed.get(name))
    once = len(times) == n and set(times.values()) == {1}
    print(f"{len(times)} of {n} inputs have a line, {sum(times.values()) - len(times)} have more than one")
    print(
        f"{len(killed)} files; {len(differ)} differ from those of the run left alone {differ[:5]}; drafts left: {left}"
    )
    good = once and not differ and not left
    print("every input exactly once, no half file, the same bits" if good else "NOT THE SAME")
    if not good:
        for log in folder.glob("*.log"):
            print(log.name, log.read_text()[-2000:])
    return 0 if good else 1


def _content(file: Path) -> bytes:
    content = file.read_bytes()
    if file.suffix == ".json":  # how long it took is another number each time
        return b"\n".join(line for line in content.splitlines() if b'"seconds"' not in line)
    return content


def _processor_seconds(work: Callable[[], object]) -> float:
    def used() -> float:
        usage = resource.getrusage(resource.RUSAGE_SELF)
        return usage.ru_utime + usage.ru_stime

    before = used()
    work()
    return used() - before


def _resident() -> float:
    """Return the megabytes of memory that this process has now."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


def _png(image: np.ndarray) -> bytes:
    from io import BytesIO

    file = BytesIO()
    Image.fromarray(image).save(file, "PNG")
    return file.getvalue()


class _Nothing:
    """A predictor without a network: 2 m everywhere."""

    corrects_known_cameras = False
    runtime = "none"
    camera, focal_correction = "exif", None

    def __init__(self) -> None:
        from types import SimpleNamespace

        self.model = SimpleNamespace(config=SimpleNamespace(size=(8, 8)))

    def __call__(self, image: object, *, domain: str | None = None) -> object:
        from zoedepth.depth_map import DepthMap
        from zoedepth.geometry.camera import Camera
        from zoedepth.images import to_image

        photo = to_image(image)
        depth = np.full(photo.shape[:2], 2, np.float32)
        camera = Camera.from_fov(photo.shape[:2], horizontal=60.0, source="assumed")
        return DepthMap(depth, None, "indoor", {"indoor": 1.0}, photo, (8, 8), camera)


def _shard_of(index: int, machines: int) -> int:
    from zoedepth.jobs.names import key_of

    return int.from_bytes(key_of(f"{index // 1000:05d}/{index:08d}.jpg")[:8], "big") % machines


def _manifest_times(n: int) -> tuple[float, float]:
    """Return the seconds of adding a line to a manifest, and of reading one of ``n`` lines again."""
    from zoedepth.jobs.manifest import Entry, Manifest

    with tempfile.TemporaryDirectory() as name:
        path = Path(name, "m.jsonl")
        manifest = Manifest(path)
        manifest.begin({}, named=False)
        began = time.perf_counter()
        for index in range(n):
            outputs = {"depth": (f"{index}_depth.png", 100_000), "sidecar": (f"{index}.json", 900)}
            manifest.add(Entry(f"/photos/{index:08d}.jpg", "done", 100_000, 1_764_000_000_000_000_000, outputs, 0.5))
        add = (time.perf_counter() - began) / n
        manifest.close()
        began = time.perf_counter()
        Manifest(path).close()
        return add, time.perf_counter() - began


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one of the measurements."""
    commands = {
        "kill": kill, "lose-a-node": lose_a_node, "overhead": overhead, "ray-overhead": ray_overhead, "many": many,
        "parts": parts, "simulate": simulate,
    }  # fmt: skip
    return tyro.extras.subcommand_cli_from_dict(commands, args=arguments)


if __name__ == "__main__":
    sys.exit(main())
