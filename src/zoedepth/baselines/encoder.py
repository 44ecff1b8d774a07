"""Encoders of the baselines: any timm network as maps at the strides that are asked for."""

from typing import Any

from jaxtyping import Float
from torch import Tensor, nn

from zoedepth.model.encoder import TimmEncoder, load_features, replace_depthwise


class FeatureEncoder(TimmEncoder):
    """The maps of a timm network, fine to coarse.

    Args:
        name: timm architecture.
        levels: which of its maps, as timm counts them (``out_indices``).
        options: further arguments of timm's constructor, such as ``output_stride``.

    Attributes:
        channels: of the maps.
        strides: of the maps, pixels.
    """

    def __init__(self, name: str, *, levels: tuple[int, ...], options: dict[str, Any] | None = None) -> None:
        import timm

        super().__init__()
        self.stages: Any = timm.create_model(
            name, pretrained=False, features_only=True, out_indices=levels, **(options or {})
        )
        self.channels: tuple[int, ...] = tuple(self.stages.feature_info.channels())
        self.strides: tuple[int, ...] = tuple(self.stages.feature_info.reduction())
        self.channels_last = getattr(self.stages, "output_fmt", None) == "NHWC"
        replace_depthwise(self.stages)

    def load_timm(self, network: nn.Module) -> None:
        """Take the weights of timm's network of the same shape; its classifier, and what follows the maps, stay out."""
        load_features(self.stages, network)

    def checkpoint_gradients(self) -> None:
        """From now on the backward pass computes what is inside the stages again, instead of keeping it."""
        if hasattr(self.stages, "set_grad_checkpointing"):
            self.stages.set_grad_checkpointing(True)
        for stage in (module for module in self.stages.modules() if hasattr(module, "grad_checkpointing")):
            stage.grad_checkpointing = True

    def forward(self, x: Float[Tensor, "batch 3 height width"]) -> list[Float[Tensor, "batch _ _ _"]]:
        """Maps of normalised pixels."""
        maps = self.stages(x)
        return [level.permute(0, 3, 1, 2) for level in maps] if self.channels_last else maps
