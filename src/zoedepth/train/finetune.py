"""Fine-tune a model on one's own data: look at the data, choose what fits it, train, and compare before and after."""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import torch
from torch.utils.data import Subset

from zoedepth.config import ModelConfig
from zoedepth.data.integrity import find_broken
from zoedepth.data.sample import DepthDataset, Sample
from zoedepth.errors import InputError
from zoedepth.evaluation.dataset_scores import score_dataset
from zoedepth.evaluation.predictions import ModelSource
from zoedepth.evaluation.protocols import protocol_of
from zoedepth.evaluation.summary import Summary, summarise
from zoedepth.forward.tensors import on_device
from zoedepth.images import atomic_path, write_image
from zoedepth.model.interface import DepthModel
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.outputs.ownership import has_own_mark
from zoedepth.presets import focal_in_network
from zoedepth.train.config import FinetuneOptions, OptimConfig, SourceConfig, TrainConfig
from zoedepth.train.extend import extended, extended_config, head_of, origin_of
from zoedepth.train.metric import train_metric
from zoedepth.train.pictures import data_sheet
from zoedepth.train.processes import own_device
from zoedepth.train.run import identity_of
from zoedepth.train.sources import open_source
from zoedepth.train.state import check_same, checkpoints
from zoedepth.train.survey import Survey, survey
from zoedepth.train.tolerant import explained, too_many
from zoedepth.weights.card import model_card
from zoedepth.weights.exported import is_exported
from zoedepth.weights.load import load_network
from zoedepth.weights.save import save_model

RESULTS = ("model.safetensors", "README.md", "metrics.json", "data.jpg")
"""Files that a fine-tuning writes into its folder."""

INITIAL = "initial.safetensors"
"""File, in the folder of a fine-tuning, of the model that training starts from."""

ROUTER_RIGHT = 0.95
"""Share of the held-out photos that the router must send to the head of their label; below it the router is trained."""


@dataclass(frozen=True)
class Plan:
    """A fine-tuning before it begins: what was found in the data, and what was chosen for it."""

    config: TrainConfig
    """The configuration of the training."""
    data: dict[str, str]
    """Name of a data set → where it is."""
    surveys: dict[str, Survey]
    """Name of a data set → what was found in it."""
    broken: dict[str, dict[int, str]]
    """Name of a data set → number of a pair that cannot be read → what is wrong with it."""
    init: str
    """The model to start from, for ``load_model``."""
    new_domains: tuple[str, ...]
    """Domains that the model gets a new head for."""
    unseen_domains: tuple[str, ...]
    """Domains of the model that the data has no photo of."""


