"""Small random ZoeDepth models of transformers, to compare ours with: no released weights are needed."""

from typing import Any

import torch
from transformers import BeitConfig, ZoeDepthConfig, ZoeDepthForDepthEstimation

NYU = {"name": "nyu", "n_bins": 64, "min_depth": 1e-3, "max_depth": 10.0}
KITTI = {"name": "kitti", "n_bins": 64, "min_depth": 1e-3, "max_depth": 80.0}


def twin_config(
    *,
    heads: tuple[dict[str, Any], ...] = (NYU,),
    centers: str = "softplus",
    size: int | tuple[int, int] = 64,
    **changes: Any,
) -> ZoeDepthConfig:
    """A transformers config of a tiny BEiT, with the LayerNorm eps that BEiT was trained with."""
    backbone = BeitConfig(
        image_size=size,
        num_hidden_layers=4,
        hidden_size=32,
        intermediate_size=128,
        num_attention_heads=4,
        use_relative_position_bias=True,
        reshape_hidden_states=False,
        out_features=["stage1", "stage2", "stage3", "stage4"],
        layer_norm_eps=1e-6,
    )
    if len(heads) > 1:
        changes = {
            "num_patch_transformer_layers": 4,
            "patch_transformer_hidden_size": 128,
            "patch_transformer_intermediate_size": 1024,
            "patch_transformer_num_attention_heads": 4,
            **changes,
        }
    return ZoeDepthConfig(
        backbone_config=backbone,
        neck_hidden_sizes=[8, 16, 24, 32],
        fusion_hidden_size=16,
        bottleneck_features=16,
        num_relative_features=8,
        bin_embedding_dim=128,
        bin_centers_type=centers,
        bin_configurations=list(heads),
        **changes,
    )


def twin(config: ZoeDepthConfig, *, seed: int = 0) -> ZoeDepthForDepthEstimation:
    """A random model whose every weight matters: new ones give nearly the same depth everywhere."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        model = ZoeDepthForDepthEstimation(config).eval()
        with torch.no_grad():
            for name, value in model.named_parameters():
                if "relative_position" in name or value.ndim < 2:
                    # A table of zeros would hide how it is resized.
                    value.add_(0.1 * torch.randn_like(value))
                else:
                    value.normal_(0, 1 / value[0].numel() ** 0.5)
    return model
