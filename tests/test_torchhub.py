"""The original's entry points: its names, arguments, defaults and units."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from PIL import Image
from tests.models import random_model
from tests.servers import FileServer

from zoedepth import torchhub
from zoedepth.build import without_memory
from zoedepth.config import DecoderConfig, ModelConfig
from zoedepth.errors import InputError, InputWarning
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.presets import PRESETS
from zoedepth.sizes import network_size
from zoedepth.torchhub import OriginalInterface
from zoedepth.weights.checkpoint import write_checkpoint
from zoedepth.weights.save import checkpoint_of

REPO = Path(__file__).parents[1]
ENTRIES = {"ZoeD_N": "zoed-m12-n", "ZoeD_K": "zoed-m12-k", "ZoeD_NK": "zoed-m12-nk"}


def tiny(preset: str, tiny_config: ModelConfig) -> ModelConfig:
    """A released model with the smallest encoder and widths."""
    released = PRESETS[preset]
    one = len(released.domains) == 1
    head = replace(released.head, n_bins=8, embedding_width=16, projector_width=16, seed_width=16)
    return replace(
        released,
        encoder=tiny_config.encoder,
        decoder=DecoderConfig(widths=(16, 16, 16, 16), features=8),
        head=head,
        router=released.router if one else replace(released.router, width=16, feedforward_width=32),
        size=(64, 96),
    )


def as_loaded(config: ModelConfig) -> ZoeDepth:
    """Make a random model in the order of channels that a loaded one has."""
    return random_model(config).to(memory_format=torch.channels_last)


@pytest.fixture
def tiny_presets(tiny_config: ModelConfig, monkeypatch: pytest.MonkeyPatch) -> dict[str, ModelConfig]:
    """The released presets, small: the entry points build these."""
    small = {name: tiny(name, tiny_config) for name in ENTRIES.values()}
    monkeypatch.setattr(torchhub, "PRESETS", {**PRESETS, **small})
    monkeypatch.setattr(torchhub, "ENCODERS", {"beit_large_patch16_384": tiny_config.encoder})
    monkeypatch.setattr(torchhub, "with_encoder", lambda config, name: config)
    return small


def photo(size: tuple[int, int] = (45, 70)) -> Image.Image:
    noise = np.random.default_rng(0).integers(0, 256, (size[0] // 5, size[1] // 5, 3), dtype=np.uint8)
    return Image.fromarray(noise).resize(size[::-1], Image.Resampling.BICUBIC)


def by_hand(model: ZoeDepth, x: torch.Tensor, *, pad: bool, flip: bool) -> torch.Tensor:
    """The original's ``infer``, step by step (``depth_model.py``)."""
    height, width = x.shape[2:]
    top, left = (int(np.sqrt(side / 2) * 3) if pad else 0 for side in (height, width))
    padded = F.pad(x, [left, left, top, top], mode="reflect")

    def once(pixels: torch.Tensor) -> torch.Tensor:
        size = network_size((pixels.shape[2], pixels.shape[3]), model.config.size)
        resized = F.interpolate(pixels, size, mode="bilinear", align_corners=True)
        depth = F.interpolate(model(resized).depth, padded.shape[2:], mode="bicubic", align_corners=False)
        return depth[:, :, top : top + height, left : left + width]

    return (once(padded) + once(padded.flip(3)).flip(3)) / 2 if flip else once(padded)


