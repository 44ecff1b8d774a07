"""The models of the paper, of the released checkpoints, and of this package, by name.

This file does not import torch.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace

from zoedepth.config import (
    INDOOR,
    OUTDOOR,
    AdaBinsNetworkConfig,
    AnyModelConfig,
    AttractorConfig,
    BaselineConfig,
    BtsNetworkConfig,
    DecoderConfig,
    DornNetworkConfig,
    EncoderConfig,
    LocalBinsNetworkConfig,
    ModelConfig,
    NetworkConfig,
    NewCrfsNetworkConfig,
    PixelBinsNetworkConfig,
    RouterConfig,
)
from zoedepth.config.heads import HEAD_CONFIGS
from zoedepth.errors import InputError, no_such
from zoedepth.sizes import network_focal, network_size

TRAINING_CAMERAS: dict[str, tuple[float, tuple[int, int]]] = {
    "indoor": (519.4696, (480, 640)),
    "outdoor": (721.5377, (352, 1216)),
}
"""Domain → fy and (height, width), pixels, of the photos that the paper's models learn its metres from: those of
NYU Depth v2, and those of KITTI (its most frequent camera) after the KB crop."""


def in_training_cameras(config: ModelConfig) -> ModelConfig:
    """Give the domains indoor and outdoor the focal lengths of NYU and KITTI, as the network of this config sees them.

    Photos are resized as the config says, and not padded, as in the training and the evaluation of the paper.
    """

    focal = {name: round(focal_in_network(config, *camera), 2) for name, camera in TRAINING_CAMERAS.items()}
    return replace(config, domains=tuple(replace(each, focal_px=focal.get(each.name)) for each in config.domains))


def focal_in_network(config: AnyModelConfig, focal_px: float, size: tuple[int, int]) -> float:
    """Return the focal length of a photo as the network of a config sees it, in pixels of its input, without padding.

    Args:
        config: the config of the model.
        focal_px: fy, pixels of the photo.
        size: (height, width) of the photo.
    """
    network = network_size(size, config.size, multiple=config.multiple, keep_aspect_ratio=config.keep_aspect_ratio)
    return network_focal(focal_px, size[0], network[0])


def with_focal_of_size(config: ModelConfig, before: ModelConfig) -> ModelConfig:
    """Return a config whose size was changed, with the focal lengths that belong to the new size.

    Those of NYU and KITTI at the size of ``before`` become those at the size of ``config``; others stay.
    """
    known = set(before.domains) & set(in_training_cameras(before).domains)
    pairs = zip(config.domains, in_training_cameras(config).domains, strict=True)
    return replace(config, domains=tuple(new if old in known else old for old, new in pairs))


def _beit(name: str, side: int, taps: tuple[int, ...], channels: tuple[int, ...]) -> EncoderConfig:
    return EncoderConfig(name, "beit", size=(side, side), taps=taps, channels=channels)


def _swin(name: str, side: int) -> EncoderConfig:
    return EncoderConfig(name, "swin", size=(side, side))


def _convolutional(name: str, side: int) -> EncoderConfig:
    return EncoderConfig(name, "convolutional", size=(side, side))


_LARGE = {"taps": (5, 11, 17, 23), "channels": (256, 512, 1024, 1024)}

ENCODERS: dict[str, EncoderConfig] = {
    config.name: config
    for config in (
        _beit("beit_large_patch16_384", 384, **_LARGE),
        _beit("beit_large_patch16_512", 512, **_LARGE),
        _beit("beit_base_patch16_384", 384, taps=(2, 5, 8, 11), channels=(96, 192, 384, 768)),
        _swin("swin_large_patch4_window12_384", 384),
        _swin("swinv2_large_window12to24_192to384", 384),
        _swin("swinv2_base_window12to24_192to384", 384),
        _swin("swinv2_tiny_window16_256", 256),
        _convolutional("tf_efficientnet_b5", 456),
        _convolutional("tf_efficientnet_lite0", 224),
        _convolutional("tf_efficientnet_lite1", 240),
        _convolutional("tf_efficientnet_lite2", 260),
        _convolutional("tf_efficientnet_lite3", 300),
    )
}
"""The encoders of the paper and of MiDaS v3.1, by their timm name (MiDaS ``dpt_depth.py``, ``model_loader.py``)."""

_BEIT_L = ENCODERS["beit_large_patch16_384"]

# A model that we train has one architecture, whatever it is trained on: that of the paper, with the mean of the pulls,
# as released. A model with released weights follows the weights. The values in which the two differ are here and in
# docs/paper.md, and nowhere else.
_PAPER_N = in_training_cameras(ModelConfig(_BEIT_L))
_PAPER_K = in_training_cameras(ModelConfig(_BEIT_L, domains=(OUTDOOR,), size=(384, 768)))
_PAPER_NK = in_training_cameras(ModelConfig(_BEIT_L, domains=(INDOOR, OUTDOOR)))
_PAPER_NK_ONE_HEAD = ModelConfig(_BEIT_L, domains=(replace(OUTDOOR, name="any"),))

_RELEASED_K = replace(_PAPER_K, head=AttractorConfig(centers="normed", attractor_ratio=False))
_RELEASED_NK = replace(
    _PAPER_NK,
    head=AttractorConfig(
        n_attractors=(16, 16, 16, 16),
        relative_input=False,
        bottleneck_factor=4,
        projector_width=64,
        seed_width=64,
    ),
    router=RouterConfig("trained", classifier="transformer"),
)


def with_encoder(config: ModelConfig, name: str) -> ModelConfig:
    """Change the encoder of a config; a Swin also changes the size, to the only one it takes.

    Raises:
        InputError: there is no such encoder.
    """
    if name not in ENCODERS:
        raise no_such("encoder", name, ENCODERS)
    encoder = ENCODERS[name]
    size = encoder.size if encoder.family == "swin" else config.size
    return with_focal_of_size(replace(config, encoder=encoder, size=size), config)


def with_head(config: ModelConfig, name: str) -> ModelConfig:
    """Change the metric head of a config, with the values that the paper compares it with.

    A head that the config has already keeps its values.

    Raises:
        InputError: there is no such head.
    """
    if name not in HEAD_CONFIGS:
        raise no_such("head", name, HEAD_CONFIGS)
    return config if isinstance(config.head, HEAD_CONFIGS[name]) else replace(config, head=HEAD_CONFIGS[name]())


MINIATURE = in_training_cameras(
    ModelConfig(
        ENCODERS["tf_efficientnet_lite0"],
        decoder=DecoderConfig(widths=(48, 96, 128, 160), features=32, output_stride=2),
        head=AttractorConfig(
            n_bins=32,
            reduce="mean",
            alpha=1.0,
            initial_centers="geometric",
            bottleneck_factor=4,
            embedding_width=32,
            projector_width=32,
            seed_width=128,
        ),
        domains=(INDOOR, OUTDOOR),
        size=(256, 352),
        antialias=True,
        pad=False,
    )
)
"""The paper's architecture at a fiftieth of its size: comparisons in miniature are made with it."""

