"""The released checkpoints' own names and shapes, with random values: 1.4 GB each."""

import json
import subprocess
import sys
from pathlib import Path

from zoedepth.cli import main
from zoedepth.presets import PRESETS

UNUSED = {
    "fc_norm.weight", "fc_norm.bias", "head.weight", "head.bias",
    "refinenet4.resConfUnit1.conv1.weight", "refinenet4.resConfUnit1.conv1.bias",
    "refinenet4.resConfUnit1.conv2.weight", "refinenet4.resConfUnit1.conv2.bias",
}  # fmt: skip
"""Ends of the names of weights that exist, and that no forward pass reads."""


def run(step: str, *arguments: object) -> dict:
    command = [sys.executable, "-m", "tests.weights.layouts.full_size", step, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=Path(__file__).parents[3])
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout.splitlines()[-1])


def test_released_checkpoints_load_predict_and_survive_all_layouts(tmp_path: Path):
    """One after the other, in one process of the tests: each needs some gigabytes."""
    for kind in ("n", "k", "nk"):
        check(kind, tmp_path / kind)


def check(kind: str, tmp_path: Path) -> None:
    tmp_path.mkdir()
    original, preset = tmp_path / f"ZoeD_M12_{kind.upper()}.pt", PRESETS[f"zoed-m12-{kind}"]
    ours, theirs, back = tmp_path / "ours", tmp_path / "theirs", tmp_path / "back.pt"
    try:
        run("write", f"original-{kind}.txt", original)
        loaded = run("load", original)
        assert loaded["config"] == repr(preset)
        assert loaded["finite"]
        assert loaded["depth"][0] < loaded["depth"][1]
        assert loaded["peak"] < 1.6 * loaded["size"]
        if kind == "nk":
            routed = loaded["routed"]
            assert len(set(routed["domains"])) == 2
            assert routed["domains"] == routed["domains_alone"]
            assert routed["difference"] < 1e-5
            assert routed["voted"] == [routed["vote"]] * 3
            assert routed["voted_difference"] < 1e-5

        assert main(["convert", str(original), str(ours), "--to", "zoedepth"]) == 0
        assert main(["convert", str(ours), str(theirs), "--to", "huggingface"]) == 0
        assert main(["convert", str(theirs), str(back), "--to", "original"]) == 0
        if kind == "nk":  # one head: test_huggingface.py
            there = run("transformers", theirs)
            assert there["report"] == {}
            assert there["relative_difference"] < 1e-5

        differences = run("compare", original, back)
        assert differences["missing"] == []
        # timm < 0.9.6 has them in the file, the key list has not.
        assert all(name.endswith("relative_position_index") for name in differences["added"])
        assert len(differences["added"]) == 24
        assert all(any(name.endswith(end) for end in UNUSED) for name in differences["changed"])
        assert len(differences["changed"]) == len(UNUSED)
    finally:
        for file in tmp_path.rglob("*"):
            if file.is_file():
                file.unlink()