class TestInterface:
    @pytest.fixture
    def model(self, tiny_config: ModelConfig) -> ZoeDepth:
        return as_loaded(tiny("zoed-m12-n", tiny_config))

    @pytest.mark.parametrize("pad", [True, False])
    @pytest.mark.parametrize("flip", [True, False])
    @pytest.mark.parametrize("size", [(45, 70), (70, 45), (40, 200), (64, 96)], ids=str)
    @torch.no_grad()
    def test_infer_is_the_originals(self, model: ZoeDepth, pad: bool, flip: bool, size: tuple[int, int]):
        x = torch.rand(2, 3, *size, generator=torch.Generator().manual_seed(0))
        found = OriginalInterface(model).infer(x, pad_input=pad, with_flip_aug=flip)
        assert found.shape == (2, 1, *size)
        torch.testing.assert_close(found, by_hand(model, x, pad=pad, flip=flip), rtol=1e-5, atol=1e-5)

    def test_defaults_pad_and_flip(self, model: ZoeDepth):
        x = torch.rand(1, 3, 45, 70, generator=torch.Generator().manual_seed(0))
        interface = OriginalInterface(model)
        torch.testing.assert_close(interface.infer(x), interface.infer(x, True, True))
        assert not torch.allclose(interface.infer(x), interface.infer(x, True, False))
        assert not torch.allclose(interface.infer(x), interface.infer(x, False, True))

    def test_outputs_of_infer_pil(self, model: ZoeDepth):
        interface, image = OriginalInterface(model), photo()
        depth = interface.infer_pil(image)
        assert isinstance(depth, np.ndarray)
        assert (depth.shape, depth.dtype) == ((45, 70), np.float32)
        pixels = torch.from_numpy(np.array(image)).permute(2, 0, 1)[None] / 255
        with torch.no_grad():
            np.testing.assert_allclose(depth, interface.infer(pixels)[0, 0].numpy(), rtol=1e-6)
            for pad, flip in ((True, False), (False, True)):
                expected = interface.infer(pixels, pad, flip)[0, 0].numpy()
                np.testing.assert_allclose(interface.infer_pil(image, pad, flip), expected, rtol=1e-5)
                assert not np.allclose(depth, expected, rtol=1e-4), "the options change nothing here"
        tensor = interface.infer_pil(image, output_type="tensor")
        assert isinstance(tensor, torch.Tensor)
        np.testing.assert_allclose(tensor.numpy(), depth, rtol=1e-6)
        picture = interface.infer_pil(image, output_type="pil")
        assert isinstance(picture, Image.Image)
        assert picture.size == image.size
        assert np.abs(np.array(picture).astype(float) - 256 * depth).max() <= 1
        with pytest.raises(InputError, match="output_type"):
            interface.infer_pil(image, output_type="jpeg")

    def test_16_bits_are_clipped_and_not_wrapped(self, model: ZoeDepth, monkeypatch: pytest.MonkeyPatch):
        interface = OriginalInterface(model)
        far = torch.tensor([[[[1.0, 255.9, 256.0, 300.0, -0.1]]]])
        monkeypatch.setattr(interface, "infer", lambda *_: far)
        assert np.array(interface.infer_pil(photo(), output_type="pil")).tolist() == [[256, 65510, 65535, 65535, 0]]

    def test_images_of_all_modes_are_read_as_predictor_reads_them(self, model: ZoeDepth):
        interface, colours = OriginalInterface(model), photo()
        grey = np.asarray(colours.convert("L"))
        wanted = interface.infer_pil(Image.fromarray(grey))
        levels = grey.astype(np.uint16) * 257
        for image in (
            Image.fromarray(levels),
            Image.fromarray(levels.astype(np.int32)),
            Image.frombytes("I;16B", colours.size, levels.astype(">u2").tobytes()),
            Image.fromarray((grey / 255).astype(np.float32)),
            Image.fromarray(grey).convert("LA"),
        ):
            np.testing.assert_array_equal(interface.infer_pil(image), wanted, err_msg=image.mode)
        transparent = colours.copy()
        transparent.putalpha(Image.fromarray(grey))
        palette, black = colours.convert("P"), colours.convert("1")
        for image, same in (
            (transparent, colours), (colours.convert("CMYK"), colours),
            (palette, palette.convert("RGB")), (black, black.convert("RGB")),
        ):  # fmt: skip
            np.testing.assert_array_equal(interface.infer_pil(image), interface.infer_pil(same), err_msg=image.mode)

    def test_images_out_of_range_are_refused_and_dark_ones_are_named(self, model: ZoeDepth):
        interface, grey = OriginalInterface(model), np.asarray(photo().convert("L"))
        with pytest.raises(InputError, match="scale floats"):
            interface.infer_pil(Image.fromarray(grey.astype(np.float32)))
        with pytest.raises(InputError, match="integers outside"):
            interface.infer_pil(Image.fromarray(grey.astype(np.int32) * 1000))
        with pytest.warns(InputWarning, match="too dark: it has 16 bits"):
            interface.infer_pil(Image.fromarray(grey.astype(np.uint16) * 16))

    def test_exif_orientation_is_not_applied_as_in_the_original(self, model: ZoeDepth):
        interface, turned = OriginalInterface(model), photo()
        turned.getexif()[0x0112] = 6
        np.testing.assert_array_equal(interface.infer_pil(turned), interface.infer_pil(photo()))

    def test_gradients_reach_the_pixels(self, model: ZoeDepth):
        x = torch.rand(1, 3, 45, 70, requires_grad=True)
        OriginalInterface(model).infer(x).sum().backward()
        assert x.grad is not None
        assert (x.grad != 0).any()

    def test_forward_returns_what_the_original_promises(self, tiny_config: ModelConfig):
        interface = OriginalInterface(as_loaded(tiny_config))
        x = torch.rand(2, 3, 64, 64)
        with torch.no_grad():
            result = interface(x)
            everything = interface(x, return_final_centers=True, return_probs=True)
        assert set(result) == {"metric_depth", "rel_depth", "domain_logits"}
        assert result["metric_depth"].shape == result["rel_depth"].shape == (2, 1, 64, 64)
        assert result["domain_logits"].shape == (2, 2)
        assert everything["bin_centers"].shape == everything["probs"].shape == (2, 8, 64, 64)
        depth = (everything["bin_centers"] * everything["probs"]).sum(dim=1, keepdim=True)
        torch.testing.assert_close(depth, everything["metric_depth"])

    def test_forward_undoes_imagenets_normalisation_when_asked(self, model: ZoeDepth):
        x = torch.rand(1, 3, 64, 96)
        mean, std = (torch.tensor(v)[:, None, None] for v in ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225)))
        interface = OriginalInterface(model)
        for wrong in ((x - mean) / std, x * 255):
            with pytest.raises(InputError, match=r"pixels .* in \[0, 1\]"):
                interface(wrong)
        with torch.no_grad():
            torch.testing.assert_close(
                interface((x - mean) / std, denorm=True)["metric_depth"], interface(x)["metric_depth"]
            )

    def test_vote_of_a_batch_by_compat_is_that_of_the_photos_and_that_of_their_mirror_images(self, tiny_config):
        """The released code runs the two passes one after the other, each with its own vote."""
        voting = replace(tiny_config, router=replace(tiny_config.router, vote="batch"))
        model = as_loaded(voting)
        x = torch.rand(3, 3, 64, 64, generator=torch.Generator().manual_seed(1))
        with torch.no_grad():
            expected = (model(x).depth + model(x.flip(3)).depth.flip(3)) / 2
            torch.testing.assert_close(OriginalInterface(model).infer(x, pad_input=False), expected)


