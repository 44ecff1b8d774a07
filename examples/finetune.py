"""Fine-tune the small model on your own photos with depth, and see what it brought.

python examples/finetune.py my_photos runs/mine     # my_photos: see docs/your-data.md
python examples/finetune.py                         # rendered rooms, if there are no photos yet
"""

import sys
from pathlib import Path

from zoedepth.train.config import FinetuneOptions
from zoedepth.train.finetune import finetune, plan


def main(data: str = "synthetic:rooms?n=30", out: str = "runs/finetune", steps: str | None = None) -> None:
    """Look at the data, train, and compare the model before and after on pairs that were held out."""
    options = FinetuneOptions(init="zoed-lite", steps=int(steps) if steps else None)
    chosen = plan({"mine": data}, options, out=Path(out))
    print(f"{chosen.config.steps} steps of {chosen.config.batch_size} photos")
    for name, (before, after) in finetune(chosen, out=Path(out)).items():
        if before.metrics and after.metrics:
            print(f"{name}: REL {before.metrics.rel:.3f} -> {after.metrics.rel:.3f}")
    print(f"{out}/model.safetensors: load_model() takes it")


if __name__ == "__main__":
    main(*sys.argv[1:])
