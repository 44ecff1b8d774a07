"""``zoedepth models``: list the models that have a name."""

import json
from dataclasses import asdict
from typing import Annotated

import tyro


def models(*, json_: Annotated[bool, tyro.conf.arg(name="json")] = False) -> int:
    """List the models that have a name: their purpose, size and licence, and whether they are on this machine.

    Files of weights and Hugging Face ids can be loaded too; they are not listed here.

    Args:
        json_: print one JSON object for each model and nothing else.
    """
    from zoedepth.weights.hub import cached
    from zoedepth.weights.load import is_here
    from zoedepth.weights.releases import RELEASES, download_folder

    for name, release in RELEASES.items():
        in_hub_cache = release.hub_id is not None and cached(release.hub_id)
        if json_:
            record = {"name": name, **asdict(release), "path": str(release.path)}
            print(json.dumps({**record, "present": release.present, "hub_present": in_hub_cache}))
            continue
        here = "here" if is_here(release) else "not here"
        print(f"{name:<20} {here:<9} {release.size:<8} weights: {release.licence}")
        print(f"    {release.what}")
        if release.url:
            print(f"    {release.url}")
        if release.hub_id:
            print(f"    or {release.hub_id} at Hugging Face")
    if not json_:
        print("\nUse one: zoedepth predict --model NAME; in Python: load_model('NAME').")
        print("One that is not here is downloaded once, or put its file there by hand:")
        print(f"    {download_folder()}")
    return 0
