"""The configuration of a training run: frozen dataclasses, every field of which the command line can override."""

from dataclasses import dataclass, field
from typing import Literal

from zoedepth.config import AnyModelConfig, ModelConfig
from zoedepth.errors import InputError

Precision = Literal["auto", "bf16-mixed", "16-mixed", "32-true"]


@dataclass(frozen=True)
class SourceConfig:
    """How the samples of one data set are drawn and augmented."""

    name: str
    """The NAME in ``--data NAME=PATH``."""
    weight: int = 1
    """Its turns in a round of the mixture."""
    domain: str | None = None
    """Scene type of its photos, where the data itself says none."""
    depth_scale: float | None = None
    """Stored value of one metre, where the data itself says none."""
    sparse: bool = False
    """Depth is known at scattered points (lidar): resizing keeps each, where taking every n-th pixel loses most."""
    gradient_term: bool = True
    """Stage 1: the gradient term of the loss is used. Not for scattered depth, which has no neighbours (DPT)."""
    crop: Literal["squeeze", "fit", "window"] = "squeeze"
    """squeeze: the whole photo, its shape ignored (released). fit: a window of the network's shape, as large as fits.
    window: one of the size below, not resized (the native baselines)."""
    window: tuple[int, int] | None = None
    """window only: its (height, width), multiples of the model's; None: the model's size."""
    max_zoom: float = 1.0
    """fit only: windows are up to this many times smaller than the photo, and depth that many times nearer."""
    zoom_probability: float = 1.0
    """fit only: share of the samples that are zoomed."""
    kitti_crop: bool = False
    """First take the bottom centre 352x1216 of the photo."""
    rotate_degrees: float = 1.0
    """Largest rotation, either way."""
    color_probability: float = 0.5
    """Share of the samples whose colours are changed."""
    gamma: tuple[float, float] = (0.9, 1.1)
    """Range of the gamma."""
    brightness: tuple[float, float] = (0.75, 1.25)
    """Range of the brightness factor."""
    channel_gain: tuple[float, float] = (0.9, 1.1)
    """Range of the factor of each colour channel."""
    saturation: tuple[float, float] = (1.0, 1.0)
    """Range of the saturation; 0 is grey."""


@dataclass(frozen=True)
class OptimConfig:
    """AdamW with one-cycle rates (paper; released ``config_zoedepth.json``), with constant ones (MiDaS v3.1), or with
    falling ones (BTS, NeWCRFs; DORN, with plain gradient descent)."""

    optimizer: Literal["adamw", "sgd"] = "adamw"
    """adamw, or gradient descent with the momentum below."""
    learning_rate: float = 1.61e-4
    """Highest rate, that of the metric heads and the router."""
    encoder_factor: float = 0.1
    """The encoder's rate, as a factor of it. 0 freezes the encoder."""
    position_factor: float = 0.1
    """The rate of the relative position tables, as a factor of it."""
    decoder_factor: float = 1.0
    """The decoder's rate, as a factor of it. 0 freezes the decoder."""
    weight_decay: float = 0.01
    """Decay of the weights."""
    decay_encoder_only: bool = False
    """The weights after the encoder are not decayed (BTS)."""
    frozen: tuple[str, ...] = ()
    """Parameters that stay as they are, as patterns of their names: ``encoder.*norm*`` (BTS)."""
    schedule: Literal["one-cycle", "constant", "polynomial"] = "one-cycle"
    """one-cycle: see the fields below. constant: every rate as it is. polynomial: from the highest rate to that divided
    by ``final_division``, as the power 0.9 of the steps that are left. The latter two with the higher ``momentum``."""
    warmup: float = 0.7
    """Share of the steps before the rates fall."""
    initial_division: float = 1.0
    """The first rate is the highest divided by this."""
    final_division: float = 1e4
    """The last rate is the first divided by this."""
    momentum: tuple[float, float] = (0.85, 0.95)
    """AdamW's first beta, or the momentum: lowest where the rate is highest, and the other way round."""
    eps: float = 1e-8
    """Added to AdamW's denominator; BTS trains with 1e-3."""
    clip: float = 0.1
    """Largest norm of all gradients together."""


