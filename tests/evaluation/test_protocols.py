"""Protocols as the paper and its code have them, which pixels they score, and the hash that tells them apart."""

import os
import subprocess
import sys
from dataclasses import asdict, fields, replace

import numpy as np
import pytest

from zoedepth.errors import InputError
from zoedepth.evaluation.protocols import (
    INDOOR,
    OUTDOOR,
    PLAIN,
    PROTOCOLS,
    Crop,
    Protocol,
    crop_mask,
    find_protocol,
    protocol_of,
)

# ---------------------------------------------------------------------------------------------------- crops


@pytest.mark.parametrize(
    ("size", "rows", "columns"),
    [
        # Absolute indices, whatever the size: 426 x 560 pixels of NYU.
        ((480, 640), (45, 471), (41, 601)),
        ((768, 1024), (45, 471), (41, 601)),
        ((352, 1216), (45, 352), (41, 601)),
        ((64, 96), (45, 64), (41, 96)),
        ((40, 40), (0, 0), (0, 0)),
    ],
)
def test_eigen_crop_is_the_same_window_of_every_picture(
    size: tuple[int, int], rows: tuple[int, int], columns: tuple[int, int]
) -> None:
    assert_scored(crop_mask(size, "eigen"), size, rows, columns)


@pytest.mark.parametrize(
    ("size", "rows", "columns"),
    [
        ((480, 640), (45, 471), (41, 601)),
        # 45 / 480 x 768 = 72, 471 / 480 x 768 = 753.6, 41 / 640 x 1024 = 65.6, 601 / 640 x 1024 = 961.6
        ((768, 1024), (72, 754), (66, 962)),
        # 33, 345.4; 77.9, 1141.9
        ((352, 1216), (33, 345), (78, 1142)),
    ],
)
def test_scaled_eigen_crop_is_the_same_share_of_every_picture(
    size: tuple[int, int], rows: tuple[int, int], columns: tuple[int, int]
) -> None:
    assert_scored(crop_mask(size, "eigen-scaled"), size, rows, columns)


@pytest.mark.parametrize(
    ("size", "rows", "columns"),
    [
        # 0.40810811 x 352 = 143.65, 0.99189189 x 352 = 349.15, 0.03594771 x 1216 = 43.71, 0.96405229 x 1216 = 1172.29.
        ((352, 1216), (143, 349), (43, 1172)),
        # 153.04, 371.96; 44.65, 1197.35
        ((375, 1242), (153, 371), (44, 1197)),
        # 195.89, 476.11; 23.01, 616.99
        ((480, 640), (195, 476), (23, 616)),
        # 313.43, 761.77; 36.81, 987.19
        ((768, 1024), (313, 761), (36, 987)),
    ],
)
def test_garg_crop_is_the_same_share_of_every_picture(
    size: tuple[int, int], rows: tuple[int, int], columns: tuple[int, int]
) -> None:
    assert_scored(crop_mask(size, "garg"), size, rows, columns)


def assert_scored(mask: np.ndarray, size: tuple[int, int], rows: tuple[int, int], columns: tuple[int, int]) -> None:
    """The mask is True in rows[0] <= row < rows[1] and likewise columns, and nowhere else."""
    assert mask.shape == size
    assert mask.dtype == bool
    assert mask.sum() == (rows[1] - rows[0]) * (columns[1] - columns[0])
    assert mask[rows[0] : rows[1], columns[0] : columns[1]].all()


@pytest.mark.parametrize(
    ("crop", "counts"),
    [
        ("none", (428_032, 307_200, 786_432)),
        ("eigen", (307 * 560, 238_560, 238_560)),
        ("eigen-scaled", (312 * 1064, 238_560, 682 * 896)),
        ("garg", (232_574, 281 * 593, 448 * 951)),
    ],
)
def test_number_of_scored_pixels_is_the_known_one(crop: Crop, counts: tuple[int, int, int]) -> None:
    assert tuple(crop_mask(size, crop).sum() for size in ((352, 1216), (480, 640), (768, 1024))) == counts


# ---------------------------------------------------------------------------------------------------- values

PAPER = {
    # The paper's overview of data sets: cap in metres, crop, and whether KITTI's crop comes first.
    "nyu": (10, "eigen", False),
    "sunrgbd": (8, "eigen-scaled", False),
    "ibims": (10, "eigen", False),
    "diode-indoor": (10, "eigen-scaled", False),
    "hypersim": (80, "eigen-scaled", False),
    "kitti": (80, "garg", True),
    "vkitti2": (80, "garg", True),
    "ddad": (80, "garg", False),
    "diml-outdoor": (80, "garg", False),
    "diode-outdoor": (80, "garg", False),
}


def test_protocols_are_ten_of_the_paper_ten_of_its_code_and_three_for_other_data() -> None:
    assert set(PROTOCOLS) == {*PAPER, *(f"{name}-released" for name in PAPER), "indoor", "outdoor", "plain"}
    assert all(protocol.name == name for name, protocol in PROTOCOLS.items())


@pytest.mark.parametrize("name", PAPER)
def test_paper_protocol_has_the_values_of_the_paper(name: str) -> None:
    protocol = PROTOCOLS[name]
    assert (protocol.max_depth, protocol.crop, protocol.kitti_crop) == PAPER[name]
    assert protocol.min_depth == 1e-3
    assert (protocol.photo_size, protocol.photo_short_side, protocol.resize) == (None, None, "squeeze")
    assert (protocol.pad, protocol.flip_average, protocol.upsampling) == (False, True, "bilinear")
    assert (protocol.mean, protocol.use_mask, protocol.alignment) == ("images", True, "none")
    assert "metre" in protocol.decoding or " m" in protocol.decoding


