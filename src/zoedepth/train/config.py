"""The configuration of a training, as frozen dataclasses. The command line can override every field."""

import math
from dataclasses import dataclass, field
from typing import Literal

from zoedepth.config import AnyModelConfig, ModelConfig
from zoedepth.errors import InputError

Precision = Literal["auto", "bf16-mixed", "16-mixed", "32-true"]

Check = Literal["quick", "full", "off"]
"""The look at the data before a training. quick: headers, sizes and ends of all files. full: every sample is read. off:
nothing; files that turn out to be broken are skipped all the same."""


@dataclass(frozen=True)
class SourceConfig:
    """A data set to train on: how its samples are drawn and augmented."""

    name: str
    """The NAME in ``--data NAME=PATH``."""
    weight: int = 1
    """Number of turns that it has in a round of the mixture."""
    domain: str | None = None
    """Scene type of its photos, unless a list or a sample names another; it replaces that of ``dataset.json``."""
    depth_scale: float | None = None
    """Stored value of one metre, for whole numbers of which the data does not name one."""
    max_depth: float | None = None
    """Metres from which on depth is unknown, unless a list or a sample names others; it replaces those of
    ``dataset.json``."""
    min_depth: float | None = None
    """Metres up to which depth is not trained on, where that is farther than the domain's nearest depth (BTS,
    NeWCRFs). It is unknown then, as it is at the domain's bounds."""
    root: str | None = None
    """The folder that the paths of a list are relative to; None: that of the list."""
    focal_px: float | None = None
    """Focal length of its photos, pixels, for data that does not name one. Only a model in a canonical camera asks."""
    without_camera: Literal["refuse", "assume"] = "refuse"
    """Stage 2 of a model in a canonical camera, a photo whose focal length nobody says. refuse: it is an error. assume:
    it is taken to come from the canonical camera."""
    sparse: bool = False
    """Depth is known at scattered points (lidar). Resizing then keeps every point; to take every n-th pixel would lose
    most of them."""
    gradient_term: bool = True
    """Use the gradient term of the loss, where the training has one. False for scattered depth, whose points have no
    neighbours (DPT)."""
    crop: Literal["squeeze", "fit", "window"] = "squeeze"
    """squeeze: the whole photo, resized to the network's shape (released). fit: the largest window of the network's
    shape, resized. window: a window of the size below, not resized (the native baselines)."""
    window: tuple[int, int] | None = None
    """window only: (height, width), multiples of what the model needs; None: the model's size."""
    max_zoom: float = 1.0
    """fit only: windows are up to this many times smaller than the photo; depth is divided by the same number. In a
    canonical camera that is a longer lens."""
    min_zoom: float = 1.0
    """fit only: below 1, down to 0.5, windows are also larger than the photo, by up to 1 / this number, and depth is
    multiplied likewise, as of a wider lens. Around the photo its borders are reflected, and depth is unknown there."""
    zoom_probability: float = 1.0
    """fit only: share of the samples that are zoomed in on."""
    kitti_crop: bool = False
    """First cut photos of the size of KITTI's frames to their bottom centre, 352x1216; others stay."""
    rotate_degrees: float = 1.0
    """Largest rotation, in either direction."""
    color_probability: float = 0.5
    """Share of the samples whose colours are changed."""
    gamma: tuple[float, float] = (0.9, 1.1)
    """Range of the exponent gamma of the colours."""
    brightness: tuple[float, float] = (0.75, 1.25)
    """Range of the brightness factor."""
    channel_gain: tuple[float, float] = (0.9, 1.1)
    """Range of the factors of the colour channels, one a channel."""
    saturation: tuple[float, float] = (1.0, 1.0)
    """Range of the factor of the saturation; 0 is grey."""


