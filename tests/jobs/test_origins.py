"""Photos that are no files here: read whole, within bounds, again where a network failed."""

import io
import tarfile
import zipfile
from pathlib import Path

import fsspec
import pytest

from zoedepth.errors import InputError
from zoedepth.jobs import origins
from zoedepth.jobs.origins import Address, Held, TarMember, ZipMember, is_address, open_bytes, open_store, patiently


@pytest.fixture(autouse=True)
def no_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(origins, "_FIRST_WAIT", 0)


@pytest.mark.parametrize(
    ("text", "expected"),
    [("s3://b/a.jpg", True), ("https://a.org/b.jpg?c=d", True), ("git+ssh://x", True), ("a.jpg", False),
     ("C:\\a", False), ("c://a", False), ("/a://b", False), ("photos: 1", False), ("://", False)],
)  # fmt: skip
def test_addresses(text: str, expected: bool) -> None:
    assert is_address(text) == expected


def test_signatures_are_secrets_and_other_queries_are_part_of_the_name() -> None:
    signed = "https://b.s3.amazonaws.com/a.jpg?X-Amz-Algorithm=AWS4&X-Amz-Signature=abc"
    assert Address(signed).name == "https://b.s3.amazonaws.com/a.jpg"
    assert Address("https://a.org/photo?id=3").name == "https://a.org/photo?id=3"


@pytest.mark.parametrize(
    "signature",
    [
        "X-Amz-Algorithm=AWS4&X-Amz-Credential=a&X-Amz-Date=1&X-Amz-Expires=9&X-Amz-SignedHeaders=host&X-Amz-Signature=b",
        "AWSAccessKeyId=a&Expires=9&Signature=b",
        "X-Goog-Algorithm=a&X-Goog-Credential=b&X-Goog-Date=1&X-Goog-Expires=9&X-Goog-SignedHeaders=c&X-Goog-Signature=d",
        "GoogleAccessId=a&Expires=9&Signature=b",
        "Policy=a&Signature=b&Key-Pair-Id=c",
        "sv=2022-11-02&ss=b&srt=o&sp=r&st=1&se=9&spr=https&sip=1.2.3.4&sr=b&skoid=a&sktid=b&skt=1&ske=9&sks=b&skv=1&sig=c",
        "sig=a",
    ],
)
def test_a_signature_leaves_the_rest_of_the_query(signature: str) -> None:
    names = [Address(f"https://a.org/img?id={i}&{signature}&versionId=7").name for i in (1, 2)]
    assert names == [f"https://a.org/img?id={i}&versionId=7" for i in (1, 2)]
    assert Address(f"https://a.org/img?{signature}").name == "https://a.org/img"


def test_what_only_azure_calls_a_part_of_a_signature_stays_elsewhere() -> None:
    assert Address("https://a.org/img?se=4&sig=a").name == "https://a.org/img?se=4"
    assert Address("https://a.org/img?sv=1&expires=2").name == "https://a.org/img?sv=1&expires=2"


@pytest.mark.parametrize("error", [ConnectionResetError("reset"), RuntimeError("reset")])  # clients have their own
def test_an_address_is_read_again_where_the_network_fails(error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    store = fsspec.filesystem("memory")
    store.pipe("/origins/a.jpg", b"content")
    opened, left = type(store).open, 3

    def failing(self: object, *arguments: object, **options: object) -> object:
        nonlocal left
        left -= 1
        if left >= 0:
            raise error
        return opened(self, *arguments, **options)

    monkeypatch.setattr(type(store), "open", failing)
    assert Address("memory://origins/a.jpg").read() == b"content"
    left = 99
    with pytest.raises(InputError, match=r"cannot be read from its store: .*reset"):
        Address("memory://origins/a.jpg").read()
    assert left == 99 - origins.TRIES


def test_what_is_not_there_is_not_asked_for_again() -> None:
    asked = []

    def missing() -> None:
        asked.append(1)
        raise FileNotFoundError("a")

    with pytest.raises(FileNotFoundError):
        patiently(missing)
    assert len(asked) == 1
    with pytest.raises(InputError, match="cannot be read from its store"):
        Address("memory://origins/none.jpg").read()


def test_no_such_kind_of_address() -> None:
    with pytest.raises(InputError, match=r"xyz.*Known are s3"):
        open_store("xyz://a/b")


def test_members_of_archives(tmp_path: Path) -> None:
    content = bytes(range(256)) * 100
    with zipfile.ZipFile(tmp_path / "a.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("x/a.jpg", content)
    member = ZipMember(str(tmp_path / "a.zip"), "x/a.jpg")
    assert (member.read(), member.name) == (content, f"{tmp_path / 'a.zip'}::x/a.jpg")
    with tarfile.open(tmp_path / "a.tar", "w") as archive:
        info = tarfile.TarInfo("x/a.jpg")
        info.size = len(content)
        archive.addfile(info, io.BytesIO(content))
    with tarfile.open(tmp_path / "a.tar") as archive:
        where = archive.getmember("x/a.jpg").offset_data
    member = TarMember(str(tmp_path / "a.tar"), "x/a.jpg", where, len(content))
    assert (member.read(), member.name) == (content, f"{tmp_path / 'a.tar'}::x/a.jpg")
    with open_bytes(str(tmp_path / "a.tar")) as file:
        assert file.read(7) == b"x/a.jpg"
    assert Held("b", b"1").read() == b"1"


def test_damaged_archives(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "b.zip", "w") as archive:
        archive.writestr("a.jpg", b"12345678" * 100)
    damaged = (tmp_path / "b.zip").read_bytes().replace(b"12345678", b"12345679", 1)
    (tmp_path / "b.zip").write_bytes(damaged)
    with pytest.raises(InputError, match=r"cannot be read from its archive.*CRC"):
        ZipMember(str(tmp_path / "b.zip"), "a.jpg").read()
    (tmp_path / "b.tar").write_bytes(b"123")
    with pytest.raises(InputError, match="is cut off"):
        TarMember(str(tmp_path / "b.tar"), "a.jpg", 1, 99).read()


def test_a_member_that_unpacks_to_far_more_than_it_is_large_is_not_unpacked(tmp_path: Path) -> None:
    with (
        zipfile.ZipFile(tmp_path / "bomb.zip", "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("a.png", "w") as file,
    ):
        for _ in range(120):
            file.write(bytes(1_000_000))
    with pytest.raises(InputError, match="would unpack to 120,000,000"):
        ZipMember(str(tmp_path / "bomb.zip"), "a.png").read()


def test_nothing_larger_than_a_photo_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(origins, "MAX_PHOTO", 1000)
    fsspec.filesystem("memory").pipe("/origins/large.jpg", bytes(1001))
    with zipfile.ZipFile(tmp_path / "c.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("large.jpg", bytes(1001))
    for origin in (
        Address("memory://origins/large.jpg"),
        ZipMember(str(tmp_path / "c.zip"), "large.jpg"),
        TarMember("none.tar", "large.jpg", 0, 1001),
    ):
        with pytest.raises(InputError, match="larger than 1,000 bytes"):
            origin.read()
