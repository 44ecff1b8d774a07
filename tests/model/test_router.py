import math
from dataclasses import replace

import pytest
import torch

from zoedepth.config import RouterConfig
from zoedepth.errors import InputError
from zoedepth.model.router import build_router, positional_code

CLASSIFIERS = pytest.mark.parametrize("classifier", ["mlp", "transformer"])
LEARNED = pytest.mark.parametrize("kind", ["trained", "auto"])


def router(kind: str, *, classifier: str = "mlp", n_domains: int = 3) -> torch.nn.Module:
    torch.manual_seed(0)
    return build_router(RouterConfig(kind, classifier=classifier, width=16), 6, n_domains).eval()


def bottleneck(batch: int = 4, size: tuple[int, int] = (2, 3)) -> torch.Tensor:
    return 3 * torch.randn(batch, 6, *size, generator=torch.Generator().manual_seed(1))


def test_labeled_router_gives_the_given_domain():
    given = torch.tensor([2, 0, 1, 2])
    routing = router("labeled")(bottleneck(), given)
    assert torch.equal(routing.domain, given)
    assert routing.logits is None
    assert routing.weight is None


@pytest.mark.parametrize("n_domains", [2, 3])
def test_labeled_router_without_labels_is_an_error(n_domains: int):
    with pytest.raises(InputError, match="domain"):
        router("labeled", n_domains=n_domains)(bottleneck(), None)


@pytest.mark.parametrize("kind", ["labeled", "trained", "auto"])
def test_one_domain_needs_neither_labels_nor_a_classifier(kind: str):
    single = router(kind, n_domains=1)
    assert list(single.parameters()) == []
    routing = single(bottleneck(), None)
    assert routing.domain.tolist() == [0] * 4
    assert routing.domain.dtype == torch.long
    assert routing.logits is None


@CLASSIFIERS
@LEARNED
def test_each_image_takes_its_own_best_score_in_evaluation(kind: str, classifier: str):
    routing = router(kind, classifier=classifier)(bottleneck(12), None)
    assert routing.logits.shape == (12, 3)
    assert len(set(routing.domain.tolist())) > 1
    for scores, domain in zip(routing.logits.tolist(), routing.domain.tolist(), strict=True):
        assert scores[domain] == max(scores)
    assert routing.weight is None


@CLASSIFIERS
def test_scores_of_an_image_do_not_depend_on_the_batch(classifier: str):
    network, x = router("trained", classifier=classifier), bottleneck()
    together = network(x, None).logits
    for i in range(4):
        assert torch.allclose(network(x[i : i + 1], None).logits[0], together[i], atol=1e-5)


@CLASSIFIERS
@LEARNED
@pytest.mark.parametrize("training", [True, False])
def test_given_domains_override_the_classifier(kind: str, classifier: str, training: bool):
    network = router(kind, classifier=classifier).train(training)
    given = torch.tensor([1, 1, 0, 2])
    routing = network(bottleneck(), given)
    assert torch.equal(routing.domain, given)
    assert routing.weight is None
    assert routing.logits.shape == (4, 3), "still scored, for the loss on the labels"


def test_auto_router_mixes_by_its_probabilities_while_training():
    routing = router("auto").train()(bottleneck(), None)
    for scores, weights in zip(routing.logits.tolist(), routing.weight.tolist(), strict=True):
        total = sum(math.exp(score) for score in scores)
        assert weights == pytest.approx([math.exp(score) / total for score in scores], abs=1e-6)


def test_rows_of_a_routing_are_rows_of_all_it_holds():
    routing = router("auto").train()(bottleneck(), None)
    rows = torch.tensor([3, 1])
    for found, whole in zip(routing.rows(rows), routing, strict=True):
        assert torch.equal(found, whole[[3, 1]])
    labeled = router("labeled")(bottleneck(), torch.tensor([2, 0, 1, 2])).rows(rows)
    assert labeled.domain.tolist() == [2, 0]
    assert labeled.logits is None


def test_trained_router_is_hard_while_training():
    assert router("trained").train()(bottleneck(), None).weight is None


@CLASSIFIERS
@pytest.mark.parametrize("size", [(1, 1), (2, 3), (12, 16)])
def test_bottleneck_of_any_size(classifier: str, size: tuple[int, int]):
    logits = router("trained", classifier=classifier)(bottleneck(2, size), None).logits
    assert logits.shape == (2, 3)
    assert logits.isfinite().all()


@CLASSIFIERS
@pytest.mark.parametrize("n_domains", [1, 3])
def test_everything_a_router_makes_is_on_the_device_of_its_input(classifier: str, n_domains: int):
    """The device that has shapes but no numbers refuses to meet the CPU, as a GPU does."""
    network = router("trained", classifier=classifier, n_domains=n_domains).to("meta")
    assert network(bottleneck().to("meta"), None).domain.is_meta


