"""Models on the Hugging Face Hub: the files of a model, from there, from the cache, and back.

``huggingface_hub`` keeps the cache (``HF_HOME``), the token (``HF_TOKEN``) and the offline switch
(``HF_HUB_OFFLINE``); it is imported when used. Only weights in safetensors and JSON are ever downloaded: no pickles,
and no code.
"""

from pathlib import Path

from zoedepth.errors import InputError

CONFIG = "config.json"
WEIGHTS = "model.safetensors"
PREPROCESSOR = "preprocessor_config.json"
"""How large photos are made; folders of transformers have it, ours have the size in their config."""

_FILE_SUFFIXES = (".safetensors", ".pt", ".pth", ".ckpt", ".bin", ".json", ".onnx")
_LOG_IN = "set HF_TOKEN to a token of yours, or run `hf auth login`"


def is_hub_id(name: str) -> bool:
    """Whether a name has the form of a model on the Hub, "organisation/model". Nothing is looked up.

    A relative path of two parts has that form too, so look for files first. Names with the suffix of a file of weights
    are taken for paths: a mistyped one should not be searched for on the Hub.
    """
    if name.count("/") != 1 or name.lower().endswith(_FILE_SUFFIXES):
        return False
    from huggingface_hub.utils import HFValidationError, validate_repo_id

    try:
        validate_repo_id(name)
    except HFValidationError:
        return False
    return True


def fetch(repo_id: str, *, revision: str | None = None) -> Path:
    """The local folder with ``config.json`` and ``model.safetensors`` of a model on the Hub.

    ``preprocessor_config.json`` comes along where there is one.

    What is in the cache is not downloaded again, and is used as it is when the network cannot be reached or
    ``HF_HUB_OFFLINE`` is set.

    Args:
        repo_id: "organisation/model".
        revision: branch, tag or commit; None is the main branch.

    Returns:
        A folder in the cache, which belongs to ``huggingface_hub``: read it, and change nothing in it.

    Raises:
        InputError: there is no such model or revision, it is gated, it has no safetensors or no config, or it is not
            in the cache and the network cannot be used. The message says what to do.
    """
    _require_hub_id(repo_id)
    from huggingface_hub import hf_hub_download, try_to_load_from_cache
    from huggingface_hub.errors import EntryNotFoundError

    folder, wanted = Path(), revision
    for name in (CONFIG, WEIGHTS, PREPROCESSOR):
        if name == PREPROCESSOR and try_to_load_from_cache(repo_id, name, revision=wanted) is not None:
            break  # it is here, or known not to exist
        try:
            folder = Path(hf_hub_download(repo_id, name, revision=wanted)).parent
        except EntryNotFoundError as error:
            if name != PREPROCESSOR:
                raise _fetch_error(error, repo_id, name, revision) from error
        except Exception as error:  # the Hub's, the HTTP client's, the operating system's, those of a faster client
            raise _fetch_error(error, repo_id, name, revision) from error
        # The folder is named after the commit: all files come from one, whatever is pushed in the meantime.
        wanted = folder.name
    return folder


def cached(repo_id: str) -> bool:
    """Whether both files of a model's main branch are in the local cache. Needs no network."""
    if not is_hub_id(repo_id):
        return False
    from huggingface_hub import try_to_load_from_cache

    return all(isinstance(try_to_load_from_cache(repo_id, name), str) for name in (CONFIG, WEIGHTS))


def push_folder(folder: Path, repo_id: str, *, private: bool = False, message: str = "Upload a ZoeDepth model") -> str:
    """Upload the files of a folder to the Hub in one commit; the model is created there if need be.

    Args:
        folder: what to upload, subfolders included.
        repo_id: "organisation/model".
        private: only you and your organisation see the model. False leaves that to the settings of the organisation,
            which are usually public, and a model that exists stays as it is.
        message: of the commit.

    Returns:
        The address of the model.

    Raises:
        InputError: the folder is missing or empty, you may not write there, the model is public and should be private,
            the Hub refuses the model card, or the network cannot be used.
    """
    _require_hub_id(repo_id)
    if not folder.is_dir() or not any(folder.iterdir()):
        raise InputError(f"{folder} is not a folder with files: save the model there first")
    from huggingface_hub import HfApi

    api = HfApi()
    try:
        url = api.create_repo(repo_id, private=private or None, exist_ok=True)
        # To an existing model ``private`` means nothing to the Hub; files that were to be private would be public.
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
        raise InputError(f"{repo_id!r} is not the name of a model on the Hub: expected organisation/model")


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
                f"{name} of {repo_id} is not in the cache {constants.HF_HUB_CACHE}, and HF_HUB_OFFLINE forbids to "
                "download it: unset it, or give a folder or file of weights"
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
            "it holds no model of zoedepth or transformers"
            if name == CONFIG
            else "only safetensors are loaded from the Hub, because pickles such as pytorch_model.bin can run code; "
            "ask its owner to convert it, or give a file of weights that you trust"
        )
        return InputError(f"{repo_id} has no {name}: {hint} (its files: {page}/tree/{revision or 'main'})")
    if _status(error) in (401, 403):
        return InputError(f"the Hub does not let you read {repo_id}: {_LOG_IN} ({_first_line(error)})")
    return InputError(
        f"cannot get {name} of {repo_id} from {constants.ENDPOINT}, and it is not in the cache: {_first_line(error)}. "
        "Check the connection and the disk, and type the command again; or give a folder or file of weights"
    )


def _push_reason(error: Exception) -> str:
    if _status(error) == 401:
        return f"you are not logged in; {_LOG_IN}"
    if _status(error) in (403, 404):
        return f"your token may not write there; check the name, and {_LOG_IN} with write access"
    return f"{_first_line(error)}. Check the connection, and type the command again"


def _status(error: Exception) -> int | None:
    return getattr(getattr(error, "response", None), "status_code", None)


def _first_line(error: Exception) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]
