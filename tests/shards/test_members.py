"""Members of a sample: names, roles, and bytes that come back; and blocks that are damaged or have far too many."""

import tarfile

import pytest
from tests.shards.samples import DEPTH, MEMBERS, PHOTO

from zoedepth.errors import InputError
from zoedepth.shards.members import Roles, find_roles, pack, split_name, unpack


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("0.jpg", ("0", "jpg")),
        ("a/b.c/0.Depth.PNG", ("a/b.c/0", "depth.png")),
        ("scene\n1.json", ("scene\n1", "json")),
        ("0", None),
        (".hidden", None),
        ("a/.hidden.png", None),
        ("a/b.png/", None),
        ("", None),
    ],
)
def test_key_ends_at_the_first_dot_of_the_name(name: str, expected: tuple[str, str] | None) -> None:
    assert split_name(name) == expected


@pytest.mark.parametrize(
    ("extensions", "expected"),
    [
        (["json", "depth.png", "jpg"], Roles("jpg", "depth.png", "depth", None)),
        (["rgb.webp", "depth_map.npy", "mask.png", "cls"], Roles("rgb.webp", "depth_map.npy", "depth", "mask.png")),
        (["image.png", "disparity.npz"], Roles("image.png", "disparity.npz", "disparity", None)),
    ],
)
def test_roles_by_extension(extensions: list[str], expected: Roles) -> None:
    assert find_roles(extensions, "here") == expected


@pytest.mark.parametrize("extensions", [[], ["jpg"], ["depth.png"], ["jpg", "png", "depth.png"], ["jpg", "depth.jpg"]])
def test_sample_without_one_photo_and_one_target_is_an_error(extensions: list[str]) -> None:
    with pytest.raises(InputError, match="here: needs one photo"):
        find_roles(extensions, "here")


def test_members_come_back_and_bytes_do_not_depend_on_their_order() -> None:
    members = {"png": PHOTO, "depth.png": DEPTH, "json": b"{}"}
    block = pack("00000007", members)
    assert len(block) % tarfile.BLOCKSIZE == 0
    assert unpack(block, "here") == members
    assert pack("00000007", dict(reversed(members.items()))) == block


def test_damaged_block_is_an_error_that_says_where() -> None:
    block = pack("0", {name.partition(".")[2]: content for name, content in MEMBERS.items()})
    for damaged in (block[:600], block[:700], b"?" + block[1:], block + b"rubbish" * 100):
        with pytest.raises(InputError, match="here: the shard is damaged"):
            unpack(damaged, "here")


def test_header_of_digits_is_an_error_at_once() -> None:
    """A shard of 66 kB took 7 s."""
    header = tarfile.TarInfo("x")
    header.type, header.size = tarfile.XHDTYPE, 64_512
    block = header.tobuf(tarfile.USTAR_FORMAT) + b"1" * header.size + pack("0", {"json": b"{}"})
    with pytest.raises(InputError, match=r"here: the shard is damaged.*255 digits"):
        unpack(block, "here")


def test_block_with_two_members_of_one_name_or_with_thousands_is_an_error() -> None:
    with pytest.raises(InputError, match=r"here: has two members \.json"):
        unpack(pack("0", {"json": b"{}"}) + pack("1", {"json": b"{}"}), "here")
    with pytest.raises(InputError, match="more than 100"):
        unpack(pack("0", {str(number): b"" for number in range(101)}), "here")
    assert len(unpack(pack("0", {str(number): b"" for number in range(100)}), "here")) == 100


@pytest.mark.parametrize("mask", ["mask.npy", "mask.jpg", "mask.PNG"])
def test_a_mask_that_is_not_read_is_refused(mask: str) -> None:
    with pytest.raises(InputError, match=rf"its mask \.{mask} is not read\. Save masks as \.mask\.png"):
        find_roles(["jpg", "depth.png", mask], "a.tar")