@pytest.mark.parametrize(
    ("name", "differences"),
    [
        ("nyu", {}),
        ("sunrgbd", {"min_depth": 0.0, "crop": "eigen"}),
        ("ibims", {"min_depth": 0.0}),
        (
            "diode-indoor",
            {"crop": "eigen", "use_mask": False, "photo_short_side": 480, "photo_antialias": False},
        ),
        ("hypersim", {"crop": "eigen", "photo_size": (480, 640), "photo_antialias": False}),
        ("kitti", {}),
        ("vkitti2", {}),
        ("ddad", {"photo_size": (352, 1216), "photo_antialias": False}),
        ("diml-outdoor", {"min_depth": 2.0}),
        ("diode-outdoor", {"use_mask": False, "photo_short_side": 480, "photo_antialias": False}),
    ],
)
def test_released_code_differs_from_the_paper_where_it_is_documented(name: str, differences: dict[str, object]) -> None:
    paper, released = asdict(PROTOCOLS[name]), asdict(PROTOCOLS[f"{name}-released"])
    found = {key: value for key, value in released.items() if value != paper[key]}
    decoded_otherwise = found.pop("decoding", None) is not None
    assert found == {"name": f"{name}-released", **differences}
    assert decoded_otherwise == (name in ("hypersim", "vkitti2"))


def test_domains_have_the_protocols_of_nyu_and_kitti() -> None:
    indoor, outdoor = protocol_of("indoor"), protocol_of("outdoor")
    assert (indoor, outdoor) == (INDOOR, OUTDOOR)
    for own, paper in ((indoor, PROTOCOLS["nyu"]), (outdoor, PROTOCOLS["kitti"])):
        # But for photos that keep their proportions, and a crop that goes with their size.
        crop = "eigen-scaled" if paper.crop == "eigen" else paper.crop
        assert own == replace(paper, name=own.name, resize="keep-aspect", decoding="metres", crop=crop)


def test_domain_without_a_protocol_of_its_own_is_scored_wherever_depth_is_known() -> None:
    plain = protocol_of("attic")
    assert plain is PLAIN
    assert (plain.min_depth, plain.max_depth, plain.crop, plain.kitti_crop) == (1e-3, 1000.0, "none", False)


def test_protocol_is_found_by_name() -> None:
    assert find_protocol("ddad-released") is PROTOCOLS["ddad-released"]


def test_unknown_protocol_is_an_error_that_names_it_and_the_known() -> None:
    with pytest.raises(InputError) as raised:
        find_protocol("nyuv2")
    assert all(name in str(raised.value) for name in ("'nyuv2': did you mean nyu", *PROTOCOLS))


@pytest.mark.parametrize(("low", "high"), [(-1.0, 10.0), (10.0, 10.0), (11.0, 10.0)])
def test_empty_range_of_depth_is_an_error(low: float, high: float) -> None:
    with pytest.raises(InputError, match="min_depth < max_depth"):
        Protocol("none", min_depth=low, max_depth=high)


def test_photo_of_two_sizes_is_an_error() -> None:
    with pytest.raises(InputError, match="not both"):
        Protocol("both", max_depth=10.0, photo_size=(480, 640), photo_short_side=480)


# ---------------------------------------------------------------------------------------------------- hash

CHANGES = {
    "max_depth": 9.0,
    "min_depth": 0.0,
    "crop": "none",
    "kitti_crop": True,
    "photo_size": (480, 640),
    "photo_short_side": 480,
    "photo_antialias": False,
    "resize": "squeeze",
    "pad": True,
    "flip_average": False,
    "upsampling": "bicubic",
    "mean": "pixels",
    "use_mask": False,
    "alignment": "median",
    "decoding": "feet",
}


def test_changes_below_are_of_every_field() -> None:
    assert {*CHANGES, "name"} == {field.name for field in fields(Protocol)}


@pytest.mark.parametrize("name", CHANGES)
def test_hash_changes_with_every_field(name: str) -> None:
    changed = replace(INDOOR, **{name: CHANGES[name]})
    assert changed.hash != INDOOR.hash
    assert changed.label == f"indoor#{changed.hash}"


def test_hash_does_not_depend_on_the_name() -> None:
    assert replace(INDOOR, name="rooms").hash == INDOOR.hash
    assert PROTOCOLS["nyu"].hash == PROTOCOLS["nyu-released"].hash


def test_equal_protocols_have_equal_hashes() -> None:
    assert Protocol("a", max_depth=10, min_depth=0).hash == Protocol("b", max_depth=10.0, min_depth=0.0).hash


@pytest.mark.parametrize(
    ("name", "label"),
    [
        ("indoor", "indoor#ae5634ef"),
        ("outdoor", "outdoor#ea9478f1"),
        ("plain", "plain#da54aaf4"),
        ("nyu", "nyu#0dffd32c"),
        ("kitti", "kitti#4250ca88"),
    ],
)
def test_published_protocols_do_not_change_silently(name: str, label: str) -> None:
    # Whoever changes a value changes what results under this name mean: say so in the changelog.
    assert PROTOCOLS[name].label == label


def test_hash_is_the_same_in_another_process() -> None:
    code = "from zoedepth.evaluation.protocols import PROTOCOLS; print(*(p.hash for p in PROTOCOLS.values()))"
    environment = {**os.environ, "PYTHONHASHSEED": "1"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split() == [protocol.hash for protocol in PROTOCOLS.values()]
