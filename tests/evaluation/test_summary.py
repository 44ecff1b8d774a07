"""Numbers of many images."""

import dataclasses
import json
import math
from dataclasses import replace

import pytest

from zoedepth.errors import InputError
from zoedepth.evaluation.protocols import INDOOR, OUTDOOR, Protocol
from zoedepth.evaluation.scoring import RANGES, Score
from zoedepth.evaluation.summary import Summary, summarise
from zoedepth.evaluation.uncertainty import UncertaintyScores
from zoedepth.metrics import Sums, add_sums, mean_metrics, pooled_metrics

PROTOCOLS = {"indoor": INDOOR, "outdoor": OUTDOOR}


def sums_of(n_pixels: int, rel: float) -> Sums:
    """Make the sums of pixels with this REL; the other numbers follow from it in some way."""
    n = n_pixels
    return Sums(n, rel * n, 4 * rel**2 * n, rel * n / 2, n, n, n, rel * n, rel**2 * n / 16, rel * n / 8)


def score_of(
    rel: float | None, *, n_pixels: int = 100, domain: str = "indoor", routed: str | None = None, **more: object
) -> Score:
    """Score an image whose pixels are all between 1 and 2 m; without a REL it has no known pixel."""
    if rel is None:
        return Score("photo.jpg", domain, routed, None)
    sums = sums_of(n_pixels, rel)
    ranges = tuple(sums if low == 1 else Sums() for low in RANGES[:-1])
    return Score("photo.jpg", domain, routed, sums, ranges, **more)


def summary_of(*scores: Score, source: str = "ours", protocols: dict[str, Protocol] = PROTOCOLS, **more) -> Summary:
    return summarise(source, "rooms", scores, protocols, **more)


# ---------------------------------------------------------------------------------------------------- summaries


def test_mean_is_over_images_and_the_other_over_pixels_or_the_other_way_round() -> None:
    scores = [score_of(0.1, n_pixels=300), score_of(0.5, n_pixels=100)]
    images, pixels = (
        f([one.sums for one in scores]) for f in (lambda s: mean_metrics([x.metrics() for x in s]), pooled_metrics)
    )
    assert (images.rel, pixels.rel) == (pytest.approx(0.3), pytest.approx(0.2))
    found = summary_of(*scores)
    assert (found.metrics, found.other_mean, found.mean) == (images, pixels, "images")
    found = summary_of(*scores, protocols={"indoor": replace(INDOOR, mean="pixels")})
    assert (found.metrics, found.other_mean, found.mean) == (pixels, images, "pixels")


def test_images_without_a_known_pixel_are_counted_and_in_no_mean() -> None:
    found = summary_of(score_of(0.1), score_of(None), score_of(0.3), n_failed=2)
    assert (found.n_images, found.n_scored, found.n_failed) == (3, 2, 2)
    assert found.metrics.rel == pytest.approx(0.2)


def test_nothing_scored_has_no_numbers() -> None:
    found = summary_of(score_of(None, routed="indoor"), n_failed=1)
    assert (found.n_images, found.n_scored, found.metrics, found.other_mean) == (1, 0, None, None)
    assert (found.domains, found.ranges, found.uncertainty, found.boundary_f1) == ({}, {}, {}, None)
    assert summary_of().router is None


def test_domains_are_apart_where_there_are_several() -> None:
    rooms, streets = [score_of(0.1), score_of(0.3)], [score_of(0.5, domain="outdoor")]
    found = summary_of(*rooms, *streets)
    assert found.metrics.rel == pytest.approx(0.3)
    assert {domain: m.rel for domain, m in found.domains.items()} == {
        "indoor": pytest.approx(0.2),
        "outdoor": pytest.approx(0.5),
    }
    assert summary_of(*rooms).domains == {}


def test_domains_have_the_kind_of_mean_of_all() -> None:
    pooled = {domain: replace(protocol, mean="pixels") for domain, protocol in PROTOCOLS.items()}
    scores = [score_of(0.1, n_pixels=300), score_of(0.5, n_pixels=100), score_of(0.5, domain="outdoor")]
    assert summary_of(*scores).domains["indoor"].rel == pytest.approx(0.3)
    assert summary_of(*scores, protocols=pooled).domains["indoor"].rel == pytest.approx(0.2)