@dataclass(frozen=True)
class OptimConfig:
    """The optimizer and its rates.

    AdamW with one-cycle rates (paper; released ``config_zoedepth.json``), with constant rates (MiDaS v3.1), or with
    falling rates (BTS, NeWCRFs); DORN has falling rates and plain gradient descent.
    """

    optimizer: Literal["adamw", "sgd"] = "adamw"
    """adamw: AdamW. sgd: gradient descent with the momentum below."""
    learning_rate: float = 1.61e-4
    """Highest rate of the metric heads and the router."""
    encoder_factor: float = 0.1
    """The encoder's rate as a factor of ``learning_rate``. 0 freezes the encoder."""
    position_factor: float = 0.1
    """The rate of the relative position tables as a factor of ``learning_rate``. 0 freezes them."""
    decoder_factor: float = 1.0
    """The decoder's rate as a factor of ``learning_rate``. 0 freezes the decoder."""
    weight_decay: float = 0.01
    """Weight decay."""
    decay_encoder_only: bool = False
    """Apply weight decay to the encoder only (BTS)."""
    frozen: tuple[str, ...] = ()
    """Patterns of the names of parameters that are not trained: ``encoder.*norm*`` (BTS)."""
    schedule: Literal["one-cycle", "constant", "polynomial"] = "one-cycle"
    """one-cycle: see the fields below. constant: the highest rate in every step. polynomial: the rate falls from the
    highest to that divided by ``final_division``, with the power 0.9 of the share of steps that are left. Constant and
    polynomial schedules use the higher ``momentum``."""
    warmup: float = 0.7
    """Share of the steps in which the rates rise."""
    initial_division: float = 1.0
    """The first rate is the highest rate divided by this."""
    final_division: float = 1e4
    """The last rate is the first rate divided by this."""
    momentum: tuple[float, float] = (0.85, 0.95)
    """Lowest and highest value of AdamW's first beta, or of the momentum: lowest where the rate is highest."""
    eps: float = 1e-8
    """Number added to AdamW's denominator; BTS trains with 1e-3."""
    clip: float = 0.1
    """Largest norm of all gradients together; larger gradients are scaled down to it."""

    def __post_init__(self) -> None:
        if not self.clip > 0:  # also where it is not a number
            raise InputError(f"clip must be above 0, and infinite to cut nothing; it is {self.clip}")
        for name in ("learning_rate", "initial_division", "final_division", "eps"):
            if not 0 < getattr(self, name) < math.inf:
                raise InputError(f"{name} must be above 0 and finite; it is {getattr(self, name)}")
        for name in ("encoder_factor", "position_factor", "decoder_factor", "weight_decay"):
            if not 0 <= getattr(self, name) < math.inf:
                raise InputError(f"{name} must be 0 or more, and finite; it is {getattr(self, name)}")
        if not 0 <= self.warmup <= 1:
            raise InputError(f"warmup is a share of the steps, from 0 to 1; it is {self.warmup}")


