"""Shards: every place belongs to exactly one, the same one on every machine."""

from pathlib import PurePosixPath

import pytest

from zoedepth.errors import InputError
from zoedepth.jobs.shard import JobShard


@pytest.mark.parametrize("count", [1, 2, 7, 1000])
def test_each_place_is_in_one_shard_and_shards_are_alike(count: int) -> None:
    places = [PurePosixPath(f"day {index % 13}/{index}.jpg") for index in range(2000)]
    shards = [JobShard(index, count) for index in range(count)]
    sizes = [sum(shard.holds(place) for place in places) for shard in shards[:8]]
    assert all(sum(shard.holds(place) for shard in shards) == 1 for place in places[:20])
    if count <= 8:
        assert sum(sizes) == 2000
        assert max(sizes) < 1.3 * 2000 / count


def test_a_place_stays_in_its_shard() -> None:
    """These must never change: commands of two versions may work on one job."""
    assert [JobShard(index, 4).holds(PurePosixPath("photos/a.jpg")) for index in range(4)] == [
        False, True, False, False,
    ]  # fmt: skip


@pytest.mark.parametrize("text", ["2/2", "1/0", "-1/2", "1", "a/b", "1/2/3", "0/1000000", ""])
def test_what_is_no_shard_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="--shard must be i/n"):
        JobShard.parse(text)


def test_text() -> None:
    assert str(JobShard.parse(" 3/8 ")) == "3/8"
