"""Write model cards: the ``README.md`` that the Hub shows, with metadata for the Hub in front."""

import json
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Literal

from zoedepth.config import (
    AdaBinsNetworkConfig,
    AnyModelConfig,
    BaselineConfig,
    BtsNetworkConfig,
    DornNetworkConfig,
    LocalBinsNetworkConfig,
    ModelConfig,
    NewCrfsNetworkConfig,
    PixelBinsNetworkConfig,
)
from zoedepth.metrics import HEADINGS

if TYPE_CHECKING:
    from huggingface_hub import EvalResult

# The Hub takes the licences of its list only (huggingface.co/docs/hub/repositories-licenses). These are the ones that
# weights come under. Any other licence goes under "other", which is always right.
_LICENCES = frozenset({
    "afl-3.0", "agpl-3.0", "apache-2.0", "bsd-2-clause", "bsd-3-clause", "cc0-1.0", "cc-by-3.0", "cc-by-4.0",
    "cc-by-sa-3.0", "cc-by-sa-4.0", "cc-by-nc-3.0", "cc-by-nc-4.0", "cc-by-nd-4.0", "cc-by-nc-nd-3.0",
    "cc-by-nc-nd-4.0", "cc-by-nc-sa-3.0", "cc-by-nc-sa-4.0", "creativeml-openrail-m", "gpl-2.0", "gpl-3.0", "lgpl-2.1",
    "lgpl-3.0", "mit", "mpl-2.0", "odbl", "odc-by", "openrail", "openrail++", "unknown", "unlicense",
})  # fmt: skip

_CITATION = r"""
```bibtex
@misc{bhat2023zoedepth,
  title         = {ZoeDepth: Zero-shot Transfer by Combining Relative and Metric Depth},
  author        = {Bhat, Shariq Farooq and Birkl, Reiner and Wofk, Diana and Wonka, Peter and M{\"u}ller, Matthias},
  year          = {2023},
  eprint        = {2302.12288},
  archivePrefix = {arXiv},
  primaryClass  = {cs.CV}
}
```
""".strip()


def model_card(
    config: AnyModelConfig,
    *,
    name: str,
    layout: Literal["zoedepth", "huggingface"],
    licence: str | None = None,
    trained_on: str | None = None,
    metrics: Mapping[str, Mapping[str, float]] | None = None,
) -> str:
    """Write the text of a ``README.md``: YAML for the Hub, then Markdown for people. It says what is not known.

    Args:
        config: the model's config.
        name: name that the model is loaded by, "organisation/model" on the Hub.
        layout: file format of the weights; "huggingface" is the one that transformers reads.
        licence: licence of the weights: an identifier of the Hub such as "cc-by-nc-4.0", or any text.
        trained_on: training data, with its terms.
        metrics: name of a data set → name of a metric (see ``metrics.Metrics``) → the value that was measured.
    """
    name = _one_line(name)
    front = _front_matter(name, layout, licence, metrics or {})
    sections = [
        f"# {name}",
        f"{_what(config)}, from a single RGB photo: {_who(config)} [ZoeDepth](https://arxiv.org/abs/2302.12288) "
        "(Bhat et al. 2023).",
        _architecture(config),
        f"## Use\n\n{_use(config, name, layout)}",
        f"## Measured\n\n{_table(metrics) if metrics else 'Not run.'}",
        "## Licence\n\nThree things with terms of their own:\n\n"
        "- Code (the package `zoedepth`): MIT.\n"
        f"- Weights (this model): {_phrase(licence)}.\n"
        f"- Training data: {_phrase(trained_on)}. Weights carry the terms of the data they were trained on.",
        f"## Cite\n\n{_CITATION}",
    ]
    return f"---\n{front}\n---\n\n" + "\n\n".join(sections) + "\n"


def _front_matter(name: str, layout: str, licence: str | None, metrics: Mapping[str, Mapping[str, float]]) -> str:
    """Return the YAML that the Hub reads."""
    from huggingface_hub import ModelCardData

    identifier, licence_name = _licence(licence)
    return ModelCardData(
        pipeline_tag="depth-estimation",
        library_name="transformers" if layout == "huggingface" else "zoedepth",
        tags=["depth-estimation", "metric-depth", "zoedepth"],
        model_name=name if metrics else None,
        eval_results=_results(metrics) or None,
        license=identifier,
        license_name=licence_name,
    ).to_yaml()


def _licence(licence: str | None) -> tuple[str, str | None]:
    """Return a licence as the Hub wants it: an identifier of its list, or "other" and a name."""
    if licence is None:
        return "unknown", None
    identifier = licence.strip().lower()
    return (identifier, None) if identifier in _LICENCES else ("other", _slug(licence))


def _results(metrics: Mapping[str, Mapping[str, float]]) -> "list[EvalResult]":
    from huggingface_hub import EvalResult

    results: list[EvalResult] = []
    taken: set[str] = set()
    for data, values in metrics.items():
        identifier = _slug(data)
        while identifier in taken:  # the Hub would join two data sets with one identifier
            identifier += "-2"
        taken.add(identifier)
        results += [
            EvalResult(
                task_type="depth-estimation",
                task_name="Monocular depth estimation",
                dataset_type=identifier,
                dataset_name=_one_line(data),
                metric_type=metric,
                metric_name=heading,
                metric_value=float(values[metric]),
            )
            for metric, heading in HEADINGS.items()
            if metric in values
        ]
    return results