@dataclass(frozen=True)
class TrainConfig:
    """One run of one stage."""

    stage: Literal["relative", "metric"]
    """relative: encoder and decoder on disparity. metric: the whole model on depth in metres."""
    model: AnyModelConfig
    """The network."""
    sources: tuple[SourceConfig, ...]
    """The data sets it can be trained on; those given with ``--data`` are used."""
    steps: int
    """Optimizer steps."""
    batch_size: int = 16
    """Samples a step, of all processes together."""
    optim: OptimConfig = field(default_factory=OptimConfig)
    """Rates and their schedule."""
    mix_by: Literal["image", "batch"] = "image"
    """Data sets take turns image by image, or batch by batch (released)."""
    accumulate: int = 1
    """The samples of a step go through the network in this many batches, for the memory of one. Losses whose statistics
    are those of a batch (SILog) are then those of the smaller ones."""
    domain_weight: float = 100.0
    """metric: weight of the router's cross-entropy."""
    chamfer_weight: float = 0.1
    """metric: weight of the distance between an image's bins and its depths, for AdaBins."""
    window_chamfer_weight: float = 0.02
    """metric: weight of that between windows' bins and their depths, for LocalBins with windows."""
    route_by_label: bool = True
    """metric: while training, images take the head of their label; False: the router's choice (released)."""
    trim: float = 0.2
    """relative: share of the largest residuals of an image that is ignored."""
    gradient_weight: float = 0.5
    """relative: weight of the gradient term."""
    task_weights: Literal["images", "pareto"] = "images"
    """relative: how the losses of the data sets are weighed. images: every image counts the same. pareto: by the
    multi-objective step (MGDA), under which no data set's loss is raised."""
    pareto_every: int = 1
    """relative: steps between two solutions for the weights, each of which costs a backward pass a data set."""
    pareto_parameters: Literal["decoder", "all"] = "decoder"
    """relative: the gradients that are weighed against each other. All of BEiT-L's are 0.7 GB a data set."""
    pareto_normalizer: Literal["none", "l2", "loss", "loss+"] = "none"
    """relative: what the gradients are divided by first; see ``zoedepth.pareto.Normalizer``."""
    gradient_checkpointing: bool = False
    """Compute the encoder's blocks again in the backward pass instead of keeping them: less memory, a third slower."""
    freeze_batch_norm: bool = True
    """Keep the statistics of the encoder's batch norms as pre-trained (released)."""
    ema_decay: float | None = None
    """Keep, save and validate an exponential moving average of the weights with this decay."""
    precision: Precision = "auto"
    """Autocast of the forward; the losses and the weights are float32. auto: bfloat16 on hardware made for it, or else
    float32, or on such GPUs float16."""
    holdout: int = 0
    """The last pairs of each data set, this many, are not trained on but validated on."""
    validate_every: int = 500
    """Steps between validations."""
    checkpoint_every: int = 250
    """Steps between checkpoints; the last one is always written."""
    keep_checkpoints: int = 2
    """Checkpoints kept in the run's folder, the newest."""
    pictures: int = 4
    """Samples in the picture of predictions that is made at each validation; 0: none."""
    log_every: int = 10
    """Steps between lines of the log."""
    n_workers: int = 2
    """Processes that read and augment samples."""
    seed: int = 43
    """Of the initial weights, the order of the data and the augmentations."""

    def __post_init__(self) -> None:
        if self.steps < 1 or self.batch_size < 1:
            raise InputError(f"steps and batch_size must be >= 1; they are {self.steps} and {self.batch_size}")
        if self.accumulate < 1 or self.batch_size % self.accumulate:
            raise InputError(f"a batch of {self.batch_size} cannot be split into {self.accumulate} equal parts")
        for name in ("pareto_every", "validate_every", "checkpoint_every", "log_every", "keep_checkpoints"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} must be >= 1; it is {getattr(self, name)}")
        if self.stage == "relative" and not isinstance(self.model, ModelConfig):
            raise InputError("the baselines have no relative depth to train: stage 1 is for ZoeDepth")
        windows = {source.window for source in self.sources if source.crop == "window"} - {None}
        if any(side % self.model.multiple for window in windows if window for side in window):
            raise InputError(f"windows must have sides that are multiples of {self.model.multiple}; got {windows}")
        sizes = {source.window if source.crop == "window" else None for source in self.sources}
        if self.mix_by == "image" and len(sizes) > 1:
            raise InputError(f"sources of different windows {sizes} cannot be in one batch: mix_by must be 'batch'")
        if self.mix_by == "batch" and self.stage == "relative" and len(self.sources) > 1:
            raise InputError("stage 1 needs all data sets in each batch: mix_by must be 'image'")