class TestEntries:
    @pytest.mark.parametrize("entry", ENTRIES)
    def test_torch_hub_loads_the_repository_without_network(self, entry: str, tiny_presets):
        model = torch.hub.load(str(REPO), entry, source="local", pretrained=False)
        assert isinstance(model, torchhub.OriginalInterface)
        assert model.model.config == tiny_presets[ENTRIES[entry]]
        assert not model.training

    @pytest.mark.parametrize("entry", ENTRIES)
    def test_weights_from_a_file(self, entry: str, tiny_presets, tmp_path: Path):
        model = as_loaded(tiny_presets[ENTRIES[entry]])
        write_checkpoint(checkpoint_of(model), tmp_path / "model", to="zoedepth")
        for path in (str(tmp_path / "model"), f"local::{tmp_path / 'model'}"):
            loaded = torch.hub.load(str(REPO), entry, source="local", pretrained=path)
            x = torch.rand(1, 3, 64, 96)
            with torch.no_grad():
                torch.testing.assert_close(loaded(x)["metric_depth"], model(x).depth, rtol=1e-5, atol=1e-5)

    def test_weights_of_another_kind_are_refused(self, tiny_presets, tmp_path: Path):
        """A K in the place of N would be 8 times too far."""
        model = as_loaded(tiny_presets["zoed-m12-k"])
        write_checkpoint(checkpoint_of(model), tmp_path / "k.safetensors", to="zoedepth")
        with pytest.raises(InputError, match="is not a zoed-m12-n"):
            torch.hub.load(str(REPO), "ZoeD_N", source="local", pretrained=str(tmp_path / "k.safetensors"))

    def test_weights_from_a_url_are_fetched_once(self, tiny_presets, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))
        model = as_loaded(tiny_presets["zoed-m12-n"])
        write_checkpoint(checkpoint_of(model), tmp_path / "n.safetensors", to="zoedepth")
        with FileServer((tmp_path / "n.safetensors").read_bytes()) as server:
            url = f"{server.url}/n.safetensors"
            torch.hub.load(str(REPO), "ZoeD_N", source="local", pretrained=f"url::{url}")
            n_requests = len(server.requests)
            torch.hub.load(str(REPO), "ZoeD_N", source="local", pretrained=url)
            assert len(server.requests) == n_requests
        (kept,) = (tmp_path / "torch/hub/checkpoints").rglob("*.safetensors")
        assert kept.name == "n.safetensors"

    def test_each_address_has_weights_of_its_own(self, tiny_presets, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))
        folder, release = torchhub.download_folder(), torchhub.RELEASES["zoed-m12-n"]
        addresses = ["https://a.org/model.pt", "https://b.org/model.pt", "https://a.org/model.pt?v=2"]
        loaded = []
        monkeypatch.setattr(torchhub, "download", lambda url, path: loaded.append(path) or path)
        monkeypatch.setattr(torchhub, "load_network", lambda source, compat: as_loaded(tiny_presets["zoed-m12-n"]))
        for address in (*addresses, f"https://mine.org/{release.file}", release.url):
            torch.hub.load(str(REPO), "ZoeD_N", source="local", pretrained=f"url::{address}")
        assert len(set(loaded)) == 5
        assert release.path not in loaded[:4]
        assert loaded[4] == release.path == folder / release.file  # the original's own address is the release

    @pytest.mark.parametrize(
        "address", ["https://a.org", "https://a.org/", "https://a.org/weights/?v=2", "http://a/.."]
    )
    def test_an_address_without_a_file_name_is_refused(self, address: str):
        with pytest.raises(InputError, match="has no file name: give the address of a file"):
            torch.hub.load(str(REPO), "ZoeD_N", source="local", pretrained=address)

    @pytest.mark.parametrize(("mode", "resize"), [("infer", "keep-aspect"), ("eval", "squeeze"), ("train", "squeeze")])
    def test_modes_keep_or_squeeze_the_proportions(self, tiny_presets, mode: str, resize: str):
        model = torch.hub.load(str(REPO), "ZoeD_N", source="local", config_mode=mode)
        assert model.model.config.resize == resize
        with torch.no_grad():
            depth = model(torch.rand(1, 3, 40, 200))["metric_depth"]
        assert depth.shape[2:] == ((64, 96) if resize == "squeeze" else (32, 96))

    def test_compat(self, tiny_presets):
        k = torch.hub.load(str(REPO), "ZoeD_K", source="local", compat=("10m",))
        assert k.model.config.domains[0].max_depth == 10.0
        nk = torch.hub.load(str(REPO), "ZoeD_NK", source="local", compat=("batch-vote",))
        assert nk.model.router.by_batch

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ({"config_mode": "test"}, "config_mode"),
            ({"midas_model_type": "DPT_Huge"}, "midas_model_type"),
            ({"pretrained": True, "midas_model_type": "DPT_BEiT_B_384"}, "DPT_BEiT_L_384 only"),
            ({"pretrained": "no/such/file.pt"}, "no file"),
            ({"compat": ("10m",)}, "10m"),
        ],
    )
    def test_wrong_arguments_say_what_is_right(self, arguments: dict, message: str):
        with pytest.raises(InputError, match=message):
            torchhub.build(
                "zoed-m12-n",
                **{"pretrained": False, "midas_model_type": "DPT_BEiT_L_384", "config_mode": "infer", "compat": ()}
                | arguments,
            )

    @pytest.mark.parametrize("entry", ENTRIES)
    def test_further_options_of_the_original_are_refused_by_name(self, entry: str, tiny_presets):
        def load(**options: object) -> object:
            return torch.hub.load(str(REPO), entry, source="local", **options)

        load(train_midas=False, use_pretrained_midas=False, force_keep_ar=True)
        for option in ({"img_size": [384, 512]}, {"train_midas": True}, {"n_bins": 32}):
            with pytest.raises(InputError, match=f"{next(iter(option))} cannot be set here"):
                load(**option)

    def test_other_encoders_of_midas(self, monkeypatch: pytest.MonkeyPatch):
        """Their configs; with random weights, as in the original."""
        with without_memory():
            model = torchhub.build(
                "zoed-m12-nk",
                pretrained=False,
                midas_model_type="DPT_SwinV2_T_256",
                config_mode="infer",
                compat=(),
            )
        assert model.model.config.encoder.name == "swinv2_tiny_window16_256"
        assert model.model.config.size == (256, 256)


def test_checkout_that_is_not_installed_can_be_loaded(tmp_path: Path):
    """hubconf finds the package beside it. A wrong argument is enough to see that it was imported."""
    code = (
        "import sys; sys.path = [p for p in sys.path if not p.endswith('/src')]\n"
        "sys.meta_path = [f for f in sys.meta_path if 'editable' not in repr(f).lower()]\n"
        "import importlib.util as util\n"
        "assert util.find_spec('zoedepth') is None, 'the test needs a path without the package'\n"
        f"import torch; torch.hub.load({str(REPO)!r}, 'ZoeD_N', source='local', midas_model_type='none')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert "InputError: midas_model_type 'none' is unknown" in done.stderr, done.stderr
