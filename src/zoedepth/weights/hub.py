"""Download models from the Hugging Face Hub, find them in its cache, and upload them.

``huggingface_hub`` keeps the cache (``HF_HOME``), the token (``HF_TOKEN``) and the offline switch
(``HF_HUB_OFFLINE``). It is imported when used. Only safetensors, JSON and model cards are ever downloaded: no pickles,
no code.
"""

import os
from pathlib import Path

from zoedepth.download import cache_home
from zoedepth.errors import InputError, first_line
from zoedepth.stored import read_json

CONFIG = "config.json"
WEIGHTS = "model.safetensors"
PREPROCESSOR = "preprocessor_config.json"
"""File with the size of photos. Folders of transformers have it; in ours the size is in the config."""
CARD = "README.md"
"""The model card, which says under which licence the weights come."""

_FILE_SUFFIXES = (".safetensors", ".pt", ".pth", ".ckpt", ".bin", ".json", ".onnx", ".xml", ".pt2")
_LOG_IN = "set HF_TOKEN to your token, or run `hf auth login`"


def give_a_home() -> None:
    """Tell ``huggingface_hub`` where to keep its cache if the user has no home; it would make a folder named "~"."""
    usual = os.path.expanduser(os.path.join("~", ".cache"))
    if not {"HF_HOME", "HF_HUB_CACHE", "XDG_CACHE_HOME"} & set(os.environ) and str(cache_home()) != usual:
        os.environ["HF_HOME"] = str(cache_home() / "huggingface")


give_a_home()  # here, because huggingface_hub reads the environment once, when it is first imported


def is_hub_id(name: str) -> bool:
    """Return True if a name has the form of a model on the Hub, "organisation/model". Nothing is looked up.

    A relative path of two parts has the same form, so look for files first. A name with the suffix of a weights file
    counts as a path, so that a mistyped one is not searched for on the Hub.
    """
    # Versions of the hub's library before 2 take any letters, and a line's end.
    if name.count("/") != 1 or not name.isascii() or name.endswith("\n") or name.lower().endswith(_FILE_SUFFIXES):
        return False
    from huggingface_hub.utils import HFValidationError, validate_repo_id

    try:
        validate_repo_id(name)
    except HFValidationError:
        return False
    return True


def fetch(repo_id: str, *, revision: str | None = None) -> Path:
    """Return a local folder with ``config.json`` and ``model.safetensors`` of a model on the Hub.

    If the model has a ``preprocessor_config.json`` or a ``README.md``, these are there too. Files in the cache are not
    downloaded again, and are used as they are when the network cannot be reached or ``HF_HUB_OFFLINE`` is set. A model
    of transformers must have its ``preprocessor_config.json`` there then: without it, the size of photos is not known.

    Args:
        repo_id: "organisation/model".
        revision: branch, tag or commit; None is the main branch.

    Returns:
        A folder in the cache. It belongs to ``huggingface_hub``: read it and change nothing in it.

    Raises:
        InputError: there is no such model or revision, it is gated, it has no safetensors or no config, or it is not
            in the cache and the network cannot be used. The message says what to do.
    """
    _require_hub_id(repo_id)
    from huggingface_hub import hf_hub_download, try_to_load_from_cache
    from huggingface_hub.errors import EntryNotFoundError, LocalEntryNotFoundError

    folder, wanted = Path(), revision
    for name in (CONFIG, WEIGHTS, PREPROCESSOR, CARD):
        optional = name in (PREPROCESSOR, CARD)
        if optional and try_to_load_from_cache(repo_id, name, revision=wanted) is not None:
            continue  # it is here, or it is known not to exist
        try:
            folder = Path(hf_hub_download(repo_id, name, revision=wanted)).parent
        except EntryNotFoundError as error:
            # A local one is no word of the Hub's: the network failed, and the model may have the file.
            unknown = isinstance(error, LocalEntryNotFoundError) and name == PREPROCESSOR and _has_processor(folder)
            if unknown or not optional:
                raise _fetch_error(error, repo_id, name, revision) from error
        except Exception as error:  # from the Hub, the HTTP client, the operating system or a faster client
            raise _fetch_error(error, repo_id, name, revision) from error
        # The folder is named after the commit. All files come from it, even if somebody pushes in the meantime.
        wanted = folder.name
    return folder


def _has_processor(folder: Path) -> bool:
    """Return True if a folder's config is one of transformers, whose size of photos is in another file."""
    return read_json(folder / CONFIG).get("model_type") == "zoedepth"