@CLASSIFIERS
def test_every_weight_of_the_classifier_gets_a_gradient(classifier: str):
    network = router("trained", classifier=classifier)
    network(bottleneck(8), None).logits.square().sum().backward()
    assert [name for name, p in network.named_parameters() if p.grad is None or not p.grad.any()] == []


def test_scores_are_float32_under_autocast():
    with torch.autocast("cpu", dtype=torch.bfloat16):
        logits = router("trained")(bottleneck(), None).logits
    assert logits.dtype == torch.float32


def test_vote_of_the_released_code_sums_the_scores_of_the_batch():
    """One image that is very sure outvotes three that are not (``zoedepth_nk_v1.py``)."""
    voting = build_router(RouterConfig("trained", vote="batch", width=16), 6, 2).eval()
    scores = torch.tensor([[0.0, 5.0], [1.0, 0.0], [1.0, 0.0], [1.0, 0.0]])
    del voting.classifier
    voting.classifier = lambda _: scores
    assert voting(bottleneck(), None).domain.tolist() == [1, 1, 1, 1]
    assert torch.equal(voting(bottleneck(), None).logits, scores)
    own = build_router(RouterConfig("trained", width=16), 6, 2).eval()
    del own.classifier
    own.classifier = lambda _: scores
    assert own(bottleneck(), None).domain.tolist() == [1, 0, 0, 0]
    given = torch.tensor([0, 1, 0, 1])
    assert torch.equal(voting(bottleneck(), given).domain, given)


@pytest.mark.parametrize("kind", ["labeled", "auto"])
def test_only_a_trained_router_votes(kind: str):
    with pytest.raises(InputError, match="vote"):
        RouterConfig(kind, vote="batch")


def test_mlp_sees_the_mean_of_the_bottleneck():
    network, x = router("trained"), bottleneck()
    flat = x.mean(dim=(2, 3), keepdim=True).expand_as(x)
    assert torch.allclose(network(x, None).logits, network(flat, None).logits, atol=1e-5)


def test_mlp_has_one_hidden_layer_with_a_relu():
    network, x = router("trained"), bottleneck()
    first, last = (layer for layer in network.classifier.mlp if isinstance(layer, torch.nn.Linear))
    hidden = (x.mean(dim=(2, 3)) @ first.weight.T + first.bias).clamp(min=0)
    torch.testing.assert_close(network(x, None).logits, hidden @ last.weight.T + last.bias, rtol=1e-4, atol=1e-5)


def test_transformer_sees_where_things_are():
    network, x = router("trained", classifier="transformer"), bottleneck()
    assert not torch.allclose(network(x, None).logits, network(x.flip(3), None).logits, atol=1e-4)


def test_transformer_scores_its_class_token():
    """Zeros before the pixels, a code of each one's place, the layers, then an MLP on what became of the zeros."""
    network, x = router("trained", classifier="transformer"), bottleneck()
    classifier = network.classifier
    pixels = torch.einsum("bchw,dc->bhwd", x, classifier.project.weight[:, :, 0, 0]) + classifier.project.bias
    tokens = torch.cat([torch.zeros(len(x), 1, 16), pixels.flatten(1, 2)], dim=1) + positional_code(7, 16)
    for layer in classifier.transformer.layers:
        tokens = layer(tokens)
    first, _, last = classifier.mlp
    hidden = (tokens[:, 0] @ first.weight.T + first.bias).clamp(min=0)
    expected = hidden @ last.weight.T + last.bias
    torch.testing.assert_close(network(x, None).logits, expected, rtol=1e-4, atol=1e-5)


def test_transformer_has_the_released_size():
    """Four post-norm layers of width 128, feed-forward 1024, on a bottleneck of 256: 1,369,090 weights."""
    config = replace(RouterConfig(), classifier="transformer", width=128)
    layer = (3 * 128 * 128 + 3 * 128) + (128 * 128 + 128) + (128 * 1024 + 1024) + (1024 * 128 + 128) + 4 * 128
    total = (256 * 128 + 128) + 4 * layer + (128 * 128 + 128) + (128 * 2 + 2)
    with torch.device("meta"):
        network = build_router(config, 256, 2)
    assert sum(p.numel() for p in network.parameters()) == total == 1_369_090


@pytest.mark.parametrize(("length", "width"), [(1, 4), (7, 8), (193, 128)])
def test_positional_code_is_sines_then_cosines(length: int, width: int):
    code = positional_code(length, width)
    assert code.shape == (length, width)
    for position in {0, length // 2, length - 1}:
        for i in range(width // 2):
            angle = position * math.exp(-math.log(10000) * 2 * i / width)
            assert code[position, i].item() == pytest.approx(math.sin(angle), abs=1e-4)
            assert code[position, width // 2 + i].item() == pytest.approx(math.cos(angle), abs=1e-4)
