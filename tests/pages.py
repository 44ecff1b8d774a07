"""The pages of the documentation, as tests read them."""

import re


def blocks(page: str, language: str) -> list[str]:
    """Return the programs, commands or files of a language that a page in Markdown shows."""
    return re.findall(rf"```{language}\n(.*?)```", page, flags=re.DOTALL)
