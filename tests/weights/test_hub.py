import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.servers import FakeHub

from zoedepth.weights.hub import give_a_home, is_hub_id

CONFIG, WEIGHTS = b'{"domains": []}', bytes(range(256)) * 1000
MODEL = {"config.json": CONFIG, "model.safetensors": WEIGHTS}

# huggingface_hub reads its environment when it is imported, so every client is a process.
CLIENT = """
import json, os, sys, time
from pathlib import Path
from zoedepth.errors import InputError
from zoedepth.weights.hub import cached, fetch, push_folder

time.sleep = lambda seconds: None  # huggingface_hub waits longer and longer between its attempts
results = []
for expression in sys.argv[1:]:
    try:
        results.append(str(eval(expression)))
    except InputError as error:
        results.append(f"InputError: {error}")
print(json.dumps(results))
"""


def run(environment: dict[str, str], *expressions: str) -> list[str]:
    """What each expression gives in a fresh process: its value, or its InputError."""
    command = [sys.executable, "-c", CLIENT, *expressions]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.fixture
def hub() -> Iterator[FakeHub]:
    repos = {
        "lab/model": MODEL,
        "lab/gated": MODEL,
        "lab/secret": MODEL,
        "lab/pickle": {"config.json": CONFIG, "pytorch_model.bin": b"danger", "modeling.py": b"danger"},
        "lab/original": {"ZoeD_M12_N.pt": b"danger"},
    }
    with FakeHub(repos, gated=["lab/gated"], private=["lab/secret"]) as hub:
        yield hub


@pytest.fixture
def home(tmp_path: Path) -> Path:
    return tmp_path / "home"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "to push"
    folder.mkdir()
    for name, content in (MODEL | {"README.md": b"---\nlicense: mit\n---\n# Model\n"}).items():
        (folder / name).write_bytes(content)
    return folder


def push(folder: Path, name: str, more: str = "") -> str:
    return f"push_folder(Path({str(folder)!r}), {name!r}{more})"


def check(folder: str, expected: dict[str, bytes] = MODEL) -> None:
    files = {file.name: file.read_bytes() for file in Path(folder).iterdir()}
    assert files == expected


# --- names ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["org/name", "Org-1/zoed_lite.v2", "a/b"])
def test_hub_ids(name: str):
    assert is_hub_id(name)


BROKEN = [
    "", "zoed-lite", "a/b/c", "/a", "a/", "./a", "../a", "~/a", "/", "a\\b", "a\\b/c", "a b/c", "a/b\n", "a/b--c",
    "a/b..c", "a/b.git", "-a/b", "a/.b", "ä/b", "a/" + "b" * 97, "https://host", "runs/model.safetensors", "runs/x.PT",
]  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_paths_and_broken_names_are_no_hub_ids(name: str):
    assert not is_hub_id(name)