def plan(
    data: Mapping[str, str],
    options: FinetuneOptions | None = None,
    *,
    out: Path,
    init: str | None = None,
    steps: int | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Plan:
    """Look at the data, and choose what fits it. Writes ``out/data.jpg``, a picture of some of the data.

    Args:
        data: name of a data set → where it is, anything that ``zoedepth.opening.open_dataset`` opens.
        options: the user's choices.
        out: folder for the result.
        init: starting weights, in place of those in ``options``.
        steps: number of steps, in place of that in ``options``.
        progress: called while files are looked at, with the number of pairs that are done, and of all.

    Raises:
        InputError: the data cannot be read or is not plausible, there are too few pairs, the model cannot be
            fine-tuned, or ``out`` has files that are not those of a fine-tuning, or the run of other data, options or
            weights. Nothing in ``out`` is changed then.
    """
    options = options or FinetuneOptions()
    options = replace(options, init=init or options.init, steps=options.steps if steps is None else steps)
    init = options.init
    _check_out(out, data)
    if is_exported(init):
        raise InputError(f"{init} is an exported file, which cannot be trained: give what it was exported from")
    model = load_network(init)
    if not isinstance(model, ZoeDepth) or not isinstance(model.config, ModelConfig):
        raise InputError(
            f"{init} is a baseline, which cannot be fine-tuned this way: train it with its recipe (zoedepth train "
            "RECIPE --init)"
        )
    if not model.config.domains:
        raise InputError(f"{init} gives relative depth only: train metric heads on it (zoedepth train RECIPE --init)")
    surveys, broken, samples, held_out = {}, {}, [], []
    for name, source in data.items():
        given = SourceConfig(name, domain=options.domain, depth_scale=options.depth_scale, root=options.root)
        dataset = open_source(given, source)
        surveys[name], broken[name], some = _look(dataset, name, source, options, progress)
        samples += some
        held_out.append(options.holdout if options.holdout is not None else min(50, max(1, len(dataset) // 7)))
        if len(dataset) - held_out[-1] < 1:
            raise InputError(
                f"{source} has {len(dataset)} pairs: a holdout of {held_out[-1]} leaves none to train on. Add "
                "pairs, or give a smaller --holdout"
            )
    far: dict[str, float] = {}
    for found in surveys.values():
        for scene, metres in found.far.items():
            far[scene] = max(metres, far.get(scene, 0.0))
    config = _config(model.config, surveys, far)
    known, wanted = {d.name for d in model.config.domains}, {d.name for d in config.domains}
    n = sum(found.n for found in surveys.values()) - sum(held_out)
    batch_size = min(4, n) if options.batch_size is None else options.batch_size
    steps = steps_for(n, max(1, batch_size)) if options.steps is None else options.steps
    chosen = TrainConfig(
        stage="metric",
        model=config,
        sources=tuple(
            replace(
                _source(name, found, canonical=config.canonical_camera),
                domain=options.domain,
                depth_scale=options.depth_scale,
                max_depth=found.max_depth,
                root=options.root,
            )
            for name, found in surveys.items()
        ),
        steps=steps,
        batch_size=batch_size,
        optim=_optim(config, options.learning_rate),
        # Data of one known domain would teach the router to name that domain for every photo. So the router is not
        # trained on it, unless it is wrong about these photos (see finetune).
        domain_weight=1.0 if len(config.domains) > 1 and (len(far) > 1 or wanted > known) else 0.0,
        ema_decay=0.99,
        holdout=min(held_out),
        holdouts=tuple(held_out) if len(set(held_out)) > 1 else (),
        validate_every=max(1, steps // 5),
        checkpoint_every=100,
        seed=options.seed,
        check="off",  # it has been looked at
    )
    out.mkdir(parents=True, exist_ok=True)
    _check_run(chosen, data, model, out)
    write_image(out / "data.jpg", data_sheet(samples[:8]))
    return Plan(
        chosen, dict(data), surveys, broken, init, tuple(sorted(wanted - known)),
        tuple(sorted(known - set(far))) if len(known) > 1 else (),
    )  # fmt: skip


def finetune(
    plan: Plan,
    *,
    out: Path,
    devices: int | None = None,
    n_nodes: int = 1,
) -> dict[str, tuple[Summary, Summary]]:
    """Train as planned, or go on with an interrupted fine-tuning in ``out``.

    Afterwards ``out`` holds ``model.safetensors``, its card ``README.md``, and ``metrics.json``; checkpoints and logs
    are in ``out/run``.

    Args:
        plan: the plan.
        out: folder for the result.
        devices: processes on each machine, see ``zoedepth.train.processes.launch_fabric``.
        n_nodes: machines.

    Returns:
        Name of a data set → what was measured on its held-out pairs, before and after.

    Raises:
        InputError: ``out`` has the run of other data, options or weights.
    """
    model = load_network(plan.init)
    start = out / INITIAL
    assert isinstance(model, ZoeDepth)  # there is no plan for other models
    assert isinstance(plan.config.model, ModelConfig)
    if not (start.is_file() and checkpoints(out / "run")):  # else they are the weights that the run began with
        save_model(extended(model, plan.config.model), start)
    before = {name: _measure(str(start), name, plan, "before") for name in plan.data}
    config = plan.config
    if any(summary.router is not None and summary.router < ROUTER_RIGHT for summary in before.values()):
        config = replace(config, domain_weight=1.0)
    last = train_metric(config, data=plan.data, out=out / "run", init=str(start), devices=devices, n_nodes=n_nodes)
    after = {name: _measure(str(last), name, plan, "after") for name in plan.data}
    measured = {name: (before[name], after[name]) for name in plan.data}
    _write(out, load_network(last), measured)
    return measured


def _check_out(out: Path, data: Mapping[str, str]) -> None:
    """Check that nothing in a folder would be replaced that is not of a fine-tuning."""
    for source in data.values():
        if Path(source).is_dir() and out.is_dir() and out.samefile(source):
            raise InputError(f"--out {out} is the folder of the data: choose another one, so that they do not mix")
    ours = (out / INITIAL).is_file() or (out / "run").is_dir()
    clash = [name for name in RESULTS if (out / name).exists()]
    only_looked = clash == ["data.jpg"] and has_own_mark(out / "data.jpg")  # a plan was made, and no more
    if clash and not ours and not only_looked:
        raise InputError(
            f"--out {out} has {', '.join(clash)}, and no fine-tuning has written it: choose another folder, or move "
            "these files away"
        )


def _check_run(config: TrainConfig, data: Mapping[str, str], model: ZoeDepth, out: Path) -> None:
    """Check that the run in ``out``, if there is one, is of this configuration, this data and this model."""
    existing = checkpoints(out / "run")
    if not existing or not isinstance(config.model, ModelConfig):
        return
    opened = {source.name: open_source(source, data[source.name]) for source in config.sources}
    with TemporaryDirectory(dir=out, prefix=".") as folder:
        start = Path(folder) / INITIAL
        save_model(extended(model, config.model), start)
        identity = identity_of(opened, data, str(out / INITIAL), start=str(start))
    check_same(existing[-1], config, identity, besides=["domain_weight"])  # which is chosen when it has been measured


def _look(
    dataset: DepthDataset,
    name: str,
    source: str,
    options: FinetuneOptions,
    progress: Callable[[int, int], None],
) -> tuple[Survey, dict[int, str], list[Sample]]:
    """Look at the files of a data set and at some of its depth; return findings, broken pairs and samples to show."""
    broken: dict[int, str] = {}
    if options.check != "off":
        broken = find_broken(dataset, full=options.check == "full", progress=progress)
        if too_many(broken, len(dataset)):
            raise InputError(explained(source, broken, len(dataset)))
    found, samples = survey(dataset, name=name, broken=broken, trusted=options.check == "off")
    if found.doubts.impossible:
        raise InputError(
            f"{name}: {'; '.join(found.doubts.impossible)}. Give the right depth_scale in the data or by "
            "--depth-scale, or --check off if it is right as it is"
        )
    return found, broken | found.unreadable, samples


def _source(name: str, found: Survey, *, canonical: bool) -> SourceConfig:
    """Return a source that shows photos at the scale at which the network will see them: it is to learn this camera."""
    return SourceConfig(
        name,
        crop="fit",
        sparse=found.sparse,
        rotate_degrees=2.0,
        color_probability=0.8,
        without_camera="assume" if canonical and not found.n_cameras else "refuse",
    )


def _config(config: ModelConfig, surveys: Mapping[str, Survey], far: Mapping[str, float]) -> ModelConfig:
    """Return the config of the model that is trained: heads for all domains, and the camera that their metres are of.

    In a canonical camera it stays what it is, and depth reaches as far as it does once it is scaled to it. Else it
    becomes that of the data: the median of its focal lengths, or unknown if the camera of a photo is.

    Args:
        config: the config of the model there is.
        surveys: name of a data set → what was found in it.
        far: domain → its farthest depth, metres.

    Raises:
        InputError: the model is in a canonical camera, and the camera of some photos of a data set is known and of
            others is not.
    """
    lenses: dict[str, list[float]] = {}
    unknown: set[str] = set()
    scaled = dict.fromkeys(far, 0.0)
    for name, found in surveys.items():
        if config.canonical_camera and 0 < found.n_cameras < found.n_seen:
            raise InputError(
                f"{name} says the camera of {found.n_cameras} of the {found.n_seen} photos that were looked at: give "
                "fx, fy, cx, cy for all of them, in the list or in dataset.json, or for none"
            )
        for scene, metres in found.far.items():
            cameras = found.cameras.get(scene, ())
            focal = [focal_in_network(config, camera.fy, camera.size) for camera in cameras]
            lenses.setdefault(head_of(config, scene), []).extend(focal)
            if len(cameras) < found.count[scene]:
                unknown.add(head_of(config, scene))
            canonical = origin_of(config, scene, far[scene]).focal_px if config.canonical_camera else None
            widest = canonical / min(focal) if canonical is not None and focal else 1.0
            scaled[scene] = max(scaled[scene], metres * widest)
    if config.canonical_camera:
        one = {head_of(config, scene): origin_of(config, scene, metres).focal_px for scene, metres in far.items()}
        return extended_config(config, scaled, focal_px={head: focal for head, focal in one.items() if focal})
    learned = {head: round(median(found), 2) for head, found in lenses.items() if head not in unknown}
    return extended_config(config, scaled, focal_px=learned)


def steps_for(n: int, batch_size: int) -> int:
    """Return the number of steps: 40 epochs of a few dozen pairs, falling to the paper's 5 epochs of many thousands."""
    epochs = min(40.0, max(5.0, 40.0 * (30 / n) ** 0.4))
    return max(100, round(epochs * n / batch_size))


def _optim(config: ModelConfig, learning_rate: float | None) -> OptimConfig:
    """Choose the rates: convolutional encoders take larger ones than the paper's transformers."""
    if config.encoder.family == "convolutional":
        rate = 3e-4 if learning_rate is None else learning_rate
        return OptimConfig(learning_rate=rate, encoder_factor=0.3, warmup=0.1, initial_division=20, clip=1.0)
    rate = 1.61e-4 if learning_rate is None else learning_rate
    return OptimConfig(learning_rate=rate, warmup=0.3, initial_division=20)


def _measure(model: str, name: str, plan: Plan, label: str) -> Summary:
    """Score a model on the held-out pairs of a data set."""
    (source,) = (source for source in plan.config.sources if source.name == name)
    dataset = open_source(source, plan.data[name])
    n = len(dataset)
    held_out = Subset(dataset, range(n - plan.config.held_out(name), n))
    protocols = {scene: protocol_of(scene) for scene in dataset.domains}
    knows = plan.config.model.canonical_camera and plan.surveys[name].n_cameras > 0
    tested = ModelSource(on_device(load_network(model), own_device()), camera="data" if knows else "none")
    with torch.no_grad():
        results = score_dataset(tested, held_out, protocols, workers=tested.workers)
    return summarise(
        label,
        name,
        list(results.scores.values()),
        protocols,
        n_failed=len(results.failures),
        camera=tested.camera,
    )


def _write(out: Path, model: DepthModel, measured: Mapping[str, tuple[Summary, Summary]]) -> None:
    """Write the model with its provenance, its card, and the metrics."""
    metrics: dict[str, dict[str, float]] = {}
    for name, (_, after) in measured.items():
        if after.metrics is not None:
            protocols = ", ".join(after.protocols.values())
            metrics[f"{name} (held out, {after.n_scored} pairs, {protocols})"] = asdict(after.metrics)
    about = model.provenance = replace(model.provenance, measured=metrics)
    save_model(model, out / "model.safetensors")
    card = model_card(
        model.config, name="model.safetensors", layout="zoedepth", licence=about.licence, trained_on=about.trained_on,
        metrics=about.measured,
    )  # fmt: skip
    values = {name: {"before": a.to_json(), "after": b.to_json()} for name, (a, b) in measured.items()}
    for path, text in ((out / "README.md", card), (out / "metrics.json", json.dumps(values, indent=2) + "\n")):
        with atomic_path(path) as part:
            part.write_text(text, encoding="utf-8")