ZOED_LITE = replace(
    MINIATURE,
    decoder=replace(MINIATURE.decoder, upsampling="convex"),
    # The place and the temperature of the log-binomial come to rest at their bounds, and the deviation says nothing.
    head=replace(MINIATURE.head, probability="softmax"),
    canonical_camera=True,
    # Scaled to the camera of NYU or KITTI, what a wide lens sees is farther than these sets reach.
    domains=tuple(replace(domain, max_depth=2 * domain.max_depth) for domain in MINIATURE.domains),
)
"""The paper's future "mobile architecture": the model shipped in the package. It is trained in one camera for each
domain, so that data of any lens teach it, and any lens is right where it is known."""

PRESETS: dict[str, ModelConfig] = {
    # The twelve models of the paper's model table (appendix): ZoeD-{relative pre-training}-{metric fine-tuning}. The
    # three released ones carry the released values; those of zoed-m12-n are the paper's.
    "zoed-x-n": _PAPER_N,
    "zoed-n-n": _PAPER_N,
    "zoed-nk-n": _PAPER_N,
    "zoed-m12-n": _PAPER_N,
    "zoed-x-k": _PAPER_K,
    "zoed-k-k": _PAPER_K,
    "zoed-nk-k": _PAPER_K,
    "zoed-m12-k": _RELEASED_K,
    "zoed-nk-nk-one-head": _PAPER_NK_ONE_HEAD,
    "zoed-m12-nk-one-head": _PAPER_NK_ONE_HEAD,
    "zoed-nk-nk": _PAPER_NK,
    "zoed-m12-nk": _RELEASED_NK,
    # Its Table 2 has one more, with one head; the same with two heads is not in the paper.
    "zoed-x-nk-one-head": _PAPER_NK_ONE_HEAD,
    "zoed-x-nk": _PAPER_NK,
    # Its backbone ablation.
    "zoed-m12-n-swin-l": with_encoder(_PAPER_N, "swin_large_patch4_window12_384"),
    "zoed-m12-n-swin2-t": with_encoder(_PAPER_N, "swinv2_tiny_window16_256"),
    "zoed-m12-n-swin2-b": with_encoder(_PAPER_N, "swinv2_base_window12to24_192to384"),
    "zoed-m12-n-swin2-l": with_encoder(_PAPER_N, "swinv2_large_window12to24_192to384"),
    "zoed-m12-n-beit-b": with_encoder(_PAPER_N, "beit_base_patch16_384"),
    "zoed-m12-n-beit-l-512": with_encoder(_PAPER_N, "beit_large_patch16_512"),
    "zoed-m12-n-efficientnet-b5": with_encoder(_PAPER_N, "tf_efficientnet_b5"),
    "zoed-lite": ZOED_LITE,
    # MiDaS v3.1 after its relative pre-training: stage 2 of the released models started from it.
    "dpt-beit-large-384": ModelConfig(_BEIT_L, domains=(), size=(384, 384)),
}
"""Name → architecture. ``weights/releases.py`` knows which of them have weights, and where."""