def _what(config: AnyModelConfig) -> str:
    if config.domains:
        return "Depth in metres, along the optical axis"
    return "Relative depth, inverse and up to an unknown scale and shift"


_BASELINES = {
    BtsNetworkConfig: "BTS (Lee et al. 2019)",
    AdaBinsNetworkConfig: "AdaBins (Bhat et al. 2021)",
    LocalBinsNetworkConfig: "LocalBins (Bhat et al. 2022)",
    PixelBinsNetworkConfig: "PixelBins (Sarwari et al. 2021)",
    NewCrfsNetworkConfig: "NeWCRFs (Yuan et al. 2022)",
    DornNetworkConfig: "DORN (Fu et al. 2018)",
}


def _who(config: AnyModelConfig) -> str:
    if isinstance(config, BaselineConfig):
        return f"{_BASELINES[type(config.network)]}, a baseline of"
    return "a model of"


def _architecture(config: AnyModelConfig) -> str:
    height, width = config.size
    size = "photos are resized near it, their aspect ratio kept"
    if not config.keep_aspect_ratio:
        size = "the only one it takes" if config.one_size else "photos are squeezed to it"
    lines = [
        f"- Encoder: `{config.encoder_name}` (timm).",
        f"- Input: RGB, trained at {height} x {width} pixels (height x width): {size}.",
    ]
    if not config.domains:
        return "\n".join([*lines, "- Heads: none. Metric heads can be trained on it: `zoedepth train ... --init`."])
    lines += [
        f"- Heads: {len(config.domains)}, {_routing(config)}.",
        f"- Camera: {_camera(config)}.",
        "",
        "| domain | nearest depth | farthest depth |",
        "|---|---|---|",
        *(f"| {_cell(domain.name)} | {domain.min_depth:g} m | {domain.max_depth:g} m |" for domain in config.domains),
    ]
    return "\n".join(lines)


def _camera(config: AnyModelConfig) -> str:
    if config.canonical_camera:
        return "metres fit any lens whose focal length is known (one canonical camera)"
    known = [f"{domain.focal_px:g} for {_one_line(domain.name)}" for domain in config.domains if domain.focal_px]
    lens = f", whose focal lengths were, in pixels of the network's input: {', '.join(known)}" if known else ""
    return f"metres hold for lenses like those of the training photos{lens}"


def _routing(config: AnyModelConfig) -> str:
    if len(config.domains) == 1:
        return "for every photo"
    if _is_labeled(config):
        return "one for each domain, which the caller names"
    return "one for each domain, which the model chooses for every photo"


def _is_labeled(config: AnyModelConfig) -> bool:
    return isinstance(config, ModelConfig) and config.router.kind == "labeled"


def _use(config: AnyModelConfig, name: str, layout: str) -> str:
    domain = ""
    if len(config.domains) > 1 and _is_labeled(config):
        domain = f", domain={_quoted(config.domains[0].name)}"
    if not config.domains:
        return _python(
            "from zoedepth import Predictor, load_model",
            f"predictor = Predictor(load_model({_quoted(name)}))",
            'relative = predictor.relative("photo.jpg")  # float32 (height, width), near is large',
        )
    ours = _python(
        "from zoedepth import Predictor, load_model",
        f"predictor = Predictor(load_model({_quoted(name)}))",
        f'depth = predictor("photo.jpg"{domain}).depth  # metres, float32 (height, width)',
    )
    if layout == "zoedepth":
        return ours
    theirs = _python(
        "from transformers import pipeline",
        f'estimate = pipeline("depth-estimation", model={_quoted(name)})',
        'depth = estimate("photo.jpg")["predicted_depth"]  # metres, (height, width)',
    )
    note = (
        "\n\nGive transformers one photo at a time: it chooses the head of a whole batch by one vote, so that a street "
        "in a batch of rooms comes out as a room. `zoedepth` chooses for every photo."
    )
    return f"{ours}\n\nOr with transformers:\n\n{theirs}{note if len(config.domains) > 1 else ''}"


def _python(*lines: str) -> str:
    return "\n".join(("```python", *lines, "```"))


def _quoted(text: str) -> str:
    """Return a Python string in double quotes, as in the lines around it."""
    return json.dumps(text, ensure_ascii=False)


def _table(metrics: Mapping[str, Mapping[str, float]]) -> str:
    names = [name for name in HEADINGS if any(name in values for values in metrics.values())]
    rows = [["data", *(HEADINGS[name] for name in names)], ["---"] * (len(names) + 1)]
    for data, values in metrics.items():
        rows.append([_cell(data), *(f"{values[name]:.3f}" if name in values else "not run" for name in names)])
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _one_line(text: str) -> str:
    """Join lines, so that the text cannot end the paragraph, heading or list item that it is in."""
    return " ".join(text.split())


def _phrase(text: str | None) -> str:
    return _one_line(text or "").rstrip(".") or "not stated"


def _cell(text: str) -> str:
    return _one_line(text).replace("|", "\\|")


def _slug(text: str) -> str:
    """Reduce a text to small letters, digits, dots and dashes, as the Hub wants identifiers."""
    return re.sub(r"[^a-z0-9.]+", "-", text.lower()).strip("-.") or "unknown"
