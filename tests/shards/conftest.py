"""Seven pairs, and three shards of them."""

from pathlib import Path

import pytest
from tests.folders import write_pairs
from tests.shards.samples import THREE

from zoedepth.data.pairs import PairDataset
from zoedepth.shards.writer import write_shards


@pytest.fixture
def pairs(tmp_path: Path) -> PairDataset:
    """Seven pairs."""
    return PairDataset(write_pairs(tmp_path / "pairs", n=7, size=(16, 24)))


@pytest.fixture
def shards(pairs: PairDataset, tmp_path: Path) -> Path:
    """Three shards of three, three and one."""
    write_shards(pairs, tmp_path / "shards", name="pairs", size=THREE)
    return tmp_path / "shards"