@dataclass(frozen=True)
class TrainConfig:
    """One training of one stage."""

    stage: Literal["relative", "metric"]
    """relative: train encoder and decoder on disparity. metric: train the whole model on depth in metres."""
    model: AnyModelConfig
    """The network."""
    sources: tuple[SourceConfig, ...]
    """The data sets that it can be trained on. A training uses those that ``--data`` names."""
    steps: int
    """Number of optimizer steps."""
    batch_size: int = 16
    """Samples in a step, of all processes together."""
    optim: OptimConfig = field(default_factory=OptimConfig)
    """Optimizer, rates and their schedule."""
    mix_by: Literal["image", "batch"] = "image"
    """Data sets take turns image by image, or batch by batch (released)."""
    accumulate: int = 1
    """Number of batches that the samples of a step are split into, to need the memory of one of them. A loss with
    statistics over a batch (SILog) then takes them over these smaller batches."""
    loss_size: Literal["network", "truth"] = "network"
    """metric: where depth is compared. network: at the size of the network's input, to which the true depth is brought.
    truth: at the size that the true depth has, to which the prediction is brought (released); every measured point
    counts then, and none is moved. For sources with the crops "squeeze" and "window"."""
    domain_weight: float = 100.0
    """metric: weight of the router's cross-entropy. 0 leaves it out."""
    chamfer_weight: float = 0.1
    """metric: weight of the chamfer distance between an image's bins and its depths, for AdaBins."""
    window_chamfer_weight: float = 0.02
    """metric: weight of the chamfer distance between windows' bins and their depths, for LocalBins with windows."""
    log_gradient_weight: float = 0.0
    """metric: weight of the error of the edges, the differences between neighbours of ln depth. Sources whose depth is
    scattered leave it out (``SourceConfig.gradient_term``)."""
    spread_weight: float = 0.0
    """metric: weight of the likelihood that ties the standard deviation of the bins to the error of the depth."""
    route_by_label: bool = True
    """metric: while training, an image goes to the head of its label; False: to the router's choice (released)."""
    trim: float = 0.2
    """relative: share of an image's residuals that is ignored, the largest ones."""
    gradient_weight: float = 0.5
    """relative: weight of the gradient term."""
    task_weights: Literal["images", "pareto"] = "images"
    """relative: how the losses of the data sets are weighed. images: every image counts the same. pareto: the
    multi-objective step (MGDA) finds weights under which no data set's loss rises."""
    pareto_every: int = 1
    """relative: steps between two solutions for the weights. A solution costs a backward pass for each data set."""
    pareto_parameters: Literal["decoder", "all"] = "decoder"
    """relative: the parameters whose gradients are compared. The gradients of all of BEiT-L take 0.7 GB a data set."""
    pareto_normalizer: Literal["none", "l2", "loss", "loss+"] = "none"
    """relative: the number that the gradients are divided by first; see ``zoedepth.pareto.Normalizer``."""
    gradient_checkpointing: bool = False
    """Compute the encoder's blocks again in the backward pass instead of keeping them: less memory, a third slower."""
    freeze_batch_norm: bool = True
    """Keep the statistics of the encoder's batch norms as they were before the training (released)."""
    ema_decay: float | None = None
    """Keep, save and validate an exponential moving average of the weights with this decay."""
    precision: Precision = "auto"
    """Precision of the forward pass; losses and weights are float32. auto: bfloat16 on hardware made for it; on other
    GPUs float16, elsewhere float32."""
    holdout: int = 0
    """Number of pairs at the end of each data set that are validated on instead of trained on."""
    holdouts: tuple[int, ...] = ()
    """Numbers of held-out pairs, one for each of ``sources``, where they differ; empty: ``holdout`` for all."""
    validate_every: int = 500
    """Steps between validations."""
    checkpoint_every: int = 250
    """Steps between checkpoints; the last step always writes one."""
    keep_checkpoints: int = 2
    """Number of checkpoints kept in the run's folder, the newest ones."""
    pictures: int = 4
    """Samples in the picture of predictions that each validation makes; 0: no picture."""
    log_every: int = 10
    """Steps between lines of the log. Where data sets take turns batch by batch, each has a line."""
    n_workers: int = 2
    """Processes that read and augment samples; 0: the training does it itself."""
    check: Check = "quick"
    """Look at the data before the first step. quick: headers, sizes and ends of all files. full: every sample is read.
    off: nothing. Otherwise the depth of some pairs is looked at before stage 2, too, and depth that no photo has is
    refused."""
    seed: int = 43
    """Seed of the initial weights, the order of the data and the augmentations."""

    def __post_init__(self) -> None:
        if self.steps < 1 or self.batch_size < 1:
            raise InputError(f"steps and batch_size must be at least 1; they are {self.steps} and {self.batch_size}")
        if self.accumulate < 1 or self.batch_size % self.accumulate:
            raise InputError(
                f"a batch of {self.batch_size} cannot be split into {self.accumulate} equal parts: accumulate must "
                "divide batch_size"
            )
        for name in ("pareto_every", "validate_every", "checkpoint_every", "log_every", "keep_checkpoints"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} must be at least 1; it is {getattr(self, name)}")
        if min((self.holdout, self.n_workers, self.pictures, *self.holdouts)) < 0:
            raise InputError(
                f"holdout, n_workers and pictures must be 0 or more; they are {[self.holdout, *self.holdouts]}, "
                f"{self.n_workers} and {self.pictures}"
            )
        if self.holdouts and len(self.holdouts) != len(self.sources):
            raise InputError(
                f"holdouts has {len(self.holdouts)} numbers for {len(self.sources)} sources: give one each"
            )
        if self.ema_decay is not None and not 0 <= self.ema_decay < 1:
            raise InputError(f"ema_decay must be from 0 to below 1; it is {self.ema_decay}")
        if self.stage == "relative" and not isinstance(self.model, ModelConfig):
            raise InputError("a baseline has no relative depth to train: stage 1 is for ZoeDepth, use stage 'metric'")
        if self.loss_size == "truth" and (cut := [each.name for each in self.sources if each.crop == "fit"]):
            raise InputError(
                f"loss_size is 'truth', but the photos of {cut} are cut to fit, and their depth with them: set "
                "loss_size to 'network', or the crop of these sources to 'squeeze'"
            )
        windows = {source.window for source in self.sources if source.crop == "window" and source.window is not None}
        if any(side % self.model.multiple for window in windows for side in window):
            raise InputError(
                f"the sides of a source's window must be multiples of {self.model.multiple} for this model; they are "
                f"{sorted(windows)}"
            )
        sizes = {source.window if source.crop == "window" else None for source in self.sources}
        if self.mix_by == "image" and len(sizes) > 1:
            raise InputError(
                f"sources with windows of different sizes {sizes} cannot share a batch: set mix_by to 'batch'"
            )
        if self.mix_by == "batch" and self.stage == "relative" and len(self.sources) > 1:
            raise InputError("stage 1 needs all data sets in each batch: set mix_by to 'image'")

    def held_out(self, name: str) -> int:
        """Return the number of pairs of a source, by its name, that are held out."""
        names = [source.name for source in self.sources]
        return self.holdouts[names.index(name)] if self.holdouts else self.holdout


@dataclass(frozen=True)
class FinetuneOptions:
    """The choices in a fine-tuning on data of one's own; None: the data decides."""

    init: str = "zoed-lite"
    """Model to start from: a name of ``zoedepth models``, a file or folder of weights, a Hugging Face id."""
    domain: str | None = None
    """Scene type of the photos, indoor, outdoor or a name of your own: where the data names none, and in place of that
    of ``dataset.json``."""
    depth_scale: float | None = None
    """Stored value of one metre in PNGs and other whole numbers, for data that does not name one."""
    check: Check = "quick"
    """Look at the data first. quick: headers, sizes and ends of all files, and the depth of up to 200 pairs. full:
    every pair is read. off: the depth is believed, however implausible; use it for data beyond a kilometre or below a
    centimetre."""
    holdout: int | None = None
    """Pairs held out for the comparison, the last of each data set; None: a seventh, at least 1 and at most 50."""
    steps: int | None = None
    """Optimizer steps; None: chosen by the number of pairs."""
    batch_size: int | None = None
    """Samples in a step; None: 4."""
    learning_rate: float | None = None
    """Highest rate; None: chosen by the kind of encoder."""
    seed: int = 43
    """Seed of the order of the data and the augmentations."""
    root: str | None = None
    """The folder that the paths of lists are relative to; None: that of each list."""
