"""A second process beside that of the test: the two that ``torchrun --nproc-per-node 2`` starts, one of them here."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import timedelta

import pytest
import torch.distributed as distributed

HOST = "127.0.0.1"
CODE = """
import json, os, sys
from torch.distributed import TCPStore
from zoedepth.cli import main
TCPStore(os.environ["MASTER_ADDR"], int(os.environ["MASTER_PORT"])).set("imported", "")
print(json.dumps([main(arguments) for arguments in json.loads(sys.argv[1])]))
"""


@dataclass
class Second:
    """The second process. It has nothing to say before it has ended."""

    codes: list[int] = field(default_factory=list)
    """The exit code of each command."""
    errors: str = ""
    """What it wrote to standard error."""


@contextmanager
def beside(*commands: Sequence[str]) -> Iterator[Second]:
    """Run ``zoedepth COMMAND`` for each of the commands in a second process, while the test does the same in this one.

    To start both would take several times as long as what they do. They meet as under torchrun: by the same variables,
    at the same kind of store.

    Yields:
        The second process, whose fields are filled when it has ended, after the block.
    """
    store = distributed.TCPStore(HOST, 0, is_master=True, wait_for_workers=False)
    variables = {
        "MASTER_ADDR": HOST, "MASTER_PORT": str(store.port), "WORLD_SIZE": "2", "LOCAL_WORLD_SIZE": "2",
        "GROUP_RANK": "0", "TORCHELASTIC_RUN_ID": "none", "TORCHELASTIC_RESTART_COUNT": "0",
        "TORCHELASTIC_USE_AGENT_STORE": "True",
    }  # fmt: skip
    second = Second()
    process = subprocess.Popen(
        [sys.executable, "-c", CODE, json.dumps([list(map(str, command)) for command in commands])],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, **variables, "OMP_NUM_THREADS": "1", "RANK": "1", "LOCAL_RANK": "1"},
    )  # fmt: skip
    try:
        store.wait(["imported"], timedelta(seconds=300))
        with pytest.MonkeyPatch.context() as patch:
            for name, value in {**variables, "RANK": "0", "LOCAL_RANK": "0"}.items():
                patch.setenv(name, value)
            yield second
        output, second.errors = process.communicate(timeout=300)
        assert process.returncode == 0, second.errors[-3000:]
        second.codes = json.loads(output.splitlines()[-1])
    finally:
        process.kill()
        if distributed.is_initialized():
            distributed.destroy_process_group()