def test_cache_of_the_hub_without_a_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """As in a container with a user that has no name: expanduser leaves the "~" as it is."""
    for name in ("HF_HOME", "HF_HUB_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, "")  # or monkeypatch would not take away what is set below
        monkeypatch.delenv(name)
    monkeypatch.setattr("os.path.expanduser", lambda path: path)
    give_a_home()
    assert Path(os.environ["HF_HOME"]).is_absolute()
    monkeypatch.setenv("HF_HOME", "mine")
    give_a_home()
    assert os.environ["HF_HOME"] == "mine"


# --- fetch ------------------------------------------------------------------------------------------------------------


def test_model_is_downloaded_once_and_then_works_without_network(hub: FakeHub, home: Path):
    online = hub.environment(home)
    before, folder, again, after = run(
        online, "cached('lab/model')", "fetch('lab/model')", "fetch('lab/model')", "cached('lab/model')"
    )
    assert (before, after) == ("False", "True")
    assert again == folder
    check(folder)
    assert len([request for request in hub.requests if request.startswith("GET") and "/resolve/" in request]) == 2
    hub.close()
    assert run(online, "fetch('lab/model')") == [folder]
    assert run(hub.environment(home, offline=True), "fetch('lab/model')", "cached('lab/model')") == [folder, "True"]


def test_only_weights_configs_and_card_are_downloaded_and_of_one_commit(hub: FakeHub, home: Path):
    """Weights are asked for by the commit of the config, so that a push in between cannot mix two models."""
    hub.repos["lab/model"] |= {"pytorch_model.bin": b"danger", "modeling.py": b"danger", "README.md": b"# Model"}
    hub.repos["lab/model"]["preprocessor_config.json"] = b"{}"
    (folder,) = run(hub.environment(home), "fetch('lab/model')")
    files = {file.name: file.read_bytes() for file in Path(folder).iterdir()}
    assert files == MODEL | {"preprocessor_config.json": b"{}", "README.md": b"# Model"}
    asked = [request.split("/")[-2:] for request in hub.requests if "/resolve/" in request]
    assert {file for _, file in asked} == {*MODEL, "preprocessor_config.json", "README.md"}
    assert {revision for revision, file in asked if file == "model.safetensors"} == {hub.commit("lab/model")}


def test_newer_model_is_noticed_and_the_older_one_can_be_had(hub: FakeHub, home: Path, folder: Path):
    commit = hub.commit("lab/model")
    (folder / "model.safetensors").write_bytes(b"newer")
    old, _, new, same = run(
        hub.environment(home, token=hub.token),
        "fetch('lab/model')",
        push(folder, "lab/model"),
        "fetch('lab/model')",
        f"fetch('lab/model', revision={commit!r})",
    )
    assert (Path(new) / "model.safetensors").read_bytes() == b"newer"
    assert same == old
    check(old)


def test_gated_and_private_models_are_fetched_with_a_token(hub: FakeHub, home: Path):
    refused, _, gated, secret = run(
        hub.environment(home, token="hf_other"),
        "fetch('lab/gated')",
        f"os.environ.update(HF_TOKEN={hub.token!r})",
        "fetch('lab/gated')",
        "fetch('lab/secret')",
    )
    assert refused.startswith("InputError: lab/gated is gated")
    check(gated)
    check(secret)


def test_what_is_wrong_with_a_model_is_said(hub: FakeHub, home: Path):
    unknown, secret, gated, pickle, original, revision, name = run(
        hub.environment(home),
        "fetch('lab/unknown')",
        "fetch('lab/secret')",
        "fetch('lab/gated')",
        "fetch('lab/pickle')",
        "fetch('lab/original')",
        "fetch('lab/model', revision='v9')",
        "fetch('lab')",
    )
    assert unknown.startswith("InputError: the Hub has no model lab/unknown, or it is private")
    assert secret.startswith("InputError: the Hub has no model lab/secret, or it is private")
    assert gated.startswith(f"InputError: lab/gated is gated: ask for access on {hub.url}/lab/gated")
    for message in (unknown, secret, gated):
        assert "HF_TOKEN" in message
        assert "hf auth login" in message
    assert pickle.startswith(
        "InputError: lab/pickle has no model.safetensors: only safetensors are loaded from the Hub"
    )
    assert original.startswith("InputError: lab/original has no config.json")
    assert revision.startswith("InputError: lab/model has no revision 'v9'")
    assert name.startswith("InputError: 'lab' is not the name of a model on the Hub")
    assert not any("GET" in request and request.endswith((".bin", ".py", ".pt")) for request in hub.requests)


def test_offline_without_the_model(hub: FakeHub, home: Path):
    (message,) = run(hub.environment(home, offline=True), "fetch('lab/model')")
    assert message.startswith(f"InputError: config.json of lab/model is not in the cache {home / 'hub'}")
    assert "HF_HUB_OFFLINE" in message
    assert hub.requests == []


def test_size_of_photos_is_not_guessed_without_the_network(hub: FakeHub, home: Path):
    """Of a model of transformers whose weights are here: the file with the size may be at the Hub. Cards may lack."""
    hub.repos["lab/model"] |= {"config.json": b'{"model_type": "zoedepth"}', "preprocessor_config.json": b"{}"}
    files = [
        f"__import__('huggingface_hub').hf_hub_download({name!r}, {file!r})"
        for name in ("lab/model", "lab/gated")
        for file in MODEL
    ]
    run(hub.environment(home, token=hub.token), *files)
    theirs, ours = run(hub.environment(home, offline=True), "fetch('lab/model')", "fetch('lab/gated')")
    assert theirs.startswith("InputError: preprocessor_config.json of lab/model is not in the cache")
    check(ours)
    (fetched,) = run(hub.environment(home), "fetch('lab/model')")
    assert (Path(fetched) / "preprocessor_config.json").is_file()
    hub.close()
    assert run(hub.environment(home), "fetch('lab/model')") == [fetched]


def test_no_network_and_no_model(hub: FakeHub, home: Path):
    hub.close()
    (message,) = run(hub.environment(home), "fetch('lab/model')")
    assert message.startswith(f"InputError: cannot get config.json of lab/model from {hub.url}")
    assert "Check the connection" in message


# --- push -------------------------------------------------------------------------------------------------------------


def test_pushed_model_is_what_was_in_the_folder(hub: FakeHub, home: Path, folder: Path):
    """With the uploader that is used where hf_xet is installed; the other tests use the plain one."""
    environment = hub.environment(home, token=hub.token) | {"HF_HUB_DISABLE_XET": "0"}
    new, existing, fetched = run(
        environment, push(folder, "lab/new", ", message='First'"), push(folder, "lab/pickle"), "fetch('lab/new')"
    )
    pushed = {file.name: file.read_bytes() for file in folder.iterdir()}
    assert (new, existing) == (f"{hub.url}/lab/new", f"{hub.url}/lab/pickle")
    assert hub.repos["lab/new"] == pushed
    assert hub.repos["lab/pickle"] == pushed | {"pytorch_model.bin": b"danger", "modeling.py": b"danger"}
    assert hub.commits == [("lab/new", "First"), ("lab/pickle", "Upload a ZoeDepth model")]
    assert "lab/new" not in hub.private
    check(fetched, MODEL | {"README.md": pushed["README.md"]})


def test_private_model_is_private_or_refused(hub: FakeHub, home: Path, folder: Path):
    made, existing, public = run(
        hub.environment(home, token=hub.token),
        push(folder, "lab/new", ", private=True"),
        push(folder, "lab/secret", ", private=True"),
        push(folder, "lab/model", ", private=True"),
    )
    assert (made, existing) == (f"{hub.url}/lab/new", f"{hub.url}/lab/secret")
    assert "lab/new" in hub.private
    assert public.startswith("InputError: lab/model exists and is public")
    assert [name for name, _ in hub.commits] == ["lab/new", "lab/secret"]


def test_what_is_wrong_with_a_push_is_said(hub: FakeHub, home: Path, folder: Path, tmp_path: Path):
    (tmp_path / "empty").mkdir()
    anonymous, _, foreign, missing, empty, name = run(
        hub.environment(home),
        push(folder, "lab/new"),
        "os.environ.update(HF_TOKEN='hf_other')",
        push(folder, "lab/model"),
        push(tmp_path / "nothing", "lab/new"),
        push(tmp_path / "empty", "lab/new"),
        push(folder, "new"),
    )
    assert anonymous.startswith(f"InputError: cannot push {folder} to lab/new: you are not logged in; set HF_TOKEN")
    assert missing.startswith(f"InputError: {tmp_path / 'nothing'} is not a folder with files")
    assert empty.startswith(f"InputError: {tmp_path / 'empty'} is not a folder with files")
    assert name.startswith("InputError: 'new' is not the name of a model on the Hub")
    assert "your token may not write there" in foreign
    hub.close()
    (down,) = run(hub.environment(home, token=hub.token), push(folder, "lab/new"))
    assert "refused" in down
    assert "Check the connection" in down
    assert hub.commits == []
