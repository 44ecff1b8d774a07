"""The convert and push commands."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from tests.servers import FakeHub
from tests.twins import KITTI, NYU, twin, twin_config

from zoedepth.cli import main
from zoedepth.model.zoedepth import ZoeDepth
from zoedepth.weights.checkpoint import read_checkpoint
from zoedepth.weights.load import load_model
from zoedepth.weights.releases import RELEASES
from zoedepth.weights.save import save_model


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small model of transformers with two heads."""
    path = tmp_path_factory.mktemp("twin") / "twin"
    twin(twin_config(heads=(NYU, KITTI))).save_pretrained(path)
    return path


def same(one: Path, other: Path) -> bool:
    first, second = read_checkpoint(one), read_checkpoint(other)
    return (
        first.config == second.config
        and first.weights.keys() == second.weights.keys()
        and all(torch.equal(value, second.weights[name]) for name, value in first.weights.items())
    )


class TestConvert:
    @pytest.mark.parametrize(
        ("to", "target"),
        [("zoedepth", "model"), ("zoedepth", "model.safetensors"), ("huggingface", "model")],
    )
    def test_there_and_loaded(self, to: str, target: str, folder: Path, tmp_path: Path, capsys):
        assert main(["convert", str(folder), str(tmp_path / target), "--to", to]) == 0
        assert capsys.readouterr().out.strip() == str(tmp_path / target)
        assert same(folder, tmp_path / target)

    def test_original(self, folder: Path, tmp_path: Path):
        """The original has fixed names of its heads, and no sizes but what the shapes tell."""
        assert main(["convert", str(folder), str(tmp_path / "model.pt"), "--to", "original"]) == 0
        state = torch.load(tmp_path / "model.pt", weights_only=True)["model"]
        assert "attractors.kitti.3._net.2.weight" in state
        x = torch.rand(1, 3, 64, 64)
        with torch.no_grad():
            found, expected = load_model(tmp_path / "model.pt")(x).depth, load_model(folder)(x).depth
        torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-5)

    def test_card_has_name_and_licence(self, folder: Path, tmp_path: Path):
        options = ["--to", "huggingface", "--name", "Kitchens", "--licence", "mit"]
        assert main(["convert", str(folder), str(tmp_path / "model"), *options]) == 0
        card = (tmp_path / "model" / "README.md").read_text()
        assert "license: mit" in card
        assert "# Kitchens" in card

    def test_damaged_source_writes_nothing(self, folder: Path, tmp_path: Path, capsys):
        broken = tmp_path / "broken.safetensors"
        broken.write_bytes((folder / "model.safetensors").read_bytes()[:-100])
        assert main(["convert", str(broken), str(tmp_path / "model"), "--to", "zoedepth"]) == 2
        assert "broken.safetensors" in capsys.readouterr().err
        assert [path.name for path in tmp_path.iterdir()] == ["broken.safetensors"]

    def test_weights_that_do_not_fit_are_not_written_on(self, tiny_model: ZoeDepth, tmp_path: Path, capsys):
        """The bytes are whole, but no model would load them."""
        with torch.no_grad():
            tiny_model.shared.bottleneck.weight[0] = float("nan")
        save_model(tiny_model, tmp_path / "nan.safetensors")
        assert main(["convert", str(tmp_path / "nan.safetensors"), str(tmp_path / "out"), "--to", "zoedepth"]) == 2
        assert "not finite" in capsys.readouterr().err
        assert not (tmp_path / "out").exists()

    def test_existing_folder_is_kept(self, folder: Path, tmp_path: Path, capsys):
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "mine.txt").write_text("mine")
        assert main(["convert", str(folder), str(tmp_path / "out"), "--to", "zoedepth"]) == 2
        assert "is there already" in capsys.readouterr().err
        assert [path.name for path in (tmp_path / "out").iterdir()] == ["mine.txt"]

    def test_target_that_cannot_be_is_refused_before_a_model_is_looked_for(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
    ):
        monkeypatch.setattr("zoedepth.weights.load.find", lambda *_, **__: pytest.fail("a model was looked for"))
        (tmp_path / "mine.pt").write_text("mine")
        for to, target, message in (
            ("original", "mine.pt", "mine.pt is there already"),
            ("zoedepth", "mine.pt", "is a folder"),
            ("huggingface", ".", "is there already"),
            ("original", "out", "ends with .pt"),
            ("zoedepth", "mine.pt/deep/model", "cannot write"),
        ):
            assert main(["convert", "zoed-lite", str(tmp_path / target), "--to", to]) == 2
            assert message in " ".join(capsys.readouterr().err.split())
        assert (tmp_path / "mine.pt").read_text() == "mine"

    def test_model_the_other_layout_has_not(self, tmp_path: Path, capsys):
        assert main(["convert", "zoed-lite", str(tmp_path / "out"), "--to", "huggingface"]) == 2
        assert "transformers' ZoeDepth has no such model: encoder family 'convolutional'" in capsys.readouterr().err
        assert list(tmp_path.iterdir()) == []

    def test_shipped_model_as_a_folder(self, tmp_path: Path):
        assert main(["convert", "zoed-lite", str(tmp_path / "lite"), "--to", "zoedepth"]) == 0
        assert same(RELEASES["zoed-lite"].path, tmp_path / "lite")
        size, shipped = (
            path.stat().st_size for path in (tmp_path / "lite/model.safetensors", RELEASES["zoed-lite"].path)
        )
        assert abs(size - shipped) < 10_000, "16 bits stay 16 bits"