def test_router_is_the_share_of_images_with_a_choice_that_took_their_own_head() -> None:
    right, wrong = score_of(0.1, routed="indoor"), score_of(0.1, routed="outdoor")
    no_choice, not_scored = score_of(0.1), score_of(None, routed="indoor")
    assert summary_of(right, wrong, wrong, no_choice, not_scored).router == 0.5
    assert summary_of(no_choice).router is None


def test_doubts_and_edges_are_means_over_the_images_that_have_them() -> None:
    found = summary_of(
        score_of(0.1, uncertainty=UncertaintyScores(0.2, 0.6, 0.9), boundary_f1=0.25),
        score_of(0.1, uncertainty=UncertaintyScores(0.4, 0.8, 1.0), boundary_f1=0.75),
        score_of(0.1),
    )
    assert found.uncertainty == {"ause": pytest.approx(0.3), "coverage1": 0.7, "coverage2": 0.95}
    assert found.boundary_f1 == 0.5


def test_ranges_are_pooled_and_have_their_share() -> None:
    near, far = sums_of(300, 0.1), sums_of(100, 0.5)
    ranges = tuple({1: near, 40: far}.get(low, Sums()) for low in RANGES[:-1])
    both = Score("a", "indoor", None, add_sums([near, far]), ranges)
    found = summary_of(both, score_of(0.3, n_pixels=400))
    assert list(found.ranges) == ["1-2", "40-80"]
    assert [entry["share"] for entry in found.ranges.values()] == [700 / 800, 100 / 800]
    assert found.ranges["1-2"]["rel"] == pytest.approx((300 * 0.1 + 400 * 0.3) / 700)
    assert found.ranges["40-80"]["rmse"] == pytest.approx(1.0)


def test_protocols_and_alignment_are_named() -> None:
    aligned = replace(INDOOR, alignment="median")
    found = summary_of(score_of(0.1), protocols={"indoor": aligned})
    assert (found.protocols, found.alignment) == ({"indoor": aligned.label}, "median")
    assert summary_of(score_of(0.1)).protocols == {"indoor": INDOOR.label, "outdoor": OUTDOOR.label}


@pytest.mark.parametrize("change", [{"mean": "pixels"}, {"alignment": "median"}])
def test_domains_that_are_averaged_or_aligned_in_different_ways_are_an_error(change: dict[str, str]) -> None:
    with pytest.raises(InputError, match="in one way"):
        summary_of(score_of(0.1), protocols={"indoor": INDOOR, "outdoor": replace(OUTDOOR, **change)})


def test_holes_are_a_share_of_the_scored_pixels() -> None:
    assert summary_of(score_of(0.1, n_pixels=300, n_holes=30), score_of(0.2), score_of(None)).holes == 30 / 400
    assert summary_of(score_of(None)).holes == 0


def test_order_of_the_scores_does_not_matter_to_the_last_bit() -> None:
    scores = [
        score_of(
            0.1 * math.sqrt(i), n_pixels=7 * i, uncertainty=UncertaintyScores(0.1 * i, 0.3 * i, 0.7), boundary_f1=i / 7
        )
        for i in range(1, 12)
    ]
    assert summary_of(*scores) == summary_of(*scores[::-1]) == summary_of(*scores[5:], *scores[:5])


def test_summary_is_plain_values_for_json() -> None:
    found = summary_of(score_of(0.1, routed="indoor"), score_of(0.2, domain="outdoor"))
    values = json.loads(json.dumps(found.to_json()))
    assert values["metrics"] == dataclasses.asdict(found.metrics)
    assert values["protocols"] == {"indoor": INDOOR.label, "outdoor": OUTDOOR.label}
    # The key that files of the first version have.
    assert set(values) == {f.name for f in dataclasses.fields(Summary)} - {"uncertainty"} | {"calibration"}