def cached(repo_id: str) -> bool:
    """Return True if config and weights of a model's main branch are in the local cache. Needs no network."""
    if not is_hub_id(repo_id):
        return False
    from huggingface_hub import try_to_load_from_cache

    return all(isinstance(try_to_load_from_cache(repo_id, name), str) for name in (CONFIG, WEIGHTS))


def push_folder(folder: Path, repo_id: str, *, private: bool = False, message: str = "Upload a ZoeDepth model") -> str:
    """Upload the files of a folder to the Hub in one commit. The model is created there if it does not exist.

    Args:
        folder: folder to upload, subfolders included.
        repo_id: "organisation/model".
        private: True makes a model that only you and your organisation see. False leaves it to the settings of the
            organisation, which are usually public. A model that exists stays as it is.
        message: commit message.

    Returns:
        The address of the model.

    Raises:
        InputError: the folder is missing or empty, you may not write there, the model exists and is public but
            ``private`` is asked for, the Hub refuses the model card, or the network cannot be used.
    """
    _require_hub_id(repo_id)
    if not folder.is_dir() or not any(folder.iterdir()):
        raise InputError(f"{folder} is not a folder with files: save the model there first")
    from huggingface_hub import HfApi

    api = HfApi()
    try:
        url = api.create_repo(repo_id, private=private or None, exist_ok=True)
        # The Hub ignores ``private`` for an existing model: files that should be private would become public.
        if private and not api.model_info(repo_id).private:
            raise InputError(
                f"{repo_id} exists and is public: make it private on {url}/settings, or push without private"
            )
        api.upload_folder(repo_id=repo_id, folder_path=folder, commit_message=message)
    except InputError:
        raise
    except Exception as error:  # see ``fetch``
        raise InputError(f"cannot push {folder} to {repo_id}: {_push_reason(error)}") from error
    return str(url)


def _require_hub_id(repo_id: str) -> None:
    if not is_hub_id(repo_id):
        raise InputError(f"{repo_id!r} is not the name of a model on the Hub: give organisation/model")


def _fetch_error(error: Exception, repo_id: str, name: str, revision: str | None) -> InputError:
    from huggingface_hub import constants
    from huggingface_hub.errors import (
        EntryNotFoundError,
        GatedRepoError,
        LocalEntryNotFoundError,
        RepositoryNotFoundError,
        RevisionNotFoundError,
    )

    page = f"{constants.ENDPOINT}/{repo_id}"
    if isinstance(error, LocalEntryNotFoundError):
        if constants.HF_HUB_OFFLINE:
            return InputError(
                f"{name} of {repo_id} is not in the cache {constants.HF_HUB_CACHE}, and HF_HUB_OFFLINE forbids "
                "downloading: unset it, or give a folder or file of weights"
            )
        error = error.__cause__ if isinstance(error.__cause__, Exception) else error  # what happened to the request
    if isinstance(error, GatedRepoError):
        return InputError(f"{repo_id} is gated: ask for access on {page}, then {_LOG_IN}")
    if isinstance(error, RepositoryNotFoundError):
        return InputError(
            f"the Hub has no model {repo_id}, or it is private: check the name; if it is private, {_LOG_IN}"
        )
    if isinstance(error, RevisionNotFoundError):
        return InputError(f"{repo_id} has no revision {revision!r}: see the branches and tags on {page}")
    if isinstance(error, EntryNotFoundError):
        hint = (
            "it is not a model of zoedepth or transformers"
            if name == CONFIG
            else "only safetensors are loaded from the Hub, because pickles such as pytorch_model.bin can run code. "
            "Ask the owner to convert it, or give a file of weights that you trust"
        )
        return InputError(f"{repo_id} has no {name}: {hint} (its files: {page}/tree/{revision or 'main'})")
    if _status(error) in (401, 403):
        return InputError(f"the Hub does not let you read {repo_id}: {_LOG_IN} ({first_line(error)})")
    return InputError(
        f"cannot get {name} of {repo_id} from {constants.ENDPOINT}, and it is not in the cache: {first_line(error)}. "
        "Check the connection and the disk, and type the command again; or give a folder or file of weights"
    )


def _push_reason(error: Exception) -> str:
    if _status(error) == 401:
        return f"you are not logged in; {_LOG_IN}"
    if _status(error) in (403, 404):
        return f"your token may not write there; check the name, and {_LOG_IN} with write access"
    return f"{first_line(error)}. Check the connection, and type the command again"


def _status(error: Exception) -> int | None:
    return getattr(getattr(error, "response", None), "status_code", None)
