"""The one thing that pyproject.toml cannot say: README.md as a package index shows it.

The README links to files beside it. An index has none of them, so a link into the project becomes
its words, and a picture is left out.
"""

import re
from pathlib import Path

from setuptools import setup


def for_index(text: str) -> str:
    """Markdown without pictures and links that lead into the project."""
    text = re.sub(r"!\[[^\]]*\]\((?!https?://)[^)]*\)\n*", "", text)
    return re.sub(r"\[([^\]]*)\]\((?!https?://)[^)]*\)", r"\1", text)


if __name__ == "__main__":
    readme = Path(__file__).with_name("README.md").read_text(encoding="utf-8")
    setup(long_description=for_index(readme), long_description_content_type="text/markdown")