TRAINED: dict[str, ModelConfig] = {**PRESETS, "zoed-m12-k": _PAPER_K, "zoed-m12-nk": _PAPER_NK}
"""Name → architecture that the recipes train: one for all models of the same domains. Only the released checkpoints
differ from it."""


# --- the systems the paper compares with ------------------------------------------------------------------------------


_ANY = replace(OUTDOOR, name="any")
_KITTI_SIZE = (352, 1216)
_NATIVE: dict[str, NetworkConfig] = {
    "bts": BtsNetworkConfig(),
    "adabins": AdaBinsNetworkConfig(),
    "localbins": LocalBinsNetworkConfig(),
    "pixelbins": PixelBinsNetworkConfig(),
    "newcrfs": NewCrfsNetworkConfig(),
}

BASELINES: dict[str, BaselineConfig] = {
    **{f"{name}-n": BaselineConfig(network, domains=(INDOOR,)) for name, network in _NATIVE.items()},
    **{f"{name}-k": BaselineConfig(network, domains=(OUTDOOR,), size=_KITTI_SIZE) for name, network in _NATIVE.items()},
    # Trained on both, as in the paper's Table 2.
    **{f"{name}-nk": BaselineConfig(network, domains=(_ANY,)) for name, network in _NATIVE.items()},
    # DORN's layer over the whole photo has one size, and its intervals fit one range.
    "dorn-n": BaselineConfig(DornNetworkConfig(), domains=(INDOOR,), size=(257, 353)),
    "dorn-k": BaselineConfig(
        DornNetworkConfig(n_intervals=71, rates=(6, 12, 18), pooling=16), domains=(OUTDOOR,), size=(385, 513)
    ),
    "dorn-nk": BaselineConfig(DornNetworkConfig(n_intervals=80), domains=(_ANY,), size=(257, 353)),
}
"""Name → architecture of the baselines, as their authors built them, for NYU (n), KITTI (k) and both (nk)."""


# --- the released code's behaviour ------------------------------------------------------------------------------------


def _batch_vote(config: AnyModelConfig) -> AnyModelConfig:
    if not isinstance(config, ModelConfig) or len(config.domains) < 2 or config.router.kind != "trained":
        raise InputError(
            "compat 'batch-vote' is for models whose trained router chooses between several heads. Leave it out."
        )
    return replace(config, router=replace(config.router, vote="batch"))


def _ten_metres(config: AnyModelConfig) -> AnyModelConfig:
    head = config.head if isinstance(config, ModelConfig) else None
    if len(config.domains) != 1 or not isinstance(head, AttractorConfig) or head.centers != "normed":
        raise InputError(
            "compat '10m' is for ZoeD-K: one head with normed centers, which alone depend on a range. Leave it out."
        )
    domain = config.domains[0]
    return replace(config, domains=(replace(domain, min_depth=INDOOR.min_depth, max_depth=INDOOR.max_depth),))


def _eighty_metres(config: AnyModelConfig) -> AnyModelConfig:
    if isinstance(config, BaselineConfig):  # they all were trained on photos of one size there
        return replace(config, domains=(OUTDOOR,), size=config.size if config.one_size else _KITTI_SIZE)
    head = config.head
    if len(config.domains) != 1 or not isinstance(head, AttractorConfig) or head.centers != "softplus":
        raise InputError(
            "compat '80m' is for checkpoints that do not name their range: those of the baselines, and of the original "
            "with one head and softplus centers. Leave it out."
        )
    return in_training_cameras(replace(config, domains=(OUTDOOR,)))


def _squeeze(config: AnyModelConfig) -> AnyModelConfig:
    return replace(config, resize="squeeze")


COMPAT: dict[str, Callable[[AnyModelConfig], AnyModelConfig]] = {
    "batch-vote": _batch_vote,
    "10m": _ten_metres,
    "80m": _eighty_metres,
    "squeeze": _squeeze,
}
"""Behaviour of the released code that this package does not have, by name; for comparing with its numbers.

batch-vote: one head for the whole batch. 10m: ZoeD-K as loaded without naming a data set, 8 times too near. 80m: a
checkpoint of KITTI, of a baseline or of the original with one head and softplus centers; the files do not name their
data set, and are taken for NYU's. squeeze: photos are resized to exactly the trained size, whatever their proportions
(its "eval" mode).
"""


def with_compat(config: AnyModelConfig, names: Iterable[str]) -> AnyModelConfig:
    """Give a config the named behaviours of the released code.

    Raises:
        InputError: a name is unknown, or this model has no such behaviour.
    """
    for name in names:
        if name not in COMPAT:
            raise no_such("compat", name, COMPAT)
        config = COMPAT[name](config)
    return config