class TestPush:
    def test_published_model_is_loaded_by_its_id(self, folder: Path, tmp_path: Path):
        """In a process of its own, because the hub's address is read when it starts."""
        code = (
            "import sys; from zoedepth.cli import main\n"
            "assert main(['push', sys.argv[1], 'me/model', '--to', 'huggingface', '--licence', 'mit']) == 0\n"
            "assert main(['convert', 'me/model', sys.argv[2], '--to', 'zoedepth']) == 0\n"
        )
        with FakeHub({}) as hub:
            environment = {**os.environ, **hub.environment(tmp_path / "home", token="hf_right")}
            command = [sys.executable, "-c", code, str(folder), str(tmp_path / "back")]
            done = subprocess.run(command, env=environment, capture_output=True, text=True)
            assert done.returncode == 0, done.stderr
            assert "me/model" in done.stdout
        back = read_checkpoint(tmp_path / "back")
        assert back.config == read_checkpoint(folder).config
        assert back.provenance.licence == "mit"

    def test_terms_training_data_and_numbers_are_inherited(self, tmp_path: Path, capsys):
        assert main(["convert", "zoed-lite", str(tmp_path / "lite"), "--to", "zoedepth"]) == 0
        assert main(["push", str(tmp_path / "lite/model.safetensors"), "me/lite", "--dry-run"]) == 0
        pushed, converted = capsys.readouterr().out, (tmp_path / "lite/README.md").read_text()
        for card in (pushed, converted):
            assert "license: other\nlicense_name: non-commercial-research\n" in card
            assert "| NYU Depth v2, 654 test pairs | 0.162 |" in card
            assert "CC BY-NC-SA 3.0" in card
        assert main(["push", "zoed-lite", "me/lite", "--dry-run", "--licence", "mit"]) == 2
        assert main(["convert", "zoed-lite", str(tmp_path / "mit"), "--to", "zoedepth", "--licence", "mit"]) == 2
        assert capsys.readouterr().err.count("stay non-commercial") == 2
        assert not (tmp_path / "mit").exists()

    def test_weights_without_a_licence_are_not_uploaded(self, folder: Path, capsys):
        for options in ([], ["--dry-run"], ["--licence", "unknown"]):
            assert main(["push", str(folder), "me/model", *options]) == 2
            assert "licence of these weights is not known" in capsys.readouterr().err

    def test_dry_run_prints_the_card_and_needs_no_network(self, folder: Path, capsys):
        assert main(["push", str(folder), "me/model", "--dry-run", "--licence", "mit"]) == 0
        assert "license: mit" in capsys.readouterr().out

    def test_no_id(self, folder: Path, capsys):
        assert main(["push", str(folder), "model"]) == 2
        assert "owner/name" in capsys.readouterr().err
