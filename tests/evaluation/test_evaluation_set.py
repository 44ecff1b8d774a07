"""Data to evaluate on: which protocol is chosen, what may be changed of it, and what cannot be scored."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.folders import write_disparity_pairs, write_pairs

from zoedepth.errors import InputError
from zoedepth.evaluation.evaluation_set import open_evaluation_set
from zoedepth.evaluation.identity import settings_fingerprint
from zoedepth.evaluation.protocols import INDOOR, OUTDOOR, PLAIN, PROTOCOLS


def write_nyu(folder: Path) -> Path:
    """Write one photo of NYU's test set, in its official folder."""
    scene = folder / "official_splits/test/kitchen"
    scene.mkdir(parents=True)
    Image.new("RGB", (640, 480), (90, 60, 30)).save(scene / "rgb_00045.jpg")
    Image.fromarray(np.full((480, 640), 2500, np.uint16)).save(scene / "sync_depth_00045.png")
    return folder


def write_diode(folder: Path) -> Path:
    """Write one photo of DIODE's indoor scenes in its official folder, whose mask says that nothing is known."""
    stem = folder / "val/indoors/scene_00019/scan_00183/00019_00183_indoors_000_010"
    stem.parent.mkdir(parents=True)
    Image.new("RGB", (64, 48), (90, 60, 30)).save(f"{stem}.png")
    np.save(f"{stem}_depth.npy", np.full((48, 64, 1), 2.5, np.float32))
    np.save(f"{stem}_depth_mask.npy", np.zeros((48, 64)))
    return folder


def test_each_domain_has_its_protocol(tmp_path: Path) -> None:
    path = write_pairs(tmp_path, n=3, split="test")
    header, *lines = path.read_text().splitlines()
    domains = ("indoor", "outdoor", "attic")
    lines = [line.replace(",indoor", f",{domain}") for line, domain in zip(lines, domains, strict=True)]
    path.write_text("\n".join([header, *lines]) + "\n")
    assert open_evaluation_set(path).protocols == {"indoor": INDOOR, "outdoor": OUTDOOR, "attic": PLAIN}


def test_given_protocol_goes_before_and_changes_after(tmp_path: Path) -> None:
    path = write_pairs(tmp_path, n=1, split="test")
    found = open_evaluation_set(path, protocol=PROTOCOLS["nyu"], changes={"crop": "garg", "max_depth": 5.0})
    assert found.protocols == {"indoor": replace(PROTOCOLS["nyu"], crop="garg", max_depth=5.0)}
    with pytest.raises(InputError, match="min_depth < max_depth"):
        open_evaluation_set(path, changes={"min_depth": 20.0})


def test_published_set_in_its_official_folder_has_the_papers_protocol_unless_told_otherwise(tmp_path: Path) -> None:
    folder = write_nyu(tmp_path)
    assert open_evaluation_set(folder, name="nyu").protocols == {"indoor": PROTOCOLS["nyu"]}
    assert open_evaluation_set(folder, name="nyu", protocol=PLAIN).protocols == {"indoor": PLAIN}


def test_own_list_of_a_published_name_does_not(tmp_path: Path) -> None:
    path = write_pairs(tmp_path, n=1, split="test")
    assert open_evaluation_set(path, name="nyu").protocols == {"indoor": INDOOR}


@pytest.mark.parametrize(
    ("protocol", "known"),
    [(None, False), (PROTOCOLS["diode-indoor"], False), (PROTOCOLS["diode-indoor-released"], True)],
    ids=["none", "paper", "released"],
)
def test_masks_of_a_published_set_are_applied_where_the_protocol_says_so(tmp_path: Path, protocol, known: bool) -> None:
    found = open_evaluation_set(write_diode(tmp_path), name="diode-indoor", protocol=protocol)
    assert bool(found.dataset[0].mask.any()) is known


def test_photo_without_truth_and_folder_with_a_test_list_are_read(tmp_path: Path) -> None:
    path = write_pairs(tmp_path, n=2, split="test")
    path.write_text(path.read_text().replace("depth/test_001.png", "None"))
    write_pairs(tmp_path, n=5)
    found = open_evaluation_set(tmp_path)
    assert [bool(found.dataset[i].mask.any()) for i in range(len(found.dataset))] == [True, False]
    assert found.about == {"data": str(tmp_path)}


def test_settings_of_the_data_are_its_state(tmp_path: Path) -> None:
    path = write_pairs(tmp_path, n=1, split="test")
    assert open_evaluation_set(path).state == {"settings": None}
    (tmp_path / "dataset.json").write_text('{"max_depth": 9}')
    assert open_evaluation_set(tmp_path).state == {"settings": settings_fingerprint(str(path))} != {"settings": None}


def test_disparity_is_an_error_that_names_the_data(tmp_path: Path) -> None:
    path = write_disparity_pairs(tmp_path)
    with pytest.raises(InputError, match=r"train\.csv has disparity"):
        open_evaluation_set(path)
